"""What tests of environments share: rows beside single environments."""

import numpy as np
import pytest


@pytest.fixture
def rows_alike(same):
    """rows_alike(vector, singles, steps): asserts that rows, from seed 5 on, are bit for bit the single environments named for them.

    Yields observations and info of the vector environment after each of the steps with random actions, and closes it at the end.
    """

    def compared(vector, singles, steps):
        rows, _ = vector.reset(seed=5)
        assert all(same(env.reset(seed=5 + row)[0], rows[row]) for row, env in singles.items())
        for actions in np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *vector.action_space.shape)).astype(np.float32):
            rows, rewards, *_, infos = vector.step(actions)
            for row, env in singles.items():
                observation, reward, *_, info = env.step(actions[row])
                assert same(observation, rows[row]) and reward == rewards[row]
                assert all(infos[name][row] == value for name, value in info.items())
            yield rows, infos
        vector.close()

    return compared
