"""`soft-tendon sweep`: runs side by side, and what is made of the learning curves that they leave."""

import csv
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
from soft_tendon_env.tools.files import PACKAGE

DRIVER = """
import sys
from pathlib import Path
from types import SimpleNamespace

from soft_tendon_env.cli.main import main
from soft_tendon_env.learning import sweep

note = "pathlib.Path(sys.argv[-2], 'process').write_text(str(os.getpid()))"
sweep.TRAIN = (sys.executable, "-c", f"import os, pathlib, sys, time; {note}; time.sleep(60)")
sweep.find_config = Path
sweep.read_training = lambda path, changes, seed: SimpleNamespace(task="TipPose")
main(["sweep", *sys.argv[1:]])
"""


def write_run(folder, seed, errors, **columns):
    """A run whose evaluations, every 100 steps, are of these errors; more columns by name."""
    run = folder / f"seed_{seed}"
    (run / "best").mkdir(parents=True)
    (run / "config.json").write_text(json.dumps({"task": columns.pop("task", "TipPose")}))
    header = ["steps", "seconds", "return", "diverged", *columns, "position_error_rms", "position_error_p95"]
    rows = [[100 * (i + 1), 60 * (i + 1), 0, 0, *(values[i] for values in columns.values()), error, 1] for i, error in enumerate(errors)]
    with open(run / "evaluations.csv", "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    evaluated = {key: None if value == "nan" else value for key, value in zip(header, rows[-1], strict=True)}
    (run / "best" / "config.json").write_text(json.dumps({"evaluated": evaluated}))


@pytest.fixture
def shown(command, tmp_path, monkeypatch, capsys):
    """shown(*arguments): what `soft-tendon sweep` prints of runs in an empty folder, and the cells of the table by configuration."""
    monkeypatch.chdir(tmp_path)

    def show(*arguments):
        command("sweep", *arguments, "--only-plot", "--out", "runs")
        printed = capsys.readouterr().out
        lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in printed.splitlines() if line.startswith("| ")]
        return printed, {cells[0]: cells for cells in lines}

    return show


def test_curves_are_interquartile_means_over_seeds_where_all_have_come(shown, tmp_path):
    for seed, error in enumerate((0.010, 0.030, 0.020, 0.900, 0.001)):
        write_run(tmp_path / "runs" / "one", seed, [0.5, error, error][: 3 if seed else 2])
    printed, rows = shown("one.toml")
    first, last = csv.DictReader((tmp_path / "runs" / "one" / "learning_curve.csv").read_text().splitlines())
    assert (first["seeds"], float(first["position_error_rms_high"])) == ("5", 0.5)
    assert float(last["position_error_rms"]) == pytest.approx(0.020), "without 0.001 and 0.9"
    assert 0.001 <= float(last["position_error_rms_low"]) < 0.010 and 0.030 < float(last["position_error_rms_high"]) <= 0.9
    assert rows["one"][1] == "5" and rows["one"][4].startswith("20.0 [") and "one: shown up to step 200, where" in printed
    assert (tmp_path / "runs" / "learning_curves.png").read_bytes().startswith(b"\x89PNG")


def test_a_table_and_a_picture_per_task_and_what_cannot_be_shown_is_named(shown, tmp_path):
    write_run(tmp_path / "runs" / "tip", 0, [0.3, 0.2])
    write_run(tmp_path / "runs" / "tip", 1, [0.3, "nan"])
    write_run(tmp_path / "runs" / "goal", 0, [0.3, 0.2], task="Reach", reached=(0.0, 0.75))
    (tmp_path / "runs" / "goal" / "seed_1").mkdir()
    (tmp_path / "docs.md").write_text("".join(f"<!-- sweep {task} -->\nold\n<!-- /sweep {task} -->\n" for task in ("TipPose", "Reach")))
    printed, rows = shown("tip.toml", "goal.toml", "missing.toml", "--write-docs", "docs.md")
    written = (tmp_path / "docs.md").read_text()
    assert written.count("| tip ") == written.count("| goal ") == 1 and "old" not in written
    assert {path.name for path in (tmp_path / "runs").glob("*.png")} == {"learning_curves_TipPose.png", "learning_curves_Reach.png"}
    assert rows["tip"][4].startswith("- [200, -]"), "a seed without a number is the worst"
    assert "missing has no folders seed_0" in printed and "seed_1 has no evaluations.csv" in printed


def test_every_configuration_is_trained_with_every_seed_and_one_that_fails_stops_no_other(command, capsys, monkeypatch, tmp_path):
    write_run(tmp_path / "made", 0, [0.1])
    copy = (
        "import shutil, sys; '--seed 4' in ' '.join(sys.argv) and 1 / 0; shutil.copytree('made/seed_0', sys.argv[-2], dirs_exist_ok=True)"
    )
    monkeypatch.setattr(learning, "TRAIN", (sys.executable, "-c", copy))
    monkeypatch.setattr(learning, "find_config", Path)
    monkeypatch.setattr(learning, "read_training", lambda path, changes, seed: SimpleNamespace(task="TipPose"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="1"):
        command("sweep", "one.toml", "two.toml", "--seeds", 2, "--first-seed", 3, "--out", "runs")
    printed = capsys.readouterr()
    assert printed.err.count("ZeroDivisionError") == 2 and "seed_4 has no evaluations.csv" in printed.out
    assert {path.parent.name for path in (tmp_path / "runs").rglob("seed_3/evaluations.csv")} == {"seed_3"}


@pytest.mark.slow  # processes
@pytest.mark.parametrize("signal_sent", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_kill_stop_the_runs(tmp_path, signal_sent):
    (tmp_path / "driver.py").write_text(DRIVER)
    command = [sys.executable, "driver.py", "one.toml", "--workers", "2", "--out", "runs"]
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    child = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True)
    while len(notes := [path for path in tmp_path.rglob("process") if path.read_text()]) < 2:
        assert child.poll() is None
        time.sleep(0.05)
    child.send_signal(signal_sent)
    assert "the same command goes on" in child.communicate(timeout=30)[1] and child.returncode != 0
    for note in notes:
        with pytest.raises(ProcessLookupError):
            os.kill(int(note.read_text()), 0)
