"""The paper's laws do what they are defined to do: accelerations, references, fixed points, independence of coordinates."""

import numpy as np
import pytest

from soft_tendon_env.control.paper_laws import (
    Gains,
    ShapeTarget,
    TipPoseTarget,
    energy_left_inverse,
    euclidean_left_inverse,
    seen_from,
    shape_tension,
    tip_pose_tension,
)
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, pose_error
from soft_tendon_env.envs.targets.motions import Circle, CircleCourse
from soft_tendon_env.model.inverse_statics import tension_for_tip_pose

GAINS = Gains(10_000.0, 1000.0)
CIRCLE = CircleCourse(Circle())


def on_circle(t, apart=1e-4):
    samples = CIRCLE.sample(t + apart * np.array([-1.0, 0.0, 1.0]))
    return TipPoseTarget(samples.tip_pose[1], samples.tip_twist[1], (samples.tip_twist[2] - samples.tip_twist[0]) / (2.0 * apart))


def acceleration(terms, q_dot, tension):
    """q_ddot of the equation of motion (23)."""
    forces = terms.actuation @ tension + terms.external_force - terms.bias - terms.damping @ q_dot - terms.elastic_force
    return np.linalg.solve(terms.mass, forces)


def test_the_target_seen_from_a_moving_tip_against_differences(build, random_state):
    model = build("paper")
    q, q_dot = random_state(model, 0)
    t, apart = 0.7, 1e-5

    def seen(s):
        terms, wanted = model.terms(q + s * q_dot, q_dot), on_circle(t + s)
        return adjoint(inverse_pose(terms.tip_pose) @ wanted.pose) @ wanted.twist

    terms = model.terms(q, q_dot)
    twist, twist_dot = seen_from(terms.tip_pose, terms.tip_jacobian @ q_dot, on_circle(t))
    np.testing.assert_allclose(twist, seen(0.0))
    differences = (seen(apart) - seen(-apart)) / (2.0 * apart)
    np.testing.assert_allclose(twist_dot, differences, rtol=1e-5, atol=1e-5 * np.abs(differences).max())


@pytest.mark.parametrize("left_inverse", [energy_left_inverse, euclidean_left_inverse])
@pytest.mark.parametrize("seed", range(3))
def test_full_actuation_gives_the_tip_the_commanded_acceleration(build, random_state, left_inverse, seed):
    model, wanted = build("paper"), on_circle(0.3 + seed)
    q, q_dot = random_state(model, seed)
    terms = model.terms(q, q_dot)
    twist = terms.tip_jacobian @ q_dot
    twist_bar, twist_bar_dot = seen_from(terms.tip_pose, twist, wanted)
    command = twist_bar_dot + 1000.0 * (twist_bar - twist) + 10_000.0 * pose_error(terms.tip_pose, wanted.pose)
    q_ddot = acceleration(terms, q_dot, tip_pose_tension(terms, q_dot, wanted, GAINS, left_inverse))
    np.testing.assert_allclose(terms.tip_jacobian @ q_ddot + terms.tip_bias, command, rtol=1e-6, atol=1e-6 * np.abs(command).max())


def in_other_coordinates(terms, q_dot, T):
    """The same state in coordinates p with q = T p."""
    square, column = ("mass", "damping", "stiffness"), ("bias", "actuation", "elastic_force", "external_force")
    changed = {name: T.T @ getattr(terms, name) @ T for name in square} | {name: T.T @ getattr(terms, name) for name in column}
    return terms._replace(**changed, tip_jacobian=terms.tip_jacobian @ T), np.linalg.solve(T, q_dot)


def test_only_the_inverse_in_the_energy_gives_the_same_tensions_in_all_coordinates(build, random_state):
    model = build("paper_16dof")
    q, q_dot = random_state(model, 3)
    terms, T = model.terms(q, q_dot), np.eye(16) + 0.3 * np.random.default_rng(0).normal(size=(16, 16))
    change = {}
    for left_inverse in (energy_left_inverse, euclidean_left_inverse):
        here = tip_pose_tension(terms, q_dot, on_circle(1.0), GAINS, left_inverse)
        there = tip_pose_tension(*in_other_coordinates(terms, q_dot, T), on_circle(1.0), GAINS, left_inverse)
        change[left_inverse] = np.abs(there - here).max() / np.abs(here).max()
    assert change[energy_left_inverse] < 1e-6
    assert change[euclidean_left_inverse] > 1e-2


def test_small_deviations_on_the_circle_die_out_at_the_rate_of_the_gains(build):
    """Full actuation: the slow pole of s^2 + kd s + kp."""
    model, wanted = build("paper"), TipPoseTarget(CIRCLE.sample(np.array([0.3])).tip_pose[0], np.zeros(6), np.zeros(6))
    rest = np.concatenate([tension_for_tip_pose(model, wanted.pose).q, np.zeros(10)])

    def rate(x):
        q, q_dot = np.split(x, 2)
        terms = model.terms(q, q_dot)
        return np.concatenate([q_dot, acceleration(terms, q_dot, tip_pose_tension(terms, q_dot, wanted, GAINS))])

    for _ in range(20):  # what (39) leaves free comes to rest where it stores least energy: Newton steps of q_ddot = 0
        jacobian = np.stack([(rate(rest + d) - rate(rest - d)) / 2e-6 for d in 1e-6 * np.eye(20)], axis=1)
        rest = rest - np.linalg.solve(jacobian, rate(rest))
    assert np.abs(rate(rest)).max() < 1e-5
    slow = np.roots([1.0, 1000.0, 10_000.0]).max()
    parts = np.sort(np.linalg.eigvals(jacobian).real)
    np.testing.assert_allclose(parts[-6:], slow, rtol=1e-3)


@pytest.mark.parametrize("name", ["paper", "paper_16dof", "four_tendon"])
def test_shape_law_holds_the_wanted_shape_with_its_tensions(build, name):
    model = build(name)
    tension = 3.0 + np.arange(model.tendon_count)
    wanted, q = ShapeTarget(tension, np.zeros(model.tendon_count)), model.rest_coordinates(tension)
    found = shape_tension(model, q, 0.0 * q, wanted, Gains(1000.0, 100.0))
    np.testing.assert_allclose(found, tension, rtol=1e-12)
    if not model.arm.effects.count:
        assert np.abs(acceleration(model.terms(q, 0.0 * q), 0.0 * q, found)).max() < 1e-6


def test_shape_laws_are_the_printed_ones(build, random_state):
    wanted, gains = ShapeTarget(np.arange(10.0), 2.0 * np.arange(10.0)), Gains(1000.0, 100.0)
    q, q_dot = random_state(build("paper"), 0)
    expected = wanted.tension + 100.0 * (wanted.tension_rate - q_dot) + 1000.0 * (wanted.tension - q)  # (37)
    np.testing.assert_allclose(shape_tension(build("paper"), q, q_dot, wanted, gains), expected)
    model = build("paper_16dof")
    q, q_dot = random_state(model, 0)
    q_bar, q_bar_dot = (np.concatenate([part, np.zeros(6)]) for part in wanted)
    B = model.terms(q, q_dot).actuation
    expected = wanted.tension + 100.0 * B.T @ (q_bar_dot - q_dot) + 1000.0 * B.T @ (q_bar - q)  # (38)
    np.testing.assert_allclose(shape_tension(model, q, q_dot, wanted, gains), expected)


def test_laws_say_what_they_cannot_do(build):
    explicit, four = build("paper_48dof"), build("four_tendon")
    with pytest.raises(ValueError, match="explicit basis"):
        shape_tension(explicit, np.zeros(48), np.zeros(48), ShapeTarget(np.zeros(10), np.zeros(10)), GAINS)
    with pytest.raises(ValueError, match=r"q should have shape \(10,\)"):
        shape_tension(build("paper"), np.zeros(9), np.zeros(10), ShapeTarget(np.zeros(10), np.zeros(10)), GAINS)
    with pytest.raises(ValueError, match="in 3 of 6 directions"):
        tip_pose_tension(four.terms(np.zeros(3), np.zeros(3)), np.zeros(3), on_circle(0.0), GAINS)
