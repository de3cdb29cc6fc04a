"""Linearised forces and the linear map of a period: against differences of all terms of the motion,
and against its formula."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated, evaluate_force
from soft_tendon_env.mechanics.motion.force_gradient import GradientMemory, force_gradient
from soft_tendon_env.mechanics.motion.implicit_euler import start_matrices
from soft_tendon_env.mechanics.motion.period_map import (
    add_jacobian,
    make_plan,
    matrices_of_motion,
    transposed_map,
)
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.workspace import sizes_of, zeros
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.step_control import step_method

GRAVITY = {"effects.gravity.acceleration": [3.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
SCENES = {
    "bare": {},
    "gravity and payload": GRAVITY,
    "loads inside": {**GRAVITY, "strain.include_loads": True},
    "fluid": {**GRAVITY, "effects.fluid": {"density": 1000.0}},
    "stiffening": {"effects.nonlinear_elasticity": {"bending": 5.0, "stretch": 0.05}},
    "moving base": {
        "effects.moving_base": {
            "amplitude": [0.0, 0.01, 0.0],
            "angular_amplitude": 0.2,
            "frequency": 2.0,
        }
    },
    "explicit": {
        "strain": {
            "type": "explicit",
            "modes": [{"strains": ["bend_y", "bend_z"], "order": 1, "span": "rod"}],
        }
    },
}
TIME = 0.1  # [s], at which the base moves
PERIOD = 0.02


@pytest.mark.parametrize("scene", SCENES)
def test_gradient_is_that_of_all_terms(build, scene):
    changes = {"quadrature.intervals": 4, **SCENES[scene]}
    model = build("three_tendon", changes)
    rng = np.random.default_rng(0)
    unit = model.coordinate_scale()
    n = model.coordinate_count
    u = np.array([1.0, 3.0, 2.0])
    q = 0.3 * unit * rng.normal(size=n)
    v = 3.0 * unit * rng.normal(size=n)
    a = 30.0 * unit * rng.normal(size=n)
    w = unit * rng.normal(size=n)

    def power(q, v):
        terms = model.terms(q, v, time=TIME)
        force = (
            terms.actuation @ u
            - terms.elastic_force
            - terms.damping @ v
            - terms.bias
            + terms.external_force
        )
        return w @ (force - terms.mass @ a)

    def gradient(x, y):
        slopes = []
        for step in 1e-4 * np.diag(unit):
            ahead = power(q + x * step, v + y * step)
            behind = power(q - x * step, v - y * step)
            slopes.append((ahead - behind) / 2e-4)
        return np.array(slopes) / unit

    scratch = make_scratch(model.arm, 1)
    memory = zeros(GradientMemory, sizes_of(model.arm))
    motion = Motion(q, v, model.packed_strain(q), np.zeros(0), np.array([TIME]))
    scratch.work.strain.xi[:] = motion.xi
    evaluate_force(
        model.arm,
        step_method(model)._replace(strain_tolerance=1e-12),
        u,
        q,
        v,
        motion.state,
        TIME,
        scratch,
    )
    start_matrices(model.arm, scratch)
    memory.w[:] = w
    memory.a[:] = a
    damping = scratch.first.matrices.D @ w
    force_gradient(model.arm, u, motion, 2e-3, True, scratch.work, memory)
    for found, expected in (
        (memory.by_q, gradient(1.0, 0.0)),
        (memory.by_rate - damping, gradient(0.0, 10.0) / 10.0),
    ):
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, atol=1e-5 * largest)


@pytest.mark.parametrize("scene", ["bare", "gravity and payload", "loads inside", "fluid"])
def test_map_is_that_of_the_extrapolated_linearly_implicit_step(scene, build):
    changes = {"quadrature.intervals": 4, **SCENES[scene]}
    model = build("three_tendon", changes)
    simulation = Simulation(model)
    rng = np.random.default_rng(0)
    for _ in range(5):
        tension = rng.uniform(1.0, 4.0, 3)
        simulation.step(tension, PERIOD)
    arm = model.arm
    n = model.coordinate_count
    motion = simulation._motion
    scratch = make_scratch(arm, 2)
    method = Extrapolated(2, 2, True, False, 1e-9)
    scratch.work.strain.xi[:] = motion.xi
    u = np.ones(3)
    q = motion.q
    q_dot = motion.q_dot
    assert evaluate_force(arm, method, u, q, q_dot, motion.state, 0.0, scratch) == OK
    matrices_of_motion(arm, method, scratch)
    matrices = scratch.first.matrices
    mass = matrices.M
    damping = matrices.D
    stiffness = matrices.G

    def step(h):
        unit = np.eye(n)
        nothing = np.zeros((n, 2 * n))
        system = mass + h * damping + h**2 * stiffness
        right = np.hstack([-h * stiffness, mass, h * unit])
        v = np.linalg.solve(system, right)
        still = np.hstack([unit, nothing])
        by_q = still + h * v
        held = np.hstack([nothing, unit])
        return np.vstack([by_q, v, held])

    def close(found, expected):
        for part in (slice(0, 2 * n), slice(2 * n, None)):
            block = expected[:, part]
            largest = np.abs(block).max()
            np.testing.assert_allclose(found[:, part], block, atol=1e-9 * largest)

    plan = make_plan(arm, 1, 1, np.zeros((n, n - 3)))
    plan.forces[:] = np.eye(n)
    for count in (1, 3):
        h = PERIOD / count
        found = np.zeros((2 * n, 3 * n))
        add_jacobian(scratch.first, 0.5 * h, 2 * count, 2.0, plan, found)
        add_jacobian(scratch.first, h, count, -1.0, plan, found)
        fine = np.linalg.matrix_power(step(0.5 * h), 2 * count)
        coarse = np.linalg.matrix_power(step(h), count)
        expected = 2.0 * fine - coarse
        close(found, expected[: 2 * n])
    rows = []
    for unit in np.eye(2 * n):
        q = unit[:n].copy()
        v = unit[n:].copy()
        impulse = np.zeros((2, n))
        assert transposed_map(scratch.first, PERIOD, scratch, q, v, impulse) == OK
        rows.append(np.concatenate([q, v, impulse.sum(axis=0)]))
    half = step(0.5 * PERIOD)
    expected = 2.0 * half @ half - step(PERIOD)
    close(np.array(rows), expected[: 2 * n])
