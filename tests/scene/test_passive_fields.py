"""Files of passive fields: saved and read, which of them fit a scene, what is refused and what is
warned of."""

import dataclasses
import json
import warnings

import numpy as np
import pytest
import tomli_w

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene, save_scene
from soft_tendon_env.scene.passive_fields import (
    FidelityWarning,
    fields_of,
    find_fields,
    read_fields,
)
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError

ARM = load_scene("three_tendon")
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}


@pytest.fixture
def shipped():
    return find_fields(ARM)


def naming(path, count=3, **more):
    return ARM.replace(
        {"strain.passive": {"type": "snapshots", "fields": count, "file": str(path), **more}}
    )


def test_saved_fields_read_back_equal(shipped, tmp_path):
    shipped.save(path := tmp_path / "arm.fields.json")
    again = read_fields(path)
    assert again.digest == shipped.digest
    assert again.errors == dict(shipped.errors)
    assert again.effects == shipped.effects
    np.testing.assert_array_equal(again.coefficients, shipped.coefficients)
    assert [file.name for file in tmp_path.iterdir()] == ["arm.fields.json"]


def test_a_file_beside_a_scene_is_named_relative_to_it(shipped, tmp_path, monkeypatch):
    shipped.save(tmp_path / "arm.fields.json")
    passive = {"type": "snapshots", "fields": 4, "file": "arm.fields.json"}
    table = scene_to_dict(ARM) | {"strain": {"type": "statics_based", "passive": passive}}
    (folder := tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(folder)
    (tmp_path / "arm.toml").write_text(tomli_w.dumps(table))
    scene = load_scene("../arm.toml")
    assert build_model(scene).coordinate_count == 7
    save_scene(scene, folder / "copy.toml")
    assert load_scene(folder / "copy.toml") == scene


@pytest.mark.parametrize(
    ("passive", "message"),
    [
        ({"fields": 3, "file": "missing.json"}, "strain.passive.file is 'missing.json'"),
        ({"fields": 3, "digest": "0123456789abcdef"}, "names passive fields that this arm has not"),
        ({"fields": 25}, "strain.passive.fields is 25"),
        ({"fields": 3, "files": "x"}, "strain.passive.files is an unknown key"),
    ],
)
def test_mistakes_name_their_key(passive, message):
    with pytest.raises(ConfigurationError, match=message):
        build_model(ARM.replace({"strain.passive": {"type": "snapshots", **passive}}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: {}, r"strain\.passive\.file is .*odd\.fields\.json"),
        (
            lambda table: {**table, "coefficients": table["coefficients"][:2]},
            "its coefficients should be finite and of shape",
        ),
        (
            lambda table: {**table, "arm": {**table["arm"], "strains": ["bend_y"]}},
            "of an arm of other segments",
        ),
        (
            lambda table: {
                **table,
                **{name: table[name][:2] for name in ("coefficients", "singular_values")},
            },
            "there are 2 of this arm",
        ),
    ],
)
def test_changed_files_are_refused(shipped, tmp_path, change, message):
    shipped.save(path := tmp_path / "odd.fields.json")
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(ConfigurationError, match=message):
        build_model(naming(path))


def test_a_digest_pins_the_fields(shipped, tmp_path):
    shipped.save(path := tmp_path / "arm.fields.json")
    other = dataclasses.replace(shipped, coefficients=2.0 * shipped.coefficients)
    assert fields_of(naming(path, digest=shipped.digest)).digest == shipped.digest
    other.save(path)
    with pytest.raises(
        ConfigurationError, match=rf"digest is '{shipped.digest}', but .* has '{other.digest}'"
    ):
        fields_of(naming(path, digest=shipped.digest))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"segments.0.young_modulus": 4e6}, "young_modulus of"),
        ({"tendons.2.tension_limits": [-50.0, 10.0]}, "N, not -50 to 10 N"),
        ({"effects.tip_load.force": [0.0, 0.0, -50.0]}, "'force'"),
    ],
)
def test_what_fields_were_not_made_for_is_warned_of(changes, words):
    scene = ARM.replace({**changes, "strain.passive": {"type": "snapshots", "fields": 3}})
    with pytest.warns(FidelityWarning, match=words):
        fields_of(scene)


@pytest.mark.parametrize(
    "changes",
    [{}, {"segments.0.density": 900.0}, {"tendons.0.tension_limits": [0.0, 5.0]}, GRAVITY],
)
def test_what_they_were_made_for_is_not(changes):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fields_of(ARM.replace({**changes, "strain.passive": {"type": "snapshots", "fields": 3}}))


def test_loaded_scenes_get_fields_made_under_loads(shipped):
    loaded = find_fields(ARM.replace(GRAVITY))
    assert shipped.effects == Effects()
    assert loaded.effects.gravity is not None
    assert loaded.digest != shipped.digest
