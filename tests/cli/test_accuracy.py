"""`soft-tendon accuracy`: table, picture and scene; mistakes in one line."""

import csv

import numpy as np
import pytest

from soft_tendon_env.accuracy import calibration
from soft_tendon_env.accuracy.calibration import calibrate, recommended
from soft_tendon_env.accuracy.pareto import Point
from soft_tendon_env.accuracy.settings import Setting, strain_fields
from soft_tendon_env.accuracy.test_inputs import motion_tensions
from soft_tendon_env.cli import accuracy
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.passive_fields import PassiveFields, arm_of
from soft_tendon_env.scene.scene import breakpoints
from soft_tendon_env.tools import user_cache

ARM = load_scene("three_tendon")
SECONDS = 0.2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A user's cache, which the tests here share."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def cache(folder, monkeypatch):
    """Short motions, and two passive fields as if they were the arm's own."""
    coefficients = np.zeros((3, 1, 6, 11))
    for order in range(3):
        coefficients[order, 0, 1, order] = coefficients[order, 0, 2, order] = 1.0
    limits = np.array([tendon.tension_limits for tendon in ARM.tendons])
    fields = PassiveFields(arm_of(ARM), limits, breakpoints(ARM), coefficients, ARM.effects, np.ones(3), {})
    (folder / "soft_tendon_env" / "fields").mkdir(parents=True, exist_ok=True)
    fields.save(folder / "soft_tendon_env" / "fields" / "own.fields.json")
    monkeypatch.setattr(user_cache, "cache_parents", lambda: [folder])
    for module in (calibration, accuracy):
        monkeypatch.setattr(module, "motion_tensions", lambda scene, kind, seed: motion_tensions(scene, kind, seed, SECONDS))
        monkeypatch.setattr(module, "own_fields", lambda scene: fields)
    return fields


def test_the_front_is_printed_written_and_drawn(command, tmp_path, capsys):
    command("accuracy", "three_tendon", "--motion", "redrawn", "--seeds", "1", "2", "--out", tmp_path)
    printed = capsys.readouterr().out
    assert "on 2 motions (redrawn)" in printed and "Error bar, what its last refinement changed" in printed
    assert all(f"| ({preset}) " in printed for preset in ("fast", "standard", "fine"))
    found = list(csv.DictReader((tmp_path / "three_tendon.csv").read_text().splitlines()))
    errors = [float(row["tip_error"]) for row in found if not row["strain_field"].startswith("(")]
    assert errors == sorted(errors, reverse=True) and len(errors) == len(found) - 3 > 3
    assert (tmp_path / "three_tendon.png").read_bytes().startswith(b"\x89PNG")
    assert not list(tmp_path.glob("*.toml"))


def test_the_recommended_setting_is_a_scene_that_loads_and_is_that_of_calibrated(command, tmp_path, capsys):
    few = ("--motion", "redrawn", "--seeds", "1", "2")
    command("accuracy", "three_tendon", *few, "--within", "2mm", "--check", "6", "--out", tmp_path)
    printed = capsys.readouterr().out
    assert "within 2mm, with a margin of" in printed and "checked on 6 other motions: 6 of 6 within 2mm" in printed
    scene = load_scene(tmp_path / "three_tendon_2mm.toml")
    inputs = [motion_tensions(ARM, "redrawn", seed, SECONDS) for seed in (1, 2)]
    best = recommended(ARM, calibrate(ARM, inputs, accuracy.made_fields(ARM)), 2e-3)
    model = build_model(scene)
    assert model.coordinate_count == best.coordinates and model.grid.per_piece == best.setting.intervals
    assert scene.integrator == best.setting.of(ARM).integrator and scene.tendons == ARM.tendons


def test_own_fields_go_beside_the_scene_that_names_them(cache, tmp_path):
    setting = Setting("own 3", strain_fields(ARM, cache)["own 3"], 8, 1e-5)
    accuracy.write_recommended(ARM, Point(setting, 6, (0.0,), 200.0, 1.0), cache, 1e-3, tmp_path)
    scene = load_scene(tmp_path / "three_tendon_1mm.toml")
    assert scene.strain.passive.file == str(tmp_path / "three_tendon_1mm.fields.json") and scene.strain.passive.digest == cache.digest
    assert build_model(scene).coordinate_count > len(ARM.tendons)


def test_an_input_of_ones_own(command, tmp_path, capsys):
    path = tmp_path / "pulls.csv"
    np.savetxt(path, motion_tensions(ARM, "smooth", 0, SECONDS), delimiter=",", header="a,b,c", comments="")
    command("accuracy", "three_tendon", "--input", path, "--out", tmp_path / "out")
    assert f"on 1 motions ({path})" in capsys.readouterr().out


def test_without_matplotlib_it_says_so(command, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("soft_tendon_env.cli.errors._is_there", lambda module: module != "matplotlib")
    command("accuracy", "three_tendon", "--motion", "redrawn", "--seeds", "1", "2", "--out", tmp_path)
    assert 'no picture: pip install "soft_tendon_env[pictures]"' in capsys.readouterr().out


def test_a_tolerance_out_of_reach_ends_in_one_line(command, tmp_path, capsys):
    with pytest.raises(SystemExit) as exit:
        command("accuracy", "three_tendon", "--motion", "redrawn", "--seeds", "1", "2", "--within", "9.1um", "--out", tmp_path)
    assert "soft-tendon accuracy: error: " in str(exit.value.code) and "the best there is keeps within" in str(exit.value.code)
    assert not list(tmp_path.glob("*.toml"))
