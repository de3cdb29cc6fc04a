"""Objectives against differences: of errors in the coordinates, of targets in time; targets moved to where a wrong model sees them."""

import numpy as np
import pytest

from soft_tendon_env.control.objectives import Dynamics, Shape, TipPose, TipPosition
from soft_tendon_env.control.protocol import Reference
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose, pose_error

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
def test_errors_vanish_at_the_target_alone(model, arm, objective):
    now = arm(0)
    there = objective.aim(now, target_of(model, [now.q]), 0.0, PERIOD)
    np.testing.assert_allclose(there.error, 0.0, atol=1e-12)
    np.testing.assert_allclose(there.velocity, 0.0, atol=1e-12)
    assert np.linalg.norm(objective.aim(now, target_of(model, [arm(1).q]), 0.0, PERIOD).error) > 0.01 * model.length


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


@pytest.mark.parametrize("objective", ["position"], indirect=True)
def test_the_bias_of_the_position_is_its_acceleration(model, arm, objective):
    """R^T r_dot_dot at q_ddot = 0: the tip frame turns, the target's axes do not."""
    q, q_dot, terms = arm(2)
    h = 1e-4 / np.abs(q_dot / model.coordinate_scale()).max()
    before, now, after = (model.tip_pose(p)[:3, 3] for p in (q - h * q_dot, q, q + h * q_dot))
    expected = terms.tip_pose[:3, :3].T @ (after - 2.0 * now + before) / h**2
    bias = objective.aim(arm(2), target_of(model, [q]), 0.0, PERIOD).bias
    np.testing.assert_allclose(bias, expected, atol=1e-3 * np.abs(expected).max())
    assert np.abs(bias - terms.tip_bias[3:]).max() > 0.1 * np.abs(expected).max()  # the turning matters here


@pytest.mark.parametrize("objective", KINDS, indirect=True)
@pytest.mark.parametrize("time", [0.0, 0.02, 0.025])
def test_the_velocity_is_the_target_s(model, objective, time):
    """Seen from an arm that stands at the target, what its error gains per time; between instants too."""
    path = [model.rest_coordinates([1.0 + 0.3 * i, 0.1 * i, 0.4]) for i in range(4)]
    target = target_of(model, path, (0.0, 0.02, 0.04, 0.06))
    q = path[0] + time / 0.02 * (path[1] - path[0])
    still, h = moving(model, q), 1e-3
    now, later = (objective.aim(still, target, t, PERIOD) for t in (time, time + h))
    short = objective.aim(still, target, time, h)
    speed = np.linalg.norm(short.velocity)
    assert np.linalg.norm(now.error) < 1e-3 and speed > 0.01
    np.testing.assert_allclose((later.error - now.error) / h, short.velocity, atol=2e-3 * speed)


def test_a_model_sees_the_pose_target_displaced_as_its_tip_is(model, arm):
    """A model that reaches what it sees has the arm at the target; before, the errors are the same motion in their two frames."""
    objective, terms, goal = TipPose(), arm(0).terms, arm(1).terms.tip_pose
    off = np.array([0.1, -0.2, 0.15, 0.01, 0.02, -0.01])
    measured = moved_pose(terms.tip_pose, off)
    seen = objective.seen_from(terms.tip_pose, Reference(np.zeros(1), goal[None]), measured).tip_pose[0]
    np.testing.assert_allclose(moved_pose(seen, off), goal, atol=1e-12)
    frame = adjoint(inverse_pose(terms.tip_pose) @ measured)
    np.testing.assert_allclose(pose_error(terms.tip_pose, seen), frame @ pose_error(measured, goal), atol=1e-12)


def test_a_model_sees_the_position_target_displaced_as_its_tip_is(model, arm):
    objective, now, goal = TipPosition(), arm(0), arm(1).terms.tip_pose
    pose = now.terms.tip_pose
    measured = moved_pose(pose, np.array([0.0, 0.0, 0.0, 0.01, 0.02, -0.01]))
    for target in (Reference(np.zeros(1), goal[None]), Reference(np.zeros(1), tip_position=goal[None, :3, 3])):
        of_arm = objective.aim(now._replace(terms=now.terms._replace(tip_pose=measured)), target, 0.0, PERIOD).error
        of_model = objective.aim(now, objective.seen_from(pose, target, measured), 0.0, PERIOD).error
        np.testing.assert_allclose(of_model, of_arm, atol=1e-14)
        assert np.linalg.norm(of_arm) > 0.01


def test_bending_the_rod_evenly_by_an_angle_of_one_counts_as_half_its_length(build):
    modes = [{"strains": ["torsion", "bend_y", "stretch"], "order": 2, "span": "rod"}]
    model = build("three_tendon", {"strain": {"type": "explicit", "modes": modes}})
    strain = np.zeros(6)
    strain[1], reference = 1.0 / model.length, model.strain(np.zeros(9))[1]
    columns = np.stack([(model.strain(unit)[1] - reference).ravel() for unit in np.eye(9)], axis=1)
    q = np.linalg.lstsq(columns, np.tile(strain, len(reference)), rcond=None)[0]
    np.testing.assert_allclose(columns @ q, np.tile(strain, len(reference)), atol=1e-12)
    error = Shape(model).aim(moving(model, np.zeros(9)), Reference(np.zeros(1), q=q[None]), 0.0, PERIOD).error
    assert np.linalg.norm(error) == pytest.approx(0.5 * model.length, rel=1e-9)
