"""`soft-tendon fields`: what there is for an arm is reported, what there is not is made, in the cache or beside it."""

import pytest

from soft_tendon_env.accuracy import proper_orthogonal_fields
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.passive_fields import find_fields, read_fields

OWN = ("fields", "three_tendon", "--set", "segments.0.radius=0.009")


@pytest.fixture
def few(monkeypatch, tmp_path):
    """Few and short motions, few tests, and a cache of its own."""
    monkeypatch.setattr("soft_tendon_env.tools.user_cache.cache_parents", lambda: [tmp_path / "cache"])
    monkeypatch.setattr(proper_orthogonal_fields, "RUNS", 1)
    monkeypatch.setattr(proper_orthogonal_fields, "TESTS", 1)
    monkeypatch.setattr(proper_orthogonal_fields, "COUNTS", (0, 3, 6))
    return tmp_path


def test_fields_that_ship_are_reported_and_not_made_again(command, capsys, few, monkeypatch):
    monkeypatch.setattr("soft_tendon_env.cli.fields.make_passive_fields", None)
    command("fields", "three_tendon", "--coordinates", 9)
    printed = capsys.readouterr().out
    assert find_fields(load_scene("three_tendon")).digest in printed and "written" not in printed
    rows = [line.split("|")[1:3] for line in printed.splitlines() if line.startswith("|")]
    assert ["3", "0"] in [[cell.strip() for cell in row] for row in rows]
    assert 'passive = { type = "snapshots", fields = 6 }' in printed


def test_an_arm_of_its_own_gets_fields_in_the_cache(command, capsys, few):
    command(*OWN, "--within", "1mm")
    printed = capsys.readouterr().out
    (path,) = (few / "cache" / "soft_tendon_env" / "fields").iterdir()
    scene = load_scene("three_tendon").replace({"segments.0.radius": 0.009})
    assert f"written: {path}" in printed and find_fields(scene).digest == read_fields(path).digest
    assert build_model(scene.replace({"strain.passive": {"type": "snapshots", "fields": 4}})).coordinate_count == 7


def test_what_is_in_the_cache_is_made_anew_only_where_that_is_asked_for(command, capsys, few):
    for more, is_made in (((), True), ((), False), (("--anew",), True)):
        command(*OWN, *more)
        assert ("written" in capsys.readouterr().out) is is_made


def test_a_file_beside_the_scene(command, capsys, few):
    arguments = ("fields", "three_tendon", "--coordinates", 6, "--out", few / "arm.fields.json")
    command(*arguments)
    assert 'fields = 3, file = "arm.fields.json"' in capsys.readouterr().out
    assert read_fields(few / "arm.fields.json").fits(load_scene("three_tendon"))
    command(*arguments)
    assert "written" not in capsys.readouterr().out
