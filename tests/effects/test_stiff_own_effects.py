"""A user's own stiff effects, without derivatives by hand: stable at steps of 20 ms where
`implicit` names what they depend on."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.effects import LANES, Effect, Struct, adds_wrench, kernel

RATE = 1e5  # [1/s]
STIFFNESS = 1e5  # [N/m]
ANCHOR = (0.295, 0.01, -0.02)


class Drag(Struct):
    rate: float


class Spring(Struct):
    stiffness: tuple[float, float, float]  # along the axes of the world frame
    anchor: tuple[float, float, float]


@adds_wrench(Drag, implicit=("twist",))
@kernel
def drag(parameters, nodes):
    """-rate M eta."""
    for i in range(nodes.wrench.size):
        nodes.wrench[i] -= parameters.rate * nodes.inertia[i] * nodes.twist[i]


@adds_wrench(Spring, implicit=("pose",))
@kernel
def spring(parameters, nodes):
    """stiffness (anchor - r) at the tip, in its frame."""
    last = nodes.packs - 1
    pose = last * 12 * LANES + LANES - 1
    at = last * 6 * LANES + LANES - 1
    for k in range(3):
        for i in range(3):
            force = parameters.stiffness[i] * (
                parameters.anchor[i] - nodes.pose[pose + (9 + i) * LANES]
            )
            nodes.wrench[at + (3 + k) * LANES] += nodes.pose[pose + (3 * i + k) * LANES] * force


@pytest.fixture
def stiff(forgotten):
    """stiff(parameters): a model of a bare arm with a stiff effect."""

    def make(parameters):
        @ste.register("effect", "stiff")
        class Stiff(Effect):
            def parameters(self, rod):
                return parameters

        scene = ste.load_scene("three_tendon")
        bare = at_fidelity(scene, "standard")
        return ste.build_model(bare.replace({"effects.stiff": {}}), "scene")

    return make


def simulate_pull(model, seconds):
    """Simulation after so long under a pull of 3 N, in steps of 20 ms, and how many steps were
    rejected."""
    simulation = ste.Simulation(model)
    return simulation, sum(
        simulation.step([3.0, 0.0, 0.0], 0.02).rejected for _ in range(round(50 * seconds))
    )


def test_a_stiff_drag_creeps_as_it_should(stiff):
    """(D + D_drag) q_dot = B u - K to the small inertia; hardly a step is tried again, where it
    would be thousands otherwise."""
    model = stiff(Drag(RATE))
    simulation, rejected = simulate_pull(model, 2.0)
    terms = model.terms(simulation.state.q, simulation.state.q_dot, time=simulation.state.time)
    drive = terms.actuation @ [3.0, 0.0, 0.0] - terms.elastic_force
    creep = np.linalg.solve(terms.damping + terms.external_damping, drive)
    np.testing.assert_allclose(
        simulation.state.q_dot, creep, rtol=0, atol=1e-4 * np.abs(creep).max()
    )
    assert rejected < 10


def test_a_stiff_spring_comes_to_rest(stiff):
    model = stiff(Spring(3 * (STIFFNESS,), ANCHOR))
    simulation, rejected = simulate_pull(model, 2.0)
    rest = ste.static_equilibrium(model, [3.0, 0.0, 0.0])
    away = np.linalg.norm(model.tip_pose(simulation.state.q)[:3, 3] - rest.tip_pose[:3, 3])
    assert rest.converged
    assert away < 1e-9 * model.length
    distance = np.linalg.norm(rest.tip_pose[:3, 3] - ANCHOR)
    assert distance < 1e-4
    assert rejected < 20
