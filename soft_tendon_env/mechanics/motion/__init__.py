"""Time integration and static balance: steps of the integrator, whole motions, batches of arms."""
