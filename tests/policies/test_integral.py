"""Integral action: what a policy sees of its target, row by row; agents that ship act with it."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.policies.integral import IntegralPolicy

FAST = {"scene": "three_tendon", "fidelity": "fast"}
TIME = 0.4  # [s], twenty control periods


class Seen:
    """A policy that does nothing, and keeps what it sees."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.last = observation
        flat = observation["observation"] if isinstance(observation, dict) else observation
        return (
            np.zeros((*flat.shape[:-1], 3), dtype=np.float32),
            (0 if state is None else state) + 1,
        )


def rows_of(task, rows=2, **options):
    return gym.make_vec(IDS[task], num_envs=rows, **FAST, **options)


def observed(envs, **ways):
    """An observation of zeros but for these groups, the same for all rows."""
    layout = envs.unwrapped.episodes.layout
    flat = np.zeros((envs.num_envs, layout.space.shape[0]), dtype=np.float32)
    for name, value in ways.items():
        flat[:, layout.slices[name]] = value
    return flat


def groups(envs, seen):
    return {name: seen[:, where] for name, where in envs.unwrapped.episodes.layout.slices.items()}


def test_ways_are_seen_with_their_integral_now_and_ahead():
    envs = rows_of("TipPose")
    policy = Seen()
    way = np.array([0.1, 0.0, -0.2, 0.3, 0.05, 0.0], dtype=np.float32)
    given, state = (
        observed(envs, target_error=way, preview=np.tile(2.0 * way, 2), tip_position=0.5),
        None,
    )
    integral = IntegralPolicy(policy, envs, TIME)
    for calls in range(1, 5):
        _, state = integral.predict(given, state)
        seen = groups(envs, policy.last)
        share = calls * envs.unwrapped.episodes.period / TIME
        np.testing.assert_allclose(
            seen["target_error"], np.tile((1.0 + share) * way, (2, 1)), rtol=1e-6
        )
        expected_preview = np.tile((2.0 + share) * way, (2, 2))
        np.testing.assert_allclose(seen["preview"], expected_preview, rtol=1e-6)
        assert (seen["tip_position"] == 0.5).all()
        assert policy.last.dtype == np.float32
        assert state.policy == calls
    assert (groups(envs, given)["target_error"] == way).all()  # as it was


def test_a_target_that_is_not_observed_as_a_way_is_refused():
    with pytest.raises(
        ValueError,
        match=(
            "integral_time needs an observation with one of target_error, .*; it has coordinates,"
            " rates"
        ),
    ):
        IntegralPolicy(
            Seen(), rows_of("TipPose", observation=("coordinates", "rates", "target_twist")), TIME
        )


def test_goals_move_with_the_integral_of_the_way_to_them():
    """In a tenth of the rod's length: the integral is bounded in these units."""
    envs = rows_of("Reach")
    policy = Seen()
    length = envs.unwrapped.episodes.model.length
    way = np.array([0.01, -0.005, 0.002])
    tip = np.tile([0.1, 0.2, 0.0], (2, 1)).astype(np.float32)
    goal = (tip + way).astype(np.float32)
    flat = np.zeros((2, 3), dtype=np.float32)
    given = {"observation": flat, "achieved_goal": tip, "desired_goal": goal}
    integral = IntegralPolicy(policy, envs, TIME)
    state = None
    share = envs.unwrapped.episodes.period / TIME
    for calls in range(1, 4):
        _, state = integral.predict(given, state)
        moved = policy.last["desired_goal"] - goal
        expected_moved = np.tile(calls * share * way, (2, 1))
        np.testing.assert_allclose(moved, expected_moved, atol=1e-7)
        np.testing.assert_array_equal(policy.last["achieved_goal"], tip)
    for _ in range(200):
        _, state = integral.predict(given, state)
    most = np.minimum(np.abs(way) * 203 * share, 0.1 * 0.1 * length)
    np.testing.assert_allclose(
        policy.last["desired_goal"] - goal, np.tile(np.sign(way) * most, (2, 1)), atol=1e-7
    )


def test_nothing_is_integrated_on_the_way_and_nothing_is_left_of_the_last_episode():
    """Row by row; any part of the error that is large is enough."""
    envs = rows_of("TipPose")
    policy = Seen()
    near = np.full(6, 0.4, dtype=np.float32)
    far = np.full(6, 0.1, dtype=np.float32)
    far[2] = -0.9
    given = observed(envs, target_error=near)
    columns = envs.unwrapped.episodes.layout.slices["target_error"]
    given[1, columns] = far
    integral = IntegralPolicy(policy, envs, TIME)
    _, state = integral.predict(given, None)
    share = envs.unwrapped.episodes.period / TIME
    expected_integral = [[share * 0.4] * 6, [0.0] * 6]
    np.testing.assert_allclose(state.integral, expected_integral, rtol=1e-6)
    begins = np.array([True, False])
    given[1, columns] = near
    _, state = integral.predict(given, state, begins)
    np.testing.assert_allclose(state.integral, share * 0.4, rtol=1e-6)
    alone, _ = IntegralPolicy(policy, envs, TIME).predict(given[0], None)
    assert alone.shape == (3,)
    assert policy.last.shape == given[0].shape


def test_integrals_quicker_than_a_period_are_refused():
    with pytest.raises(ValueError, match="integral_time should be at least a control period"):
        IntegralPolicy(Seen(), rows_of("TipPose"), 0.019)
