"""Accuracy against computing time: test motions, references, passive fields, trials.

References are converged, passive fields come from snapshots, trials are of an arm.
"""
