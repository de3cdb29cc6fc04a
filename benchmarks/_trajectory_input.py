"""The tensions that the benchmarks run on: a second of lively pulls on five of the paper's ten
tendons.

The same as in tests/data/trajectories.json and examples/paper_trajectory.py.
"""

import numpy as np

DURATION = 1.0  # [s]


def tensions_at(times: np.ndarray) -> np.ndarray:
    """Tensions [N], (times, 10), at times [s]."""
    u = np.zeros((len(times), 10))
    u[:, 0] = 6.0 * np.sin(np.pi * times) ** 2
    u[:, 3] = 4.0 * np.sin(2.0 * np.pi * times) ** 2
    u[:, 5] = 2.5 * (1.0 - np.cos(2.0 * np.pi * times / 1.5))
    u[:, 8] = 3.0 * np.sin(np.pi * times) ** 2
    u[times >= 0.5, 1:3] = 8.0, 5.0
    return u


def tension_table(step: float) -> np.ndarray:
    """Tensions in the middle of each step of the input, (steps, 10); to be held over the step."""
    return tensions_at(step * (np.arange(round(DURATION / step)) + 0.5))
