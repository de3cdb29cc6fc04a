"""A training that tests change."""

import pytest

from soft_tendon_env import register
from soft_tendon_env.learning.config import Training


@pytest.fixture
def recurrent_ppo(forgotten):
    """RecurrentPPO, which users register."""
    from sb3_contrib import RecurrentPPO

    register("algorithm", "RecurrentPPO", RecurrentPPO)


@pytest.fixture(scope="session")
def training(table):
    """training(steps=..., ...): the same, changed."""
    return lambda **changes: Training.parse({**table, **changes}, "file")
