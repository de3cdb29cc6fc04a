"""Feedforward from statics: it comes to rest where inverse statics say, also along targets in motion.

Targets out of reach are held as near as possible, without trembling; once they are within reach again nothing is left of that.
"""

import numpy as np
import pytest
from scipy.optimize import minimize

from soft_tendon_env.control import CONTROLLERS, ControllerInput, Reference
from soft_tendon_env.control.feedforward import StaticFeedforward
from soft_tendon_env.control.objectives import Dynamics, TipPose, TipPosition
from soft_tendon_env.model.inverse_statics import tension_for_tip_pose
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.statics import static_equilibrium

PERIOD = 0.02
HEAVY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
ARMS = {
    "paper": ("paper", None),
    "redundant": ("four_tendon", None),
    "heavy": ("three_tendon", HEAVY),
    "loads inside": ("three_tendon", {**HEAVY, "strain.include_loads": True}),
}
FAR = np.array([2.0, 1.0, 0.5])
CASES = [(task, name) for task in ("TipPose", "Reach") for name in CONTROLLERS[task] if name != "paper"]  # unstable at this period
LONG = [pytest.param(scene, marks=pytest.mark.slow) for scene in ("catheter", "paper")]


def decided(controller, model, targets):
    """Equilibria (periods, n) that are followed, with arms that are elsewhere: nothing measured enters."""
    rng, memory, path = np.random.default_rng(0), None, []
    for target in targets:
        q = rng.normal(size=model.coordinate_count)
        memory = controller.act(ControllerInput(q, q, np.eye(4), np.zeros(model.tendon_count), target), memory).memory
        path.append(memory.q)
    return np.array(path)


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_tips_that_tensions_hold_are_reached(build, limits_of, arm, share):
    """To a thousandth of the length, as inverse statics do."""
    model = build(*ARMS[arm])
    limits = limits_of(model)
    tension = share * limits[:, 1] * np.random.default_rng(1).random(model.tendon_count)
    pose = static_equilibrium(model, tension).tip_pose
    found = tension_for_tip_pose(model, pose)
    target = Reference(np.zeros(1), pose[None], pose[None, :3, 3])
    for objective in (TipPose(0.1 * model.length), TipPosition()):
        tip = model.tip_pose(decided(StaticFeedforward(model, limits, PERIOD, objective), model, [target] * 20)[-1])
        assert np.linalg.norm(tip[:3, 3] - pose[:3, 3]) < 1e-3 * model.length
        if isinstance(objective, TipPose):
            assert found.reachable
            np.testing.assert_allclose(tip, found.tip_pose, atol=5e-3 * max(model.length, 1.0))


@pytest.mark.parametrize("arm", ARMS)
def test_moving_tips_are_followed(build, limits_of, arm):
    """A period ahead, from the second period on."""
    model = build(*ARMS[arm])
    limits = limits_of(model)
    phase = np.arange(model.tendon_count)
    at = [0.15 * limits[:, 1] * (1.0 + np.sin(0.1 * k + phase)) for k in range(31)]
    poses = np.stack([static_equilibrium(model, tension).tip_pose for tension in at])
    times = PERIOD * np.arange(2.0)
    targets = [Reference(times, poses[k : k + 2], poses[k : k + 2, :3, 3]) for k in range(30)]
    path = decided(StaticFeedforward(model, limits, PERIOD, TipPose(0.1 * model.length)), model, targets)
    away = np.linalg.norm(np.stack([model.tip_pose(q)[:3, 3] for q in path]) - poses[1:, :3, 3], axis=1)
    assert away.max() < 2e-3 * model.length
    assert np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)) > 0.05 * model.length


def test_the_null_space_is_for_effort_or_for_tightness(build, limits_of):
    """With more to keep tendons tight by, the same position takes more tension, and slack tendons pull."""
    model = build("paper")
    limits = limits_of(model)
    pose = static_equilibrium(model, np.linspace(2.0, 8.0, 10)).tip_pose
    target, tension = Reference(np.zeros(1), None, pose[None, :3, 3]), []
    for tight in (0.0, 0.1, 0.2):
        controller = StaticFeedforward(model, limits, PERIOD, TipPosition(), tight=tight)
        q = decided(controller, model, [target] * 20)[-1]
        assert np.linalg.norm(model.tip_pose(q)[:3, 3] - pose[:3, 3]) < 2e-3 * model.length
        tension.append(q)
    assert (np.diff(np.mean(tension, axis=1)) > 0.5).all()
    assert np.min(tension[0]) < 0.1 and min(np.min(tension[1]), np.min(tension[2])) > 1.0


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
    """With feedforward alone the arm still swings after five and a half seconds."""
    model, limits = build(scene), limits_of(build(scene))
    motion = drive(CONTROLLERS[task][name].make(model, limits, PERIOD), model, far, 275)
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
