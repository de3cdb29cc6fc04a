"""Elastic tendons: displacement against tension at rest, slack, stiff springs at long steps."""

import numpy as np
import pytest

from soft_tendon_env import build_model
from soft_tendon_env.model.simulation import simulate
from soft_tendon_env.model.statics import commanded_equilibrium, static_equilibrium
from soft_tendon_env.scene.scene import Scene

RAMP = {"effects.actuators.rate_limit": 0.02}
"""Actuators that take their time: a spring that is stretched by millimetres at once pulls as hard as it is stiff."""


def springs(stiffness=5e3, **more):
    return {"effects.tendon_elasticity": {"stiffness": stiffness, "displacement_limits": [0.0, 0.05]}, **more}


@pytest.mark.parametrize("stiffness", [200.0, 5e3, 3e5])
@pytest.mark.parametrize("scene", ["three_tendon", "four_tendon", "helical"])
def test_displacements_and_tensions_meet_at_rest(build, scene, stiffness):
    """The displacements that belong to an equilibrium under tensions lead there, in statics and in motion."""
    model = build(scene, springs(stiffness, **RAMP))
    u = np.linspace(2.0, 1.0, model.tendon_count)
    rest = static_equilibrium(model, u)
    command = model.command(u, rest.q)
    found, tension = commanded_equilibrium(model, command)
    assert found.converged
    np.testing.assert_allclose(tension, u, rtol=1e-5)
    np.testing.assert_allclose(found.tip_pose, rest.tip_pose, atol=1e-7)
    motion = simulate(model, command, 40.0, 0.02)
    np.testing.assert_allclose(motion.tip_pose[-1], rest.tip_pose, atol=1e-6)


def test_a_slack_tendon_does_not_pull(build):
    model = build("three_tendon", springs())
    found, tension = commanded_equilibrium(model, [0.004, -0.001, -0.02])
    assert tension[0] > 0.5 and tension[2] == 0.0
    np.testing.assert_allclose(found.tip_pose, static_equilibrium(model, tension).tip_pose, atol=1e-9)
    motion = simulate(model, [0.004, -0.001, -0.02], 40.0, 0.02)
    np.testing.assert_allclose(motion.tip_pose[-1], found.tip_pose, atol=1e-6)
    straight = simulate(model, [-0.01, -0.01, -0.01], 0.2, 0.02)
    np.testing.assert_array_equal(straight.q, 0.0)


G = [9.81, 0.0, 0.0]
EXPLICIT = {"type": "explicit", "modes": [{"strains": ["bend_y", "bend_z"], "order": 1, "span": "rod"}]}


@pytest.mark.parametrize("strain, most", [({"type": "statics_based"}, 0.03), (EXPLICIT, 2e-4)])
def test_stiff_springs_are_stable_at_long_steps(build, strain, most):
    """3e5 N/m, a steel cable, at 20 ms: explicit steps would have to be shorter than 0.2 ms.

    An arm that bends alone is held at its displacements by actuators of any strength. One that is compressed too lets tendons fall slack,
    and its motion is chaotic: 1e-12 m of one command are millimetres after five seconds at any step, so that the average counts."""
    settings = {"strain": strain, "integrator.step": 0.02, "effects.gravity.acceleration": G, "effects.tendon_elasticity.strength": 1e5}
    model = build("three_tendon", springs(3e5, **RAMP) | settings)
    fine = build_model(model.scene.replace({"integrator.step": 1e-3}))
    largest = []
    for seed in range(4):
        table = np.repeat(np.random.default_rng(seed).uniform(0.0, 0.004, (10, 3)), 20, axis=0)
        table = np.concatenate([table, np.tile(table[-1], (400, 1))])
        motion, exact = (simulate(own, table, 12.0, 0.02) for own in (model, fine))
        assert motion.rejected == 0 and np.ptp(exact.tip_pose[:, 2, 3]) > 0.02
        apart = np.linalg.norm(motion.tip_pose[:, :3, 3] - exact.tip_pose[:, :3, 3], axis=1)
        assert apart[-1] < 1e-4, "[m], of 0.3 m"
        largest.append(apart.max())
    assert np.mean(largest) < most, largest


@pytest.mark.parametrize("fidelity", ["fast", "standard", "fine"])
def test_a_wire_that_cables_drive_by_displacement_never_diverges(fidelity):
    """Steel cables 6 mm off a Nitinol wire of 1 mm: jumps and ramps of 8 mm, and rest where the statics has it."""
    offsets = [[6e-3 * np.cos(angle), 6e-3 * np.sin(angle)] for angle in np.deg2rad([0.0, 120.0, 240.0])]
    wire = {"length": 0.25, "young_modulus": 5.2e10, "poisson_ratio": 0.33, "density": 6450.0, "radius": 5e-4}
    tendons = [{"routing": {"type": "straight", "offset": offset}, "tension_limits": [0.0, 80.0]} for offset in offsets]
    for stiffness in (1e3, 1e5, 1e7):
        effects = {"tendon_elasticity": {"stiffness": stiffness, "displacement_limits": [-0.02, 0.02]}}
        for damping in (1e7, 1e8):
            table = {"name": "wire", "segments": [{**wire, "damping": damping}], "tendons": tendons, "effects": effects}
            model, end = build_model(Scene.parse(table, "wire"), fidelity), np.array([0.008, -0.02, -0.02])
            for command in (end, np.linspace(0.0, 1.0, 50)[:, None] * end):
                assert np.isfinite(simulate(model, command, 1.0, 0.02).tip_pose).all()
        rest, _ = commanded_equilibrium(model, 0.5 * end)
        held = simulate(model, 0.5 * end, 20.0, 1.0).tip_pose[-1]
        assert rest.converged and np.linalg.norm(held[:3, 3] - rest.tip_pose[:3, 3]) < 1e-9 * model.length
