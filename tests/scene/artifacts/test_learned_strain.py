"""Files of learned strains: saved and read without unpickling, which of them fit a scene, what is refused and what is warned of."""

import dataclasses
import io
import pickle
import warnings
import zipfile

import numpy as np
import pytest
import tomli_w

from soft_tendon_env.model.model import build_model
from soft_tendon_env.scene.artifacts.learned_strain import (
    WEIGHTS,
    LearnedRange,
    LearnedStrainWarning,
    find_learned,
    is_learned,
    learned_of,
    learned_path,
    read_learned,
)
from soft_tendon_env.scene.file import load_scene, save_scene
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError

GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
ARM = load_scene("three_tendon").replace(GRAVITY)


@pytest.fixture
def learned(untrained):
    return untrained("three_tendon", GRAVITY)[0]


def naming(path, **more):
    return ARM.replace({"strain.include_loads": {"type": "learned", "file": str(path), **more}})


@pytest.fixture
def own_cache(monkeypatch, tmp_path):
    """A user's cache in a folder of its own."""
    monkeypatch.setattr("soft_tendon_env.compiler.cache_folder.cache_parents", lambda: [("here", lambda: tmp_path / "cache")])


def test_a_saved_strain_reads_back_equal(learned, tmp_path):
    learned.save(path := tmp_path / "arm.loads.npz")
    again = read_learned(path)
    assert again.digest == learned.digest and again.errors == dict(learned.errors) and again.loads == dict(learned.loads)
    np.testing.assert_array_equal(again.coefficients, learned.coefficients)
    assert all((again.weights[name] == learned.weights[name]).all() for name in WEIGHTS)
    assert [file.name for file in tmp_path.iterdir()] == ["arm.loads.npz"]
    learned.save(other := tmp_path / "again.npz")
    assert other.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("place", ["the whole file", "an array", "the text"])
def test_nothing_is_unpickled(place, learned, tmp_path, malice):
    evil, folder = malice(tmp_path / "harm"), tmp_path / "harm"
    learned.save(path := tmp_path / "arm.npz")
    if place == "the whole file":
        path.write_bytes(pickle.dumps(evil))
    else:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        np.savez(path, allow_pickle=True, **{**arrays, "first" if place == "an array" else "about": np.array([evil], dtype=object)})
    pickle.loads(pickle.dumps(evil))
    folder.rmdir()  # which the pickle had made
    with pytest.raises(ValueError, match="holds no learned strain that soft-tendon learn-strain wrote"):
        read_learned(path)
    assert not folder.exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"first_bias": np.zeros(3)}, r"first_bias should be finite and of shape \(16,\), not \(3,\)"),
        ({"third": np.full((16, 5), np.nan)}, "third should be finite"),
        ({"second": None}, "KeyError.*second"),
        ({"about": np.array("{}")}, "KeyError.*arm"),
        ({"about": np.array("no JSON")}, "JSONDecodeError"),
        ({"coordinate_range": np.zeros((2, 2))}, r"coordinate_range should be finite and of shape \(3, 2\)"),
        ({"more": np.zeros(2)}, "TypeError.*more"),
    ],
)
def test_what_is_no_learned_strain_is_refused(change, words, learned, tmp_path):
    learned.save(path := tmp_path / "arm.npz")
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | change
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})
    with pytest.raises(ValueError, match=words):
        read_learned(path)


def test_a_cut_file_is_refused(learned, tmp_path):
    learned.save(path := tmp_path / "arm.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match="holds no learned strain"):
        read_learned(path)
    path.unlink()
    with pytest.raises(FileNotFoundError, match="there is no file"):
        read_learned(path)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        file.writestr("first.npy", b"nothing")
    path.write_bytes(content.getvalue())
    with pytest.raises(ValueError, match="holds no learned strain"):
        read_learned(path)


def test_a_file_beside_a_scene_is_named_relative_to_it(learned, tmp_path, monkeypatch):
    learned.save(tmp_path / "arm.loads.npz")
    table = scene_to_dict(ARM) | {"strain": {"type": "statics_based", "include_loads": {"type": "learned", "file": "arm.loads.npz"}}}
    (folder := tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(folder)
    (tmp_path / "arm.toml").write_text(tomli_w.dumps(table))
    scene = load_scene(tmp_path / "arm.toml")
    assert learned_of(scene).digest == learned.digest
    save_scene(scene, tmp_path / "again.toml")
    assert load_scene(tmp_path / "again.toml") == scene


def test_one_in_the_cache_is_found(learned, own_cache, tmp_path):
    scene = ARM.replace({"strain.include_loads": {"type": "learned"}})
    with pytest.raises(ConfigurationError, match="names a learned strain, and there is none .*soft-tendon learn-strain SCENE"):
        build_model(scene)
    learned.save(learned_path(ARM))
    dataclasses.replace(learned, loads={**learned.loads, "payload": 1.0}, borders=learned.borders * 1.0).save(
        learned_path(ARM.replace({"effects.tip_load.mass": 1.0}))
    )
    assert find_learned(ARM).loads == learned.loads, "that which was made for the scene"
    assert learned_of(scene).digest == learned.digest
    with pytest.raises(ConfigurationError, match="with the digest 0123456789abcdef"):
        learned_of(ARM.replace({"strain.include_loads": {"type": "learned", "digest": "0123456789abcdef"}}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"segments.0.radius": 0.009}, "of an arm of other segments, tendons, strains or borders"),
        ({"tendons.1.end": 0.2}, "of an arm of other segments"),
        ({"strain.strains": ["torsion", "bend_y", "bend_z"]}, "of an arm of other segments"),
        ({"strain.include_loads.digest": "0123456789abcdef"}, r"digest is '0123456789abcdef', but .* has"),
        ({"strain.include_loads.file": "/nowhere.npz"}, "file is '/nowhere.npz'"),
        ({"strain.rank_tolerance": 0.9}, "of 3 independent tensions, and the arm has"),
    ],
)
def test_what_does_not_belong_to_the_arm_is_refused(changes, words, learned, tmp_path):
    learned.save(path := tmp_path / "arm.npz")
    with pytest.raises(ConfigurationError, match=words):
        build_model(naming(path).replace(changes))


@pytest.mark.parametrize("value", ["learned", 1, {"type": "exact"}, {"type": "learned", "fields": 3}])
def test_other_values_are_refused(value):
    with pytest.raises(ConfigurationError, match="strain.include_loads"):
        ARM.replace({"strain.include_loads": value})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"segments.0.young_modulus": 6e5}, "young_modulus of 500000 in segment 0, not 600000"),
        ({"segments.0.density": 1000.0}, "density of 1070"),
        ({"effects.gravity.acceleration": [0.0, 0.0, -1.6]}, "gravity .* not .0.0, 0.0, -1.6"),
        ({"effects.tip_load.mass": 0.01}, "a payload .* of 0.0, not 0.01"),
        ({"effects.tip_load.force": [0.0, 0.1, 0.0]}, "a force"),
        ({"tendons.2.tension_limits": [0.0, 6.0]}, "0 to 5 N at tendon 2, not 0 to 6 N"),
    ],
)
def test_what_it_was_not_made_for_is_warned_of(changes, words, learned, tmp_path):
    learned.save(path := tmp_path / "arm.npz")
    scene = naming(path, digest=learned.digest)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_model(scene)
        build_model(scene.replace({"segments.0.damping": 1e4, "tendons.2.tension_limits": [0.0, 4.0]}))
    with pytest.warns(LearnedStrainWarning, match=words):
        build_model(scene.replace(changes))


def test_a_scene_without_loads_needs_no_file():
    scene = load_scene("three_tendon").replace({"strain.include_loads": {"type": "learned"}})
    assert not is_learned(scene)
    assert not build_model(scene).arm.strain.has_loads


def test_leaving_the_range_is_told_once(learned, tmp_path):
    learned.save(path := tmp_path / "arm.npz")
    watch = LearnedRange("three_tendon", learned_of(naming(path)))
    watch.look(np.array([[-1.0, 6.0, 3.0, 99.0]]))  # the last is a passive coordinate
    with pytest.warns(LearnedStrainWarning, match="'three_tendon' has coordinate 1 at 6.5 N, outside of -4 to 6 N"):
        watch.look(np.array([[0.0, 0.0, 0.0], [0.0, 6.5, 0.0]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        watch.look(np.full(3, 99.0))
        LearnedRange("three_tendon", learned_of(naming(path))).look(np.full(3, np.nan))
        LearnedRange("three_tendon", None).look(np.full(3, 99.0))
