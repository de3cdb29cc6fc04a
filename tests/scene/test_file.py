"""Scene files: those that ship load and survive a round trip, the paper's follow its table, bad files are named."""

import json

import numpy as np
import pytest

from soft_tendon_env.scene.file import SHIPPED, load_scene, save_scene, scene_names
from soft_tendon_env.scene.scene import extrapolation_columns, scene_to_dict, tendon_ends, tendon_offset
from soft_tendon_env.tools.configuration import ConfigurationError


@pytest.mark.cases("name", scene_names())
def test_shipped_scene_loads_and_round_trips(name, tmp_path):
    scene = load_scene(name)
    assert scene.name == name and scene.description
    assert (SHIPPED / f"{name}.toml").read_text(encoding="utf-8").startswith("# ")
    step = 0.002 if name == "catheter" else 0.02
    assert (scene.integrator.step, extrapolation_columns(scene)) == (step, 3)
    save_scene(scene, tmp_path / "copy.toml")
    assert load_scene(tmp_path / "copy.toml") == scene
    assert load_scene(str(SHIPPED / f"{name}.toml")) == scene
    assert json.loads(json.dumps(scene_to_dict(scene))) == scene_to_dict(scene)
    assert [path.name for path in tmp_path.iterdir()] == ["copy.toml"]


def test_paper_tendons_follow_the_papers_table():
    scene = load_scene("paper")
    x = np.linspace(0.0, 0.5, 31)
    r, r_t, r_m, turn, s, c = 0.03 - 0.01 * x, 0.02, 0.025, 4 * np.pi * x, np.sin(np.pi / 6), np.cos(np.pi / 6)
    table = [
        (r, 0 * x),
        (-r * s, r * c),
        (-r * s, -r * c),
        (r_t * np.sin(turn), r_t * np.cos(turn)),
        (r_t * np.sin(turn), -r_t * np.cos(turn)),
        (-r, 0 * x),
        (r * s, -r * c),
        (r * s, r * c),
        (r_m * np.sin(np.pi / 2 + turn), r_m * np.cos(np.pi / 2 + turn)),
        (-r_m * np.sin(np.pi / 2 + turn), r_m * np.cos(np.pi / 2 + turn)),
    ]
    assert [tendon_ends(scene, tendon) for tendon in scene.tendons] == [(0.0, 1.0)] * 5 + [(0.0, 0.5)] * 5
    for tendon, yz in zip(scene.tendons, table, strict=True):
        np.testing.assert_allclose(tendon_offset(scene, tendon, x)[0], np.column_stack(yz), atol=1e-16)


@pytest.mark.cases(
    "content, message",
    [
        (b'name = "x"\nsegments = ]\n', "is not valid TOML: .*line 2"),
        (b"name = '\xff'", "is not valid TOML: .*invalid start byte"),
        (b"", "segments is missing: it is required"),
        (b"nme = 'x'", "nme is an unknown key .*did you mean 'name'"),
        (b"name = 2024-01-01", "name is datetime.date.*: it should be a valid string"),
    ],
)
def test_bad_file_is_named_with_its_mistake(tmp_path, content, message):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_scene(path)
    assert all(line.startswith(f"{path}: ") for line in str(caught.value).splitlines())
