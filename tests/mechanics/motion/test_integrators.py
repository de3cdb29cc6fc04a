"""Orders of convergence in time: the error at a fixed time falls with the step as the method promises."""

import numpy as np
import pytest

import soft_tendon_env as ste

HOLD = 0.1  # [s], a multiple of all steps: the input is the same for all of them
STEPS = (0.01, 0.005, 0.0025)
METHODS = {
    "1 column": ("extrapolated", 1, 1), "2 columns": ("extrapolated", 2, 2), "3 columns": ("extrapolated", 3, 3),
    "4 columns": ("extrapolated", 4, 4), "runge_kutta_4": ("runge_kutta_4", None, 4),
}  # fmt: skip
BENDING_ONLY = {"strain.strains": ["torsion", "bend_y", "bend_z"]}  # no fast axial modes, which hide the order of any method


def end(build, scene, changes, tensions, method, columns, step):
    changes = {**changes, "integrator.method": method, "integrator.columns": columns, "integrator.step": step}
    final = ste.simulate(build(scene, changes), tensions, HOLD * len(tensions), HOLD).final
    return np.concatenate([final.q, final.q_dot])


def smooth(count, greatest):
    """Tensions (10, count) that change little from row to row."""
    t = HOLD * np.arange(10)[:, None]
    return 0.5 * greatest * np.sin(np.pi * t) ** 2 * (1 + np.cos(np.arange(count)))


@pytest.mark.parametrize("method", METHODS)
def test_order_of_a_soft_motion(build, method):
    name, columns, order = METHODS[method]
    tensions = smooth(3, 2.0)
    exact = end(build, "three_tendon", BENDING_ONLY, tensions, "extrapolated", 6, 0.001)
    errors = [np.abs(end(build, "three_tendon", BENDING_ONLY, tensions, name, columns, step) - exact).max() for step in STEPS]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order - 0.35 < slopes).all() and (slopes < order + 0.8).all(), (errors, slopes)


@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_error_of_a_stiff_motion_falls_with_columns_and_steps(build, columns):
    """The paper's arm has rates of 1e4 1/s: at steps far beyond them every column and every halving still helps."""
    tensions = smooth(10, 10.0)
    exact = end(build, "paper_16dof", {}, tensions, "extrapolated", 5, 0.0005)
    errors = [np.abs(end(build, "paper_16dof", {}, tensions, "extrapolated", columns, step) - exact)[:16].max() for step in STEPS]
    fewer = np.abs(end(build, "paper_16dof", {}, tensions, "extrapolated", max(columns - 1, 1), STEPS[0]) - exact)[:16].max()
    assert errors[0] > 1.7 * errors[1] > 1.7**2 * errors[2], errors
    assert columns == 1 or errors[0] < 0.5 * fewer, (errors, fewer)


@pytest.mark.parametrize("columns", [2, 3])
def test_tolerance_bounds_the_error(build, columns):
    """Error control: a hundred times the accuracy asked for gives at least five times the accuracy, at more steps."""
    tensions = smooth(10, 10.0)
    changes = {"integrator.columns": columns, "integrator.step": 0.05}
    model = {tolerance: build("paper", {**changes, "integrator.tolerance": tolerance}) for tolerance in (1e-4, 1e-6)}
    exact = ste.simulate(build("paper", {"integrator.columns": 4, "integrator.step": 5e-4}), tensions, 1.0, HOLD)
    runs = {tolerance: ste.simulate(m, tensions, 1.0, HOLD) for tolerance, m in model.items()}
    errors = {tolerance: np.linalg.norm((run.tip_pose - exact.tip_pose)[:, :3, 3], axis=1).max() for tolerance, run in runs.items()}
    assert errors[1e-6] < 0.2 * errors[1e-4] and errors[1e-4] < 0.01, errors
    assert runs[1e-6].steps > 2 * runs[1e-4].steps
