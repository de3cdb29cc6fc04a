"""Time integration and static balance: steps of the integrators, whole motions, batches of arms."""
