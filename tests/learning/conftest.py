"""A small training, which tests change."""

import pytest

from soft_tendon_env.learning.config import Training


@pytest.fixture(scope="session")
def table():
    """The table of a small training: 256 steps of PPO in four rows."""
    return {
        "task": "TipPose",
        "algorithm": "PPO",
        "steps": 256,
        "arms": 4,
        "seconds": 0.4,
        "hyperparameters": {"n_steps": 16, "batch_size": 32, "n_epochs": 1},
        "options": {"scene": "three_tendon", "fidelity": "fast"},
        "evaluation": {"every": 128, "episodes": 2, "skip": 0.2},
    }


@pytest.fixture(scope="session")
def training(table):
    """training(steps=..., ...): the same, changed."""
    return lambda **changes: Training.parse({**table, **changes}, "file")
