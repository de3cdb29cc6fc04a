"""Cheap linear map of a held period: its formula, and how far it is from differences of the period itself."""

import numpy as np
import pytest

from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
SCENES = {
    "bare": {},
    "gravity and payload": GRAVITY,
    "loads inside": {**GRAVITY, "strain.include_loads": True},
    "fluid": {"effects.fluid.density": 1000.0},
    "elastic tendons": {"effects.tendon_elasticity": {"stiffness": 500.0, "displacement_limits": [0.0, 0.01]}},
    "explicit": {
        "strain": {
            "type": "explicit",
            "modes": [{"strains": ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"], "order": 1, "span": "rod"}],
        }
    },
    "small steps": {"integrator": {"method": "runge_kutta_4", "step": 1e-4}},
}
UNITS = {"elastic tendons": 1e-3}  # [m], commands in the place of 1 N
ERROR = {"gravity and payload": 0.35, "elastic tendons": 0.25, "explicit": 0.15}
"""Relative error of the map along a direction, where it is above 0.1: what is left out of the stiffness, of gravity for example."""


@pytest.fixture(params=SCENES)
def moving(request, build):
    """An arm in motion, the simulation of it, and a command."""
    simulation = Simulation(build("three_tendon", {"quadrature.intervals": 4, **SCENES[request.param]}))
    rng, unit = np.random.default_rng(0), UNITS.get(request.param, 1.0)
    for _ in range(5):
        simulation.step(unit * rng.uniform(1.0, 4.0, 3), PERIOD)
    return simulation, unit * rng.uniform(1.0, 4.0, 3)


@pytest.mark.parametrize("moving", ["bare", "gravity and payload", "loads inside", "fluid"], indirect=True)
def test_map_is_the_extrapolated_linearly_implicit_step(moving):
    simulation, command = moving
    n, state = simulation.model.coordinate_count, simulation.state
    terms = simulation.model.terms(state.q, state.q_dot)
    damping, stiffness = terms.damping + terms.external_damping, terms.stiffness + terms.external_stiffness

    def step(h):
        system = terms.mass + h * damping + h**2 * stiffness
        v = np.linalg.solve(system, np.hstack([-h * stiffness, terms.mass, h * terms.actuation]))
        by_q = np.hstack([np.eye(n), np.zeros((n, n + command.size))]) + h * v
        return np.vstack([by_q, v, np.hstack([np.zeros((command.size, 2 * n)), np.eye(command.size)])])

    expected = (2.0 * step(0.5 * PERIOD) @ step(0.5 * PERIOD) - step(PERIOD))[: 2 * n]
    found = simulation.implicit_map(command, PERIOD)
    for own, known in ((found.state, expected[:, : 2 * n]), (found.command, expected[:, 2 * n :])):
        np.testing.assert_allclose(own, known, atol=1e-6 * np.abs(known).max())


def test_map_is_near_differences_of_the_period_and_leaves_the_simulation(moving, request):
    simulation, command = moving
    state, unit = simulation.state, simulation.model.coordinate_scale()
    found = simulation.implicit_map(command, PERIOD)
    np.testing.assert_equal(simulation.state.q, state.q)

    def after(dq, dv, du):
        simulation.reset(state.q + dq, state.q_dot + dv, effects=state.effects)
        simulation.step(command + du, PERIOD)
        return np.concatenate([simulation.state.q / unit, simulation.state.q_dot / unit])

    rng, shares = np.random.default_rng(1), np.tile(unit, 2)
    for part in np.eye(3):
        dq, dv, du = part[0] * unit * rng.normal(size=unit.size), part[1] * unit * rng.normal(size=unit.size), part[2] * command
        way = 1e-4 * rng.uniform(0.5, 1.0)
        expected = (after(way * dq, way * dv, way * du) - after(-way * dq, -way * dv, -way * du)) / (2.0 * way)
        error = (found.state @ np.concatenate([dq, dv]) + found.command @ du) / shares - expected
        assert np.linalg.norm(error) < ERROR.get(request.node.callspec.params["moving"], 0.1) * np.linalg.norm(expected)


@pytest.mark.cases("command, duration, message", [([1.0], 0.02, "command"), ([1.0] * 3, 0.0, "duration"), ([np.nan] * 3, 0.02, "command")])
def test_bad_arguments_of_a_map_are_named(build, command, duration, message):
    with pytest.raises(ValueError, match=message):
        Simulation(build("three_tendon", {"quadrature.intervals": 2})).implicit_map(command, duration)
