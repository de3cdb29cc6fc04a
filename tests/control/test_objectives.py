"""Objectives against differences: of errors in the coordinates, of targets in time; targets moved to where a wrong model sees them."""

import numpy as np
import pytest

from soft_tendon_env.control.objectives import Dynamics, Shape, TipPose, TipPosition
from soft_tendon_env.control.protocol import Reference

PERIOD = 0.02
KINDS = ["pose", "position", "shape"]


@pytest.fixture(scope="module")
def model(build):
    return build("three_tendon", {"strain.passive": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}]})


@pytest.fixture
def objective(model, request):
    return {"pose": TipPose(0.1 * model.length), "position": TipPosition(), "shape": Shape(model)}[request.param]


@pytest.fixture
def arm(model, random_state):
    """arm(seed): the model in random motion."""
    return lambda seed: moving(model, *random_state(model, seed))


def moving(model, q, q_dot=None):
    """The model at coordinates and rates, at rest without these."""
    q_dot = np.zeros_like(q) if q_dot is None else q_dot
    return Dynamics(q, q_dot, model.terms(q, q_dot))


def target_of(model, path, ahead=(0.0,)):
    """The target that goes through coordinates path (m, n)."""
    poses = np.stack([model.tip_pose(q) for q in path])
    return Reference(np.array(ahead), poses, poses[:, :3, 3], np.array(path))


@pytest.mark.parametrize("objective", KINDS, indirect=True)
def test_the_jacobian_is_the_fall_of_the_error_near_the_target(model, arm, objective):
    """error(q + dq) = -jacobian dq to first order: what is left falls with the square of dq."""
    q = arm(0).q
    target, jacobian = target_of(model, [q]), objective.aim(arm(0), target_of(model, [q]), 0.0, PERIOD).jacobian
    direction = (arm(1).q - q) / 10.0
    left = []
    for size in (1e-1, 1e-2):
        moved = q + size * direction
        error = objective.aim(moving(model, moved), target, 0.0, PERIOD).error
        left.append(np.linalg.norm(error + jacobian @ (moved - q)) / np.linalg.norm(error))
    assert left[1] < 0.15 * left[0] + 1e-9 and left[0] < 0.1


@pytest.mark.parametrize("objective", ["pose", "shape"], indirect=True)
def test_the_bias_is_what_the_jacobian_gains(model, arm, objective):
    """d/dt (jacobian q_dot) at q_ddot = 0, in the frame that turns with the tip."""
    q, q_dot, _ = arm(2)
    target, h = target_of(model, [q]), 1e-6
    path = (q - h * q_dot, q, q + h * q_dot)
    before, now, after = (objective.aim(moving(model, p, q_dot), target, 0.0, PERIOD) for p in path)
    velocity = now.jacobian @ q_dot
    difference = (after.jacobian - before.jacobian) @ q_dot / (2 * h)
    np.testing.assert_allclose(now.bias, difference, atol=1e-5 * max(np.abs(difference).max(), np.abs(velocity).max()))
