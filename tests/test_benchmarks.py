"""The benchmarks run at tiny settings, print a table, and write CSV and a picture. What they measure is not judged here."""

import csv
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
TINY = {
    "evaluation_cost": ("--quick", "--repeats", "1"),
    "evaluation": ("--arms", "1", "--evaluations", "5", "--repeats", "2", "--no-start"),
    "accuracy_against_time": ("--quick", "--repeats", "1"),
    "fidelity": ("--quick",),
    "fields": ("--quick", "--scenes", "three_tendon"),
    "integrator": ("--quick",),
    "recording": ("--steps", "20", "--turns", "1"),
    "throughput": ("--ways", "native", "sync", "--seconds", "0.02"),
    "statics": ("--models", "paper", "--targets", "2"),
}


def test_every_benchmark_is_tried_here():
    assert set(TINY) == {path.stem for path in (ROOT / "benchmarks").glob("[a-z]*.py")}


@pytest.mark.parametrize("name", TINY)
def test_benchmark_prints_a_table_and_writes_csv_and_picture(name, tmp_path):
    command = [sys.executable, ROOT / "benchmarks" / f"{name}.py", *TINY[name], "--out", str(tmp_path)]
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    printed = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True).stdout
    assert sum(line.startswith("|") for line in printed.splitlines()) >= 3
    with open(tmp_path / f"{name}.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert rows and all(len(row) == len(header) for row in rows)
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_example_and_benchmarks_pull_alike():
    example = runpy.run_path(str(ROOT / "examples" / "paper_trajectory.py"))["tension"]
    benchmarks = runpy.run_path(str(ROOT / "benchmarks" / "_trajectory_input.py"))["tensions_at"]
    times = np.linspace(0.0, 1.0, 101)
    np.testing.assert_array_equal([example(t) for t in times], benchmarks(times))
