"""Orders of convergence in time: the error at a fixed time falls with the step as the method promises."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import soft_tendon_env as ste
from soft_tendon_env.accuracy.test_inputs import motion_tensions
from soft_tendon_env.mechanics.motion.advance import Control, Record, Scheme, advance, next_step
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.stages import Attempt, evaluate_force, predict_strain
from soft_tendon_env.mechanics.motion.status import INACCURATE, OK
from soft_tendon_env.model.step_control import step_control, step_method

HOLD = 0.1  # [s], a multiple of all steps: the input is the same for all of them
STEPS = (0.01, 0.005, 0.0025)
LOADS_INSIDE = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True}
BENDING_ONLY = {"strain.strains": ["torsion", "bend_y", "bend_z"]}  # no fast axial modes, which hide the order of any method


def end(build, scene, changes, tensions, columns, step):
    changes = {**changes, "integrator.columns": columns, "integrator.step": step}
    final = ste.simulate(build(scene, changes), tensions, HOLD * len(tensions), HOLD).final
    return np.concatenate([final.q, final.q_dot])


def smooth(count, greatest):
    """Tensions (10, count) that change little from row to row."""
    t = HOLD * np.arange(10)[:, None]
    return 0.5 * greatest * np.sin(np.pi * t) ** 2 * (1 + np.cos(np.arange(count)))


@pytest.mark.parametrize("loads", [{}, LOADS_INSIDE], ids=["unloaded", "loads inside"])
@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_order_of_a_soft_motion(build, columns, loads):
    tensions, changes = smooth(3, 2.0), {**BENDING_ONLY, **loads}
    exact = end(build, "three_tendon", changes, tensions, 6, 0.001)
    errors = [np.abs(end(build, "three_tendon", changes, tensions, columns, step) - exact).max() for step in STEPS]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (columns - 0.35 < slopes).all() and (slopes < columns + 0.8).all(), (errors, slopes)


@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_error_of_a_stiff_motion_falls_with_columns_and_steps(build, columns):
    """The paper's arm has rates of 1e4 1/s: at steps far beyond them every column and every halving still helps."""
    tensions = smooth(10, 10.0)
    exact = end(build, "paper_16dof", {}, tensions, 5, 0.0005)
    errors = [np.abs(end(build, "paper_16dof", {}, tensions, columns, step) - exact)[:16].max() for step in STEPS]
    fewer = np.abs(end(build, "paper_16dof", {}, tensions, max(columns - 1, 1), STEPS[0]) - exact)[:16].max()
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


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5])
def test_a_step_takes_the_fewest_columns_that_meet_the_tolerance(build, tolerance):
    """Bit for bit the step of fixed order, the lowest whose error estimate is within the tolerance, at its number of evaluations."""
    model = build("paper_16dof", {"integrator.tolerance": tolerance})
    simulation, taken = ste.Simulation(model), []
    for row in motion_tensions(model.scene, "redrawn", 0, 0.6):
        before, report = simulation.state, simulation.step(row, 0.02)
        fixed = {columns: steps_of(model, before, columns, row[None], 0.02) for columns in range(2, 7)}
        columns = min(columns for columns, (_, done) in fixed.items() if done.error <= tolerance)
        taken.append(columns)
        motion, done = fixed[columns]
        assert report == (1, 0, done.error, 1 + columns * (columns - 1) // 2) == (done.steps, done.rejected, done.error, done.evaluations)
        np.testing.assert_array_equal(motion.q, simulation.state.q)
        np.testing.assert_array_equal(motion.q_dot, simulation.state.q_dot)
    assert min(taken) < max(taken), taken


@pytest.mark.parametrize("columns", [2, 3, 4])
def test_order_with_the_damping_and_stiffness_of_the_start(build, columns):
    """What a step keeps of its start leaves the order as it is, and the error of a quiet motion within a hundredth."""
    tensions = smooth(5, 2.0)
    exact = end(build, "helical", BENDING_ONLY, tensions, 6, 0.001)
    model = build("helical", BENDING_ONLY)
    errors, anew = [], []
    for step in STEPS:
        motion, done = steps_of(model, ste.Simulation(model).state, columns, tensions, step)
        assert done.status == OK and done.steps == round(len(tensions) * HOLD / step)
        found = end(build, "helical", BENDING_ONLY, tensions, columns, step)
        assert (np.concatenate([motion.q, motion.q_dot]) != found).any()
        errors.append(np.abs(np.concatenate([motion.q, motion.q_dot]) - exact).max())
        anew.append(np.abs(found - exact).max())
    assert np.log2(errors[1] / errors[2]) > columns - 0.35, errors
    assert errors == pytest.approx(anew, rel=0.01)


def steps_of(model, state, columns, tensions, step):
    """A motion under rows of tensions by steps with as many columns each, and how that went."""
    q, q_dot, effects = state.q.copy(), state.q_dot.copy(), state.effects.copy()
    motion = Motion(q, q_dot, model.grid.packed(state.strain), effects, np.array([state.time]))
    method = step_method(model)._replace(columns=columns, least=columns, freeze_jacobian=True)
    control = Control(step=step, tolerance=np.inf, adaptive=False, smallest=step)
    n, scratch = q.size, make_scratch(model.arm, columns)
    record = Record(np.empty((0, n)), np.empty((0, n)), np.empty((0, 4, 4)))
    durations = np.full(len(tensions), HOLD if len(tensions) > 1 else step)
    return motion, advance(model.arm, Scheme(method, control), tensions, durations, motion, step, scratch, record)


@pytest.mark.parametrize(("scene", "changes"), [("helical", {}), ("three_tendon", LOADS_INSIDE)], ids=["unloaded", "loads inside"])
def test_the_strain_is_foreseen_to_second_order_where_a_motion_goes_on(build, scene, changes):
    """Along its rates the error falls with the cube of the time, aside of them with the square, and a bias out of proportion counts for
    nothing."""
    model = build(scene, changes)
    n, n_a = model.coordinate_count, model.tendon_count
    scratch, method, unit = make_scratch(model.arm, 2), step_method(model), model.coordinate_scale()
    q, v, aside = unit * np.linspace(0.5, 0.2, n), 3.0 * unit * np.cos(np.arange(n)), 3.0 * unit * np.sin(np.arange(n))

    def foreseen(change, bias=1.0):
        scratch.work.xi[:] = model.packed_strain(q)
        assert evaluate_force(model.arm, method, np.zeros(n_a), q, v, np.zeros(0), 0.0, scratch) == OK
        scratch.work.xi_bias[:] *= bias
        predict_strain(model.arm.strain, q + change, q, scratch.work)
        return np.abs(scratch.work.xi - model.packed_strain(q + change)).max()

    for h in (0.02, -0.02):
        assert foreseen(h * v) / foreseen(0.5 * h * v) == pytest.approx(8.0, rel=0.15)
        assert foreseen(h * v) < 0.3 * foreseen(h * v, bias=0.0)
    assert foreseen(0.02 * aside) / foreseen(0.01 * aside) == pytest.approx(4.0, rel=0.3)
    assert foreseen(0.02 * v, bias=1e9) == foreseen(0.02 * v, bias=0.0)


def test_strains_of_a_tolerance_are_as_good_as_others(build):
    """Newton stops sooner within the steps of a tolerance; being quadratic, it leaves a strain that hardly shows it."""
    model = build("paper_16dof", {"integrator.tolerance": 5e-4})
    assert step_method(model).strain_tolerance > 2 * step_method(build("paper_16dof")).strain_tolerance
    simulation = ste.Simulation(model)
    for row in motion_tensions(model.scene, "wild", 0, 1.0):
        simulation.step(row, 0.02)
        xi = model.strain(simulation.state.q)[1]
        np.testing.assert_allclose(simulation.state.strain, xi, rtol=0.0, atol=1e-9 * np.abs(xi).max())


def test_an_arm_at_rest_takes_two_columns_and_a_jump_more(build):
    simulation = ste.Simulation(build("paper_19dof", {"integrator.tolerance": 1e-4}))
    assert simulation.step(np.zeros(10), 0.1).evaluations == 5 * 2
    assert simulation.step(np.full(10, 15.0), 0.02).evaluations >= 7


@pytest.mark.parametrize("motion", ["redrawn", "wild"])
def test_error_falls_in_proportion_to_the_tolerance(build, motion):
    """Two decades of tolerance: two of error, give or take a factor of three, at ever more evaluations."""
    exact_model = build("paper_16dof", {"integrator.columns": 4, "integrator.step": 2.5e-4})
    tensions = motion_tensions(exact_model.scene, motion, 0, 1.0)
    exact = ste.simulate(exact_model, tensions, 1.0, 0.02).tip_pose[:, :3, 3]
    errors, evaluations = [], []
    for tolerance in (1e-4, 1e-5, 1e-6):
        run = ste.simulate(build("paper_16dof", {"integrator.tolerance": tolerance}), tensions, 1.0, 0.02)
        errors.append(np.linalg.norm(run.tip_pose[:, :3, 3] - exact, axis=1).max())
        evaluations.append(run.evaluations)
    assert errors[0] > 2 * errors[1] > 4 * errors[2] and 30 < errors[0] / errors[2] < 300, errors
    assert evaluations[0] < evaluations[1] < evaluations[2]


def test_a_hopeless_step_is_given_up_before_its_last_column(build):
    """From rest to 150 N on all tendons in one step of 20 ms to a nanometre, halvings not allowed: one attempt, which would be 16."""
    model = build("paper_16dof", {"integrator.tolerance": 1e-9, "integrator.max_halvings": 0})
    simulation, method, control = ste.Simulation(model), step_method(model), step_control(model, 0.02)
    state = simulation.state
    motion = Motion(state.q, state.q_dot, model.grid.packed(state.strain), state.effects, np.zeros(1))
    record = Record(np.empty((0, 16)), np.empty((0, 16)), np.empty((0, 4, 4)))
    tensions, durations = np.full((1, 10), 150.0), np.array([0.02])
    done = advance(model.arm, Scheme(method, control), tensions, durations, motion, 0.02, make_scratch(model.arm, 6), record)
    assert (done.status, done.rejected) == (INACCURATE, 1) and done.evaluations < 16


def test_steps_below_the_most_columns_do_not_get_shorter():
    control = Control(step=0.02, tolerance=1e-4, adaptive=True, smallest=1e-6)
    assert next_step(control, 6, 1e-3, Attempt(OK, 5, 11, 1e-4, 5)) == pytest.approx(2e-3)
    assert next_step(control, 6, 1e-3, Attempt(OK, 6, 16, 1e-4, 6)) == pytest.approx(0.9e-3)
    assert next_step(control, 6, 1e-3, Attempt(INACCURATE, 6, 16, 64e-4, 6)) == pytest.approx(0.45e-3)


# quasi-static motion


def test_motion_without_inertia_is_the_flow_of_damping_and_stiffness(build):
    """D q_dot = G ([u; 0] - q), which SciPy integrates too; the error falls with the order of the columns."""
    tension = np.array([3.0, 0.0, 1.0])
    model = build("three_tendon", {"quadrature.intervals": 6})

    def rate(_, q):
        terms = model.terms(q, np.zeros(3))
        return np.linalg.solve(terms.damping, terms.stiffness @ (tension - q))

    exact = solve_ivp(rate, (0.0, 0.04), np.zeros(3), rtol=1e-11, atol=1e-11, method="Radau").y[:, -1]
    errors = []
    for step in (0.02, 0.01, 0.005):
        changes = {"quadrature.intervals": 6, "integrator.quasi_static": True, "integrator.step": step, "integrator.columns": 3}
        simulation = ste.Simulation(build("three_tendon", changes))
        simulation.step(tension, 0.04)
        errors.append(np.abs(simulation.state.q - exact).max())
    assert errors[0] < 0.1 * np.abs(exact - tension).max() + 1e-2
    assert errors[2] < errors[1] / 4.0 < errors[0] / 16.0


def test_motion_without_inertia_ends_where_statics_do(build):
    changes = {"integrator.quasi_static": True, "effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    model = build("three_tendon", changes)
    simulation = ste.Simulation(model)
    simulation.step(np.array([3.0, 0.0, 1.0]), 3.0)
    rest = ste.static_equilibrium(model, np.array([3.0, 0.0, 1.0]))
    np.testing.assert_allclose(simulation.tip_pose, rest.tip_pose, atol=1e-6)
