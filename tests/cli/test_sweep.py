"""`soft-tendon sweep`: runs side by side, and what is made of the learning curves that they
leave."""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import pytest
import tomli_w

from soft_tendon_env.learning import sweep as learning
from soft_tendon_env.tools.files import PACKAGE


def write_run(folder, seed, errors, task="TipPose", **columns):
    """A run whose evaluations, every 100 steps, are of these errors; more columns by name."""
    run = folder / f"seed_{seed}"
    (run / "best").mkdir(parents=True)
    (run / "config.json").write_text(json.dumps({"task": task}))
    header = [
        "steps",
        "seconds",
        "return",
        "diverged",
        *columns,
        "position_error_rms",
        "position_error_p95",
    ]
    rows = [
        [100 * (i + 1), 60 * (i + 1), 0, 0, *(values[i] for values in columns.values()), error, 1]
        for i, error in enumerate(errors)
    ]
    with open(run / "evaluations.csv", "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    evaluated = {
        key: None if value == "nan" else value for key, value in zip(header, rows[-1], strict=True)
    }
    (run / "best" / "config.json").write_text(json.dumps({"evaluated": evaluated}))


@pytest.fixture
def sweep(command, tmp_path, monkeypatch):
    """sweep(*arguments): `soft-tendon sweep` in this process and an empty folder, with trainings
    that take no time; seed 4 fails."""

    def run_job(job):
        if job.training.seed == 4:
            return "RuntimeError: this seed fails"
        write_run(job.folder.parent, job.training.seed, [0.01 * (job.training.seed + 1), 0.02])
        (job.folder / "steps").write_text(str(job.training.steps))
        return None

    monkeypatch.setattr(learning, "run_job", run_job)
    monkeypatch.chdir(tmp_path)
    before = signal.getsignal(signal.SIGTERM)
    yield lambda *arguments: command("sweep", *arguments, "--out", "runs", "--workers", "1")
    assert signal.getsignal(signal.SIGTERM) is before  # the command gives the signal back


def write_config(folder, name, **changes):
    path = folder / f"{name}.toml"
    options = {"scene": "three_tendon", "fidelity": "fast"}
    path.write_text(
        tomli_w.dumps(
            {"task": "TipPose", "algorithm": "PPO", "steps": 1000, "options": options, **changes}
        )
    )
    return path


def row_of(printed, name):
    """A configuration's cells in the table."""
    (row,) = [line for line in printed.splitlines() if line.startswith(f"| {name} ")]
    return [cell.strip() for cell in row.strip("|").split("|")]


def test_every_configuration_is_trained_with_every_seed(sweep, tmp_path, capsys):
    configs = [write_config(tmp_path, name) for name in ("one", "two")]
    sweep(*configs, "--seeds", 2, "--set", "steps=7")
    runs = [tmp_path / "runs" / name / f"seed_{seed}" for name in ("one", "two") for seed in (0, 1)]
    assert sorted((tmp_path / "runs").glob("*/seed_*")) == runs
    assert {(run / "steps").read_text() for run in runs} == {"7"}
    assert (tmp_path / "runs" / "learning_curves_TipPose.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    for name in ("one", "two"):
        assert row_of(printed, name)[:5] == [
            name,
            "2",
            "200",
            "2.00",
            "20.0 [20.0, 20.0] / 20.0 / 20.0",
        ]


def test_a_run_that_fails_stops_no_other(sweep, tmp_path, capsys):
    with pytest.raises(SystemExit) as exit:
        sweep(write_config(tmp_path, "one"), "--seeds", 5)
    printed = capsys.readouterr()
    assert exit.value.code == 1
    assert row_of(printed.out, "one")[1] == "4"
    assert "seed_4\nRuntimeError: this seed fails" in printed.err


@pytest.mark.slow
@pytest.mark.parametrize("asked", [signal.SIGTERM, signal.SIGINT])
def test_ctrl_c_and_kill_stop_the_runs(tmp_path, asked):
    path = write_config(
        tmp_path, "one", steps=10_000_000, evaluation={"every": 2048, "episodes": 2}
    )
    command = [
        sys.executable,
        "-m",
        "soft_tendon_env",
        "sweep",
        str(path),
        "--workers",
        "2",
        "--out",
        "runs",
    ]
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    child = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True
    )
    curves = [tmp_path / "runs" / "one" / f"seed_{seed}" / "evaluations.csv" for seed in (0, 1)]
    while not all(curve.exists() for curve in curves):
        assert child.poll() is None
        time.sleep(0.1)
    child.send_signal(asked)
    _, said = child.communicate()  # until the runs have ended too, which write there as well
    assert "the same command goes on" in said
    assert child.returncode != 0
    before = [curve.read_text() for curve in curves]
    time.sleep(3.0)
    assert before == [curve.read_text() for curve in curves]
    assert not (tmp_path / "runs" / "one" / "seed_2").exists()


def test_curves_are_of_all_seeds_as_far_as_all_have_come(sweep, tmp_path, capsys):
    folder = tmp_path / "runs" / "one"
    for seed, error in enumerate((0.010, 0.030, 0.020, 0.900, 0.001)):
        write_run(folder, seed, [0.5, error, *([0.1] if seed == 0 else [])])
    (folder / "seed_5").mkdir()
    write_run(tmp_path / "runs" / "mixed", 0, [0.1])
    write_run(tmp_path / "runs" / "mixed", 1, [0.1], task="Shape")
    write_run(tmp_path / "runs" / "goal", 0, [0.3, 0.2], task="Reach", reached=(0.0, 0.75))
    sweep("one.toml", "mixed.toml", "missing.toml", "goal.toml", "--only-plot")
    printed = capsys.readouterr().out
    assert row_of(printed, "one")[2] == "200"
    assert "left out:" in printed
    assert "seed_5" in printed
    assert row_of(printed, "one")[4].startswith("20.0 ["), (
        "the interquartile mean, without 0.001 and 0.9"
    )
    assert "mixed has runs of several tasks: TipPose, Shape" in printed
    assert "missing has no folders seed_0" in printed
    assert {path.name for path in (tmp_path / "runs").glob("*.png")} == {
        "learning_curves_TipPose.png",
        "learning_curves_Reach.png",
    }


def test_divergence_is_flagged_and_a_seed_without_a_number_is_the_worst(sweep, tmp_path, capsys):
    folder = tmp_path / "runs" / "one"
    for seed, error in enumerate((0.1, 0.2, "nan", 0.3)):
        write_run(folder, seed, [error])
    path = folder / "seed_2" / "evaluations.csv"
    path.write_text(path.read_text().replace("100,60,0,0,", "100,60,0,20,"))
    sweep("one.toml", "--only-plot")
    assert row_of(capsys.readouterr().out, "one")[4] == "250 [100, -] / - / - !"
