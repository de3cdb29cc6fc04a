"""`soft-tendon scenes` and `soft-tendon effects` say what there is."""

import pytest

from soft_tendon_env.cli.scenes import coordinate_count
from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.scene.file import SHIPPED, load_scene, scene_names


@pytest.mark.cases("name", scene_names())
def test_coordinates_are_those_of_the_model(build, name):
    assert coordinate_count(load_scene(name)) == build(name).coordinate_count


def test_scenes_are_listed(command, capsys):
    command("scenes")
    rows = {line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[2:-1]] for line in capsys.readouterr().out.splitlines()}
    assert rows.keys() >= {*scene_names()}
    assert rows["paper_16dof"] == ["10", "16", load_scene("paper_16dof").description]


def test_a_scene_is_printed_as_its_file(command, capsys, tmp_path):
    for name in scene_names():
        command("scenes", name)
        assert capsys.readouterr().out == (SHIPPED / f"{name}.toml").read_text()
    path = tmp_path / "own.toml"
    path.write_text((SHIPPED / "paper.toml").read_text())
    command("scenes", path)
    assert capsys.readouterr().out == path.read_text()


@pytest.mark.cases("name", EFFECTS)
def test_every_effect_has_its_parameters_with_units(command, capsys, name):
    command("effects", name)
    printed = capsys.readouterr().out
    assert printed.startswith(f"[effects.{name}]\n")
    for key, field in EFFECTS[name].model_fields.items():
        assert f"\n  {key}: " in printed and (field.description or f"`{key}`") in printed
    assert "[m/s^2]" in printed or "[N]" in printed or "[" in printed.partition("]\n")[2]


def test_all_effects_are_listed(command, capsys):
    command("effects")
    printed = capsys.readouterr().out
    assert all(f"[effects.{name}]" in printed for name in EFFECTS)
    assert '  frame: "world" or "tip", world by default' in printed and "  acceleration: array of 3 numbers, required" in printed
