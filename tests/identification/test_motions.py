"""Identification from motions: damping, lag and delay of commands, friction, and friction that the scene does not have."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.identification import identify
from soft_tendon_env.identification.identify import randomize

LAG, DELAY, FRICTION = 0.05, 0.033, 0.4
PERIOD = 0.01


@pytest.fixture(scope="module")
def moving(arm):
    """The arm with actuators that lag and tendons that rub, by other numbers than those of the robot."""
    return arm.replace({"effects.actuators.time_constant": 0.03, "effects.tendon_friction.coefficient": 0.05, "integrator.step": PERIOD})


@pytest.fixture(scope="module")
def robot(moving):
    """Numbers of the robot."""
    damping = 1.4 * moving.segments[0].damping
    actuators = {"effects.actuators.time_constant": LAG, "effects.actuators.delay": DELAY}
    return {"segments.0.damping": damping, **actuators, "effects.tendon_friction.coefficient": FRICTION}


@pytest.fixture(scope="module")
def steps(record_of, moving, robot):
    """Three motions of steps between random tensions."""
    random = np.random.default_rng(2)
    tensions = [np.repeat(random.uniform(0.0, 4.0, (3, 3)), 40, axis=0) for _ in range(3)]
    return [record_of(moving, f"steps{i}", robot, table, period=PERIOD, seed=i) for i, table in enumerate(tensions)]


@pytest.mark.slow
def test_damping_lag_delay_and_friction_are_found_from_steps(moving, steps, robot, placed):
    asked = ["segments.*.damping", "effects.actuators.time_constant", "commands.delay", "effects.tendon_friction.coefficient"]
    found = identify(moving, steps, placed, asked, fidelity="scene", held_out=0)
    truth = [robot["segments.0.damping"], LAG, DELAY, FRICTION]
    assert found.value == pytest.approx(truth, rel=0.05)
    assert ((found.intervals.low <= truth) & (truth <= found.intervals.high)).all() and not found.findings
    assert found.scene.effects.actuators.delay == pytest.approx(found.value[2])
    table = randomize(found)
    assert table["latency"] == [0.0, found.intervals.high[2] - found.value[2]]  # on top of the scene's delay
    env = gym.make("TendonRod-Reach-v1", scene=found.scene, fidelity="fast", randomize=table)
    env.reset(seed=0)
    assert 0.0 < env.unwrapped.episodes.actuation.delay(0) < 0.1 * DELAY


@pytest.mark.slow
def test_damping_alone_is_told_to_be_not_enough_where_tendons_rub(moving, steps, placed):
    smooth = moving.replace({"effects.tendon_friction.coefficient": 0.0})
    asked = ["segments.*.damping", "effects.actuators.time_constant", "commands.delay"]
    found = identify(smooth, steps, placed, asked, fidelity="scene", held_out=0)
    assert any("viscous damping alone cannot make up for friction" in text for text in found.findings)
