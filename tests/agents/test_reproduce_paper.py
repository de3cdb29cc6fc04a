"""The script that reproduces the paper's figures: short motions, and what it prints and writes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent.parent / "agents" / "reproduce_paper.py"


def run(folder, *arguments):
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    command = [sys.executable, SCRIPT, *arguments, "--out", str(folder)]
    return subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True).stdout


def holding(folder):
    """The claims that hold, by figure."""
    return {(claim["figure"], claim["paper"]) for claim in json.loads((folder / "numbers.json").read_text())["claims"] if claim["holds"]}


def is_picture(path):
    content = path.read_bytes()
    return content.startswith(b"\x89PNG") and len(content) > 20_000


def test_models_and_shapes(tmp_path):
    printed = run(tmp_path, "--figures", "2", "3", "4", "--seconds", "1")
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    full, under = numbers["tip_mismatch_mm"]["paper"], numbers["tip_mismatch_mm"]["paper_16dof"]
    assert 0.0 < under["largest"] < 0.2 * full["largest"], "mm; six passive coordinates more"
    for name in ("paper", "paper_16dof"):
        laws = numbers["shape_error"][name]
        assert 0.0 < laws["feedback"]["rms"] < 0.6 * laws["feedforward"]["rms"]
    assert all(is_picture(tmp_path / f"figure_{figure}.png") for figure in (2, 3, 4))
    rows = [line.split("|") for line in printed.splitlines() if line.startswith("| 2(") or line.startswith("| 3(")]
    assert len(rows) == len(numbers["claims"]) == 4
    assert {row[-2].strip() for row in rows if row[1].strip().startswith("2(")} == {"OK"}


@pytest.mark.slow
def test_tip_converges_to_the_circle(tmp_path):
    printed = run(tmp_path, "--figures", "5", "--seconds", "1")
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    for name in ("fully actuated", "underactuated", "underactuated, as printed"):
        own = numbers["tip_error"][name]
        assert own["start_mm"] == pytest.approx(255.0, abs=0.1), "mm from the straight arm to the circle"
        assert own["small_from_s"] < 0.6
        assert max(numbers["largest_real_parts_1_per_s"][name]) < 0.0
        assert ("5(c)" if name == "fully actuated" else "6(c)", f"rapid convergence, very small error, {name}") in holding(tmp_path)
    same = [numbers["largest_real_parts_1_per_s"][name] for name in ("underactuated", "underactuated, moments")]
    assert same[0] == pytest.approx(same[1], abs=0.02), "in the energy, it hardly matters which passive coordinates there are"
    assert "breaks down" in printed
    assert is_picture(tmp_path / "figure_5.png") and is_picture(tmp_path / "figure_6.png")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--seconds", "0.5"), "at least 1, not 0.5"),
        (("--seconds", "2", "--write-docs"), "all figures"),
        (("--figures", "7"), "invalid choice"),
    ],
)
def test_bad_arguments_are_named(tmp_path, arguments, complaint):
    with pytest.raises(subprocess.CalledProcessError) as raised:
        run(tmp_path, *arguments)
    assert complaint in raised.value.stderr
