"""A policy of your own in the benchmark, against a model-based one. `python examples/own_policy.py`

It is found as module:name, so that
`PYTHONPATH=examples soft-tendon arena --policies own_policy:Bend filtered:tracking` plays it too.
"""

import sys
from pathlib import Path

import numpy as np

from soft_tendon_env.cli.main import main

ANGLES = np.deg2rad(
    [0.0, 120.0, 240.0]
)  # of the first three tendons of the paper's arm, which run straight along its surface


class Bend:
    """Turns up the tendons on the side where the target is, and the others down: integral control
    that knows no model. `env` is its own."""

    options = {"observation": ["target_error"], "action": "increment"}

    def __init__(self, env):
        self.directions = np.zeros((env.action_space.shape[-1], 2))
        self.directions[:3] = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        """Actions (..., n_a) from target_error (..., 6): angular, then linear in the tip's frame,
        in tenths of the arm's length."""
        return np.clip(0.05 * observation[..., 4:6] @ self.directions.T, -1.0, 1.0), state


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    arguments = sys.argv[1:] or ["--settings", "nominal", "--regimes", "tip", "--episodes", "4"]
    main(
        [
            "arena",
            "--policies",
            "own_policy:Bend",
            "filtered:tracking@fast",
            "--out",
            "out/own_policy",
            *arguments,
        ]
    )
