"""The examples run, say what they found, and draw it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(example, folder, *arguments):
    """What an example prints, run as a user would, elsewhere."""
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, EXAMPLES / example, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True).stdout


def test_quick_start_comes_to_rest_and_moves(tmp_path):
    printed = run("quick_start.py", tmp_path).splitlines()
    assert len(printed) == 2
    assert all("the tip is at" in line or "it is at" in line for line in printed)


def test_paper_trajectory_prints_a_row_per_model_and_draws(tmp_path):
    printed = run("paper_trajectory.py", tmp_path, "--models", "paper", "paper_16dof", "--duration", "0.2", "--out", str(tmp_path))
    rows = {line.split()[0]: line.split() for line in printed.splitlines() if line.startswith("paper")}
    assert {name: int(row[1]) for name, row in rows.items()} == {"paper": 10, "paper_16dof": 16}
    for row in rows.values():
        own, full = float(row[5]), float(row[6])
        assert own < 0.1 and full < 0.3, "mm, within the first 0.2 s"
    assert is_picture(tmp_path / "paper_trajectory.png")


def test_paper_trajectory_refuses_a_duration_beyond_the_references(tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as raised:
        run("paper_trajectory.py", tmp_path, "--duration", "2")
    assert "between 0.01 and 1" in raised.value.stderr


def test_circle_stays_near_it_and_leaves_a_recording_and_a_picture(tmp_path):
    printed = run("circle.py", tmp_path, "--fidelity", "fast", "--seconds", "4", "--out", str(tmp_path))
    error = float(printed.split("position error ")[1].split()[0])
    assert error < 40.0, "mm: a circle of 250 mm, followed without feedback"
    assert is_picture(tmp_path / "circle.png")
    assert (tmp_path / "circle.rrd").stat().st_size > 100_000


def test_tracking_writes_a_small_moving_picture_of_an_arm_on_its_target(tmp_path):
    printed = run("tracking.py", tmp_path, "--fidelity", "fast", "--out", "new/tracking.gif")
    assert float(printed.split("position error ")[1].split()[0]) < 0.2, "mm"
    with Image.open(tmp_path / "new" / "tracking.gif") as picture:
        assert picture.n_frames == 125 and picture.info["duration"] == 40 and picture.info["loop"] == 0
    assert (tmp_path / "new" / "tracking.gif").stat().st_size < 2e6


def is_picture(path):
    content = path.read_bytes()
    return content.startswith(b"\x89PNG") and len(content) > 20_000
