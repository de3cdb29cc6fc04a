"""Orders of convergence in time: the error at a fixed time falls with the step as the method
promises."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import soft_tendon_env as ste
from soft_tendon_env.mechanics.motion.advance import Control, next_step
from soft_tendon_env.mechanics.motion.extrapolation import Attempt
from soft_tendon_env.mechanics.motion.status import INACCURATE, OK

HOLD = 0.1  # [s], a multiple of all steps: the input is the same for all of them
STEPS = (0.01, 0.005, 0.0025)
LOADS_INSIDE = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True}
BENDING_ONLY = {
    "strain.strains": ["torsion", "bend_y", "bend_z"]
}  # no fast axial modes, which hide the order of any method


def end(build, scene, changes, tensions, columns, step):
    changes = {**changes, "integrator.columns": columns, "integrator.step": step}
    duration = HOLD * len(tensions)
    model = build(scene, changes)
    motion = ste.simulate(model, tensions, duration, HOLD)
    return np.concatenate([motion.final.q, motion.final.q_dot])


def smooth(count, greatest):
    """Tensions (10, count) that change little from row to row."""
    t = HOLD * np.arange(10)[:, None]
    rise = np.sin(np.pi * t) ** 2
    shares = 0.5 * (1 + np.cos(np.arange(count)))
    return greatest * rise * shares


@pytest.mark.parametrize(
    "loads",
    [
        pytest.param({}, id="unloaded"),
        pytest.param(LOADS_INSIDE, id="loads inside", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_order_of_a_soft_motion(build, columns, loads):
    tensions = smooth(3, 2.0)
    changes = {**BENDING_ONLY, **loads}
    exact = end(build, "three_tendon", changes, tensions, 6, 0.001)
    errors = []
    for step in STEPS:
        found = end(build, "three_tendon", changes, tensions, columns, step)
        off = np.abs(found - exact)
        errors.append(off.max())
    ratios = np.array(errors[:-1]) / errors[1:]
    slopes = np.log2(ratios)
    assert (columns - 0.35 < slopes).all(), (errors, slopes)
    assert (slopes < columns + 0.8).all(), (errors, slopes)


def test_steps_below_the_most_columns_do_not_get_shorter():
    control = Control(step=0.02, tolerance=1e-4, adaptive=True, smallest=1e-6)
    assert next_step(control, 6, 1e-3, Attempt(OK, 5, 11, 1e-4, 5)) == pytest.approx(2e-3)
    assert next_step(control, 6, 1e-3, Attempt(OK, 6, 16, 1e-4, 6)) == pytest.approx(0.9e-3)
    assert next_step(control, 6, 1e-3, Attempt(INACCURATE, 6, 16, 64e-4, 6)) == pytest.approx(
        0.45e-3
    )


def test_motion_without_inertia_is_the_flow_of_damping_and_stiffness(build):
    """D q_dot = G ([u; 0] - q), which SciPy integrates too; the error falls with the order of the
    columns."""
    tension = np.array([3.0, 0.0, 1.0])
    model = build("three_tendon", {"quadrature.intervals": 6})

    def rate(_, q):
        terms = model.terms(q, np.zeros(3))
        return np.linalg.solve(terms.damping, terms.stiffness @ (tension - q))

    exact = solve_ivp(rate, (0.0, 0.04), np.zeros(3), rtol=1e-11, atol=1e-11, method="Radau").y[
        :, -1
    ]
    errors = []
    for step in (0.02, 0.01, 0.005):
        changes = {
            "quadrature.intervals": 6,
            "integrator.quasi_static": True,
            "integrator.step": step,
            "integrator.columns": 3,
        }
        simulation = ste.Simulation(build("three_tendon", changes))
        simulation.step(tension, 0.04)
        error = np.abs(simulation.state.q - exact).max()
        errors.append(error)
    assert errors[0] < 0.1 * np.abs(exact - tension).max() + 1e-2
    assert errors[2] < errors[1] / 4.0 < errors[0] / 16.0
