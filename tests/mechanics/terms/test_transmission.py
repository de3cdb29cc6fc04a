"""Elastic tendons and friction along them: the capstan equation on curves of known turns, tensions
of springs, derivatives by differences."""

import numpy as np
import pytest
from scipy.integrate import quad

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.tendons import actuation_column
from soft_tendon_env.mechanics.terms.transmission import (
    SMALL_ANGLE,
    actuator_tensions,
    add_lost_stress,
    add_tendon_matrices,
    find_columns,
    find_share,
    find_shares,
    mean_slope,
    tension_slope,
)
from soft_tendon_env.mechanics.terms.transposed_kinematics import stress_force
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

MU = 0.3
SPEED = 0.02  # [m/s] below which friction falls
STIFFNESS = 800.0  # [N/m]
STRENGTH = 6.0  # [N]
FRICTION = {"effects.tendon_friction": {"coefficient": MU, "stiction_speed": SPEED}}
SPRINGS = {
    "effects.tendon_elasticity": {
        "stiffness": STIFFNESS,
        "displacement_limits": [-0.05, 0.05],
        "slack": [0.0, 0.001, -0.002],
        "strength": STRENGTH,
    }
}
BENDING = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}],
    }
}
RADIUS = 0.008  # [m] of a helix
RATE = 20.0  # [rad/m] of its turning
HELIX = {
    "tendons.0.routing": {"type": "helix", "radius": RADIUS, "angular_rate": RATE, "phase": 0.0},
}


def arm_with(changes, intervals=5):
    return model_on(load_scene("three_tendon").replace({**BENDING, **changes}), intervals)


def over_points(model, field):
    """A field over tendons and points as (n_a, intervals, 2), without empty intervals."""
    packed = field.reshape(model.tendon_count, model.arm.rod.packs, 2, LANES)
    return packed.swapaxes(2, 3).reshape(model.tendon_count, -1, 2)[:, model.grid.real]


@pytest.mark.parametrize("direction", [-1.0, 0.4, 1.0])
def test_friction_leaves_the_capstan_s_share_along_a_circle(workspace_at, direction):
    """exp(-mu z phi), phi = k s of a tendon in the plane of an arm that is bent evenly."""
    model, curvature = arm_with(FRICTION), 6.0
    work = workspace_at(model, [0.0, 0.0, curvature])
    angle = find_share(model.arm, 0, MU, direction, work.strain, work.friction)
    phi = curvature * model.grid.points[model.grid.real]
    assert angle == pytest.approx(phi.max(), rel=1e-12)
    share = np.exp(-MU * direction * phi)
    np.testing.assert_allclose(over_points(model, work.friction.share)[0], share, rtol=1e-12)
    slip = MU * phi * share
    np.testing.assert_allclose(over_points(model, work.friction.slip)[0], slip, rtol=1e-12)


def test_a_helix_turns_by_its_curvature_over_its_length(workspace_at):
    """r w^2 / sqrt(1 + r^2 w^2) per length of a straight arm, up to the last point, of third order
    in the intervals."""
    rate = RADIUS * RATE**2 / np.sqrt(1.0 + (RADIUS * RATE) ** 2)
    errors = []
    for intervals in (8, 16):
        model = arm_with({**FRICTION, **HELIX}, intervals)
        work = workspace_at(model, np.zeros(3))
        angle = find_share(model.arm, 0, MU, 1.0, work.strain, work.friction)
        exact = rate * model.grid.points[model.grid.real].max()
        errors.append(abs(angle / exact - 1.0))
    assert errors[0] < 0.01
    assert errors[1] < errors[0] / 4.0


@pytest.mark.parametrize("a", [-2.0, -1.01 * SMALL_ANGLE, -0.5 * SMALL_ANGLE, 0.0, 0.005, 0.3, 4.0])
def test_the_mean_slope_is_an_integral(a):
    exact, _ = quad(lambda u: u * np.exp(-a * u), 0.0, 1.0, epsabs=1e-13)
    assert mean_slope(a) == pytest.approx(exact, rel=1e-7)


def rubbing(model, workspace_at, q, q_dot, tension):
    work = workspace_at(model, q, q_dot)
    work.tendons.tension[:] = tension
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    return work


def test_friction_acts_against_the_rate_at_which_tendons_are_pulled_in(workspace_at):
    """v = -dL/dt and z = v / sqrt(v^2 + v_s^2) of each; the grip is the derivative of its mean
    tension by -z."""
    model, tension = arm_with(FRICTION), np.array([2.0, 1.0, 3.0])
    q, q_dot = np.array([1.0, 3.0, -4.0]), np.array([2.0, 5.0, 3.0])
    work = rubbing(model, workspace_at, q, q_dot, tension)
    h = 1e-6
    ahead, behind = (model.tendon_lengths(q + s * h * q_dot) for s in (1, -1))
    rates = (behind - ahead) / (2 * h)
    np.testing.assert_allclose(work.tendons.pull_rate, rates, rtol=1e-6, atol=1e-9)
    z = rates / np.hypot(rates, SPEED)
    other = workspace_at(model, q)
    for i in range(3):
        angle = find_share(model.arm, i, MU, z[i], other.strain, other.friction)
        np.testing.assert_allclose(
            over_points(model, work.friction.share)[i],
            over_points(model, other.friction.share)[i],
            rtol=1e-6,
        )

        def mean(direction, i=i, angle=angle):
            share, _ = quad(lambda u: np.exp(-MU * direction * angle * u), 0.0, 1.0)
            return tension[i] * share

        grip = (mean(z[i] - 1e-5) - mean(z[i] + 1e-5)) / 2e-5
        assert work.friction.grip[i] == pytest.approx(grip, rel=1e-6)


def test_what_friction_takes_is_what_the_columns_lose(workspace_at):
    """Phi^T of the lost stress, weights included, is -sum tau (B - B of the share)."""
    model, tension = arm_with(FRICTION), np.array([2.0, 1.0, 3.0])
    work = rubbing(model, workspace_at, [1.0, 3.0, -4.0], [2.0, 5.0, 3.0], tension)
    stress = np.zeros_like(work.strain.xi)
    add_lost_stress(model.arm, work.strain, tension, work.friction.share, stress)
    weight = np.repeat(model.arm.rod.weight.reshape(-1, 1, LANES), 6, axis=1).ravel()
    lost, found = np.zeros(3), np.empty(3)
    for i, pull in enumerate(tension):
        whole, left = np.empty(3), np.empty(3)
        spare = work.spare.stress
        actuation_column(model.arm, i, work.ones.tendon, work.strain, spare, whole)
        actuation_column(model.arm, i, work.friction.share, work.strain, spare, left)
        lost += pull * (whole - left)
    assert np.abs(lost).max() > 0.0
    stress_force(model.arm.rod, model.arm.strain, work.strain.Phi, weight * stress, found)
    np.testing.assert_allclose(found, lost, rtol=1e-12, atol=1e-15)


def test_elastic_tendons_are_springs_between_nothing_and_their_strength(workspace_at):
    """T = clip(k (delta - l - (L_0 - L)), 0, T_m), whose slope is k within."""
    model, q = arm_with(SPRINGS), np.array([0.0, 1.0, 2.0])
    work = workspace_at(model, q)
    slack = np.array([0.0, 0.001, -0.002])
    path = model.arm.effects.transmission
    shortening = model.tendon_lengths(np.zeros(3)) - model.tendon_lengths(q)
    np.testing.assert_allclose(path.length, model.tendon_lengths(np.zeros(3)) + slack, rtol=1e-12)
    for command in ([0.01, 0.005, -0.01], [0.05, 0.004, 0.0], [-0.05, 0.05, 0.002]):
        stretched = np.array(command) - slack - shortening
        expected = np.clip(STIFFNESS * stretched, 0.0, STRENGTH)
        tension = actuator_tensions(model.arm, np.array(command), work.strain.xi, work.tendons)
        np.testing.assert_allclose(tension, expected, atol=1e-10)
        within = (expected > 0.0) & (expected < STRENGTH)
        slopes = [tension_slope(path, i, work.tendons) for i in range(3)]
        np.testing.assert_allclose(slopes, STIFFNESS * within)
    bare = arm_with({})
    assert tension_slope(bare.arm.effects.transmission, 0, work.tendons) == 1.0


def test_matrices_of_tendons_are_made_of_their_columns(workspace_at):
    """k B B^T of those that pull as springs, and of friction c B B^T, with c = grip dz/dv."""
    q, q_dot = np.array([1.0, 3.0, -4.0]), np.array([2.0, 5.0, 3.0])
    model = arm_with({**SPRINGS, **FRICTION})
    stretch = np.array([0.004, 0.002, -0.02])
    command = model.arm.effects.transmission.length - model.tendon_lengths(q) + stretch
    work = workspace_at(model, q, q_dot)
    tension = actuator_tensions(model.arm, command, work.strain.xi, work.tendons).copy()
    np.testing.assert_allclose(tension, STIFFNESS * np.maximum(stretch, 0.0))
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    find_columns(model.arm, work.strain, work.friction, work.ones, work.spare.stress, work.tendons)
    B = model.terms(q, q_dot).actuation
    np.testing.assert_allclose(work.tendons.columns.T, B, atol=1e-14)
    damping, stiffness = np.zeros((3, 3)), np.zeros((3, 3))
    add_tendon_matrices(model.arm, work.tendons, work.friction, damping, stiffness)
    within = (tension > 0.0) & (tension < STRENGTH)
    rubbed = work.tendons.rubbed.T
    np.testing.assert_allclose(stiffness, STIFFNESS * rubbed * within @ B.T, rtol=1e-12)
    rates = work.tendons.pull_rate
    dz_dv = SPEED**2 / np.hypot(rates, SPEED) ** 3
    np.testing.assert_allclose(
        damping, B * (work.friction.grip * dz_dv) @ B.T, rtol=1e-9, atol=1e-12
    )
    # by z: of what the shares leave
    h = 1e-6
    for i in range(3):
        columns = []
        for way in (h, -h):
            z = rates[i] / np.hypot(rates[i], SPEED) + way
            find_share(model.arm, i, MU, z, work.strain, work.friction)
            column = np.empty(3)
            actuation_column(
                model.arm, i, work.friction.share, work.strain, work.spare.stress, column
            )
            columns.append(tension[i] * column)
        slope = (columns[1] - columns[0]) / (2 * h)
        np.testing.assert_allclose(work.tendons.rubbing[i], slope, rtol=1e-6, atol=1e-9)
