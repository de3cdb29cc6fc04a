"""Stability margins: closed forms of known loops, and the latency at which an arm really becomes unstable."""

import math

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.evaluation.margins import SETTLING, WATCHED, Margins, loop_margins, margins_of
from soft_tendon_env.evaluation.play import play
from soft_tendon_env.policies.controller_policy import make_policy, observation_options

PERIOD = 0.02
ARM = {"scene": "three_tendon", "fidelity": "fast", "target": "hold"}


def integrator_response(gain, late, steps=4000):
    """Input sensitivity of the loop gain z^-late / (z - 1): u_k = d_k - v_k, v_(k+1) = v_k + gain u_(k-late)."""
    u, v = np.zeros(steps), np.zeros(steps + 1)
    for k in range(steps):
        u[k] = (k == 0) - v[k]
        v[k + 1] = v[k] + (gain * u[k - late] if k >= late else 0.0)
    return u


@pytest.mark.parametrize("gain", [0.2, 0.5, 1.0])
def test_margins_of_a_sampled_integrator(gain):
    """|L| = gain / (2 sin(w / 2)), arg L = -pi / 2 - w / 2: the gain can grow to 2, at half the rate."""
    crossing = 2.0 * math.asin(gain / 2.0)
    expected = (math.pi / 2.0 - crossing / 2.0) / crossing * PERIOD
    found = margins_of(integrator_response(gain, 0)[:, None, None], PERIOD)
    assert found.delay == pytest.approx(expected, rel=1e-3)
    assert found.gain == pytest.approx(2.0 / gain, rel=1e-2)


def test_a_period_of_delay_takes_a_period_off_the_delay_margin():
    before, after = (margins_of(integrator_response(0.3, late)[:, None, None], PERIOD).delay for late in (0, 1))
    assert before - after == pytest.approx(PERIOD, rel=1e-3)


def test_margins_of_many_loops_are_those_of_the_worst():
    """Two loops, mixed by a rotation of inputs and outputs, which no eigenvalue feels."""
    slow, quick = integrator_response(0.1, 0), integrator_response(0.8, 0)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    mixed = np.einsum("ij,mj,kj->mik", turn, np.stack([slow, quick], axis=1), turn)
    alone = margins_of(quick[:, None, None], PERIOD)
    assert margins_of(mixed, PERIOD) == pytest.approx(alone, rel=1e-6)


def test_a_loop_that_is_open_has_no_end_of_its_margins():
    response = np.zeros((50, 2, 2))
    response[0] = np.eye(2)
    assert margins_of(response, PERIOD) == Margins(math.inf, math.inf)


def arms(rows, **more):
    steps = round((SETTLING + WATCHED) / PERIOD)
    options = {**ARM, **observation_options("tracking", "TipPose"), **more}
    return gym.make_vec("TendonRod-TipPose-v0", num_envs=rows, max_episode_steps=steps, **options).unwrapped


@pytest.fixture(scope="module")
def tracking():
    """The tracking controller's margins about a pose of the small arm."""
    envs = arms(4)
    return loop_margins(make_policy("tracking", envs), envs, 3)


def test_latency_makes_an_arm_unstable_where_the_margin_says(tracking):
    """By the motion about the same pose: it dies out below the margin and grows beyond it."""

    def unrest(latency):
        options = {**ARM, **observation_options("tracking", "TipPose"), "randomize": {"latency": latency}}
        env = gym.make("TendonRod-TipPose-v0", max_episode_steps=500, **options)
        tension = play(make_policy("tracking", env), env, [3])[0].tension
        return np.abs(np.diff(tension[-100:], axis=0)).max()

    assert 0.0 < tracking.delay < 0.2 and tracking.gain > 1.0
    assert unrest(0.8 * tracking.delay) < 1e-3
    assert unrest(1.3 * tracking.delay) > 1e-1


class Blind:
    """Acts without looking: `size`, and its opposite, in turns."""

    def __init__(self, size):
        self.size = size

    def predict(self, observation, state=0, episode_start=None, deterministic=False):
        k = state or 0
        return np.full((len(observation), 3), self.size * (-1.0) ** k), k + 1


@pytest.mark.parametrize("size, margins", [(0.5, Margins(0.0, 1.0)), (0.0, Margins(math.inf, math.inf))], ids=["restless", "still"])
def test_a_policy_that_does_not_come_to_rest_has_no_margins_and_one_that_sees_nothing_all(size, margins):
    envs = arms(4)
    assert loop_margins(Blind(size), envs, 3) == margins
    assert envs.episodes.actuation.disturbance is None


def test_rows_have_to_be_one_more_than_tendons():
    with pytest.raises(ValueError, match="should have 4 rows, one more than tendons, not 3"):
        loop_margins(None, arms(3), 3)
