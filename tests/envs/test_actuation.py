"""From actions to tensions, and commands on their way: elastic tendons, actuators that lag and are
late, friction, states in mid-delay."""

import numpy as np
import pytest

from soft_tendon_env.envs import TipPoseEnv
from soft_tendon_env.model.statics import commanded_equilibrium

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
LIMITS = np.array([-0.002, 0.012])  # [m]


def tension_after(env, *actions):
    env.reset(seed=0)
    for action in actions:
        env.step(action)
    return env.episodes.tension[0]


def test_tensions_go_from_limit_to_limit():
    env = TipPoseEnv(**SMALL, action="tension")
    np.testing.assert_array_equal(tension_after(env, [-1.0, 0.0, 1.0]), [0.0, 2.5, 5.0])
    np.testing.assert_array_equal(tension_after(env, [-7.0, 0.5, 7.0]), [0.0, 3.75, 5.0])  # clipped
    env = TipPoseEnv(**SMALL, action="tension", tension_limits=[-1.0, 3.0])
    np.testing.assert_allclose(tension_after(env, [-1.0, 0.0, 1.0]), [-1.0, 1.0, 3.0])


@pytest.mark.parametrize(
    ("limits", "start"),
    [([0.0, 5.0], 0.0), ([-2.0, 5.0], 0.0), ([1.0, 5.0], 1.0), ([-5.0, -1.0], -1.0)],
)
@pytest.mark.parametrize("action", ["tension", "increment"])
def test_episodes_begin_at_rest_under_the_tension_nearest_to_zero(limits, start, action):
    env = TipPoseEnv(
        **SMALL, tension_limits=limits, action=action, observation=["last_action", "rates"]
    )
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(env.episodes.tension[0], start)
    begun = env.episodes.arms.reading.tip_pose[0].copy()
    still = np.zeros(3) if action == "increment" else observation[:3].astype(float)
    assert action == "increment" or np.allclose(
        limits[0] + 0.5 * np.ptp(limits) * (still + 1.0), start, atol=1e-6
    )
    assert not observation[env.episodes.layout.slices["rates"]].any()
    for _ in range(5):
        env.step(still)
    np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], begun, atol=1e-7)


def test_increments_add_up_within_their_rate_and_the_limits():
    env = TipPoseEnv(**SMALL, tension_rate=50.0)  # 1 N a step
    np.testing.assert_allclose(tension_after(env, [1.0, 0.5, -1.0]), [1.0, 0.5, 0.0])
    np.testing.assert_allclose(
        tension_after(env, [1.0, 0.5, -1.0], [1.0, 0.5, 1.0]), [2.0, 1.0, 1.0]
    )  # no wind-up at the limit
    np.testing.assert_allclose(tension_after(env, *[[9.0, 0.1, 0.0]] * 7), [5.0, 0.7, 0.0])
    np.testing.assert_allclose(tension_after(env, *[[1.0] * 3] * 9, [-1.0] * 3), 4.0)
    np.testing.assert_array_equal(tension_after(env), 0.0)


def test_an_action_that_is_held_leads_to_the_equilibrium_of_its_displacements():
    springs = {
        "scene": "three_tendon",
        "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": LIMITS.tolist()},
    }
    env = TipPoseEnv(scene=springs, fidelity="fast", action="tension")
    env.reset(seed=0)
    action = np.array([0.5, -1.0, -1.0])
    for _ in range(1000):
        env.step(action)
    found, tension = commanded_equilibrium(
        env.model, LIMITS[0] + 0.5 * np.ptp(LIMITS) * (action + 1.0)
    )
    np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], found.tip_pose, atol=1e-6)
    np.testing.assert_allclose(env.episodes.tension[0], tension, atol=1e-3)
    assert tension.max() > 0.5, "one is slack"
    assert tension.min() == 0.0, "one is slack"
