"""`soft-tendon learn-strain`: what there is is reported, what there is not is trained, mistakes are one line."""

import pytest

from soft_tendon_env.accuracy import loaded_strain
from soft_tendon_env.cli import learn_strain
from soft_tendon_env.model.model import build_model
from soft_tendon_env.scene.artifacts.learned_strain import find_learned, read_learned
from soft_tendon_env.scene.file import load_scene

GRAVITY = "effects.gravity.acceleration=[0,0,-9.81]"
FEW = ("three_tendon", "--set", GRAVITY, "--samples", 300, "--iterations", 5)


@pytest.fixture
def few(monkeypatch, tmp_path):
    """Few tests and turns, and a cache of its own."""
    monkeypatch.setattr(loaded_strain, "TESTS", 3)
    monkeypatch.setattr(learn_strain, "TURNS", 1)
    monkeypatch.setattr("soft_tendon_env.compiler.cache_folder.cache_parents", lambda: [("here", lambda: tmp_path / "cache")])
    return tmp_path


def test_an_arm_gets_its_strain_in_the_cache(command, capsys, few):
    command("learn-strain", *FEW)
    printed = capsys.readouterr().out
    (path,) = (few / "cache" / "soft_tendon_env" / "loads").iterdir()
    scene = load_scene("three_tendon").replace({"effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    assert f"written: {path}" in printed and find_learned(scene).digest == read_learned(path).digest
    assert "for tensions of 0 to 5 N" in printed and "on 3 tensions that it was not trained with" in printed
    rows = [line.split("|")[1].strip() for line in printed.splitlines() if line.startswith("|")]
    assert {"tip at rest", "without loads", "loads outside of the strain", "learned", "exact"} <= set(rows)
    assert 'include_loads = { type = "learned" }' in printed
    assert build_model(scene.replace({"strain.include_loads": {"type": "learned"}})).coordinate_count == 3
    command("learn-strain", *FEW)
    assert "written" not in capsys.readouterr().out
    command("learn-strain", *FEW, "--anew", "--seed", 1)
    assert "written" in capsys.readouterr().out


def test_a_file_beside_the_scene(command, capsys, few):
    out = few / "arm.loads.npz"
    command("learn-strain", *FEW, "--out", out)
    assert 'include_loads = { type = "learned", file = "arm.loads.npz" }' in capsys.readouterr().out
    command("learn-strain", *FEW, "--out", out)
    assert "written" not in capsys.readouterr().out
