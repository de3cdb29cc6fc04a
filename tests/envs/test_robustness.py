"""Saturated random actions for long: nothing raises, nothing is NaN, nothing grows."""

import gc
import sys

import numpy as np
import pytest

from soft_tendon_env.envs import ReachVectorEnv, ShapeVectorEnv, TipPoseEnv, TipPoseVectorEnv

KINDS = (TipPoseVectorEnv, ShapeVectorEnv, ReachVectorEnv)


def saturate(vector, steps, seed=0):
    """Step with actions of -1 and 1, new at random times; counts of ended and of diverged episodes."""
    rng = np.random.default_rng(seed)
    vector.reset(seed=seed)
    ended = diverged = 0
    action = rng.choice([-1.0, 1.0], vector.action_space.shape)
    for _ in range(steps):
        change = rng.random(action.shape) < 0.3
        action = np.where(change, -action, action)
        observation, reward, terminated, truncated, info = vector.step(action)
        assert vector.observation_space.contains(observation)
        assert (reward >= 0.0).all() and (reward <= 1.0).all()
        assert all(np.isfinite(values).all() for values in info.values() if values.dtype.kind == "f")
        assert (info["diverged"] == terminated).all()
        ended, diverged = ended + int((terminated | truncated).sum()), diverged + int(terminated.sum())
    return ended, diverged


@pytest.mark.parametrize("kind", KINDS)
def test_saturated_actions_at_the_limits_of_the_paper_s_arm(kind):
    assert saturate(kind(64, 60, fidelity="fast", tension_limits=[0.0, 60.0]), 130) == (128, 0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_episodes_of_saturated_actions(kind):
    assert saturate(kind(64, 500, fidelity="fast", tension_limits=[0.0, 60.0]), 16 * 501) == (1024, 0)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"fidelity": "standard"}, {"fidelity": "fast", "action": "increment"}])
@pytest.mark.parametrize("kind", KINDS)
def test_saturated_actions_for_long(kind, options):
    assert saturate(kind(64, 500, tension_limits=[0.0, 60.0], **options), 1100)[1] == 0


@pytest.mark.parametrize("kind", KINDS)
def test_saturated_actions_on_random_arms(kind, arm, everything):
    options = {**arm, "randomize": everything, "observation": "measurable", "sensors": [0.1, 0.3]}
    buckles = isinstance(arm.get("scene"), dict) and "strain.include_loads" in arm["scene"]  # soft ones do, under the loads inside
    assert saturate(kind(16, 40, **options), 100)[1] <= (4 if buckles else 0)


WILD = {
    "pushing": {"tension_limits": [-600.0, 0.0]},
    "pulling": {"tension_limits": [0.0, 3000.0]},
    "far too soft": {"randomize": {"stiffness": [0.01, 0.1], "payload": [0.0, 1.0], "density": [0.1, 10.0]}},
    "heavy errors": {"randomize": {"tension_gain": [0.0, 5.0], "tension_offset": [-100.0, 100.0], "latency": [0.0, 1.0]}},
    "few halvings": {"scene": {"scene": "paper", "integrator.max_halvings": 1}, "fidelity": None, "tension_limits": [-100.0, 300.0]},
    "long periods": {"control_period": 2.5},
}


@pytest.mark.parametrize("how", WILD)
@pytest.mark.parametrize("kind", KINDS)
def test_wild_arms_end_in_order(kind, how):
    saturate(kind(8, 40, **{"fidelity": "fast", **WILD[how]}), 50)


def test_memory_does_not_grow():
    env, vector = (kind(scene="three_tendon", fidelity="fast") for kind in (TipPoseEnv, TipPoseVectorEnv))

    def live():
        env.reset(seed=0)
        for _ in range(10):
            env.step(np.ones(3))
        vector.reset(seed=0)
        vector.step(np.ones((1, 3)))

    blocks = []
    for _ in range(10):
        for _ in range(100):
            live()
        gc.collect()
        blocks.append(sys.getallocatedblocks())
    assert np.diff(blocks).min() < 10  # a leak would show in every hundred
