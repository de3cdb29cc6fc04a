"""Forces that a model lacks: the motion with them is that of a model that has them."""

import numpy as np
import pytest

from soft_tendon_env.control.belief import tip_acceleration
from soft_tendon_env.control.force_errors import (
    SLIDING_SPEED,
    ArmGeometry,
    ForceError,
    TendonFriction,
    corrected_rollout,
    holding_matrix,
    sliding_direction,
)
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
FORCE = np.array([0.02, -0.04, 0.03])  # [N] at the tip
MASS = 0.004  # [kg] there
TENSION = np.array([[1.0, 0.5, 0.0], [1.2, 0.4, 0.1]])


@pytest.fixture
def motion(model, random_state):
    return random_state(model, 0)


def lacking(model, q, **parts):
    """A force error of some parts."""
    n = q.size
    n_a = model.tendon_count
    nothing = np.zeros((n, n))
    smooth = TendonFriction(np.zeros(n_a), np.zeros((n, n_a)))
    error = ForceError(np.zeros(n), nothing, nothing, nothing, np.zeros(n_a), smooth)
    return error._replace(**parts)


def test_loads_at_the_tip_have_its_jacobian(model, motion):
    q, q_dot = motion
    terms = model.terms(q, q_dot)
    geometry = ArmGeometry(model)
    assert geometry.places[-1] == pytest.approx(model.length)
    R = terms.tip_pose[:3, :3]
    in_world = R @ terms.tip_jacobian[3:]
    load_jacobian = geometry.at(q).load_jacobian
    off = load_jacobian[:, -3:].T - in_world
    small = 0.01 * np.abs(in_world).max()
    assert np.abs(off).max() < small


def test_loads_along_the_arm_have_the_slopes_of_its_backbone(model, motion):
    q, _ = motion
    geometry = ArmGeometry(model)
    rows = geometry.at(q).load_jacobian
    steps = 1e-5 * model.coordinate_scale()
    for column, step in enumerate(steps):
        change = np.zeros(q.size)
        change[column] = step
        ahead = model.backbone_at(q + change, geometry.places)
        behind = model.backbone_at(q - change, geometry.places)
        positions_moved = ahead[:, :3, 3] - behind[:, :3, 3]
        slope = positions_moved / (2.0 * step)
        off = rows[column].reshape(-1, 3) - slope
        largest_slope = np.abs(slope).max()
        assert np.abs(off).max() < 0.01 * largest_slope


@pytest.mark.parametrize("is_split", [False, True], ids=["linear", "with tensions"])
def test_motions_under_a_load_are_those_of_a_model_that_has_it(model, motion, is_split):
    q, q_dot = motion
    changes = {"effects.tip_load.force": FORCE.tolist()}
    loaded = model.with_scene(model.scene.replace(changes))
    simulation = Simulation(loaded)
    simulation.reset(q, q_dot)
    expected = simulation.rollout(TENSION, PERIOD)
    constant = ArmGeometry(model).at(q).load_jacobian[:, -3:] @ FORCE
    held = np.zeros(3)
    if is_split:
        held = holding_matrix(model.terms(q, q_dot)) @ constant
    error = lacking(model, q, constant=constant, held=held)
    simulation = Simulation(model)
    simulation.reset(q, q_dot)
    without = simulation.rollout(TENSION, PERIOD)
    corrected = corrected_rollout(simulation, TENSION, PERIOD, error)
    for name in ("q", "q_dot"):
        size = np.abs(getattr(expected, name)[-1] - getattr(without, name)[-1]).max()
        off = np.abs(getattr(corrected, name)[-1] - getattr(expected, name)[-1]).max()
        assert off < 0.2 * size
    tip = corrected.tip_pose[-1, :3, 3]
    way = np.linalg.norm(expected.tip_pose[-1, :3, 3] - without.tip_pose[-1, :3, 3])
    distance = np.linalg.norm(tip - expected.tip_pose[-1, :3, 3])
    assert distance < 0.2 * way


def test_motions_with_a_payload_are_those_of_a_model_that_has_it(model, motion):
    q, q_dot = motion
    heavy = model.with_scene(model.scene.replace({"effects.tip_load.mass": MASS}))
    simulation = Simulation(heavy)
    simulation.reset(q, q_dot)
    expected = simulation.rollout(TENSION, PERIOD)
    terms = model.terms(q, q_dot)
    tip = terms.tip_jacobian[3:]
    simulation = Simulation(model)
    simulation.reset(q, q_dot)
    without = simulation.rollout(TENSION, PERIOD)
    turning = tip.T @ tip_acceleration(terms, q_dot, 0.0 * q)
    error = lacking(model, q, inertia=MASS * tip.T @ tip, constant=-MASS * turning)
    corrected = corrected_rollout(simulation, TENSION, PERIOD, error)
    # rates follow an acceleration that is a mean over the period: displacements tell it
    for k in (1, 2):
        displaced = np.abs(expected.q[k] - without.q[k]).max()
        difference = corrected.q[k] - expected.q[k]
        assert np.abs(difference).max() < 0.2 * displaced


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_friction_takes_its_share_of_tensions_of_whatever_sense(turned, model, motion):
    """Of tendons that slide it is Coulomb's, whatever their rates; it always takes energy."""
    q, q_dot = motion
    q_dot = turned * q_dot
    pull = model.terms(q, q_dot).actuation
    friction = TendonFriction(np.array([0.1, 0.2, 0.3]), pull)
    tension = np.array([[2.0, 1.0, 3.0]])
    for speed_up in (1.0, 2.0):
        rates = speed_up * q_dot
        (damping,) = friction.damping(tension, rates, 1e-6)
        shortening = np.sign(rates @ pull)
        np.testing.assert_allclose(
            damping @ rates, pull @ (friction.loss * tension[0] * shortening), rtol=1e-6
        )
        np.testing.assert_allclose(sliding_direction(friction.rates(rates), 1e-6), shortening)
        assert rates @ damping @ rates > 0.0
    # tendons that stick are damped, and never by less than nothing
    (sticking,) = friction.damping(tension, 0.0 * q_dot, SLIDING_SPEED)
    np.testing.assert_allclose(
        sticking, (pull * friction.loss * tension[0] / SLIDING_SPEED) @ pull.T, rtol=1e-6
    )
    (slack,) = friction.damping(-tension, q_dot, SLIDING_SPEED)
    np.testing.assert_array_equal(slack, 0.0)


def test_motions_with_friction_are_those_of_a_model_that_has_it(model, motion):
    """By the mean of the tension over a tendon: half of what the capstan takes up to its end."""
    q, q_dot = motion
    coefficient = 0.2
    changes = {
        "effects.tendon_friction.coefficient": coefficient,
        "effects.tendon_friction.stiction_speed": SLIDING_SPEED,
    }
    rubbing = model.with_scene(model.scene.replace(changes))
    simulation = Simulation(rubbing)
    simulation.reset(q, q_dot)
    expected = simulation.rollout(TENSION, PERIOD)
    turn = np.hypot(model.discretisation.tendon_turn, ArmGeometry(model).at(q).bending)
    pull = model.terms(q, q_dot).actuation
    error = lacking(model, q, friction=TendonFriction(0.5 * coefficient * turn, pull))
    simulation = Simulation(model)
    simulation.reset(q, q_dot)
    without = simulation.rollout(TENSION, PERIOD)
    corrected = corrected_rollout(simulation, TENSION, PERIOD, error)
    displaced = np.abs(expected.q[-1] - without.q[-1]).max()
    difference = corrected.q[-1] - expected.q[-1]
    assert np.abs(difference).max() < 0.3 * displaced


def test_tensions_hold_what_tensions_make(model, motion):
    """A force that tensions make is theirs; what they cannot make is left as small as can be."""
    q, q_dot = motion
    terms = model.terms(q, q_dot)
    tension = np.array([0.3, -0.2, 0.5])
    holding = holding_matrix(terms)
    np.testing.assert_allclose(holding @ terms.actuation @ tension, tension, atol=1e-6)
    force = ArmGeometry(model).at(q).load_jacobian[:, -2]
    held = holding @ force
    left = force - terms.actuation @ held
    np.testing.assert_allclose(
        terms.actuation.T @ np.linalg.solve(terms.stiffness, left), 0.0, atol=1e-8
    )


def test_a_model_that_lacks_nothing_moves_as_it_does(model, motion):
    q, q_dot = motion
    simulation = Simulation(model)
    simulation.reset(q, q_dot)
    expected = simulation.rollout(TENSION, PERIOD)
    for error in (None, lacking(model, q)):
        rollout = corrected_rollout(simulation, TENSION, PERIOD, error)
        np.testing.assert_allclose(rollout.q, expected.q, atol=1e-12)
        np.testing.assert_allclose(rollout.by_state, expected.by_state, atol=1e-12)
