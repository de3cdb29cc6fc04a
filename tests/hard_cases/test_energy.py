"""Energy.

The tendons' work and the elastic energy have to balance through the strain's own nonlinearity; a
wrong term in bias, stiffness or columns shows as energy from nowhere. E = kinetic + elastic + load
+ sum of tension times tendon length; with damping and constant tensions it can only fall.

What a step may add: its result is off by a displacement of at most `error` [m] and by a velocity of
at most `error` / step, both as root mean square over the rod of mass m (StepReport.error is the
greater of the two, as displacements). A velocity error w changes the kinetic energy by at most
sqrt(m) w |v| + m w^2 / 2 with |v|^2 = v^T M v; a displacement error d changes the potential, to
first order, by at most sqrt(m) d |a| with the acceleration a = M^-1 (B u - K + F) that the
unbalanced force gives the undamped arm,
|a|^2 = a^T M a. So
    allowance = sqrt(m) w (|v| + step |a|) + m w^2 / 2,    w = error / step.
"""

import numpy as np
import pytest

import soft_tendon_env as ste

STEPS = (1e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2)


def potential(model, state, u):
    return model.energy(state.q, state.q_dot).total + u @ model.tendon_lengths(state.q)


def speed_and_acceleration(model, state, u):
    terms = model.terms(state.q, state.q_dot)
    force = terms.actuation @ u - terms.elastic_force + terms.external_force
    return np.sqrt(max(state.q_dot @ terms.mass @ state.q_dot, 0.0)), np.sqrt(
        force @ np.linalg.solve(terms.mass, force)
    )


def growths(model, seed, step, count):
    """(growth, allowance, energy turned over) of every step of a violent motion with constant
    tensions."""
    rng = np.random.default_rng(seed)
    top = 0.3 * model.scene.tendons[0].tension_limits[1]
    u = top * rng.uniform(size=model.tendon_count)
    rate = (
        5
        * top
        * rng.normal(size=model.coordinate_count)
        * (np.arange(model.coordinate_count) < model.arm.strain.law.active)
    )
    simulation = ste.Simulation(model)
    before = simulation.reset(
        model.rest_coordinates(top * rng.uniform(size=model.tendon_count)), rate
    )
    energy, (speed, acceleration) = (
        potential(model, before, u),
        speed_and_acceleration(model, before, u),
    )
    start = energy
    out = []
    for _ in range(count):
        report = simulation.step(u, step)
        after = simulation.state
        new_energy, (new_speed, new_acceleration) = (
            potential(model, after, u),
            speed_and_acceleration(model, after, u),
        )
        w = report.error / step
        mass = model.arm.rod.mass[0]
        allowance = (
            np.sqrt(mass) * w * (max(speed, new_speed) + step * max(acceleration, new_acceleration))
            + 0.5 * mass * w**2
        )
        out.append((new_energy - energy, allowance))
        energy = new_energy
        speed = new_speed
        acceleration = new_acceleration
    return np.array(out), start - energy


def check_no_growth(build, measured, scene, steps, changes):
    worst = 0.0
    for step in steps:
        model = build(scene, {"integrator.step": step, **changes})
        for seed in range(2):
            grown, lost = growths(model, seed, step, 30)
            assert lost > 0
            worst = max(worst, grown[:, 0].max() / lost)
    measured("largest growth / energy lost", worst)
    assert worst < 1e-9


@pytest.mark.parametrize("columns", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "scene",
    [
        "three_tendon",
        *(
            pytest.param(scene, marks=pytest.mark.slow)
            for scene in ("four_tendon", "paper", "paper_16dof", "paper moments 0-2")
        ),
    ],
)
def test_energy_never_grows_with_the_damping_of_the_scene(build, measured, scene, columns):
    """Constant tensions, a bent and moving start, steps from 0.1 to 50 ms. Expected: total energy
    and the tensions' potential never grow over a step, by more than round-off of what is turned
    over."""
    check_no_growth(build, measured, scene, STEPS, {"integrator.columns": columns})


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
@pytest.mark.parametrize("scene", ["paper", "paper moments 0-2", "three_tendon"])
def test_energy_never_grows_where_the_order_follows_the_error(build, measured, scene, tolerance):
    """As above with a tolerance: one call takes steps of any order and size. Expected: total energy
    and the tensions' potential never grow over a call."""
    check_no_growth(build, measured, scene, (5e-3, 2e-2, 5e-2), {"integrator.tolerance": tolerance})


@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize(
    "part", [0.0, 1e-2, *(pytest.param(part, marks=pytest.mark.slow) for part in (1e-3, 0.1))]
)
@pytest.mark.parametrize(
    "scene", [pytest.param("paper_16dof", marks=pytest.mark.slow), "three_tendon"]
)
def test_energy_grows_by_no_more_than_the_error_estimate(build, measured, scene, part, columns):
    """As above, with 0, 0.1, 1 and 10 % of the scene's damping, so that errors of fast undamped
    modes can show. Expected: energy grows over a step by no more than the step's own error estimate
    allows, see the top of the file."""
    damping = part * ste.load_scene(scene).segments[0].damping
    worst = 0.0
    for step in STEPS:
        model = build(
            scene,
            {"integrator.step": step, "integrator.columns": columns, "segments.0.damping": damping},
        )
        for seed in range(2):
            steps, _ = growths(model, seed, step, 30)
            worst = max(worst, (steps[:, 0] / steps[:, 1]).max())
    measured("largest growth / allowance", max(worst, 0.0))
    assert worst < 1.0


SLOPES = {1: (0.8, 1.2), 2: (1.8, 3.4), 3: (2.8, 3.4), 4: (3.8, 5.4)}
"""Bounds of the slope by columns."""


@pytest.mark.parametrize("columns", SLOPES)
def test_energy_drift_of_an_undamped_swing_falls_with_the_order(build, measured, columns):
    """No damping, no tension: whatever the total energy does is the integrator's error. Expected:
    the drift over 1 s of a smooth swing from a bent start falls with the step at least by the
    method's order."""
    least, greatest = SLOPES[columns]
    drifts = []
    for step in (0.01, 0.005, 0.0025):
        changes = {"strain.strains": ["torsion", "bend_y", "bend_z"], "segments.0.damping": 0.0}
        model = build(
            "three_tendon", {**changes, "integrator.step": step, "integrator.columns": columns}
        )
        simulation = ste.Simulation(model)
        start = np.zeros(model.coordinate_count)
        start[0] = 1.0
        simulation.reset(start)
        simulation.step(np.zeros(3), 1.0)
        state = simulation.state
        drifts.append(
            model.energy(state.q, state.q_dot).total / model.energy(start, 0 * start).total - 1
        )
    slopes = np.diff(np.log2(np.abs(drifts))) * -1
    measured("drift at 10 ms", drifts[0])
    measured("slope", slopes.mean())
    assert (least < slopes).all(), (drifts, slopes)
    assert (slopes < greatest).all(), (drifts, slopes)


def check_that_energy_never_grows(model, measured, seconds):
    """Of an arm that is released from a bent shape."""
    start = np.zeros(model.coordinate_count)
    start[0] = 0.3 * model.scene.tendons[0].tension_limits[1]
    motion = ste.simulate(
        model,
        np.zeros(model.tendon_count),
        seconds,
        0.05,
        initial=ste.Simulation(model).reset(start),
    )
    energies = [model.energy(q, v).total for q, v in zip(motion.q, motion.q_dot, strict=True)]
    measured("largest energy / start", max(energies) / energies[0])
    measured(f"energy left after {seconds:g} s", energies[-1] / energies[0])
    assert max(energies) <= energies[0] * (1 + 1e-12)
    assert energies[-1] > 0


@pytest.mark.parametrize("step", [pytest.param(0.001, marks=pytest.mark.slow), 0.01])
@pytest.mark.parametrize("scene", ["paper", "paper_16dof", "four_tendon", "three_tendon"])
def test_arm_without_damping_for_ten_seconds(build, measured, scene, step):
    """No damping at all, released from a bent shape: fast undamped modes turn every unstable method
    into an explosion. Expected: with the default integrator the energy never exceeds that of the
    start."""
    changes = {"segments.0.damping": 0.0, "integrator.step": step}
    model = build(scene, changes)
    check_that_energy_never_grows(model, measured, 10.0)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
@pytest.mark.parametrize("scene", ["paper_16dof", "three_tendon"])
def test_arm_without_damping_whose_order_follows_the_error(build, measured, scene, tolerance):
    """The same with a tolerance, where steps of several orders and sizes follow each other: more
    than two columns would feed fast modes. Expected: the energy never exceeds that of the start."""
    changes = {"segments.0.damping": 0.0, "integrator.tolerance": tolerance}
    model = build(scene, changes)
    check_that_energy_never_grows(model, measured, 5.0)


@pytest.mark.parametrize("columns", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_more_columns_are_not_for_arms_without_damping(build, measured, columns):
    """Extrapolation with 3 or more columns is not stable on the imaginary axis: undamped fast modes
    grow slowly, step after step. Expected: what can be had is a clear failure or a finite motion
    (measured: the energy after 3 s over that of the start), no NaN."""
    model = build(
        "paper",
        {"segments.0.damping": 0.0, "integrator.step": 0.001, "integrator.columns": columns},
    )
    start = np.zeros(10)
    start[0] = 18.0
    initial = ste.Simulation(model).reset(start)
    try:
        final = ste.simulate(model, np.zeros(10), 3.0, 0.05, initial=initial).final
    except ste.SimulationDiverged as error:
        final = error.state
    assert np.isfinite(final.q).all()
    assert np.isfinite(final.q_dot).all()
    assert np.abs(final.q).max() < 1e3
    measured(
        "energy / start",
        model.energy(final.q, final.q_dot).total / model.energy(start, 0 * start).total,
    )
