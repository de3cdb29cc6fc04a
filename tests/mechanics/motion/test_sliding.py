"""Substeps of tendons that rub on arms with many coordinates: the rates at their end balance the
friction of those rates, sliding or sticking."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.extrapolation import (
    Demand,
    Extrapolated,
    extrapolated_step,
)
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

H = 0.004  # [s]
SLOW = 1e-4  # [m/s]
STIFFNESS = 500.0  # [N/m]
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
SIX = {"type": "explicit", "modes": [{"strains": STRAINS, "order": 0, "span": "rod"}]}
TENSION = np.array([2.0, 0.5, 1.0])
Q = np.array([1.0, 2.0, -1.5, 0.01, 0.02, -0.01])
RATES = np.array([2.0, -5.0, 3.0, 0.05, -0.02, 0.03])


def arm_that_rubs(friction=None, elasticity=None):
    changes = {"strain": SIX, "tendons.0.end": 0.2}
    if friction:
        changes["effects.tendon_friction"] = friction
    if elasticity:
        changes["effects.tendon_elasticity"] = elasticity
    scene = load_scene("three_tendon").replace(changes)
    return model_on(scene, 2)


def attempt_at(model, rates, tension, scratch):
    """One implicit Euler step of length H."""
    strain = model.packed_strain(Q)
    state = model.arm.effects.state.copy()
    clock = np.zeros(1)
    motion = Motion(Q.copy(), rates.copy(), strain, state, clock)
    method = Extrapolated(1, 1, True, False, 1e-12)
    demand = Demand(1e300, 1, H)
    return extrapolated_step(model.arm, method, demand, tension, motion, H, scratch)


def check_balance(rates, tension, scratch):
    """Rates at the end of a substep balance tensions [N] and the friction that these have there."""
    smooth = arm_that_rubs()
    # matrices are those of the substep's beginning
    terms = smooth.terms(Q, rates, TENSION)
    M = terms.mass
    D = terms.damping
    G = terms.stiffness
    pulled = terms.actuation @ tension
    resisted = terms.elastic_force + D @ rates
    force = pulled - resisted - terms.bias
    borders = scratch.first.borders
    turn = borders.turn.reshape(3, -1)
    filled = borders.row.reshape(*turn.shape, -1)
    rows = filled[..., :6]
    sliding = rows @ scratch.v
    speeds = np.hypot(sliding, SLOW)
    directions = sliding / speeds
    turned = np.cumsum(turn * directions, axis=1)
    at_actuators = tension[:, None]
    left = at_actuators * np.exp(-turned)
    lost = np.diff(left, axis=1, prepend=at_actuators)
    friction = np.einsum("ik,ikn->n", lost, rows)
    # the power of friction is never positive
    assert friction @ scratch.v < 0.0
    damped = M + H * D
    system = damped + H**2 * G
    stiffening = H * G @ rates
    impulse = H * (force + friction - stiffening)
    change = np.linalg.solve(system, impulse)
    scale = smooth.coordinate_scale()
    expected = (rates + change) / scale
    found = scratch.v / scale
    atol = 1e-5 * np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=atol)
    moved = Q + H * scratch.v
    np.testing.assert_allclose(scratch.q, moved, rtol=1e-12)


@pytest.mark.parametrize("coefficient", [0.1, 0.8])
@pytest.mark.parametrize("speed", [1.0, 1e-4], ids=["slide", "stick"])
def test_rates_at_the_end_balance_their_own_friction(coefficient, speed):
    """(M + h D + h^2 G) dv = h (f + sum_k (T_k - T_k-1) w_k - h G v)."""
    rates = speed * RATES
    model = arm_that_rubs({"coefficient": coefficient, "stiction_speed": SLOW})
    scratch = make_scratch(model.arm, 1)
    attempt = attempt_at(model, rates, TENSION, scratch)
    assert attempt.status == OK
    check_balance(rates, TENSION, scratch)


@pytest.mark.parametrize("speed", [1.0, 1e-4], ids=["slide", "stick"])
def test_elastic_tendons_that_rub_have_the_tensions_of_their_displacements_at_the_end(speed):
    """T = k (u - s - h s'), and rates that balance these tensions and their friction."""
    rates = speed * RATES
    friction = {"coefficient": 0.3, "stiction_speed": SLOW}
    elasticity = {"stiffness": STIFFNESS, "displacement_limits": [-0.1, 0.1]}
    model = arm_that_rubs(friction, elasticity)
    scratch = make_scratch(model.arm, 1)
    command = model.command(TENSION, Q)
    attempt = attempt_at(model, rates, command, scratch)
    assert attempt.status == OK
    tension = scratch.sliding.tension.copy()
    columns = arm_that_rubs().terms(Q, rates, TENSION).actuation
    pulled_in = H * (columns.T @ scratch.v)
    expected = TENSION - STIFFNESS * pulled_in
    np.testing.assert_allclose(tension, np.maximum(expected, 0.0), rtol=1e-6, atol=1e-9)
    check_balance(rates, tension, scratch)


def test_a_system_that_is_not_positive_has_no_rates():
    """Of an arm whose masses are negative."""
    model = arm_that_rubs({"coefficient": 0.1, "stiction_speed": SLOW})
    scratch = make_scratch(model.arm, 1)
    scratch.sliding.status[0] = OK
    model.arm.rod.inertia[:] *= -1.0
    attempt = attempt_at(model, 0.0 * RATES, TENSION, scratch)
    assert attempt.status == NOT_POSITIVE
