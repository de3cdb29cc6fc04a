"""The paper's laws do what they are defined to do: accelerations, references, fixed points,
independence of coordinates."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.control.paper_laws import (
    Gains,
    PaperShape,
    PaperTipPose,
    ShapeTarget,
    TipPoseTarget,
    energy_left_inverse,
    euclidean_left_inverse,
    seen_from,
    shape_tension,
    tip_pose_tension,
)
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose, pose_error
from soft_tendon_env.envs.targets.shipped import Circle, CircleCourse

GAINS = Gains(10_000.0, 1000.0)
CIRCLE = CircleCourse(Circle())


def on_circle(t, apart=1e-4):
    samples = CIRCLE.sample(t + apart * np.array([-1.0, 0.0, 1.0]))
    return TipPoseTarget(
        samples.tip_pose[1],
        samples.tip_twist[1],
        (samples.tip_twist[2] - samples.tip_twist[0]) / (2.0 * apart),
    )


def acceleration(terms, q_dot, tension):
    """q_ddot of the equation of motion (23)."""
    forces = (
        terms.actuation @ tension
        + terms.external_force
        - terms.bias
        - terms.damping @ q_dot
        - terms.elastic_force
    )
    return np.linalg.solve(terms.mass, forces)


def test_the_target_seen_from_a_moving_tip_against_differences(build, random_state):
    model = build("paper")
    q, q_dot = random_state(model, 0)
    t = 0.7
    apart = 1e-5

    def seen(s):
        terms = model.terms(q + s * q_dot, q_dot)
        wanted = on_circle(t + s)
        return adjoint(inverse_pose(terms.tip_pose) @ wanted.pose) @ wanted.twist

    terms = model.terms(q, q_dot)
    twist, twist_dot = seen_from(terms.tip_pose, terms.tip_jacobian @ q_dot, on_circle(t))
    np.testing.assert_allclose(twist, seen(0.0))
    differences = (seen(apart) - seen(-apart)) / (2.0 * apart)
    np.testing.assert_allclose(
        twist_dot, differences, rtol=1e-5, atol=1e-5 * np.abs(differences).max()
    )


@pytest.mark.parametrize("left_inverse", [energy_left_inverse, euclidean_left_inverse])
@pytest.mark.parametrize("seed", range(3))
def test_full_actuation_gives_the_tip_the_commanded_acceleration(
    build, random_state, left_inverse, seed
):
    model = build("paper")
    wanted = on_circle(0.3 + seed)
    q, q_dot = random_state(model, seed)
    terms = model.terms(q, q_dot)
    twist = terms.tip_jacobian @ q_dot
    twist_bar, twist_bar_dot = seen_from(terms.tip_pose, twist, wanted)
    command = (
        twist_bar_dot
        + 1000.0 * (twist_bar - twist)
        + 10_000.0 * pose_error(terms.tip_pose, wanted.pose)
    )
    q_ddot = acceleration(terms, q_dot, tip_pose_tension(terms, q_dot, wanted, GAINS, left_inverse))
    np.testing.assert_allclose(
        terms.tip_jacobian @ q_ddot + terms.tip_bias,
        command,
        rtol=1e-6,
        atol=1e-6 * np.abs(command).max(),
    )


def test_shape_laws_are_the_printed_ones(build, random_state):
    wanted = ShapeTarget(np.arange(10.0), 2.0 * np.arange(10.0))
    gains = Gains(1000.0, 100.0)
    q, q_dot = random_state(build("paper"), 0)
    expected = (
        wanted.tension + 100.0 * (wanted.tension_rate - q_dot) + 1000.0 * (wanted.tension - q)
    )  # (37)
    np.testing.assert_allclose(shape_tension(build("paper"), q, q_dot, wanted, gains), expected)
    model = build("paper_16dof")
    q, q_dot = random_state(model, 0)
    q_bar, q_bar_dot = (np.concatenate([part, np.zeros(6)]) for part in wanted)
    B = model.terms(q, q_dot).actuation
    expected = (
        wanted.tension + 100.0 * B.T @ (q_bar_dot - q_dot) + 1000.0 * B.T @ (q_bar - q)
    )  # (38)
    np.testing.assert_allclose(shape_tension(model, q, q_dot, wanted, gains), expected)


@pytest.mark.parametrize("scene", ["paper", "paper_16dof", "four_tendon"])
def test_left_inverses_undo_the_actuation(build, random_state, scene):
    """Of redundant tendons the least tensions that do as much; in between is the force next to a
    given one, in the norm of the stiffness or of the coordinates."""
    model = build(scene)
    terms = model.terms(*random_state(model, 0))
    B = terms.actuation
    rng = np.random.default_rng(0)
    force = rng.normal(size=len(B))
    norms = {energy_left_inverse: np.linalg.inv(terms.stiffness), euclidean_left_inverse: None}
    for left_inverse, norm in norms.items():
        inverse = left_inverse(terms)
        rounding = 1e-8 * np.abs(B).max()
        np.testing.assert_allclose(B @ inverse @ B, B, atol=rounding)
        tension = inverse @ force
        off = force - B @ tension
        weighted = off if norm is None else norm @ off
        small = 1e-6 * np.abs(B.T @ force).max()
        np.testing.assert_allclose(B.T @ weighted, 0.0, atol=small)


def test_tips_that_cannot_be_accelerated_everywhere_are_refused(build, random_state):
    model = build("three_tendon")
    q, q_dot = random_state(model, 0)
    with pytest.raises(ValueError, match="in 3 of 6 directions"):
        tip_pose_tension(model.terms(q, q_dot), q_dot, on_circle(0.3), GAINS)


def test_the_controller_of_tips_is_the_law_within_limits(build, random_state):
    """With kp = 10,000 and kd = 1,000, of the target's motion: its twist and the twist's derivative
    from three poses. The tip is where it is measured."""
    model = build("paper")
    q, q_dot = random_state(model, 0)
    period = 1e-4
    times = period * np.arange(3.0)
    twist, acceleration = (
        np.array([0.5, -0.3, 0.2, 0.1, 0.2, -0.1]),
        np.array([30.0, -20.0, 10.0, 5.0, -8.0, 6.0]),
    )
    start = on_circle(0.4).pose
    poses = [start]
    for time in times[:2] + 0.5 * period:
        pose = moved_pose(poses[-1], period * (twist + time * acceleration))
        poses.append(pose)
    tip_pose = model.tip_pose(q)
    measured = moved_pose(tip_pose, np.array([0.02, 0.01, -0.03, 0.01, -0.02, 0.01]))
    terms = model.terms(q, q_dot)._replace(tip_pose=measured)
    target = TipPoseTarget(start, twist, acceleration)
    law = tip_pose_tension(terms, q_dot, target, GAINS)
    now = ControllerInput(q, q_dot, measured, np.zeros(10), Reference(times, np.stack(poses)))
    wide = np.tile([-1e9, 1e9], (10, 1))
    tension = PaperTipPose(model, wide, period).act(now).tension
    largest_tension = np.abs(law).max()
    np.testing.assert_allclose(tension, law, rtol=1e-5, atol=1e-5 * largest_tension)
    still = tip_pose_tension(terms, q_dot, target._replace(acceleration=np.zeros(6)), GAINS)
    largest_law = np.abs(law).max()
    assert np.abs(still - law).max() > 1e-3 * largest_law


@pytest.mark.parametrize("scene", ["paper", "paper_16dof"])
def test_the_controller_of_shapes_is_the_law(build, holding, random_state, scene):
    """With kp = 1,000 and kd = 100, of the target's rate over the period."""
    model = build(scene)
    q, q_dot = random_state(model, 0)
    first = np.arange(10.0)
    second = 3.0 + 0.5 * first
    here = holding(model, first)
    ahead = holding(model, second)
    path = np.concatenate([here.q, ahead.q])
    change = second - first
    target = ShapeTarget(first, change / 0.02)
    law = shape_tension(model, q, q_dot, target, Gains(1000.0, 100.0))
    reference = Reference(np.array([0.0, 0.02]), q=path)
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q_dot, tip_pose, np.zeros(10), reference)
    wide = np.tile([-1e9, 1e9], (10, 1))
    tension = PaperShape(model, wide, 0.02).act(now).tension
    largest_tension = np.abs(law).max()
    np.testing.assert_allclose(tension, law, rtol=1e-6, atol=1e-6 * largest_tension)
