"""Rewards in terms of the deviation of discounted returns, over episodes that come in parts."""

import numpy as np
import pytest
from stable_baselines3.common.running_mean_std import RunningMeanStd

from soft_tendon_env.learning.rllib.returns import Chunk, ReturnScale

GAMMA = 0.9


def discounted(rewards):
    """R_t = gamma R_{t-1} + r_t."""
    returns, last = [], 0.0
    for reward in rewards:
        last = GAMMA * last + reward
        returns.append(last)
    return returns


def test_rewards_are_divided_by_the_deviation_of_all_returns_so_far():
    random = np.random.default_rng(0)
    first, second = random.normal(1.0, 2.0, 7), random.normal(1.0, 2.0, 5)
    out = ReturnScale(GAMMA, 10.0)([Chunk("a", first, False), Chunk("b", second, True)])
    moments = RunningMeanStd(shape=())
    moments.update(np.array(discounted(first) + discounted(second)))
    for given, normalised in zip((first, second), out, strict=True):
        np.testing.assert_allclose(normalised, given / np.sqrt(moments.var + 1e-8), rtol=1e-12)


@pytest.mark.parametrize("ends", [False, True])
def test_an_episode_goes_on_where_its_last_part_ended_unless_it_did(ends):
    rewards = np.random.default_rng(1).normal(size=12)
    parts = ReturnScale(GAMMA, 10.0)
    parts([Chunk("a", rewards[:5], ends)])
    parts([Chunk("a", rewards[5:5], False)])
    parts([Chunk("a", rewards[5:], True)])
    moments = RunningMeanStd(shape=())
    whole = discounted(rewards)
    moments.update(np.array(whole[:5]))
    moments.update(np.array(discounted(rewards[5:]) if ends else whole[5:]))
    state = parts.get_state()
    assert state["mean"] == pytest.approx(float(moments.mean), rel=1e-12) and state["var"] == pytest.approx(float(moments.var), rel=1e-12)


def test_large_rewards_are_cut_off():
    scale = ReturnScale(0.0, 2.0)
    (out,) = scale([Chunk("a", np.array([0.0] * 99 + [1e3]), True)])
    assert out[-1] == 2.0 and not out[:-1].any()


def test_its_state_goes_on_in_another():
    rewards = [Chunk("a", np.random.default_rng(2).normal(size=9), True)]
    one, other = ReturnScale(GAMMA, 10.0), ReturnScale(GAMMA, 10.0)
    one(rewards)
    other.set_state(one.get_state())
    np.testing.assert_array_equal(one(rewards)[0], other(rewards)[0])
