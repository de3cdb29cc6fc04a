"""Moving base: inertia forces against closed forms and against gravity, and the pose of what moves along."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.mechanics.terms.evaluate import evaluate
from soft_tendon_env.mechanics.workspace import make_workspace

STIFF = {"integrator.step": 0.01, "quadrature.intervals": 12, "integrator.columns": 4}


def moving(build, name="three_tendon", **motion):
    return build(name, {**STIFF, **{f"effects.moving_base.{key}": value for key, value in motion.items()}})


def motion_of(model, tension=None, seconds=0.4):
    """From the stress-free shape."""
    u = np.zeros(model.tendon_count) if tension is None else tension
    return ste.simulate(model, u, seconds, 0.02, initial=ste.Simulation(model).state)


def test_constant_acceleration_is_gravity_the_other_way(build):
    """Einstein's lift: relative to a base with acceleration a the arm moves as it does at rest under gravity -a."""
    a, tension = np.array([0.0, -2.0, 5.0]), np.array([2.0, 0.0, 1.0])
    accelerated = motion_of(moving(build, acceleration=a.tolist()), tension)
    heavy = motion_of(build("three_tendon", {**STIFF, "effects.gravity.acceleration": (-a).tolist()}), tension)
    lift = 0.5 * a * accelerated.time[:, None] ** 2
    np.testing.assert_allclose(accelerated.tip_pose[:, :3, 3] - lift, heavy.tip_pose[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(accelerated.tip_pose[:, :3, :3], heavy.tip_pose[:, :3, :3], atol=1e-9)


@pytest.mark.no_jit
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(build):
    """eta at the nodes, by differences of the poses in time of an arm whose coordinates stand still."""
    motion = {"velocity": [0.1, 0.2, -0.3], "acceleration": [1.0, -0.5, 2.0], "amplitude": [0.1, 0.0, 0.2], "axis": [1.0, 2.0, -1.0]}
    model = moving(build, **motion, angular_velocity=3.0, angular_amplitude=0.4, frequency=0.7)
    q, still, work, h = np.array([1.0, 0.5, 2.0]), np.zeros(3), make_workspace(model.arm), 1e-4

    def node(time):
        work.xi[:] = model.arm.rod.reference_strain
        work.clock[0] = time
        assert evaluate(model.arm, still, q, still, 1e-12, work) == -1
        g, tip = np.eye(4), work.pose.reshape(-1, 12, 4)[-1, :, -1]
        g[:3, :3], g[:3, 3] = tip[:9].reshape(3, 3), tip[9:]
        return g, work.eta.reshape(-1, 6, 4)[-1, :, -1].copy(), work.eta_bias.reshape(-1, 6, 4)[-1, :, -1].copy()

    (before, eta_before, _), (g, eta, eta_bias), (after, eta_after, _) = (node(0.3 + dt) for dt in (-h, 0.0, h))
    twist = np.linalg.inv(g) @ (after - before) / (2.0 * h)
    found = np.array([twist[2, 1], twist[0, 2], twist[1, 0], *twist[:3, 3]])
    np.testing.assert_allclose(eta, found, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(eta_bias, (eta_after - eta_before) / (2.0 * h), rtol=1e-6, atol=1e-5)
