"""From actions to tensions."""

import numpy as np
import pytest

from soft_tendon_env.envs import TipPoseEnv

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


def tension_after(env, *actions):
    env.reset(seed=0)
    for action in actions:
        env.step(action)
    return env.episodes.tension[0]


def test_tensions_go_from_limit_to_limit():
    env = TipPoseEnv(**SMALL)
    np.testing.assert_array_equal(tension_after(env, [-1.0, 0.0, 1.0]), [0.0, 2.5, 5.0])
    np.testing.assert_array_equal(tension_after(env, [-7.0, 0.5, 7.0]), [0.0, 3.75, 5.0])  # clipped
    env = TipPoseEnv(**SMALL, tension_limits=[-1.0, 3.0])
    np.testing.assert_allclose(tension_after(env, [-1.0, 0.0, 1.0]), [-1.0, 1.0, 3.0])


def test_limits_are_the_tendons_own():
    scene = {"scene": "three_tendon", "tendons.1.tension_limits": [0.5, 1.5]}
    env = TipPoseEnv(**{**SMALL, "scene": scene})
    np.testing.assert_allclose(tension_after(env), [0.0, 0.5, 0.0])
    np.testing.assert_allclose(tension_after(env, np.ones(3)), [5.0, 1.5, 5.0])
    env = TipPoseEnv(**{**SMALL, "scene": scene}, tension_limits=[0.0, 2.0])
    np.testing.assert_allclose(tension_after(env, np.ones(3)), 2.0)


@pytest.mark.cases("limits, start", [([0.0, 5.0], 0.0), ([-2.0, 5.0], 0.0), ([1.0, 5.0], 1.0), ([-5.0, -1.0], -1.0)])
@pytest.mark.cases("action", ["tension", "increment"])
def test_episodes_begin_at_rest_under_the_tension_nearest_to_zero(limits, start, action):
    env = TipPoseEnv(**SMALL, tension_limits=limits, action=action, observation=["last_action", "rates"])
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(env.episodes.tension[0], start)
    begun = env.episodes.arms.reading.tip_pose[0].copy()
    still = np.zeros(3) if action == "increment" else observation[:3].astype(float)
    assert action == "increment" or np.allclose(limits[0] + 0.5 * np.ptp(limits) * (still + 1.0), start, atol=1e-6)
    assert not observation[env.episodes.layout.slices["rates"]].any()
    for _ in range(5):
        env.step(still)
    np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], begun, atol=1e-7)


def test_increments_add_up_within_their_rate_and_the_limits():
    env = TipPoseEnv(**SMALL, action="increment", tension_rate=50.0)  # 1 N a step
    np.testing.assert_allclose(tension_after(env, [1.0, 0.5, -1.0]), [1.0, 0.5, 0.0])
    np.testing.assert_allclose(tension_after(env, [1.0, 0.5, -1.0], [1.0, 0.5, 1.0]), [2.0, 1.0, 1.0])  # no wind-up at the limit
    np.testing.assert_allclose(tension_after(env, *[[9.0, 0.1, 0.0]] * 7), [5.0, 0.7, 0.0])
    np.testing.assert_allclose(tension_after(env, *[[1.0] * 3] * 9, [-1.0] * 3), 4.0)
    np.testing.assert_array_equal(tension_after(env), 0.0)


def test_tension_is_held_over_a_control_period_of_several_steps():
    env = TipPoseEnv(scene={"scene": "three_tendon", "integrator.step": 0.01}, control_period=0.05)
    assert env.episodes.arms.substeps == 5
    assert env.metadata["render_fps"] == 20


def test_the_last_action_is_observed_as_clipped():
    env = TipPoseEnv(**SMALL, observation=["last_action"])
    env.reset(seed=0)
    assert env.step([2.0, -0.5, -3.0])[0].tolist() == [1.0, -0.5, -1.0]
