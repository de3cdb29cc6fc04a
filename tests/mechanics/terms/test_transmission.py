"""Elastic tendons and friction along them: the capstan equation on curves of known turns, tensions
of springs, derivatives by differences."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.tendon_friction import (
    add_lost_stress,
    find_shares,
    find_turns,
)
from soft_tendon_env.mechanics.terms.tendons import actuation_column
from soft_tendon_env.mechanics.terms.transmission import (
    actuator_tensions,
    add_tendon_matrices,
    find_columns,
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
    scene = load_scene("three_tendon").replace({**BENDING, **changes})
    return model_on(scene, intervals)


def over_points(model, field):
    """A field over tendons and points as (n_a, intervals, 2), without empty intervals."""
    packed = field.reshape(model.tendon_count, model.arm.rod.packs, 2, LANES)
    by_tendon = packed.swapaxes(2, 3).reshape(model.tendon_count, -1, 2)
    return by_tendon[:, model.grid.real]


def turns_of(model, work, tendon=0):
    """Angles by which a tendon turns before each of its points, times mu, in order."""
    find_turns(model.arm, tendon, work.strain, work.friction.turn)
    points = model.arm.rod.packs * 2 * LANES
    end = (tendon + 1) * points
    return work.friction.turn[tendon * points : end]


def test_a_circle_turns_by_its_curvature_over_its_length(workspace_at):
    """phi = k s of a tendon in the plane of an arm that is bent evenly."""
    model = arm_with(FRICTION)
    curvature = 6.0
    work = workspace_at(model, [0.0, 0.0, curvature])
    points = model.grid.points[model.grid.real].ravel()
    angles = np.cumsum(turns_of(model, work))
    turned = angles[: points.size]
    expected_turned = MU * curvature * points
    np.testing.assert_allclose(turned, expected_turned, rtol=1e-12)


def test_a_helix_turns_by_its_curvature_over_its_length(workspace_at):
    """r w^2 / sqrt(1 + r^2 w^2) per length of a straight arm, up to the last point, of third order
    in the intervals."""
    root = np.sqrt(1.0 + (RADIUS * RATE) ** 2)
    rate = RADIUS * RATE**2 / root
    errors = []
    for intervals in (8, 16):
        model = arm_with({**FRICTION, **HELIX}, intervals)
        work = workspace_at(model, np.zeros(3))
        points = model.grid.points[model.grid.real]
        exact = MU * rate * points.max()
        ratio = turns_of(model, work).sum() / exact
        errors.append(abs(ratio - 1.0))
    assert errors[0] < 0.01
    assert errors[1] < errors[0] / 4.0


def rubbing(model, workspace_at, q, q_dot, tension):
    work = workspace_at(model, q, q_dot)
    work.tendons.tension[:] = tension
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    return work


def test_friction_acts_against_the_rate_at_which_tendons_are_pulled_in(workspace_at):
    """v = -dL/dt past the actuator; the share falls by exp(-mu z dphi) before each point, with its
    own z = v / sqrt(v^2 + v_s^2)."""
    model = arm_with(FRICTION)
    tension = np.array([2.0, 1.0, 3.0])
    q = np.array([1.0, 3.0, -4.0])
    q_dot = np.array([2.0, 5.0, 3.0])
    work = rubbing(model, workspace_at, q, q_dot, tension)
    h = 1e-6
    ahead = model.tendon_lengths(q + h * q_dot)
    behind = model.tendon_lengths(q - h * q_dot)
    pulled_in = (behind - ahead) / (2 * h)
    rates = work.friction.rate.reshape(model.tendon_count, -1)
    np.testing.assert_allclose(rates[:, 0], pulled_in, rtol=1e-6, atol=1e-9)
    count = model.grid.points[model.grid.real].size
    for i in range(3):
        speeds = np.hypot(rates[i], SPEED)
        slides = rates[i] / speeds
        weighted = turns_of(model, work, i) * slides
        left = np.exp(-np.cumsum(weighted))
        share = over_points(model, work.friction.share)[i].ravel()
        np.testing.assert_allclose(share, left[:count], rtol=1e-12)


def test_what_friction_takes_is_what_the_columns_lose(workspace_at):
    """Phi^T of the lost stress, weights included, is -sum tau (B - B of the share)."""
    model = arm_with(FRICTION)
    tension = np.array([2.0, 1.0, 3.0])
    slopes = [1.0, 3.0, -4.0]
    work = rubbing(model, workspace_at, slopes, [2.0, 5.0, 3.0], tension)
    stress = np.zeros_like(work.strain.xi)
    add_lost_stress(model.arm, work.strain, tension, work.friction.share, stress)
    weight_rows = model.arm.rod.weight.reshape(-1, 1, LANES)
    weight = np.repeat(weight_rows, 6, axis=1).ravel()
    lost = np.zeros(3)
    found = np.empty(3)
    for i, pull in enumerate(tension):
        whole = np.empty(3)
        left = np.empty(3)
        spare = work.spare.stress
        actuation_column(model.arm, i, work.ones.tendon, work.strain, spare, whole)
        actuation_column(model.arm, i, work.friction.share, work.strain, spare, left)
        lost += pull * (whole - left)
    assert np.abs(lost).max() > 0.0
    stress_force(model.arm.rod, model.arm.strain, work.strain.Phi, weight * stress, found)
    np.testing.assert_allclose(found, lost, rtol=1e-12, atol=1e-15)


def test_elastic_tendons_are_springs_between_nothing_and_their_strength(workspace_at):
    """T = clip(k (delta - l - (L_0 - L)), 0, T_m), whose slope is k within."""
    model = arm_with(SPRINGS)
    q = np.array([0.0, 1.0, 2.0])
    work = workspace_at(model, q)
    slack = np.array([0.0, 0.001, -0.002])
    path = model.arm.effects.transmission
    straight = model.tendon_lengths(np.zeros(3))
    shortening = straight - model.tendon_lengths(q)
    np.testing.assert_allclose(path.length, straight + slack, rtol=1e-12)
    for command in ([0.01, 0.005, -0.01], [0.05, 0.004, 0.0], [-0.05, 0.05, 0.002]):
        stretched = np.array(command) - slack - shortening
        expected = np.clip(STIFFNESS * stretched, 0.0, STRENGTH)
        commands = np.array(command)
        tension = actuator_tensions(model.arm, commands, work.strain.xi, work.tendons)
        np.testing.assert_allclose(tension, expected, atol=1e-10)
        within = (expected > 0.0) & (expected < STRENGTH)
        slopes = [tension_slope(path, i, work.tendons) for i in range(3)]
        np.testing.assert_allclose(slopes, STIFFNESS * within)
    bare = arm_with({})
    assert tension_slope(bare.arm.effects.transmission, 0, work.tendons) == 1.0


def test_the_stiffness_of_springs_is_made_of_their_columns(workspace_at):
    """k B B^T of those that pull between nothing and their strength."""
    q = np.array([1.0, 3.0, -4.0])
    q_dot = np.array([2.0, 5.0, 3.0])
    model = arm_with(SPRINGS)
    stretch = np.array([0.004, 0.002, -0.02])
    lengths = model.tendon_lengths(q)
    command = model.arm.effects.transmission.length - lengths + stretch
    work = workspace_at(model, q, q_dot)
    tension = actuator_tensions(model.arm, command, work.strain.xi, work.tendons)
    stretched = np.maximum(stretch, 0.0)
    np.testing.assert_allclose(tension, STIFFNESS * stretched)
    ones = work.ones.tendon
    find_columns(model.arm, work.strain, ones, work.spare.stress, work.tendons.columns)
    B = model.terms(q, q_dot).actuation
    np.testing.assert_allclose(work.tendons.columns.T, B, atol=1e-14)
    damping = np.zeros((3, 3))
    stiffness = np.zeros((3, 3))
    add_tendon_matrices(model.arm, work, None, damping, stiffness)
    within = (tension > 0.0) & (tension < STRENGTH)
    expected = STIFFNESS * B * within @ B.T
    np.testing.assert_allclose(stiffness, expected, rtol=1e-12)
    assert not damping.any()
