"""Rows of arms: a failed step keeps the last good motion, rows are read as the model says; errors
between poses are logarithms."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.mechanics.motion.pose_errors import pose_errors

SENSORS = np.array([0.0, 0.07, 0.15, 0.29, 0.3])
STATIONS = np.array([0.0, 0.1, 0.15, 0.22, 0.3])


@pytest.fixture
def small(build):
    return build("three_tendon", {"quadrature.intervals": 2})


def arms_of(model, rows=1, period=0.02, threads=1):
    return Arms(model, rows, period, STATIONS, SENSORS, threads)


def assert_reads(reading, row, model, q, q_dot, atol=1e-12):
    terms = model.terms(q, q_dot)
    tip_pose = model.tip_pose(q)
    np.testing.assert_allclose(reading.tip_pose[row], tip_pose, atol=atol)
    np.testing.assert_allclose(
        reading.tip_twist[row],
        terms.tip_jacobian @ q_dot,
        atol=10 * atol * max(1.0, np.abs(q_dot).max()),
    )
    expected_tendon_length = model.tendon_lengths(q)
    np.testing.assert_allclose(reading.tendon_length[row], expected_tendon_length, atol=atol)
    expected_backbone = model.backbone_at(q, STATIONS)
    np.testing.assert_allclose(reading.backbone[row], expected_backbone, atol=atol)


def test_a_failed_step_keeps_the_last_good_motion(build):
    model = build(
        "three_tendon",
        {"quadrature.intervals": 4, "integrator.step": 0.01, "integrator.max_halvings": 0},
    )
    arms = arms_of(model, rows=2)
    both = np.arange(2)
    straight = np.zeros((2, model.coordinate_count))
    arms.place(both, straight)
    tension = np.tile([2.0, 0.0, 0.0], (2, 2, 1))
    arms.step(tension, both)
    tension[1, 1] = [1e6, 0.0, 0.0]  # the second half of row 1's period
    half = arms_of(model, rows=1, period=0.01)
    half.rows.q[0] = arms.rows.q[1]
    half.rows.q_dot[0] = arms.rows.q_dot[1]
    half.rows.xi[0] = arms.rows.xi[1]
    arms.step(tension, both)
    half.step(tension[1:, :1], np.arange(1))
    assert arms.outcome.status[0] == 0
    assert arms.outcome.status[1] != 0
    assert arms.outcome.rejected[1] == 1
    np.testing.assert_array_equal(arms.rows.q[1], half.rows.q[0])
    q = arms.rows.q[1].copy()
    q_dot = arms.rows.q_dot[1].copy()
    assert_reads(arms.reading, 1, model, q, q_dot)


def test_samples_without_a_strain_are_told(build):
    model = build("three_tendon", {"quadrature.intervals": 4})
    q = np.zeros((10, 3))
    q[[3, 7], 0] = 1e5
    arms = arms_of(model)
    expected = [i not in (3, 7) for i in range(10)]
    reading, good = arms.read_samples(q, 0.0 * q)
    assert good.tolist() == arms.have_margin(q).tolist() == expected
    assert all(np.isfinite(values).all() for values in reading)


@pytest.mark.no_jit
def test_a_row_is_read_as_the_model_says(small):
    arms = arms_of(small)
    row = np.arange(1)
    arms.place(row, np.array([[1.0, 0.5, 0.0]]))
    arms.step(np.full((1, 1, 3), 1.0), row)
    assert arms.outcome.status[0] == 0
    rows = arms.rows
    q = rows.q[0].copy()
    q_dot = rows.q_dot[0].copy()
    assert_reads(arms.reading, 0, small, q, q_dot)
    reading, good = arms.read_samples(rows.q, rows.q_dot)
    assert good[0]
    assert arms.have_margin(rows.q)[0]
    assert_reads(reading, 0, small, q, q_dot)


ELASTIC = {"effects.tendon_elasticity": {"stiffness": 500.0, "displacement_limits": [0.0, 0.01]}}
LAGGING = {"effects.actuators": {"time_constant": 0.05}}


def tension_of(arms, row, command):
    """Tensions (n_a,) [N] that act on a row under a command (n_a,): as the actuators have followed
    it, of tendons that are springs by their lengths."""
    effects = arms.model.arm.effects
    path = effects.transmission
    if path.lags:
        return arms.rows.state[row, : command.size]
    if path.elastic:
        shortening = path.length - arms.reading.tendon_length[row]
        return np.clip(path.stiffness * (command - shortening), 0.0, path.strength)
    return command


@pytest.mark.parametrize(
    ("changes", "command"),
    [
        ({}, [2.0, 0.5, 1.0]),
        ({"effects.gravity.acceleration": [0.0, 0.0, -9.81]}, [2.0, 0.5, 1.0]),
        (LAGGING, [2.0, 0.5, 1.0]),
        (ELASTIC, [0.004, 0.0, 0.002]),
    ],
    ids=["no effects", "gravity", "lagging actuators", "elastic tendons"],
)
def test_the_tension_that_acts_is_read_on_every_arm(changes, command, build):
    command = np.array(command)
    model = build("three_tendon", {"quadrature.intervals": 2, **changes})
    arms = arms_of(model, rows=2)
    rows = np.arange(2)
    held = np.array([[2.0, 0.5, 1.0], [0.0, 1.5, 1.0]])
    straight = np.zeros((2, model.coordinate_count))
    arms.place(rows, straight, held)
    np.testing.assert_allclose(arms.reading.tension, held, rtol=1e-9, atol=1e-12)
    later = np.stack([0.5 * command, command])
    arms.step(later[:, None], rows)
    assert not arms.outcome.status.any()
    for row in rows:
        expected = tension_of(arms, row, later[row])
        np.testing.assert_allclose(arms.reading.tension[row], expected, rtol=1e-9, atol=1e-9)
    first, second = arms.reading.tension[:, 0]
    assert second > 0.0
    assert first != second


def matrix(twist):
    kx, ky, kz = twist[:3]
    p = twist[3:]
    return np.array(
        [[0.0, -kz, ky, p[0]], [kz, 0.0, -kx, p[1]], [-ky, kx, 0.0, p[2]], [0.0, 0.0, 0.0, 0.0]]
    )


def random_poses(rng, count):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    return poses


def errors(pose, wanted):
    out = np.empty((*wanted.shape[:2], 6))
    pose_errors(pose, wanted, out)
    return out


@pytest.mark.no_jit
def test_errors_are_matrix_logarithms():
    rng = np.random.default_rng(0)
    pose = random_poses(rng, 5)
    wanted = random_poses(rng, 15).reshape(5, 3, 4, 4)
    for g, row, found in zip(pose, wanted, errors(pose, wanted), strict=True):
        for g_bar, twist in zip(row, found, strict=True):
            np.testing.assert_allclose(
                matrix(twist), np.real(logm(np.linalg.solve(g, g_bar))), atol=1e-10
            )


@pytest.mark.no_jit
@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-8, 1e-4, 1.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi]
)
def test_errors_carry_the_pose_to_the_wanted_one_at_every_angle(angle):
    rng = np.random.default_rng(1)
    pose = random_poses(rng, 20)
    axes = rng.normal(size=(20, 3))
    axes[:3] = np.eye(3)
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    step = np.tile(np.eye(4), (20, 1, 1))
    step[:, :3, :3] = Rotation.from_rotvec(angle * axes).as_matrix()
    step[:, :3, 3] = rng.normal(size=(20, 3))
    wanted = pose @ step
    found = errors(pose, wanted[:, None])[:, 0]
    angles = np.linalg.norm(found[:, :3], axis=1)
    round_off = 1e-7 if angle > 3 else 1e-15 + 1e-14
    np.testing.assert_allclose(angles, angle, atol=round_off)
    for g, g_bar, twist in zip(pose, wanted, found, strict=True):
        moved = g @ expm(matrix(twist))
        np.testing.assert_allclose(moved, g_bar, atol=1e-10)
