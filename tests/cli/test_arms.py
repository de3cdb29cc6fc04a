"""`soft-tendon fields` and `learn-strain`: what there is for an arm is reported, what there is not is made, in the cache or beside it."""

import pytest

from soft_tendon_env.accuracy import loaded_strain, proper_orthogonal_fields
from soft_tendon_env.cli import learn_strain
from soft_tendon_env.model.model import build_model
from soft_tendon_env.scene.artifacts.learned_strain import find_learned, read_learned
from soft_tendon_env.scene.artifacts.passive_fields import find_fields, read_fields
from soft_tendon_env.scene.file import load_scene

GRAVITY = "effects.gravity.acceleration=[0,0,-9.81]"
OWN = ("fields", "three_tendon", "--set", "segments.0.radius=0.009")
FEW = ("learn-strain", "three_tendon", "--set", GRAVITY, "--samples", 300, "--iterations", 5)


@pytest.fixture
def few(monkeypatch, tmp_path):
    """Few and short motions, few tests and turns, and a cache of its own."""
    monkeypatch.setattr("soft_tendon_env.compiler.cache_folder.cache_parents", lambda: [("here", lambda: tmp_path / "cache")])
    monkeypatch.setattr(proper_orthogonal_fields, "RUNS", 1)
    monkeypatch.setattr(proper_orthogonal_fields, "TESTS", 1)
    monkeypatch.setattr(proper_orthogonal_fields, "COUNTS", (0, 3, 6))
    monkeypatch.setattr(loaded_strain, "TESTS", 3)
    monkeypatch.setattr(learn_strain, "TURNS", 1)
    return tmp_path


def test_fields_that_ship_are_reported_and_not_made_again(command, capsys, few, monkeypatch):
    monkeypatch.setattr("soft_tendon_env.cli.fields.make_passive_fields", None)
    command("fields", "three_tendon", "--coordinates", 9)
    printed = capsys.readouterr().out
    assert find_fields(load_scene("three_tendon")).digest in printed and "written" not in printed
    rows = [line.split("|")[1:3] for line in printed.splitlines() if line.startswith("|")]
    assert ["3", "0"] in [[cell.strip() for cell in row] for row in rows]
    assert 'passive = { type = "snapshots", fields = 6 }' in printed
    assert printed.count("steps of 20 ms") == 6 and "NO" not in printed


def test_an_arm_of_its_own_gets_fields_in_the_cache(command, capsys, few):
    command(*OWN, "--within", "1mm")
    printed = capsys.readouterr().out
    (path,) = (few / "cache" / "soft_tendon_env" / "fields").iterdir()
    scene = load_scene("three_tendon").replace({"segments.0.radius": 0.009})
    assert f"written: {path}" in printed and find_fields(scene).digest == read_fields(path).digest
    assert build_model(scene.replace({"strain.passive": {"type": "snapshots", "fields": 4}})).coordinate_count == 7


def test_an_arm_gets_its_strain_in_the_cache(command, capsys, few):
    command(*FEW)
    printed = capsys.readouterr().out
    (path,) = (few / "cache" / "soft_tendon_env" / "loads").iterdir()
    scene = load_scene("three_tendon").replace({"effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    assert f"written: {path}" in printed and find_learned(scene).digest == read_learned(path).digest
    assert "for tensions of 0 to 5 N" in printed and "on 3 tensions that it was not trained with" in printed
    rows = [line.split("|")[1].strip() for line in printed.splitlines() if line.startswith("|")]
    assert {"tip at rest", "without loads", "loads outside of the strain", "learned", "exact"} <= set(rows)
    assert 'include_loads = { type = "learned" }' in printed
    assert build_model(scene.replace({"strain.include_loads": {"type": "learned"}})).coordinate_count == 3


@pytest.mark.parametrize("arguments, anew", [(OWN, ("--anew",)), (FEW, ("--anew", "--seed", 1))], ids=["fields", "strain"])
def test_what_is_in_the_cache_is_made_anew_only_where_that_is_asked_for(command, capsys, few, arguments, anew):
    for more, is_made in (((), True), ((), False), (anew, True)):
        command(*arguments, *more)
        assert ("written" in capsys.readouterr().out) is is_made


@pytest.mark.parametrize(
    "arguments, name, entry",
    [
        (("fields", "three_tendon", "--coordinates", 6), "arm.fields.json", "fields = 3"),
        (FEW, "arm.loads.npz", 'include_loads = { type = "learned"'),
    ],
    ids=["fields", "strain"],
)
def test_a_file_beside_the_scene(command, capsys, few, arguments, name, entry):
    command(*arguments, "--out", few / name)
    assert f'{entry}, file = "{name}"' in capsys.readouterr().out
    assert name == "arm.loads.npz" or read_fields(few / name).fits(load_scene("three_tendon"))
    command(*arguments, "--out", few / name)
    assert "written" not in capsys.readouterr().out
