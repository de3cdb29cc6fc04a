"""Objectives against differences: of errors in the coordinates, of targets in time; targets moved to where a wrong model sees them."""

import numpy as np
import pytest

from soft_tendon_env.control.objectives import Shape, TipPose, TipPosition
from soft_tendon_env.control.protocol import ControllerInput, Reference

PERIOD = 0.02
KINDS = ["pose", "position", "shape"]


@pytest.fixture(scope="module")
def model(build):
    return build("three_tendon", {"strain.passive": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}]})


@pytest.fixture
def objective(model, request):
    return {"pose": TipPose(0.1 * model.length), "position": TipPosition(), "shape": Shape(model)}[request.param]


def aim_of(objective, model, target, q, q_dot):
    """Aim at a target now, at coordinates and rates."""
    terms = model.terms(q, q_dot)
    return objective.aim(ControllerInput(q, q_dot, terms.tip_pose, np.zeros(model.tendon_count), target), terms, 0.0, PERIOD)


def target_of(model, path, ahead=(0.0,)):
    """The target that goes through coordinates path (m, n)."""
    poses = np.stack([model.tip_pose(q) for q in path])
    return Reference(np.array(ahead), poses, poses[:, :3, 3], np.array(path))


@pytest.mark.parametrize("objective", KINDS, indirect=True)
def test_the_jacobian_is_the_fall_of_the_error_near_the_target(model, random_state, objective):
    """error(q + dq) = -jacobian dq to first order: what is left falls with the square of dq."""
    q, q_dot = random_state(model, 0)
    target = target_of(model, [q])
    jacobian, direction = aim_of(objective, model, target, q, q_dot).jacobian, (random_state(model, 1)[0] - q) / 10.0
    left = []
    for size in (1e-1, 1e-2):
        moved = q + size * direction
        error = aim_of(objective, model, target, moved, 0.0 * q).error
        left.append(np.linalg.norm(error + jacobian @ (moved - q)) / np.linalg.norm(error))
    assert left[1] < 0.15 * left[0] + 1e-9 and left[0] < 0.1


@pytest.mark.parametrize("objective", ["pose", "shape"], indirect=True)
def test_the_bias_is_what_the_jacobian_gains(model, random_state, objective):
    """d/dt (jacobian q_dot) at q_ddot = 0, in the frame that turns with the tip."""
    q, q_dot = random_state(model, 2)
    target, h = target_of(model, [q]), 1e-6
    path = (q - h * q_dot, q, q + h * q_dot)
    before, now, after = (aim_of(objective, model, target, p, q_dot) for p in path)
    velocity = now.jacobian @ q_dot
    difference = (after.jacobian - before.jacobian) @ q_dot / (2 * h)
    np.testing.assert_allclose(now.bias, difference, atol=1e-5 * max(np.abs(difference).max(), np.abs(velocity).max()))
