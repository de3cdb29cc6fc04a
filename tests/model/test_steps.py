"""Time steps of a scene: their lengths and orders, the commands held over them, and what is said of
those that change within."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.mechanics.motion import status
from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE
from soft_tendon_env.model.step_control import (
    LOOSEST_STRAIN,
    MOST_STEPS,
    RESOLVED,
    STRAIN_SHARE,
    UNSTABLE,
    CommandWarning,
    cause_of,
    command_table,
    linear_rate,
    step_control,
    step_count,
    step_method,
)

COARSE = {"quadrature.intervals": 2}
LENGTH = 0.3


@pytest.fixture
def model_with(build):
    """model_with({...}): the arm with three tendons, with changes of its integrator."""

    def make(changes=None):
        changes = {f"integrator.{key}": value for key, value in (changes or {}).items()}
        return build("three_tendon", {**COARSE, **changes})

    return make


@pytest.mark.no_jit
@pytest.mark.parametrize("duration", [1e-4, 0.02, 0.02 * (1 + 1e-12), 0.021, 0.05, 1.0])
def test_steps_are_equal_and_at_most_as_long_as_the_scene_s(model_with, duration):
    control = step_control(model_with({"step": 0.02, "max_halvings": 3}), duration)
    count = step_count(duration, control)
    assert count * control.step == pytest.approx(duration, rel=1e-12)
    assert control.step <= 0.02 * (1 + 1e-9)
    assert (count - 1) * 0.02 < duration
    expected_smallest = control.step / 8.0
    assert control.smallest == pytest.approx(expected_smallest)


@pytest.mark.no_jit
def test_control_is_that_of_the_scene(model_with):
    fixed = step_control(model_with(), 0.1)
    assert not fixed.adaptive
    assert fixed.tolerance == pytest.approx(UNSTABLE * LENGTH)
    assert fixed.horizon == 0.02
    adaptive = step_control(model_with({"tolerance": 1e-4}), 0.1)
    assert adaptive.adaptive
    assert adaptive.tolerance == 1e-4
    assert step_control(model_with({"quasi_static": True}), 0.1).horizon == 0.0
    with pytest.raises(ValueError, match="duration should be at most 40000 s in one call"):
        step_count(1.001 * MOST_STEPS * 0.02, fixed)


@pytest.mark.no_jit
def test_the_method_follows_tolerance_and_inertia(model_with):
    """Columns follow the error, and matrices stay those of the step's beginning, where there is a
    tolerance and inertia; the strain is as accurate as its share of the tolerance."""
    fixed = step_method(model_with({"columns": 4}))
    assert fixed == (4, 4, True, False, STEP_TOLERANCE)
    tight = step_method(model_with({"columns": 4, "tolerance": 2e-7}))
    assert tight[:4] == (4, 2, True, True)
    expected_strain_tolerance = STRAIN_SHARE * 2e-7 / LENGTH
    assert tight.strain_tolerance == pytest.approx(expected_strain_tolerance)
    assert STEP_TOLERANCE < tight.strain_tolerance < LOOSEST_STRAIN
    loose = step_method(model_with({"columns": 4, "tolerance": 1e-3}))
    assert loose.strain_tolerance == LOOSEST_STRAIN
    tightest = step_method(model_with({"columns": 4, "tolerance": 1e-7}))
    assert tightest.strain_tolerance == STEP_TOLERANCE
    slow = step_method(model_with({"columns": 4, "tolerance": 1e-4, "quasi_static": True}))
    assert slow[:4] == (4, 2, False, False)
    assert not step_method(model_with({"columns": 2, "tolerance": 1e-4})).freeze_jacobian


@pytest.mark.no_jit
def test_the_linear_rate_resolves_the_slowest_vibration(build):
    """omega / RESOLVED, with omega^2 = K / M of an arm with one constant curvature."""
    modes = [{"strains": ["bend_z"], "order": 0, "span": "rod"}]
    changes = {**COARSE, "strain": {"type": "explicit", "modes": modes}}
    model = build("three_tendon", changes)
    terms = model.terms([0.0], [0.0])
    omega = np.sqrt(terms.stiffness / terms.mass).item()
    assert linear_rate(model) == pytest.approx(omega / RESOLVED)


@pytest.mark.no_jit
def test_causes_say_the_tolerance_that_could_not_be_met(model_with):
    adaptive = model_with({"tolerance": 1e-4, "max_halvings": 5})
    control = step_control(adaptive, 0.02)
    text = cause_of(status.INACCURATE, adaptive, control)
    assert "above integrator.tolerance, 0.0001 m" in text
    assert "steps of 0.00063 s, 5 halvings" in text
    assert cause_of(status.NOT_FINITE, adaptive, control) == status.MESSAGES[status.NOT_FINITE]
    fixed = model_with()
    text = cause_of(status.INACCURATE, fixed, step_control(fixed, 0.02))
    assert text == status.MESSAGES[status.INACCURATE]


def table_of(model, command, samples=4, per_sample=3, step=0.01):
    return command_table(model, command, 1.0, samples, per_sample, step)


@pytest.mark.no_jit
def test_commands_are_held_over_steps(model_with):
    """Constants always, rows over their samples, functions at the middle of each step."""
    model = model_with()
    values = [1.0, 2.0, 3.0]
    constant = table_of(model, values)
    expected_constant = np.broadcast_to(values, (4, 3, 3))
    np.testing.assert_array_equal(constant, expected_constant)
    rng = np.random.default_rng(0)
    rows = rng.uniform(size=(4, 3))
    held = np.repeat(rows[:, None], 3, axis=1)
    np.testing.assert_array_equal(table_of(model, rows), held)
    table = table_of(model, lambda time: [time, 2.0 * time, 0.0])
    middles = 1.0 + 0.01 * (np.arange(12) + 0.5)
    expected = middles.reshape(4, 3, 1) * [1.0, 2.0, 0.0]
    np.testing.assert_allclose(table, expected, rtol=1e-14)
    with pytest.raises(ValueError, match="command"):
        table_of(model, [values, values[:2], values, values])
    single = table_of(model, lambda time: [time, 0.0, 0.0], samples=1, per_sample=1)
    np.testing.assert_allclose(single[0, 0], [1.005, 0.0, 0.0])


@pytest.mark.no_jit
@pytest.mark.parametrize(
    ("wave", "is_missed"),
    [
        (lambda time: np.sin(20.0 * time), False),
        (lambda time: float(time > 1.06), False),
        (lambda time: float(time > 1.066), True),
        (lambda time: np.sin(200.0 * np.pi * time), True),
    ],
    ids=["slow", "a jump at a border", "a jump within a step", "a period in a step"],
)
def test_commands_that_change_within_steps_are_told(model_with, recwarn, wave, is_missed):
    table_of(model_with(), lambda time: [wave(time), 0.0, 0.0])
    told = [warning for warning in recwarn if warning.category is CommandWarning]
    assert len(told) == is_missed
    if told:
        assert "changes within integrator steps of 0.01 s" in str(told[0].message)


def test_trajectories_have_a_sample_at_every_period_from_the_start_on(model_with):
    """As single steps of a simulation lead, with the commands that were held."""
    model = model_with()
    simulation = ste.Simulation(model)
    simulation.reset(time=2.0)
    start = simulation.state

    def command(time):
        return [time - 2.0, 0.5, 0.0]

    motion = ste.simulate(model, command, 0.12, 0.04, initial=start)
    np.testing.assert_allclose(motion.time, [2.0, 2.04, 2.08, 2.12], rtol=1e-14)
    assert motion.command.shape == (3, 2, 3)
    assert motion.steps == 6
    report = [0, 0.0, 0]
    for sample in range(4):
        state = simulation.state
        np.testing.assert_allclose(motion.q[sample], state.q, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(motion.q_dot[sample], state.q_dot, rtol=1e-12, atol=1e-13)
        expected_tip_pose = model.tip_pose(state.q)
        np.testing.assert_allclose(motion.tip_pose[sample], expected_tip_pose, atol=1e-12)
        for held in motion.command[min(sample, 2)]:
            single = simulation.step(held, 0.02)
            if sample < 3:
                report[0] += single.steps
                report[1] += single.error
                report[2] += single.evaluations
    np.testing.assert_allclose(motion.final.q, motion.q[-1])
    assert motion.final.time == pytest.approx(2.12)
    assert motion.steps == report[0]
    assert motion.error == pytest.approx(report[1])
    assert motion.evaluations == report[2]
    still = ste.simulate(model, command, 0.0, 0.04, initial=start)
    assert still.time.tolist() == [2.0]
    assert still.steps == 0


@pytest.mark.no_jit
def test_functions_of_time_are_asked_in_the_middles_of_steps_and_at_a_gauss_point(model_with):
    """Of every step, 1 / (2 sqrt(3)) of it later; of one step alone in its middle."""
    asked = []

    def command(time):
        asked.append(time)
        return [0.0, 0.0, 0.0]

    table_of(model_with(), command, samples=2, per_sample=2)
    middles = 1.0 + 0.01 * np.array([0.5, 1.5, 2.5, 3.5])
    gauss_point = 0.01 / (2.0 * np.sqrt(3.0))
    expected = [*middles, *(middles + gauss_point)]
    np.testing.assert_allclose(asked, expected, rtol=1e-14)
    asked.clear()
    table_of(model_with(), command, samples=1, per_sample=1)
    np.testing.assert_allclose(asked, [1.005], rtol=1e-14)


@pytest.mark.no_jit
@pytest.mark.parametrize(("share", "is_missed"), [(0.045, False), (0.055, True)])
def test_changes_within_steps_may_be_a_twentieth_of_the_range(
    model_with, recwarn, share, is_missed
):
    """Of what a command does from step to step, a jump of 1 at a border."""

    def command(time):
        place = time / 0.01 % 1.0
        is_late = place > 0.6
        return [float(time > 1.02) + share * is_late, 0.0, 0.0]

    table_of(model_with(), command)
    told = [warning for warning in recwarn if warning.category is CommandWarning]
    assert len(told) == is_missed


@pytest.mark.no_jit
def test_numbers_of_steps_are_those_that_are_documented(model_with):
    """A fixed step errs by a twentieth of the length at most, the strain of one with a tolerance by
    twice its share and no more than 3e-6; vibrations have a phase of 0.3 rad in a linearised
    one."""
    assert step_control(model_with(), 0.1).tolerance == pytest.approx(0.05 * LENGTH)
    tight = step_method(model_with({"columns": 4, "tolerance": 2e-7}))
    assert tight.strain_tolerance == pytest.approx(2.0 * 2e-7 / LENGTH)
    loose = step_method(model_with({"columns": 4, "tolerance": 1e-4}))
    assert loose.strain_tolerance == 3e-6
    model = model_with()
    still = np.zeros(3)
    terms = model.terms(still, still)
    squared_rates = np.linalg.eigvals(np.linalg.solve(terms.mass, terms.stiffness)).real
    assert linear_rate(model) == pytest.approx(np.sqrt(squared_rates.min()) / 0.3)
