"""A policy of your own in the benchmark, against a model-based one: a plain function. `python examples/own_policy.py`

It is found as module:name, so that `PYTHONPATH=examples soft-tendon arena --policies own_policy:bend filtered:tracking` plays it too. An
agent of rl_zoo3 or of Stable-Baselines3 needs no code: name its .zip file or its folder.
"""

import sys
from pathlib import Path

import numpy as np

from soft_tendon_env.cli.main import main

ANGLES = np.deg2rad([0.0, 120.0, 240.0])  # of the first three tendons of the paper's arm, which run straight along its surface


def bend(env):
    """Turns up the tendons on the side where the target is, and the others down: integral control that knows no model. `env` is its own."""
    directions = np.zeros((env.action_space.shape[-1], 2))
    directions[:3] = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)

    def act(observation):
        """Actions (rows, n_a) from target_error (rows, 6): angular, then linear in the tip's frame, in tenths of the arm's length."""
        return np.clip(0.05 * observation[:, 4:6] @ directions.T, -1.0, 1.0)

    return act


bend.options = {"observation": ["target_error"], "action": "increment"}

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    arguments = sys.argv[1:] or ["--settings", "nominal", "--regimes", "tip", "--episodes", "4"]
    main(["arena", "--policies", "own_policy:bend", "filtered:tracking@fast", "--out", "out/own_policy", *arguments])
