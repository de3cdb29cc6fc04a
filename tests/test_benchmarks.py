"""The benchmarks run at tiny settings, print a table, and write CSV and a picture. What they
measure is not judged here."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TINY = {
    "derivatives": ("--quick",),
    "effects": ("--quick",),
    "fidelity": ("--quick", "--scenes", "three_tendon"),
    "fields": ("--quick", "--scenes", "three_tendon"),
    "identification": ("--quick",),
    "identified_control": ("--quick",),
    "integrator": ("--quick",),
    "learning_curves": ("--quick",),
    "peers": ("--quick", "--peers", "own"),
    "peer_learning": ("--quick", "--ways", "ours", "apg"),
    "robot_loop": ("--seconds", "0.5"),
    "scaling": ("--quick",),
    "own_agents": ("--quick",),
    "own_arms": ("--quick",),
    "rate_limit": ("--quick",),
    "scores": ("--quick",),
    "paired": (str(ROOT), "--scenes", "three_tendon", "--turns", "1", "--calls", "1"),
}


def test_every_benchmark_is_tried_here():
    assert set(TINY) == {path.stem for path in (ROOT / "benchmarks").glob("[a-z]*.py")}


@pytest.mark.slow
@pytest.mark.parametrize("name", TINY)
def test_benchmark_prints_a_table_and_writes_csv_and_picture(name, tmp_path):
    command = [
        sys.executable,
        ROOT / "benchmarks" / f"{name}.py",
        *TINY[name],
        "--out",
        str(tmp_path),
    ]
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    process = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert sum(line.startswith("|") for line in process.stdout.splitlines()) >= 3
    with open(tmp_path / f"{name}.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert rows
    assert all(len(row) == len(header) for row in rows)
    if name not in ("scores", "rate_limit", "own_agents"):  # a table alone
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
