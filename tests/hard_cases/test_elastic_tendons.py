"""Elastic tendons as stiff as cables: commands that jump, slack that comes and goes, and rest."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.model.simulation import Simulation, simulate
from soft_tendon_env.model.statics import commanded_equilibrium

GREATEST = {
    "underwater": 0.012,
    "three_tendon": 0.02,
    "four_tendon": 0.006,
    "helical": 0.015,
    "two_segment_six": 0.008,
    "paper": 0.02,
}
"""Displacements [m] of the actuators."""


def with_elastic_tendons(name, stiffness, **changes):
    """The scene with elastic tendons of a stiffness [N/m], changed."""
    table = {"stiffness": stiffness, "displacement_limits": [0.0, GREATEST[name]]}
    return ste.load_scene(name).replace({"effects.tendon_elasticity": table, **changes})


def commands(model, greatest, rows, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, greatest, (rows, model.tendon_count))


@pytest.mark.parametrize(
    "fidelity",
    [
        "scene",
        "fast",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("standard", "fine")),
    ],
)
def test_commands_of_stiff_tendons_that_jump(measured, fidelity):
    """Actuators jump by centimetres: a cable of 2e5 to 1e7 N/m would pull with up to 100 kN and
    throw the arm; tendons go slack and taut within a step. Expected: no divergence, in 12 jumps of
    6 arms, and evaluations that do not grow with the stiffness, to a factor of 1.5."""
    for name in GREATEST:
        counts = []
        for stiffness in (2e5, 1e7):
            model = ste.build_model(at_fidelity(with_elastic_tendons(name, stiffness), fidelity))
            simulation = Simulation(model)
            counts.append(
                sum(
                    simulation.step(row, 0.15).evaluations
                    for row in commands(model, GREATEST[name], 12, 5)
                )
            )
            assert np.isfinite(simulation.tip_pose).all()
        measured("evaluations, of 1e7 / of 2e5 N/m", counts[1] / counts[0])
        assert counts[1] < 1.5 * counts[0], name


@pytest.mark.slow
def test_stiff_tendons_come_to_rest_where_the_statics_says(measured):
    """At long fixed steps a tendon that is slack at a step's beginning and taut at its end is
    pulled with what it has at neither. Expected: after 40 s at rest to 1e-6 mm, with some tendons
    slack, within 1e-6 of the length of where `commanded_equilibrium` says."""
    slack = 0
    arms = (
        ("two_segment_six", 2e6, 0.025),
        ("helical", 8e5, 0.02),
        ("three_tendon", 1e7, 0.04),
        ("paper", 1e7, 0.02),
    )
    for name, stiffness, step in arms:
        model = ste.build_model(with_elastic_tendons(name, stiffness, **{"integrator.step": step}))
        for command in commands(model, 0.4 * GREATEST[name], 3, 11):
            found, tension = commanded_equilibrium(model, command)
            motion = simulate(model, command, 40.0, 1.0)
            moves = 1e3 * np.ptp(motion.tip_pose[-5:, :3, 3], axis=0).max()
            apart = (
                np.linalg.norm(motion.tip_pose[-1, :3, 3] - found.tip_pose[:3, 3]) / model.length
            )
            slack += int((tension == 0.0).sum())
            measured("moves at the end [mm]", moves)
            measured("from the statics, part of the length", apart)
            assert found.converged, (name, stiffness, step)
            assert moves < 1e-6, (name, stiffness, step)
            assert apart < 1e-6, (name, stiffness, step)
    assert slack > 3


@pytest.mark.slow
def test_motion_of_stiff_tendons_follows_the_tolerance(measured):
    """Slack and taut within steps: nothing is smooth enough there to be extrapolated, and an
    estimate that takes it to be is wrong. Expected: over 0.8 s with four jumps each preset's own
    error, against first-order steps of 0.05 ms extrapolated from two sizes, is below 8, 3 and 1
    thousandths of the length."""
    allowed = {"fast": 8e-3, "standard": 3e-3, "fine": 1e-3}
    scene = at_fidelity(with_elastic_tendons("three_tendon", 6e5), "standard")

    def tips(integrator):
        model = ste.build_model(scene.replace({"integrator": integrator}))
        table = np.repeat(commands(model, 0.01, 4, 3), 10, axis=0)
        return simulate(model, table, 0.8, 0.02).tip_pose[:, :3, 3]

    coarse = tips({"step": 1e-4, "columns": 1})
    exact = tips({"step": 5e-5, "columns": 1})
    exact = 2.0 * exact - coarse
    for name, bound in allowed.items():
        preset = at_fidelity(with_elastic_tendons("three_tendon", 6e5), name).integrator
        error = (
            np.linalg.norm(
                tips({"step": preset.step, "tolerance": preset.tolerance}) - exact, axis=1
            ).max()
            / 0.3
        )
        measured(f"{name}, part of the length", error)
        assert error < bound
