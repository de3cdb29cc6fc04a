"""Cheap linear map of a held period, whose transpose the adjoint over rows takes: its formula."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.implicit_map import linearise, make_map_memory, transposed_map
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
SCENES = {
    "bare": {},
    "gravity and payload": GRAVITY,
    "loads inside": {**GRAVITY, "strain.include_loads": True},
    "fluid": {"effects.fluid.density": 1000.0},
}


@pytest.mark.parametrize("scene", SCENES)
def test_transposed_map_is_that_of_the_extrapolated_linearly_implicit_step(scene, build):
    simulation = Simulation(build("three_tendon", {"quadrature.intervals": 4, **SCENES[scene]}))
    rng = np.random.default_rng(0)
    for _ in range(5):
        simulation.step(rng.uniform(1.0, 4.0, 3), PERIOD)
    n, state = simulation.model.coordinate_count, simulation.state
    terms = simulation.model.terms(state.q, state.q_dot)
    damping, stiffness = terms.damping + terms.external_damping, terms.stiffness + terms.external_stiffness

    def step(h):
        system = terms.mass + h * damping + h**2 * stiffness
        v = np.linalg.solve(system, np.hstack([-h * stiffness, terms.mass, h * np.eye(n)]))
        by_q = np.hstack([np.eye(n), np.zeros((n, 2 * n))]) + h * v
        return np.vstack([by_q, v, np.hstack([np.zeros((n, 2 * n)), np.eye(n)])])

    expected = (2.0 * step(0.5 * PERIOD) @ step(0.5 * PERIOD) - step(PERIOD))[: 2 * n]
    found = transposed(simulation, rng.uniform(1.0, 4.0, 3))
    for part in (slice(0, 2 * n), slice(2 * n, None)):
        np.testing.assert_allclose(found[:, part], expected[:, part], atol=1e-6 * np.abs(expected[:, part]).max())


def transposed(simulation, command):
    """Jacobian (2n, 3n) of a period by coordinates, rates and forces that act throughout it, row by row by the transposed map."""
    arm, n = simulation.model.arm, simulation.model.coordinate_count
    scratch, memory, rows = make_scratch(arm, 2), make_map_memory(arm), []
    assert linearise(arm, Extrapolated(2, 2, True, False, 1e-9), command, simulation._motion, PERIOD, scratch, memory) == OK
    for own in np.eye(2 * n):
        memory.q[:], memory.v[:] = own[:n], own[n:]
        transposed_map(True, scratch.first, PERIOD, memory)
        rows.append(np.concatenate([memory.q, memory.v, memory.impulse.sum(axis=0)]))
    return np.array(rows)
