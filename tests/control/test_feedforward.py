"""Feedforward from statics: it comes to rest where inverse statics say, also along targets in motion."""

import numpy as np
import pytest

from soft_tendon_env.control import Reference, Situation
from soft_tendon_env.control.feedforward import StaticFeedforward
from soft_tendon_env.control.objectives import TipPose, TipPosition
from soft_tendon_env.model.inverse_statics import tension_for_tip_pose
from soft_tendon_env.model.statics import static_equilibrium

PERIOD = 0.02
HEAVY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
ARMS = {
    "paper": ("paper", None),
    "redundant": ("four_tendon", None),
    "heavy": ("three_tendon", HEAVY),
    "loads inside": ("three_tendon", {**HEAVY, "strain.include_loads": True}),
}


def decided(controller, model, targets):
    """Equilibria (periods, n) that are followed, with arms that are elsewhere: nothing measured enters."""
    rng, memory, path = np.random.default_rng(0), None, []
    for target in targets:
        q = rng.normal(size=model.coordinate_count)
        memory = controller.act(Situation(q, q, np.eye(4), np.zeros(model.tendon_count), target), memory).memory
        path.append(memory.q)
    return np.array(path)


def held_tip(model, tension):
    """The tip (4, 4) of the equilibrium under tensions."""
    return static_equilibrium(model, tension).tip_pose


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("share", [0.1, 0.3])
def test_tips_that_tensions_hold_are_reached(build, limits_of, arm, share):
    """To a thousandth of the length, as inverse statics do."""
    model = build(*ARMS[arm])
    limits = limits_of(model)
    tension = share * limits[:, 1] * np.random.default_rng(1).random(model.tendon_count)
    pose = held_tip(model, tension)
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
    poses = np.stack([held_tip(model, tension) for tension in at])
    times = PERIOD * np.arange(2.0)
    targets = [Reference(times, poses[k : k + 2], poses[k : k + 2, :3, 3]) for k in range(30)]
    path = decided(StaticFeedforward(model, limits, PERIOD, TipPose(0.1 * model.length)), model, targets)
    away = np.linalg.norm(np.stack([model.tip_pose(q)[:3, 3] for q in path]) - poses[1:, :3, 3], axis=1)
    assert away.max() < 2e-3 * model.length
    assert np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)) > 0.05 * model.length


def test_decisions_are_the_equilibrium_s_tensions(build, limits_of, holding):
    """Within limits that leave no choice but one."""
    model = build("three_tendon")
    target = holding(model, [2.0, 0.5, 0.1])
    decision = StaticFeedforward(model, limits_of(model), PERIOD, TipPosition()).act(
        Situation(np.zeros(3), np.zeros(3), np.eye(4), np.zeros(3), target)
    )
    np.testing.assert_allclose(model.rest_coordinates(decision.tension), decision.memory.q, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(decision.tension, [2.0, 0.5, 0.1], atol=0.1)


def test_the_null_space_is_for_effort_or_for_tightness(build, limits_of):
    """With more to keep tendons tight by, the same position takes more tension, and slack tendons pull."""
    model = build("paper")
    limits = limits_of(model)
    pose = held_tip(model, np.linspace(2.0, 8.0, 10))
    target, tension = Reference(np.zeros(1), None, pose[None, :3, 3]), []
    for tight in (0.0, 0.1, 0.2):
        controller = StaticFeedforward(model, limits, PERIOD, TipPosition(), tight=tight)
        q = decided(controller, model, [target] * 20)[-1]
        assert np.linalg.norm(model.tip_pose(q)[:3, 3] - pose[:3, 3]) < 2e-3 * model.length
        tension.append(q)
    assert (np.diff(np.mean(tension, axis=1)) > 0.5).all()
    assert np.min(tension[0]) < 0.1 and min(np.min(tension[1]), np.min(tension[2])) > 1.0
