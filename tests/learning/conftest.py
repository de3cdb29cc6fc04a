"""A training that tests change."""

import pytest

from soft_tendon_env.learning.config import Training


@pytest.fixture(scope="session")
def training(table):
    """training(steps=..., ...): the same, changed."""
    return lambda **changes: Training.parse({**table, **changes}, "file")
