"""Abrupt, violent and random tensions, and steps of every size.

The tensions jump, the coordinates chase them within a step or two, and the stiffest rates (1e4 1/s)
are a hundred times faster than the step. With the paper's raw passive coordinates the tendons' and
the passive fields nearly coincide, so that tensions run away against each other at almost no energy
(phantom tensions) until no strain exists.
"""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.model.statics import static_equilibrium

SCENES = ["paper", "paper_16dof", "paper moments 0-2"]
RICHEST_IS_QUICK = [*(pytest.param(name, marks=pytest.mark.slow) for name in SCENES[:2]), SCENES[2]]
"""The three, of which a quick test takes the one with the most coordinates that give way."""
BOUND = 1.5  # |q_a| over the tension applied


def pull(which, value):
    return np.where([which == "all" or i == which for i in range(10)], value, 0.0)


@pytest.mark.parametrize("step", [pytest.param(0.0005, marks=pytest.mark.slow), 0.01])
@pytest.mark.parametrize("scene", SCENES)
def test_abrupt_tension(build, measured, scene, step):
    """80, 100, 120 and 150 N all at once on one tendon (a straight one, a spiral, two that end half
    way) or on all ten. Expected: no step fails for good; no coordinate exceeds 1.5 times the
    tension."""
    model = build(scene, {"integrator.step": step})
    greatest = 0.0
    rejected = 0
    for value in (80.0, 100.0, 120.0, 150.0):
        for which in (0, 3, 5, 8, "all"):
            motion = ste.simulate(model, pull(which, value), 0.5, 0.01)
            assert np.isfinite(motion.q).all(), (
                which,
                value,
            )
            assert np.isfinite(motion.tip_pose).all(), (
                which,
                value,
            )
            greatest = max(greatest, np.abs(motion.q[:, :10]).max() / value)
            rejected = rejected + motion.rejected
    measured("q_a / tension", greatest)
    measured("rejected steps", rejected)
    assert greatest < BOUND


@pytest.mark.parametrize("step", [pytest.param(0.0005, marks=pytest.mark.slow), 0.01])
def test_abrupt_tension_with_raw_passive_coordinates(build, measured, step):
    """The paper's own passive fields: phantom tensions blow the 16-DOF model up, at any step size.
    Expected: finite motion, or SimulationDiverged with a finite state, after a bounded number of
    attempts."""
    changes = {"strain.passive_coordinates": "raw", "integrator.step": step}
    model = build("paper_16dof", changes)
    failed = 0
    for value in (80.0, 150.0):
        for which in (0, 3, 5, 8, "all"):
            try:
                motion = ste.simulate(model, pull(which, value), 0.5, 0.01)
                assert np.isfinite(motion.q).all()
                assert np.isfinite(motion.tip_pose).all()
            except ste.SimulationDiverged as error:
                assert np.isfinite(error.state.q).all()
                assert error.cause
                failed += 1
    measured("diverged, of 10", failed)
    assert failed > 0, "the raw coordinates do not run away any more: this case has lost its point"


@pytest.mark.parametrize(
    "tendons", [(5, 8), *(pytest.param(pair, marks=pytest.mark.slow) for pair in ((0, 1), (0, 3)))]
)
def test_step_of_100_newton_on_two_tendons(build, measured, tip_distance, tendons):
    """Two tendons jump to 100 N together: a violent motion, far outside of what the passive fields
    were made for. Expected: the tip of the model with moments to quadratic converges with columns
    and steps; how far it is off the 48-DOF model is measured and bounded."""
    u = sum(pull(i, 100.0) for i in tendons)

    def tip(scene, step, columns):
        return ste.simulate(
            build(scene, {"integrator.step": step, "integrator.columns": columns}), u, 0.5, 0.01
        ).tip_pose

    exact = tip("paper moments 0-2", 5e-4, 4)
    full = tip("paper_48dof", 1e-3, 3)
    errors = [tip_distance(tip("paper moments 0-2", 0.01, columns), exact) for columns in (2, 3, 4)]
    measured("10 ms, 2 columns [mm]", 1e3 * errors[0])
    measured("10 ms, 4 columns [mm]", 1e3 * errors[2])
    measured("1 ms, 2 columns [mm]", 1e3 * tip_distance(tip("paper moments 0-2", 0.001, 2), exact))
    measured("19 to 48 DOF [mm]", 1e3 * tip_distance(exact, full))
    assert errors[0] < 0.2
    assert errors[2] < 2e-3
    assert errors[2] < errors[1] < errors[0]
    assert tip_distance(tip("paper moments 0-2", 0.001, 2), exact) < 0.1 * errors[0]
    assert tip_distance(exact, full) < 0.35


@pytest.mark.parametrize(
    ("step", "most_rejected"), [pytest.param(0.01, 0.01, marks=pytest.mark.slow), (0.02, 0.3)]
)
@pytest.mark.parametrize("columns", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("scene", RICHEST_IS_QUICK)
def test_random_tensions_for_a_minute(build, measured, scene, columns, step, most_rejected):
    """Ten tensions jump to new values in 0-150 N every 10 or 20 ms, for a minute: what an untrained
    agent does. Expected: finite throughout, no coordinate above 1.5 times the greatest tension at
    steps of 10 ms and twice that tension at 20 ms, where the motion is chaotic (over 48 inputs and
    two roundings the most was 1.39 to 1.79 times), rejected steps counted (at most 1 % at 10 ms, 30
    % at 20 ms), and the last state continues."""
    changes = {"integrator.columns": columns, "integrator.step": step}
    model = build(scene, changes)
    for hold in (0.01, 0.02):
        rng = np.random.default_rng(0)
        tensions = rng.uniform(0.0, 150.0, (round(60.0 / hold), 10))
        motion = ste.simulate(model, tensions, 60.0, hold)
        assert np.isfinite(motion.q).all()
        assert np.isfinite(motion.q_dot).all()
        assert np.isfinite(motion.tip_pose).all()
        measured("q_a / 150 N", np.abs(motion.q[:, :10]).max() / 150.0)
        measured("rejected steps", motion.rejected)
        assert np.abs(motion.q[:, :10]).max() < (BOUND if step == 0.01 else 2.0) * 150.0
        assert motion.steps >= 60.0 / max(step, hold)
        assert motion.rejected < most_rejected * motion.steps
        after = ste.simulate(model, np.zeros(10), 20.0, 0.1, initial=motion.final)
        assert np.abs(after.q[-1]).max() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_steps_from_a_tenth_to_fifty_milliseconds(build, measured, tip_distance, columns):
    """The input of the reference trajectories, with a jump in mid-run, at steps of 0.1 to 50 ms: a
    factor of 500. Expected: finite, and the tip's error (to steps of 0.1 ms with 4 columns) falls
    with the step."""

    def tension(t):
        u = np.zeros(10)
        u[[0, 3, 5, 8]] = (
            6 * np.sin(np.pi * t) ** 2,
            4 * np.sin(2 * np.pi * t) ** 2,
            2.5 * (1 - np.cos(2 * np.pi * t / 1.5)),
            3 * np.sin(np.pi * t) ** 2,
        )
        if t > 0.5:
            u[[1, 2]] = (8.0, 5.0)
        else:
            u[[1, 2]] = (0.0, 0.0)
        return u

    def track(step, columns):
        return ste.simulate(
            build("paper", {"integrator.step": step, "integrator.columns": columns}),
            tension,
            1.0,
            0.05,
        ).tip_pose

    exact = track(1e-4, 4)
    steps = (0.05, 0.025, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0001)
    errors = [
        tip_distance(track(step, columns), exact) for step in steps if (step, columns) != (1e-4, 4)
    ]
    measured("error at 50 ms [mm]", 1e3 * errors[0])
    measured("error at 10 ms [mm]", 1e3 * errors[2])
    measured("error at 1 ms [mm]", 1e3 * errors[5])
    assert np.isfinite(errors).all(), errors
    assert (np.diff(errors) < 0).all(), errors
    assert errors[0] < 0.12


@pytest.mark.slow
@pytest.mark.parametrize("scene", RICHEST_IS_QUICK)
def test_error_control_through_an_abrupt_load(build, measured, tip_distance, scene):
    """Steps that follow a tolerance of 1 micrometre meet a jump of 100 N, and may grow only as the
    motion calms down. Expected: every tolerance ends near the same tip, the tighter the nearer, and
    steps are spent at the jump."""
    u = pull(0, 100.0)
    exact = ste.simulate(
        build(scene, {"integrator.step": 2e-4, "integrator.columns": 4}), u, 0.5, 0.01
    )
    distances = []
    for tolerance in (1e-4, 1e-6):
        changes = {"integrator.tolerance": tolerance, "integrator.columns": 4}
        model = build(scene, changes)
        motion = ste.simulate(model, u, 0.5, 0.01)
        distances.append(tip_distance(motion.tip_pose, exact.tip_pose))
    measured("tip error at 1e-6 [mm]", 1e3 * distances[1])
    measured("steps at 1e-6", motion.steps)
    measured("rejected at 1e-6", motion.rejected)
    assert distances[1] < 2e-5
    assert distances[1] < distances[0] < 2e-3
    assert 0 < motion.rejected < motion.steps


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-5])
@pytest.mark.parametrize("scene", SCENES)
def test_order_control_through_abrupt_tensions(build, measured, scene, tolerance):
    """80 and 150 N all at once on one tendon or on all ten, in the longest step: its first columns
    say nothing, the most may not do. Expected: no step fails for good, no coordinate exceeds 1.5
    times the tension, and two columns are enough once the arm is still."""
    model = build(scene, {"integrator.tolerance": tolerance})
    greatest = 0.0
    evaluations = 0
    for value in (80.0, 150.0):
        for which in (0, 3, 5, 8, "all"):
            motion = ste.simulate(model, pull(which, value), 0.5, 0.02)
            assert np.isfinite(motion.q).all(), (
                which,
                value,
            )
            assert np.isfinite(motion.tip_pose).all(), (
                which,
                value,
            )
            greatest = max(greatest, np.abs(motion.q[:, :10]).max() / value)
            evaluations = evaluations + motion.evaluations
    still = ste.simulate(
        model,
        pull("all", 150.0),
        0.2,
        0.02,
        initial=ste.simulate(model, pull("all", 150.0), 20.0, 0.1).final,
    )
    measured("q_a / tension", greatest)
    measured("evaluations per 20 ms", evaluations / 250)
    assert greatest < BOUND
    assert still.evaluations == 2 * still.steps == 20


@pytest.mark.parametrize("tolerance", [1e-4, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_order_control_under_random_tensions(build, measured, tolerance):
    """0 to 150 N redrawn every 20 ms for 20 s, which break steps of 20 ms with two columns.
    Expected: a finite motion, and no step fails for good."""
    model = build("paper moments 0-2", {"integrator.tolerance": tolerance})
    rng = np.random.default_rng(4)
    tensions = rng.uniform(0.0, 150.0, (1000, 10))
    motion = ste.simulate(model, tensions, 20.0, 0.02)
    measured("evaluations per 20 ms", motion.evaluations / 1000)
    measured("rejected steps", motion.rejected)
    assert np.isfinite(motion.q).all()
    assert np.isfinite(motion.tip_pose).all()


@pytest.mark.parametrize(
    "which", [*(pytest.param(tendon, marks=pytest.mark.slow) for tendon in (0, 3, 5)), "all"]
)
def test_order_control_through_jumps_under_combined_loads(build, measured, tip_distance, which):
    """40 N at once under gravity, a payload and a force at the tip: three columns at 20 ms are
    millimetres off, without a word. Expected: with a tolerance of 3e-5 m the tip is within a
    millimetre of the converged motion."""
    loads = {
        "effects.gravity.acceleration": [9.81, 0, 0],
        "effects.tip_load.mass": 0.05,
        "effects.tip_load.force": [0, 0.2, 0.1],
    }
    exact = ste.simulate(
        build("paper moments 0-2", {**loads, "integrator.step": 5e-4, "integrator.columns": 4}),
        pull(which, 40.0),
        1.0,
        0.02,
    )
    fixed = ste.simulate(
        build("paper moments 0-2", {**loads, "integrator.columns": 3}), pull(which, 40.0), 1.0, 0.02
    )
    motion = ste.simulate(
        build("paper moments 0-2", {**loads, "integrator.tolerance": 3e-5}),
        pull(which, 40.0),
        1.0,
        0.02,
    )
    measured("three columns [mm]", 1e3 * tip_distance(fixed.tip_pose, exact.tip_pose))
    measured("with the tolerance [mm]", 1e3 * tip_distance(motion.tip_pose, exact.tip_pose))
    measured("evaluations per 20 ms", motion.evaluations / 50)
    assert tip_distance(motion.tip_pose, exact.tip_pose) < 1e-3


@pytest.mark.slow
def test_equilibrium_is_reached_from_any_jump(build, measured, tip_distance):
    """Whatever happened on the way, a damped arm under constant tension must end where the statics
    say. Expected: after 40 s the tip is at the equilibrium to 1e-6 m."""
    for scene in SCENES:
        model = build(scene)
        for u in (
            pull(3, 100.0),
            pull("all", 60.0),
            np.random.default_rng(1).uniform(0.0, 60.0, 10),
        ):
            distance = tip_distance(
                ste.simulate(model, u, 40.0, 0.1).tip_pose[-1],
                static_equilibrium(model, u).tip_pose,
            )
            measured("tip to equilibrium [m]", distance)
            assert distance < 1e-6
