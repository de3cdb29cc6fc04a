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
    envs, policy = rows_of("TipPose"), Seen()
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
        np.testing.assert_allclose(seen["preview"], np.tile((2.0 + share) * way, (2, 2)), rtol=1e-6)
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
