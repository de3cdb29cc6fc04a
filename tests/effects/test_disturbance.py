"""Disturbances: virtual work of loads at points and along parts of the rod, and their functions of time."""

import numpy as np
import pytest

from soft_tendon_env.model.simulation import Simulation, simulate
from soft_tendon_env.model.statics import static_equilibrium

LENGTH, RADIUS, YOUNG = 0.3, 0.01, 5e5
INERTIA = np.pi * RADIUS**4 / 4
Q = np.random.default_rng(0).uniform(0.0, 5.0, 10)
FORCE = [0.1, 0.2, 0.3]


def loads(*tables):
    return {"effects.disturbance.loads": list(tables)}


def force_at(model, q=Q):
    return model.terms(q, 0 * q).external_force


@pytest.mark.no_jit
@pytest.mark.cases("place", [0.0, 0.001, 0.12, 0.225, 0.2999, 0.3])
def test_the_work_is_that_of_a_force_where_it_acts(uniform, slope, place):
    """F = d(force . r)/dq of the backbone itself, to fourth order in the distance of the nodes, in the first interval too."""
    changes = {"quadrature.intervals": 8, **loads({"at": place, "force": FORCE})}
    model = uniform(("torsion", "bend_y", "bend_z", "stretch"), 0, changes)
    q = np.array([1.0, 4.0, -3.0, 0.1])
    work = slope(lambda at: model.backbone_at(at, [place])[0, :3, 3], q, 1e-5).T @ FORCE
    np.testing.assert_allclose(force_at(model, q), work, rtol=0.0, atol=1e-4 * 0.024)  # of the largest, that at the tip


def test_a_pulse_is_there_from_its_start_to_its_end(build):
    """At borders of steps it begins and ends as a constant load does that is put on and taken off; at rest it is not there."""
    load = {"at": 0.21, "force": [0.0, 0.1, 0.0], "moment": [0.0, 0.0, 0.01]}
    plain = build("three_tendon", loads({**load, "force": [0.0, 0.0, 0.0], "moment": [0.0, 0.0, 0.0]}))
    signal = {"type": "pulse", "start": 0.1, "duration": 0.06}
    pushed, pulse = (build("three_tendon", loads(own)) for own in (load, {**load, "signal": signal}))
    state = Simulation(plain).state
    for model, duration in ((plain, 0.1), (pushed, 0.06), (plain, 0.14)):
        state = simulate(model, [1.0, 0.0, 2.0], duration, 0.02, initial=state).final
    whole = simulate(pulse, [1.0, 0.0, 2.0], 0.3, 0.02)
    np.testing.assert_allclose(whole.final.q, state.q, rtol=1e-12)
    rest = static_equilibrium(pulse, [1.0, 0.0, 2.0])
    np.testing.assert_allclose(rest.q, static_equilibrium(plain, [1.0, 0.0, 2.0]).q, atol=1e-12)


def test_a_sine_swings_as_a_forced_oscillator(uniform):
    """One coordinate: the amplitude of M q'' + D q' + K q = F sin(omega t) once it has settled."""
    frequency, force = 1.5, 2e-4
    signal = {"type": "sine", "frequency": frequency, "phase": 40.0}
    model = uniform(("bend_z",), 0, {**loads({"at": LENGTH, "force": [0.0, force, 0.0], "signal": signal}), "integrator.step": 2e-3})
    constant = uniform(("bend_z",), 0, loads({"at": LENGTH, "force": [0.0, force, 0.0]}))
    terms, omega = constant.terms([0.0], [0.0]), 2 * np.pi * frequency
    expected = terms.external_force / np.abs(terms.stiffness - omega**2 * terms.mass + 1j * omega * terms.damping)
    motion = simulate(model, np.zeros(3), 40.0, 0.01)
    settled = motion.q[motion.time > 35.0, 0]
    np.testing.assert_allclose(0.5 * np.ptp(settled), expected.item(), rtol=5e-3)
    start = np.sin(np.deg2rad(40.0)) * terms.external_force
    np.testing.assert_allclose(model.terms([0.0], [0.0]).external_force, start, rtol=1e-12)
