"""Where no time step succeeds: episodes end in order, and other rows go on."""

import numpy as np
import pytest

from soft_tendon_env.envs import TipPoseEnv, TipPoseVectorEnv

# Tendons that push or pull far past what the section holds, and no second try at smaller steps.
WILD = {
    "scene": {"scene": "three_tendon", "integrator.max_halvings": 0},
    "fidelity": None,
    "tension_limits": [-600.0, 600.0],
    "control_period": 0.05,
}


def until_divergence(env, seed=0, steps=200):
    """The step at which a saturated episode ends; the observations before it."""
    observation, _ = env.reset(seed=seed)
    rng, seen = np.random.default_rng(seed), [observation]
    for _ in range(steps):
        result = env.step(rng.choice([-1.0, 1.0], env.action_space.shape))
        seen.append(result[0])
        if result[2] or result[3]:
            return result, seen
    raise AssertionError("nothing diverged")


def test_a_divergence_ends_the_episode():
    env = TipPoseEnv(**WILD)
    (observation, reward, terminated, truncated, info), _ = until_divergence(env)
    assert (terminated, truncated) == (True, False)
    assert reward == 0.0 and info["diverged"] is True and isinstance(info["cause"], str) and info["cause"]
    assert env.observation_space.contains(observation) and np.isfinite(observation).all()
    assert all(np.isfinite(value) for value in info.values() if not isinstance(value, str))
    observation, info = env.reset()
    assert info["diverged"] is False and "cause" not in info


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_other_rows_go_on(mode, same):
    """Rows 0 and 2 are gentle, row 1 is not: the gentle ones are as alone."""
    vector, alone = TipPoseVectorEnv(3, None, mode, **WILD), TipPoseEnv(**WILD)
    vector.reset(seed=3)
    alone.reset(seed=5)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(60):
        action = 0.001 * rng.uniform(-1, 1, (3, 3))
        action[1] = rng.choice([-1.0, 1.0], 3)
        observation, reward, terminated, truncated, info = vector.step(action)
        expected = alone.step(action[2])
        assert same(observation[2], expected[0]) and reward[2] == expected[1] and not terminated[[0, 2]].any() and not truncated.any()
        if terminated[1]:
            ends += 1
            final = info["final_info"] if mode == "same_step" else info
            assert reward[1] == 0.0 and final["diverged"].tolist() == [False, True, False]
            assert isinstance(final["cause"][1], str) and final["_cause"].tolist() == [False, True, False]
    assert ends > 1


def test_an_episode_whose_tip_is_too_fast_ends_as_one_that_diverged():
    """At the first step at which it is faster, and with the speed in its cause; without a limit it goes on."""
    options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_twist"]}
    pull = np.array([1.0, -1.0, -1.0], dtype=np.float32)

    def speeds(**more):
        env = TipPoseEnv(**options, **more)
        env.reset(seed=0)
        found = []
        for _ in range(20):
            _, reward, terminated, _, info = env.step(pull)
            found.append(float(np.linalg.norm(env.episodes.arms.reading.tip_twist[0, 3:])))
            if terminated:
                return found, reward, info
        return found, None, None

    free, _, ended = speeds()
    assert ended is None
    limit = 0.5 * (free[0] + max(free))
    found, reward, info = speeds(tip_speed_limit=limit)
    assert found == free[: len(found)] and found[-1] > limit >= max(found[:-1])
    assert reward == 0.0 and info["diverged"] and f"tip_speed_limit is {limit:g}" in info["cause"]
