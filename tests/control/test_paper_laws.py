"""The paper's laws do what they are defined to do: accelerations, references, fixed points,
independence of coordinates."""

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
    t, apart = 0.7, 1e-5

    def seen(s):
        terms, wanted = model.terms(q + s * q_dot, q_dot), on_circle(t + s)
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
    model, wanted = build("paper"), on_circle(0.3 + seed)
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
    wanted, gains = ShapeTarget(np.arange(10.0), 2.0 * np.arange(10.0)), Gains(1000.0, 100.0)
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
