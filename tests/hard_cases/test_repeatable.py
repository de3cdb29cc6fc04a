"""The same again, bit for bit.

Warm starts, adaptive steps and scratch memory make results depend on what was computed before, at the size of a tolerance: saved states,
vectorised environments and tests then drift apart in a chaotic motion. Everything that the next step depends on has to be in the state.
"""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.envs.arms import Arms

SETTINGS = {
    "fixed steps": ("paper", {}), "fixed steps, 19 DOF, 3 columns": ("paper_19dof", {"integrator.columns": 3}),
    "error control": ("paper_16dof", {"integrator.tolerance": 1e-4, "integrator.columns": 3}),
    "order control": ("paper_19dof", {"integrator.tolerance": 1e-5}),
    "redundant": ("four_tendon", {}),
}  # fmt: skip

def random_tensions(model, rows, seed=0):
    greatest = 0.5 * model.scene.tendons[0].tension_limits[1]
    return np.random.default_rng(seed).uniform(0.0, greatest, (rows, model.tendon_count))


def same_state(a, b):
    return (a.time, a.step) == (b.time, b.step) and all(np.array_equal(getattr(a, f), getattr(b, f)) for f in ("q", "q_dot", "strain"))


@pytest.mark.parametrize("setting", SETTINGS)
def test_saved_state_continues(build, tmp_path, setting):
    """A state saved in mid-run, in the middle of steps that adapt, and loaded into a new simulation. The tip pose is computed
    from the strain, and the strain by an iteration that stops at a tolerance.
    Expected: both show the same tip pose, and go on bit for bit alike.
    """
    model = build(*SETTINGS[setting])
    tensions = random_tensions(model, 20)
    first = ste.Simulation(model)
    for row in tensions[:10]:
        first.step(row, 0.0137)
    first.state.save(tmp_path / "state.npz")
    second = ste.Simulation(model, ste.State.load(tmp_path / "state.npz"))
    assert same_state(first.state, second.state) and np.array_equal(first.tip_pose, second.tip_pose)
    for row in tensions[10:]:
        assert first.step(row, 0.0137) == second.step(row, 0.0137)
    assert same_state(first.state, second.state) and np.array_equal(first.tip_pose, second.tip_pose)


@pytest.mark.parametrize("setting", SETTINGS)
def test_rows_of_an_environment(build, measured, setting):
    """Rows of a batch are stepped one control period at a time by code of their own, with steps that adapt to each.
    Expected: bit for bit what Simulation does, from period to period, whatever the step was that the last one ended with.
    """
    model = build(*SETTINGS[setting])
    simulation, arms, one = ste.Simulation(model), Arms(model, 2, 0.0137, np.empty(0), np.empty(0)), np.arange(1, 2)
    arms.place(one, np.zeros((1, model.coordinate_count)))
    for row in random_tensions(model, 20):
        arms.step(np.tile(row, (2, arms.substeps, 1)), one)
        simulation.step(row, 0.0137)
        state = simulation.state
        assert np.array_equal(arms.rows.q[1], state.q) and np.array_equal(arms.rows.q_dot[1], state.q_dot)
        assert np.array_equal(model.grid.unpacked(arms.rows.xi[1]), state.strain)
        assert arms.rows.step[1] == state.step or model.scene.integrator.tolerance is None
    measured("last step [ms]", 1e3 * state.step)


@pytest.mark.parametrize("setting", ["fixed steps", "error control"])
def test_saved_state_continues_in_another_process(build, tmp_path, setting):
    """The same, where nothing but the file survives.
    Expected: bit for bit what this process computes.
    """
    name, changes = SETTINGS[setting]
    model = build(name, changes)
    tensions = random_tensions(model, 20)
    simulation = ste.Simulation(model)
    for row in tensions[:10]:
        simulation.step(row, 0.0137)
    simulation.state.save(tmp_path / "middle.npz")
    for row in tensions[10:]:
        simulation.step(row, 0.0137)
    np.save(tmp_path / "rest.npy", tensions[10:])
    program = f"""
        import numpy as np, soft_tendon_env as ste
        model = ste.build_model(ste.load_scene({name!r}).replace({changes!r}))
        simulation = ste.Simulation(model, ste.State.load({str(tmp_path / "middle.npz")!r}))
        for row in np.load({str(tmp_path / "rest.npy")!r}):
            simulation.step(row, 0.0137)
        simulation.state.save({str(tmp_path / "end.npz")!r})
    """
    package = str(Path(ste.__file__).parents[1])  # the same sources, wherever they were found
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))}
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True, timeout=250, cwd=tmp_path, env=environment)
    assert same_state(simulation.state, ste.State.load(tmp_path / "end.npz"))


@pytest.mark.parametrize("setting", SETTINGS)
def test_twice_the_same(build, setting):
    """The same input twice, in the same and in a fresh model, with an unrelated, diverging simulation in between.
    Expected: bit-identical trajectories.
    """
    model = build(*SETTINGS[setting])
    tensions = random_tensions(model, 20)
    first = ste.simulate(model, tensions, 0.2, 0.01)
    other = build("paper", {"integrator.columns": 4})
    with pytest.raises((ste.SimulationDiverged, ste.StrainLimitError)):
        ste.simulate(other, np.full(10, 5e3), 1.0, 0.01)
    for again in (model, ste.build_model(model.scene)):
        second = ste.simulate(again, tensions, 0.2, 0.01)
        for a, b in zip(first, second, strict=True):
            assert same_state(a, b) if isinstance(a, ste.State) else np.array_equal(a, b)


@pytest.mark.parametrize("setting", SETTINGS)
def test_whole_and_chunks(build, setting):
    """One call of simulate, or three calls that continue each other.
    Expected: the same samples bit for bit, and the same numbers of steps.
    """
    model = build(*SETTINGS[setting])
    tensions = random_tensions(model, 30)
    whole = ste.simulate(model, tensions, 0.3, 0.01)
    state, samples, steps = None, [], 0
    for rows in (tensions[:7], tensions[7:8], tensions[8:]):
        part = ste.simulate(model, rows, 0.01 * len(rows), 0.01, initial=state)
        state, steps = part.final, steps + part.steps
        samples.append(part.q[1:])
    assert np.array_equal(np.concatenate(samples), whole.q[1:]) and steps == whole.steps
    assert np.array_equal(state.q_dot, whole.final.q_dot) and np.array_equal(state.strain, whole.final.strain)


def assert_whole_is_single_steps(model, tensions, period):
    """Samples and numbers of steps; the motion by one call."""
    whole = ste.simulate(model, tensions, period * len(tensions), period)
    simulation, steps = ste.Simulation(model), 0
    for row, q in zip(tensions, whole.q[1:], strict=True):
        steps += simulation.step(row, period).steps
        assert np.array_equal(simulation.state.q, q)
    assert np.array_equal(simulation.tip_pose, whole.tip_pose[-1]) and steps == whole.steps
    return whole


@pytest.mark.parametrize("setting", ["fixed steps", "fixed steps, 19 DOF, 3 columns", "error control", "order control", "redundant"])
def test_whole_and_single_steps(build, setting):
    """One call of simulate, or a call of Simulation.step for every row.
    Expected: the same samples bit for bit, and the same numbers of steps.
    """
    model = build(*SETTINGS[setting])
    assert_whole_is_single_steps(model, random_tensions(model, 30), 0.01)


def test_whole_and_single_steps_where_steps_are_halved(build, measured):
    """Tensions of 0-150 N that jump every 20 ms make steps fail; a step size remembered from one row to the next would show.
    Expected: some steps are tried again, and calls of Simulation.step give the samples of simulate bit for bit.
    """
    model = build("paper_19dof", {"integrator.columns": 2})
    whole = assert_whole_is_single_steps(model, np.random.default_rng(0).uniform(0.0, 150.0, (100, 10)), 0.02)
    measured("steps tried again", whole.rejected)
    assert whole.rejected > 0


@pytest.mark.parametrize("changes", [{"integrator.step": 0.001}, {"integrator.tolerance": 1e-4}, {"integrator.tolerance": 1e-6}])
def test_whole_and_single_steps_of_many_integrator_steps(build, changes):
    """The same where a row is held over several integrator steps: round-off in the sum of steps, or steps that adapt across their borders.
    Expected: the same samples bit for bit.
    """
    model = build("paper", changes)
    assert_whole_is_single_steps(model, random_tensions(model, 10), 0.03)


@pytest.mark.parametrize("setting", ["fixed steps", "error control"])
def test_failed_step_leaves_the_last_good_state(build, setting):
    """A step fails half way through a call that takes several.
    Expected: the simulation stands at the state that the error carries, and a milder tension goes on from there exactly as from that state.
    """
    name, changes = SETTINGS[setting]
    model = build(name, {**changes, "integrator.step": 0.005})
    simulation = ste.Simulation(model)
    with pytest.raises(ste.SimulationDiverged) as caught:
        for _ in range(100):
            simulation.step(np.where(np.arange(10) == 0, 270.0, 0.0), 0.05)
    assert same_state(simulation.state, caught.value.state) and 0 < caught.value.state.time < 5
    before = np.random.default_rng(3).uniform(0, 20, (5, 10))
    start = ste.Simulation(model).reset(0.5 * caught.value.state.q)
    first, second = (ste.simulate(model, before, 0.05, 0.01, initial=start) for _ in range(2))
    assert np.array_equal(first.q, second.q) and np.isfinite(first.q).all()
