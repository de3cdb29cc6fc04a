"""Tendon friction: the capstan equation on arcs and helices, hysteresis of a slow cycle, creep, dissipation."""

import numpy as np
import pytest
from scipy.optimize import brentq

from soft_tendon_env.mechanics.terms.evaluate import configure, evaluate
from soft_tendon_env.mechanics.terms.tendon_friction import find_share
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.simulation import Simulation, simulate

MU = 0.15


def friction(coefficient=MU, **more):
    return {"effects.tendon_friction": {"coefficient": coefficient}, **more}


def shares(model, q, direction):
    """What is left of the tensions at the points (n_a, points), base to tip, where all tendons slide in a direction."""
    work, q = make_workspace(model.arm), np.asarray(q, dtype=float)
    assert configure(model.arm, q, 1e-12, work) == (-1, 1.0)
    assert evaluate(model.arm, np.ones(model.tendon_count), q, 0.0 * q, 1e-12, work) == -1
    for i in range(model.tendon_count):
        find_share(model.arm, i, MU, direction, work)
    return model.grid.at_points(work.share.reshape(model.tendon_count, -1), 1)[..., 0].reshape(model.tendon_count, -1)


@pytest.mark.no_jit
@pytest.mark.parametrize("direction", [1.0, -0.5])
def test_the_tension_falls_with_the_angle_of_an_arc(uniform, direction):
    """exp(-mu z theta(s)) exactly: tendons parallel to a rod bent evenly turn as it does."""
    model = uniform(("bend_z",), 0, friction(**{"quadrature.intervals": 5}))
    curvature = 8.0
    q = curvature / model.strain_at(np.ones(1), [0.1])[1][0, 2, 0] * np.ones(1)
    expected = np.exp(-MU * direction * curvature * model.grid.points[model.grid.real].ravel())
    for found in shares(model, q, direction):
        np.testing.assert_allclose(found[: expected.size], expected, rtol=1e-7)


def bent(model, tension, direction):
    """The bending (q,) of an arm with one constant strain at rest under the first tendon: E I theta / l = T r (1 - exp(-a)) / a, with
    a = mu z theta."""
    unit = model.strain_at(np.ones(1), [0.1])[1][0, 2, 0]
    terms = model.terms([0.0], [0.0])
    lever = terms.actuation[0, 0] / (unit * model.length)

    def unbalanced(q):
        a = MU * direction * unit * q * model.length * np.sign(q * unit)
        return tension * lever * unit * model.length * (-np.expm1(-a) / a if a else 1.0) - terms.stiffness[0, 0] * q

    far = 3.0 * tension * terms.actuation[0, 0] / terms.stiffness[0, 0]
    return brentq(unbalanced, 0.0, far) if unbalanced(far) < 0.0 else far


def test_hysteresis_of_a_slow_cycle(uniform):
    """Loading and unloading lie where the capstan equation has them, the loop closes, and its area is that of the theory."""
    steps = {"integrator.quasi_static": True, "integrator.columns": 1, "integrator.step": 1e-3}
    changes = friction(**{**steps, "quadrature.intervals": 5, "segments.0.damping": 200.0})
    changes["effects.tendon_friction"]["stiction_speed"] = 5e-7
    model = uniform(("bend_z",), 0, changes)
    period = 20.0

    def tension(time):
        return np.array([2.0 - 1.5 * np.cos(2.0 * np.pi * time / period), 0.0, 0.0])

    motion = simulate(model, tension, 3.0 * period, 0.05)
    pull = np.array([tension(time)[0] for time in motion.time])
    q, per = motion.q[:, 0], round(period / 0.05)
    assert np.abs(q[2 * per :] - q[per : 2 * per + 1]).max() < 1e-3 * np.abs(q).max(), "closed"
    least, most = bent(model, 0.5, -1.0), bent(model, 3.5, 1.0)

    def theory(direction, tensions):
        """Where the tendon slides, and before that where it sticks."""
        return np.clip([bent(model, own, direction) for own in tensions], least, most)

    for direction, part in ((1.0, slice(per, per + per // 2)), (-1.0, slice(per + per // 2, 2 * per))):
        np.testing.assert_allclose(q[part], theory(direction, pull[part]), rtol=1e-2)
    area = abs(np.trapezoid(q[per : 2 * per], pull[per : 2 * per]))
    grid = np.linspace(0.5, 3.5, 400)
    np.testing.assert_allclose(area, np.trapezoid(theory(-1.0, grid) - theory(1.0, grid), grid), rtol=5e-3)


def test_what_sticks_creeps(uniform):
    """An arm whose tension falls stays where friction holds it, creeps below the stiction speed, and comes to rest without friction."""
    changes = friction(**{"integrator.quasi_static": True, "quadrature.intervals": 4, "integrator.step": 0.01})
    changes["effects.tendon_friction"]["stiction_speed"] = 1e-4
    simulation = Simulation(uniform(("bend_z",), 0, changes))
    simulation.step([2.0, 0.0, 0.0], 100.0)
    lengths = [simulation.model.tendon_lengths(simulation.state.q)[0]]
    for duration in (0.1, 1.0, 1.0, 100.0):
        simulation.step([1.95, 0.0, 0.0], duration)
        lengths.append(simulation.model.tendon_lengths(simulation.state.q)[0])
    assert 0.0 < np.diff(lengths)[2] < 1e-4, "[m/s]"
    np.testing.assert_allclose(simulation.state.q[0], bent(simulation.model, 1.95, 0.0), rtol=1e-6)
