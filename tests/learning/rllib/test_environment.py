"""The arms of RLlib's runners, without Ray: together they are the rows of one environment."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.rllib.environment import make_runner_env

OPTIONS = {"scene": "three_tendon", "fidelity": "fast"}


class Context(dict):
    """As RLlib's EnvContext: settings, and which runner it is."""

    worker_index = 0


def runner(index, rows, **more):
    context = Context(task="TipPose", options=OPTIONS, episode_steps=4, threads=1, seed=7, num_envs=rows, **more)
    context.worker_index = index
    return make_runner_env(context)


@pytest.mark.parametrize("indices", [(1, 2), (0,)])
def test_runners_have_the_rows_of_one_environment_each_its_own(indices):
    rows = 4 // len(indices)
    envs = [runner(index, rows) for index in indices]
    whole = gym.make_vec(IDS["TipPose"], num_envs=4, vectorization_mode="vector_entry_point", max_episode_steps=4, **OPTIONS)
    expected, _ = whole.reset(seed=7)
    seen = [env.reset(seed=100 + index)[0] for env, index in zip(envs, indices, strict=True)]
    np.testing.assert_array_equal(np.concatenate(seen), expected)
    assert len({row.tobytes() for row in expected}) == 4
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 3)).astype(np.float32)
    for _ in range(6):  # past the end of an episode
        results = [env.step(part) for env, part in zip(envs, np.split(actions, len(envs)), strict=True)]
        expected = whole.step(actions)
        for part in range(4):
            np.testing.assert_array_equal(np.concatenate([result[part] for result in results]), expected[part])
        assert all(result[4] == {} for result in results)


def test_a_reset_without_seed_goes_on_with_the_rows_generators():
    env = runner(1, 2)
    first, _ = env.reset(seed=1)
    assert not np.array_equal(first, env.reset()[0])
    assert env.reset(seed=3)[1] == {} and env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP
