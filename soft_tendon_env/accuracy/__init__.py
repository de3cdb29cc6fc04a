"""Accuracy against computing time: test motions, converged references, passive fields from
snapshots, trials of an arm."""
