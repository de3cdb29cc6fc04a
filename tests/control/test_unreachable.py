"""Targets out of reach are held as near as possible, without trembling; once they are within reach again nothing is left of that."""

import numpy as np
import pytest
from scipy.optimize import minimize

from soft_tendon_env.control import CONTROLLERS, Reference
from soft_tendon_env.control.objectives import Dynamics, TipPose, TipPosition
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
FAR = np.array([2.0, 1.0, 0.5])
CASES = [(task, name) for task in ("TipPose", "Reach") for name in CONTROLLERS[task] if name != "paper"]  # unstable at this period
LONG = [pytest.param(scene, marks=pytest.mark.slow) for scene in ("catheter", "paper")]


@pytest.fixture
def far():
    """Beyond the length of every arm here."""
    pose = np.eye(4)
    pose[:3, 3] = FAR
    return Reference(np.zeros(1), pose[None], FAR[None])


def missed(posed, model, target, tip):
    """How far a tip is from the target [m], as controllers of the pose count, or those of the position alone."""
    objective = TipPose(0.1 * model.length) if posed else TipPosition()
    rest = np.zeros(model.coordinate_count)
    return np.linalg.norm(objective.aim(Dynamics(rest, rest, model.terms(rest, rest)._replace(tip_pose=tip)), target, 0.0, PERIOD).error)


def least_missed(posed, model, target, limits):
    """That of the nearest tip at rest, by a search that no controller uses."""
    least, greatest = limits.T

    def cost(tension):
        return missed(posed, model, target, model.tip_pose(model.rest_coordinates(tension)))

    starts = (least + share * (greatest - least) for share in (0.01, 0.3))
    found = [minimize(cost, start, method="L-BFGS-B", bounds=limits) for start in starts]
    return min(each.fun for each in found)


@pytest.mark.parametrize("scene", ["four_tendon", "three_tendon", *LONG])
@pytest.mark.parametrize("task, name", CASES)
def test_what_cannot_be_reached_is_approached_and_held_still(build, limits_of, drive, far, task, name, scene):
    """With feedforward alone the arm still swings after five seconds."""
    model, limits = build(scene), limits_of(build(scene))
    motion = drive(CONTROLLERS[task][name].make(model, limits, PERIOD), model, far, 250)
    change = np.abs(np.diff(motion.tension[-26:], axis=0)) / np.ptp(limits, axis=1)
    move = np.linalg.norm(np.diff(motion.tip[-26:, :3, 3], axis=0), axis=1)
    posed = task == "TipPose" and name != "tracking_position"
    away = missed(posed, model, far, motion.tip[-1]) - least_missed(posed, model, far, limits)
    assert change.max() < 0.01
    assert move.max() < (1e-2 if name == "feedforward" else 1e-3) * model.length
    assert abs(away) < 0.02 * model.length


@pytest.mark.parametrize("scene", ["three_tendon", LONG[1]])
@pytest.mark.parametrize("task, name", [case for case in CASES if case[1] != "feedforward"])
def test_nothing_is_wound_up(build, limits_of, drive, holding, far, task, name, scene):
    """From the same motion, a memory of three seconds out of reach settles about as fast as none."""
    model, limits = build(scene), limits_of(build(scene))
    controller, near = CONTROLLERS[task][name].make(model, limits, PERIOD), holding(model, 0.2 * limits[:, 1])
    simulation = Simulation(model)
    held = drive(controller, simulation, far, 150)
    beginning = simulation.state
    took = []
    for memory in (held.memory, None):
        simulation.reset(beginning.q, beginning.q_dot)
        tip = drive(controller, simulation, near, 150, memory).tip[:, :3, 3]
        away = np.linalg.norm(tip - near.tip_position[0], axis=1)
        outside = np.flatnonzero(away > 0.02 * away[0])
        took.append(PERIOD * outside[-1])
    assert away[0] > 0.05 * model.length and took[1] < 1.0
    assert took[0] < 1.5 * took[1] + PERIOD
