"""Identification of simulated arms from holds and motions: truth within intervals, and what the
data do not contain told."""

import json
import os
import runpy
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.cli.main import main
from soft_tendon_env.identification import MarkerSet, identify
from soft_tendon_env.identification.findings import findings
from soft_tendon_env.identification.fit import fit
from soft_tendon_env.identification.identify import randomize, save_estimate
from soft_tendon_env.identification.parameters import read_parameters
from soft_tendon_env.identification.readings import Plants, Readings
from soft_tendon_env.identification.recordings import Recording, read_recordings
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene, save_scene

E = "segments.*.young_modulus"
RHO = "segments.*.density"
NU = "segments.*.poisson_ratio"
LAG = 0.05
DELAY = 0.033
FRICTION = 0.4
PERIOD = 0.01


@pytest.fixture(scope="module")
def found(arm, holds, placed):
    return identify(arm, holds, placed, [E, RHO], fidelity="scene")


def test_the_truth_is_within_the_intervals_and_held_out_data_are_met_as_well(found, truth):
    spread = found.intervals
    for low, high, true in zip(spread.low, spread.high, truth.values(), strict=True):
        assert low <= true <= high
        assert high - low < 0.1 * true
    assert found.errors[0] < 5e-4
    assert found.errors[1] < 5e-4
    assert found.before[1] > 5.0 * found.errors[1]
    assert spread.identified.all()
    assert not found.findings
    assert found.scene.segments[0].young_modulus == pytest.approx(found.value[0])


def test_derivatives_are_those_of_smaller_differences(arm, holds, placed):
    parameters = read_parameters(
        [E, RHO, "base", "markers.tip.offset", "commands.0.gain"], arm, placed
    )
    readings = Readings(
        Plants(arm, build_model(arm), placed, parameters), read_recordings([holds], arm, placed)[:3]
    )
    x = np.full(len(parameters), 0.02)
    J = readings.jacobian(x)
    d = 3e-4
    slopes = []
    for step in d * np.eye(x.size):
        ahead = readings.residual(x + step)
        behind = readings.residual(x - step)
        slope = (ahead - behind) / (2 * d)
        slopes.append(slope)
    other = np.stack(slopes, axis=-1)
    off = np.abs(J - other).max()
    largest = np.abs(J).max()
    assert off < 1e-5 * largest


def test_derivatives_under_displacements_are_differences_of_equilibria(arm):
    elastic = {"stiffness": 3e3, "slack": [-1e-3, 0.0, 1e-3], "displacement_limits": [-0.01, 0.03]}
    placed = MarkerSet.parse({"markers": {"tip": {"arc_length": 0.2}}}, "test")
    driven = arm.replace({"effects.tendon_elasticity": elastic})
    asked = [
        E,
        "effects.tendon_elasticity.stiffness",
        "effects.tendon_elasticity.slack.1=-0.01..0.01",
        "commands.0.offset",
    ]
    commands = np.array([[[4e-3, 1e-3, 0.0]], [[0.0, 6e-3, 5e-3]]])
    holds = [
        Recording(f"{i}", "test", command, np.zeros((1, 1, 3)), 0.0, {})
        for i, command in enumerate(commands)
    ]
    readings = Readings(
        Plants(driven, build_model(driven), placed, read_parameters(asked, driven, placed)), holds
    )
    x = np.full(4, 0.02)
    d = 1e-4
    slopes = []
    for step in d * np.eye(4):
        ahead = readings.residual(x + step)
        behind = readings.residual(x - step)
        slope = (ahead - behind) / (2 * d)
        slopes.append(slope)
    other = np.stack(slopes, axis=-1)
    off = np.abs(readings.jacobian(x) - other).max()
    largest_other = np.abs(other).max()
    assert off < 1e-6 * largest_other


def test_a_file_judges_and_few_recordings_are_fitted_to(arm, holds, placed):
    found = identify(arm, holds, placed, [E], fidelity="scene", held_out=holds, fit_to=6)
    assert [*found.error_fit] == [f"holds{i}" for i in (1, 4, 6, 9, 12, 14)]
    assert len(found.error_held_out) == 16


@pytest.mark.slow
def test_a_fit_ends_where_progress_is_noise_and_one_that_does_not_converge_is_told(
    arm, monkeypatch
):
    """Elastic tendons go slack in some of the holds, whose readings have kinks there."""
    elastic = {"stiffness": 3e3, "slack": [0.0, 0.0, 0.0], "displacement_limits": [-0.01, 0.03]}
    strain = {
        "type": "explicit",
        "modes": [{"strains": ["bend_y", "bend_z"], "order": 0, "span": "rod"}],
    }
    changes = {"effects": {"tendon_elasticity": elastic}, "strain": strain}
    driven = arm.replace(changes)
    placed = MarkerSet.parse({"markers": {"tip": {"arc_length": 0.2}}}, "test")
    asked = [
        "effects.tendon_elasticity.stiffness",
        *(f"effects.tendon_elasticity.slack.{i}=-0.002..0.002" for i in range(3)),
    ]
    model = build_model(driven)
    plants = Plants(driven, model, placed, read_parameters(asked, driven, placed))
    random = np.random.default_rng(0)
    holds = [
        Recording(f"{i}", "test", random.uniform(-2e-3, 3e-3, (1, 3)), np.zeros((1, 1, 3)), 0.0, {})
        for i in range(10)
    ]
    measured = Readings(plants, holds).positions(
        np.array([0.3, 0.4, -0.3, 0.2])
    ) + 1e-3 * random.normal(size=(10, 1, 3))
    readings = Readings(
        plants,
        [replace(one, positions=place[None]) for one, place in zip(holds, measured, strict=True)],
    )
    found = fit(readings)
    monkeypatch.setattr("soft_tendon_env.identification.fit.PROGRESS", 0.0)
    exact = fit(readings)
    deviation = np.sqrt(np.diag(np.linalg.inv(exact.information)))
    assert found.converged
    assert exact.converged
    assert (np.abs(found.x - exact.x) < 0.1 * deviation).all()
    monkeypatch.setattr("soft_tendon_env.identification.fit.MOST_TRIALS", 3)
    stopped = fit(readings)
    assert not stopped.converged
    assert "did not converge" in findings(stopped, [], readings, None)[0]


@pytest.mark.slow
@pytest.mark.skipif(
    "MEASURED" not in os.environ, reason="MEASURED names no folder with measured data"
)
def test_the_tip_of_a_measured_arm_is_met_on_its_makers_validation_file(tmp_path):
    example = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "three_segment_arm.py"))
    example["write_inputs"](tmp_path)
    measured = Path(os.environ["MEASURED"])
    holds = example["write_holds"](example["file_of"](measured, "train"), tmp_path)
    judge = example["file_of"](measured, "val")
    asked, most = example["STEPS"]["18 parameters with backlash"]
    scene = load_scene(tmp_path / "three_segment.toml")
    estimate = identify(
        scene,
        holds,
        tmp_path / "markers.toml",
        asked,
        held_out=judge,
        fit_to=most,
        fidelity="scene",
    )
    distance = np.array([*estimate.error_held_out.values()])
    assert distance.size == 443
    assert distance.mean() < 5.5e-3
    assert np.sqrt((distance**2).mean()) < 6.5e-3
    backlash = asked.index("commands.backlash") - len(asked)
    assert estimate.intervals.identified[backlash]
    assert estimate.intervals.low[backlash] > 0.0


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        pytest.param(
            [E, RHO, "commands.*.gain"],
            ["a combination of ", "commands.0.gain", "known weight"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            [E, RHO, "segments.*.damping"],
            ["segments.*.damping: a free decay"],
            marks=pytest.mark.slow,
        ),
        ([E, RHO, NU], ["segments.*.poisson_ratio", "twist shows it"]),
    ],
)
def test_parameters_that_the_data_do_not_contain_are_named(arm, holds, placed, parameters, words):
    found = identify(arm, holds, placed, parameters, fidelity="scene")
    (text,) = (
        finding for finding in found.findings if finding.startswith("The data do not contain")
    )
    assert all(word in text for word in words), text
    assert found.intervals.identified[:2].all() == ("commands.*.gain" not in parameters)
    assert not found.intervals.identified[2:].any()
    assert np.isfinite([found.intervals.low, found.intervals.high]).all()


def test_a_forgotten_payload_is_told_by_the_residuals(arm, record, placed, tensions, truth):
    path = record("lacking", {**truth, "effects.tip_load.force": [0.1, 0.0, 0.0]}, tensions)
    found = identify(arm, path, placed, [E, RHO], fidelity="scene", noise=2e-4, held_out=0)
    assert any("the model lacks something" in text for text in found.findings)


def test_outliers_are_named(arm, holds, placed, tmp_path):
    rows = [row.split(",") for row in holds.read_text().splitlines()]
    rows[6][8] = str(float(rows[6][8]) + 0.02)  # middle_y of holds5
    (tmp_path / "holds.csv").write_text("\n".join(map(",".join, rows)))
    found = identify(arm, tmp_path / "holds.csv", placed, [E, RHO], fidelity="scene", held_out=0)
    (text,) = found.findings
    assert "1 of the markers' positions stand out, above all middle in 'holds5'" in text
    assert "leave their cells empty" in text


def test_labels_exchanged_in_a_held_out_hold_are_named(arm, holds, placed, tmp_path):
    rows = [row.split(",") for row in holds.read_text().splitlines()]
    holds6 = rows[7]
    of_middle = holds6[7:10]
    of_tip = holds6[10:13]
    holds6[7:13] = of_tip + of_middle
    path = tmp_path / "holds.csv"
    path.write_text("\n".join(map(",".join, rows)))
    estimate = identify(arm, path, placed, [E, RHO], fidelity="scene")
    assert "holds6" in estimate.error_held_out
    (text,) = estimate.findings
    assert "2 of the markers' positions stand out" in text
    assert "in 'holds6', which is held out" in text


def test_fewer_data_than_parameters_are_told(arm, record, placed, truth):
    path = record("single", truth, [[1.0, 0.0, 0.0]])
    header, row = path.read_text().splitlines()
    one_marker = row.split(",")[:7]
    no_others = [""] * 6
    shortened = ",".join(one_marker + no_others)
    path.write_text(f"{header}\n{shortened}\n")
    with pytest.raises(ValueError, match="there are 3 readings for 3 parameters without priors"):
        identify(arm, path, placed, [E, RHO, "segments.0.damping"], fidelity="scene", held_out=0)


def test_a_hold_without_equilibrium_is_told(arm, record, placed, truth):
    path = record("weak", truth, [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    weak = arm.replace({"segments.0.young_modulus": 2e3})
    with pytest.raises(ValueError, match="line 2: hold 'weak0' has no equilibrium"):
        identify(weak, path, placed, [E], fidelity="scene", held_out=0)


def test_the_command_writes_a_scene_numbers_and_a_page(arm, holds, folder, tmp_path, truth, capsys):
    save_scene(arm, tmp_path / "arm.toml")
    out = tmp_path / "found"
    options = [
        "--markers",
        folder / "markers.toml",
        "--parameters",
        E,
        RHO,
        "--fidelity",
        "scene",
        "--out",
        out,
    ]
    main([str(argument) for argument in ["identify", tmp_path / "arm.toml", holds, *options]])
    printed = capsys.readouterr().out
    numbers = json.loads((out / "estimate.json").read_text())
    modulus = numbers["parameters"][E]
    assert modulus["low"] <= truth["segments.0.young_modulus"] <= modulus["high"]
    assert modulus["low"] <= modulus["value"] <= modulus["high"]
    assert numbers["error_mm"]["held_out"]["mean"] < 0.5
    assert list(numbers["data"]) == ["holds.csv"]
    assert "soft_tendon_env" in numbers["versions"]
    assert load_scene(out / "scene.toml").segments[0].young_modulus == pytest.approx(
        modulus["value"]
    )
    assert f"# | {E} " in (out / "scene.toml").read_text()
    assert E in printed
    assert numbers["error_mm"]["fit"]["each"].keys() | numbers["error_mm"]["held_out"][
        "each"
    ].keys() == {f"holds{i}" for i in range(16)}


@pytest.mark.slow
def test_files_of_an_estimate_lead_to_it_again_and_to_an_environment(
    arm, record, placed, truth, tensions, tmp_path
):
    base = {"rotation": [0.0, 0.0, 3.0], "position": [0.004, 0.0, -0.003]}
    turned = record("turned", {**truth, "base": base}, tensions)
    found = identify(
        arm, turned, placed, [E, RHO, "segments.*.damping", "base"], fidelity="scene", held_out=0
    )
    assert found.errors[0] < 5e-4
    turned_by = np.subtract(found.scene.base.rotation, base["rotation"])
    assert np.abs(turned_by).max() < 0.5
    moved_by = np.subtract(found.scene.base.position, base["position"])
    assert np.abs(moved_by).max() < 1e-3
    assert found.markers.frame == placed.frame
    save_estimate(found, tmp_path)
    scene = load_scene(tmp_path / "scene.toml")
    again = identify(scene, turned, tmp_path / "markers.toml", [E], fidelity="scene", held_out=0)
    assert again.before[0] == pytest.approx(found.errors[0], rel=1e-6)
    table = json.loads((tmp_path / "estimate.json").read_text())["randomize"]
    drawn = {f"base.{name}.{axis}" for name in base for axis in range(3)}
    assert table.keys() == {E, RHO, *drawn}
    low, high = table[E]
    assert low < found.value[0] < high
    gym.make("TendonRod-Reach-v0", scene=scene, fidelity="fast", randomize=table).reset(seed=0)


def test_an_arm_that_is_driven_by_displacement_shows_its_stiffness_beside_that_of_its_tendons(
    arm, placed
):
    elastic = arm.replace(
        {"effects.tendon_elasticity": {"stiffness": 2000.0, "displacement_limits": [0.0, 0.01]}}
    )
    parameters = read_parameters([E], elastic, placed)
    model = build_model(elastic)
    plants = Plants(elastic, model, placed, parameters)
    commands = np.array([[2e-3, 0.0, 0.0], [0.0, 4e-3, 0.0], [1e-3, 0.0, 3e-3]])
    still = [
        Recording(f"{i}", "simulated", one[None], np.zeros((1, 3, 3)), 0.0, {})
        for i, one in enumerate(commands)
    ]
    truth = np.array([0.2])
    seen = Readings(plants, still).positions(truth)
    holds = [replace(one, positions=at[None]) for one, at in zip(still, seen, strict=True)]
    assert fit(Readings(plants, holds)).x == pytest.approx(truth, abs=1e-6)


@pytest.fixture(scope="module")
def moving(arm):
    """The arm with actuators that lag and tendons that rub, by other numbers than those of the
    robot."""
    return arm.replace(
        {
            "effects.actuators.time_constant": 0.03,
            "effects.tendon_friction.coefficient": 0.05,
            "integrator.step": PERIOD,
        }
    )


@pytest.fixture(scope="module")
def robot(moving):
    """Numbers of the robot."""
    damping = 1.4 * moving.segments[0].damping
    actuators = {"effects.actuators.time_constant": LAG, "effects.actuators.delay": DELAY}
    return {
        "segments.0.damping": damping,
        **actuators,
        "effects.tendon_friction.coefficient": FRICTION,
    }


@pytest.fixture(scope="module")
def steps(record_of, moving, robot):
    """Three motions of steps between random tensions."""
    random = np.random.default_rng(2)
    files = []
    for i in range(3):
        levels = random.uniform(0.0, 4.0, (3, 3))
        tensions = np.repeat(levels, 40, axis=0)
        file = record_of(moving, f"steps{i}", robot, tensions, period=PERIOD, seed=i)
        files.append(file)
    return files


@pytest.mark.slow
def test_damping_lag_delay_and_friction_are_found_from_steps(moving, steps, robot, placed):
    asked = [
        "segments.*.damping",
        "effects.actuators.time_constant",
        "commands.delay",
        "effects.tendon_friction.coefficient",
    ]
    found = identify(moving, steps, placed, asked, fidelity="scene", held_out=0)
    truth = [robot["segments.0.damping"], LAG, DELAY, FRICTION]
    assert found.value == pytest.approx(truth, rel=0.05)
    assert ((found.intervals.low <= truth) & (truth <= found.intervals.high)).all()
    assert not found.findings
    assert found.scene.effects.actuators.delay == pytest.approx(found.value[2])
    table = randomize(found)
    assert table["latency"] == [
        0.0,
        found.intervals.high[2] - found.value[2],
    ]  # on top of the scene's delay
    env = gym.make("TendonRod-Reach-v0", scene=found.scene, fidelity="fast", randomize=table)
    env.reset(seed=0)
    assert 0.0 < env.unwrapped.episodes.actuation.delay(0) < 0.1 * DELAY


@pytest.mark.slow
def test_damping_alone_is_told_to_be_not_enough_where_tendons_rub(moving, steps, placed):
    smooth = moving.replace({"effects.tendon_friction.coefficient": 0.0})
    asked = ["segments.*.damping", "effects.actuators.time_constant", "commands.delay"]
    found = identify(smooth, steps, placed, asked, fidelity="scene", held_out=0)
    assert any(
        "viscous damping alone cannot make up for friction" in text for text in found.findings
    )
