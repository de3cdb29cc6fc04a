"""`soft-tendon sweep`: runs side by side, and what is made of the learning curves that they leave."""

import csv
import functools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from soft_tendon_env.learning import sweep as learning
from soft_tendon_env.tools.configuration import read_toml
from soft_tendon_env.tools.files import PACKAGE

TRAINING = '''
"""Stands in for `soft-tendon train`: notes how it was called and leaves a run. Seeds among `fails` of the configuration fail."""
import argparse, json, os, time, tomllib
from pathlib import Path
from types import SimpleNamespace

parser = argparse.ArgumentParser()
parser.add_argument("config", type=Path)
parser.add_argument("--seed", type=int)
parser.add_argument("--out", type=Path)
parser.add_argument("--resume", action="store_true")
parser.add_argument("--set", nargs="+", default=[])
given = parser.parse_args()
config = tomllib.loads(given.config.read_text())
called = {"set": given.set, "resume": given.resume, "threads": os.environ["OMP_NUM_THREADS"], "process": os.getpid()}
with open(given.out / "called.jsonl", "a") as file:
    file.write(json.dumps(called) + "\\n")
if given.seed in config["fails"]:
    raise RuntimeError("this seed fails")
time.sleep(config.get("sleep", 0.0))
(given.out / "best").mkdir(parents=True, exist_ok=True)
(given.out / "config.json").write_text(json.dumps({"task": config["task"]}))
best = {"seconds": 60, "diverged": 0, "position_error_rms": 0.01 * (given.seed + 1)}
(given.out / "best" / "config.json").write_text(json.dumps({"evaluated": best}))
(given.out / "evaluations.csv").write_text(
    f"steps,seconds,return,diverged,position_error_rms,position_error_p95\\n100,60,1,0,0.0{given.seed + 1},0.1\\n200,120,1,0,0.02,0.1\\n"
)
'''


DRIVER = """
import sys
from pathlib import Path
from types import SimpleNamespace

from soft_tendon_env.cli.main import main
from soft_tendon_env.learning import sweep

sweep.TRAIN = (sys.executable, "fake_train.py")
sweep.find_config = Path
sweep.read_training = lambda path, changes, seed: SimpleNamespace(task="TipPose")
main(["sweep", *sys.argv[1:]])
"""


@pytest.fixture
def sweep(command, tmp_path, monkeypatch):
    """sweep(*arguments): `soft-tendon sweep` in this process and an empty folder, with a training that takes no time."""
    script = tmp_path / "fake_train.py"
    script.write_text(TRAINING)
    monkeypatch.setattr(learning, "TRAIN", (sys.executable, str(script)))
    monkeypatch.setattr(learning, "find_config", Path)
    monkeypatch.setattr(learning, "read_training", lambda path, changes, seed: SimpleNamespace(task=read_toml(path)["task"]))
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: command("sweep", *arguments, "--out", "runs")


def write_config(folder, name, task="TipPose", fails=(), **more):
    path = folder / f"{name}.toml"
    path.write_text("\n".join(f"{key} = {json.dumps(value)}" for key, value in {"task": task, "fails": list(fails), **more}.items()))
    return path


def write_run(folder, seed, errors, task="TipPose", best=None, **columns):
    """A run whose evaluations, every 100 steps, are of these errors; more columns by name."""
    run = folder / f"seed_{seed}"
    (run / "best").mkdir(parents=True)
    (run / "config.json").write_text(json.dumps({"task": task}))
    header = ["steps", "seconds", "return", "diverged", *columns, "position_error_rms", "position_error_p95"]
    rows = [[100 * (i + 1), 60 * (i + 1), 0, 0, *(values[i] for values in columns.values()), error, 1] for i, error in enumerate(errors)]
    with open(run / "evaluations.csv", "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    row = dict(zip(header, rows[(best or 100 * len(errors)) // 100 - 1], strict=True))
    evaluation = {key: None if value == "nan" else value for key, value in row.items()}
    (run / "best" / "config.json").write_text(json.dumps({"evaluated": evaluation}))


def read_csv(path):
    return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(path.read_text().splitlines())]


def row_of(printed, name):
    """A configuration's cells in the table."""
    (row,) = [line for line in printed.splitlines() if line.startswith(f"| {name} ")]
    return [cell.strip() for cell in row.strip("|").split("|")]


def called(run):
    return [json.loads(line) for line in (run / "called.jsonl").read_text().splitlines()]


def test_every_configuration_is_trained_with_every_seed(sweep, tmp_path, capsys):
    configs = [write_config(tmp_path, name) for name in ("one", "two")]
    sweep(*configs, "--seeds", 2, "--first-seed", 3, "--set", "steps=7", "options.fidelity=fast")
    expected = {"set": ["steps=7", "options.fidelity=fast"], "resume": True, "threads": "1"}
    runs = [tmp_path / "runs" / name / f"seed_{seed}" for name in ("one", "two") for seed in (3, 4)]
    for run in runs:
        (call,) = called(run)
        assert call.items() >= expected.items()
    assert sorted((tmp_path / "runs").glob("*/seed_*")) == runs
    assert (tmp_path / "runs" / "learning_curves.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    for name in ("one", "two"):
        assert row_of(printed, name) == [name, "2", "200", "2.00", "20.0 [20.0, 20.0] / 20.0 / 20.0", "45.0 [40.0, 50.0] / 45.0 / 49.0"], (
            "best: 0.04 and 0.05"
        )


def test_a_run_that_fails_stops_no_other(sweep, tmp_path, capsys):
    config = write_config(tmp_path, "one", fails=[0])
    with pytest.raises(SystemExit) as exit:
        sweep(config, "--seeds", 3, "--workers", 1)
    printed = capsys.readouterr()
    assert exit.value.code == 1
    assert "seed_0 has no evaluations.csv" in printed.out and row_of(printed.out, "one")[1] == "2"
    assert "--seed 0" in printed.err and "RuntimeError: this seed fails" in printed.err and "--seed 1" not in printed.err
    sweep(write_config(tmp_path, "one"), "--seeds", 3)
    assert row_of(capsys.readouterr().out, "one")[1] == "3", "the same command goes on"


def test_runs_are_side_by_side_as_many_as_workers(sweep, tmp_path):
    config = write_config(tmp_path, "one", sleep=1.0)
    started = time.perf_counter()
    sweep(config, "--seeds", 4, "--workers", 4)
    assert 1.0 < time.perf_counter() - started < 4.0


@pytest.mark.parametrize("background", [False, True])
def test_ctrl_c_and_kill_stop_the_runs(tmp_path, background):
    (tmp_path / "fake_train.py").write_text(TRAINING)
    (tmp_path / "driver.py").write_text(DRIVER)
    config = write_config(tmp_path, "one", sleep=60.0)
    handler = signal.SIG_IGN if background else signal.SIG_DFL  # shells have what ends in "&" ignore SIGINT
    prepare = functools.partial(signal.signal, signal.SIGINT, handler)
    command = [sys.executable, "driver.py", str(config), "--workers", "2", "--out", "runs"]
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    child = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, preexec_fn=prepare)
    notes = [tmp_path / "runs" / "one" / f"seed_{seed}" / "called.jsonl" for seed in (0, 1)]
    while not all(note.exists() and note.read_text() for note in notes):
        assert child.poll() is None
        time.sleep(0.05)
    child.send_signal(signal.SIGTERM if background else signal.SIGINT)
    assert "the same command goes on" in child.communicate(timeout=30)[1] and child.returncode != 0
    for note in notes:
        with pytest.raises(ProcessLookupError):
            os.kill(called(note.parent)[0]["process"], 0)
    assert not (tmp_path / "runs" / "one" / "seed_2").exists()


def test_curves_are_interquartile_means_over_seeds(sweep, tmp_path, capsys):
    folder = tmp_path / "runs" / "one"
    for seed, error in enumerate((0.010, 0.030, 0.020, 0.900, 0.001)):
        write_run(folder, seed, [0.5, error], best=200)
    sweep("one.toml", "--only-plot")
    first, last = read_csv(folder / "learning_curve.csv")
    assert (first["steps"], first["seeds"]) == (100, 5)
    assert first["position_error_rms"] == first["position_error_rms_low"] == first["position_error_rms_high"] == 0.5
    assert last["position_error_rms"] == pytest.approx(0.020), "without 0.001 and 0.9"
    assert 0.001 <= last["position_error_rms_low"] < 0.010 and 0.030 < last["position_error_rms_high"] <= 0.9
    assert row_of(capsys.readouterr().out, "one")[4].startswith("20.0 [")


def test_seeds_are_put_together_where_all_have_come(sweep, tmp_path, capsys):
    folder = tmp_path / "runs" / "one"
    write_run(folder, 0, [0.3, 0.2, 0.1])
    write_run(folder, 1, [0.3, 0.4], best=100)
    (folder / "seed_2").mkdir()
    sweep("one.toml", "--only-plot")
    printed = capsys.readouterr().out
    assert [row["steps"] for row in read_csv(folder / "learning_curve.csv")] == [100, 200]
    assert "one: shown up to step 200, where the first seed ends; further: seed 0 (300)" in printed
    assert "left out:" in printed and "seed_2 has no evaluations.csv" in printed
    assert row_of(printed, "one")[4:] == ["300 [200, 400] / 300 / 380", "200 [100, 300] / 200 / 280"], "the best of seed 0 came later"


def test_a_picture_per_task(sweep, tmp_path, capsys):
    write_run(tmp_path / "runs" / "tip", 0, [0.3, 0.2], angle_error_rms=(0.2, 0.1))
    write_run(tmp_path / "runs" / "goal", 0, [0.3, 0.2], task="Reach", reached=(0.0, 0.75))
    docs = tmp_path / "docs.md"
    docs.write_text("".join(f"<!-- sweep {task} -->\nold\n<!-- /sweep {task} -->\n" for task in ("TipPose", "Reach")))
    sweep("tip.toml", "goal.toml", "--only-plot", "--write-docs", docs)
    assert docs.read_text().count("| tip ") == docs.read_text().count("| goal ") == 1 and "old" not in docs.read_text()
    assert {path.name for path in (tmp_path / "runs").glob("*.png")} == {"learning_curves_TipPose.png", "learning_curves_Reach.png"}
    assert {"angle_error_rms", "angle_error_rms_low"} < set(read_csv(tmp_path / "runs" / "tip" / "learning_curve.csv")[0])
    assert read_csv(tmp_path / "runs" / "goal" / "learning_curve.csv")[1]["reached_high"] == 0.75
    printed = capsys.readouterr().out
    assert "## TipPose" in printed and "## Reach" in printed


def test_divergence_is_flagged_and_a_seed_without_a_number_is_the_worst(sweep, tmp_path, capsys):
    folder = tmp_path / "runs" / "one"
    for seed, error in enumerate((0.1, 0.2, "nan", 0.3)):
        write_run(folder, seed, [error])
    path = folder / "seed_2" / "evaluations.csv"
    path.write_text(path.read_text().replace("100,60,0,0,", "100,60,0,20,"))
    sweep("one.toml", "--only-plot")
    assert row_of(capsys.readouterr().out, "one")[4] == "250 [100, -] / - / - !"


def test_what_cannot_be_shown_is_named(sweep, tmp_path, capsys):
    write_run(tmp_path / "runs" / "mixed", 0, [0.1])
    write_run(tmp_path / "runs" / "mixed", 1, [0.1], task="Shape")
    write_run(tmp_path / "runs" / "good", 0, [0.1])
    sweep("mixed.toml", "missing.toml", "good.toml", "--only-plot")
    printed = capsys.readouterr().out
    assert "mixed has runs of several tasks: seed 0: TipPose, seed 1: Shape" in printed
    assert "missing has no folders seed_0" in printed
    assert row_of(printed, "good")[1] == "1"
