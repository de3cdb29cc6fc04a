"""The same again.

Warm starts, adaptive steps and scratch memory make results depend on what was computed before, at
the size of a tolerance: saved states and vectorised environments then drift apart in a chaotic
motion. Everything that the next step depends on has to be in the state.
"""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.envs.arms import Arms

SETTINGS = {
    "fixed steps": ("paper", {}),
    "order control": ("paper moments 0-2", {"integrator.tolerance": 1e-5}),
    "redundant": ("four_tendon", {}),
}


def random_tensions(model, rows, seed=0):
    greatest = 0.5 * model.scene.tendons[0].tension_limits[1]
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, greatest, (rows, model.tendon_count))


def same_state(a, b):
    return (a.time, a.step) == (b.time, b.step) and all(
        np.array_equal(getattr(a, f), getattr(b, f)) for f in ("q", "q_dot", "strain")
    )


@pytest.mark.parametrize("setting", SETTINGS)
def test_saved_state_continues(build, tmp_path, setting):
    """A state saved in mid-run, in the middle of steps that adapt, and loaded into a new
    simulation. The tip pose is computed from the strain, and the strain by an iteration that stops
    at a tolerance. Expected: both show the same tip pose, and go on bit for bit alike."""
    model = build(*SETTINGS[setting])
    tensions = random_tensions(model, 20)
    first = ste.Simulation(model)
    for row in tensions[:10]:
        first.step(row, 0.0137)
    first.state.save(tmp_path / "state.npz")
    second = ste.Simulation(model, ste.State.load(tmp_path / "state.npz"))
    assert same_state(first.state, second.state)
    assert np.array_equal(first.tip_pose, second.tip_pose)
    for row in tensions[10:]:
        assert first.step(row, 0.0137) == second.step(row, 0.0137)
    assert same_state(first.state, second.state)
    assert np.array_equal(first.tip_pose, second.tip_pose)


@pytest.mark.parametrize("setting", ["fixed steps", "order control"])
def test_rows_of_an_environment(build, measured, setting):
    """Rows of a batch are stepped one control period at a time by code of their own, with steps
    that adapt to each. Expected: what Simulation does to round-off, from period to period, whatever
    the step was that the last one ended with."""
    model = build(*SETTINGS[setting])
    simulation = ste.Simulation(model)
    arms = Arms(model, 2, 0.0137, np.empty(0), np.empty(0))
    one = np.arange(1, 2)
    arms.place(one, np.zeros((1, model.coordinate_count)))
    for row in random_tensions(model, 20):
        arms.step(np.tile(row, (2, arms.substeps, 1)), one)
        simulation.step(row, 0.0137)
        state = simulation.state
        for found, expected in ((arms.rows.q[1], state.q), (arms.rows.q_dot[1], state.q_dot)):
            np.testing.assert_allclose(
                found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max()
            )
    measured("last step [ms]", 1e3 * state.step)


@pytest.mark.parametrize("setting", SETTINGS)
def test_whole_and_single_steps(build, setting):
    """One call of simulate, or a call of Simulation.step for every row, with a diverging simulation
    between them. Expected: the same samples to round-off, and the same numbers of steps."""
    model = build(*SETTINGS[setting])
    assert_whole_is_single_steps(build, model, 0.01, 20)


def assert_whole_is_single_steps(build, model, period, rows, tensions=None):
    if tensions is None:
        tensions = random_tensions(model, rows)
    whole = ste.simulate(model, tensions, period * len(tensions), period)
    with pytest.raises((ste.SimulationDiverged, ste.StrainLimitError)):
        ste.simulate(build("paper", {"integrator.columns": 4}), np.full(10, 5e3), 1.0, 0.01)
    simulation = ste.Simulation(model)
    steps = 0
    samples = []
    for row in tensions:
        steps += simulation.step(row, period).steps
        samples.append(simulation.state.q)
    largest = np.abs(whole.q).max()
    np.testing.assert_allclose(samples, whole.q[1:], rtol=1e-12, atol=1e-12 * largest)
    assert steps == whole.steps
    return whole


def test_whole_and_single_steps_where_steps_are_halved(build, measured):
    """Tensions of 0-150 N that jump every 20 ms make steps fail; a step size remembered from one
    row to the next would show. Expected: some steps are tried again, and calls of Simulation.step
    give the samples of simulate to round-off."""
    rng = np.random.default_rng(0)
    tensions = rng.uniform(0.0, 150.0, (100, 10))
    whole = assert_whole_is_single_steps(
        build, build("paper moments 0-2", {"integrator.columns": 2}), 0.02, 0, tensions
    )
    measured("steps tried again", whole.rejected)
    assert whole.rejected > 0


def test_failed_step_leaves_the_last_good_state(build):
    """A step fails half way through a call that takes several. Expected: the simulation stands at
    the state that the error carries, and a milder tension goes on from there."""
    model = build("paper", {"integrator.step": 0.005})
    simulation = ste.Simulation(model)
    with pytest.raises(ste.SimulationDiverged) as caught:
        for _ in range(100):
            simulation.step(np.where(np.arange(10) == 0, 270.0, 0.0), 0.05)
    assert same_state(simulation.state, caught.value.state)
    assert 0 < caught.value.state.time < 5
    simulation.reset(0.5 * caught.value.state.q)
    simulation.step(np.full(10, 5.0), 0.05)
    assert np.isfinite(simulation.state.q).all()
