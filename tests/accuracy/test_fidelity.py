"""Presets: the shipped arms keep their quadrature, other arms get what they need, and the finer preset the more."""

import warnings

import numpy as np
import pytest

from soft_tendon_env.accuracy.fidelity import PRESETS, FidelityWarning, at_fidelity, build_model
from soft_tendon_env.accuracy.reference import distance, reference_motions, tips
from soft_tendon_env.accuracy.test_inputs import motion_tensions
from soft_tendon_env.envs import TipPoseEnv
from soft_tendon_env.model.quadrature import quadrature_estimate
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.passive_fields import FieldsWarning
from soft_tendon_env.scene.scene import TIP_TOLERANCE, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError


def helices(turns):
    routings = ({"type": "helix", "radius": 0.008, "angular_rate": 2 * np.pi * turns / 0.3, "phase": 120.0 * i} for i in range(3))
    return {"scene": "three_tendon", **{f"tendons.{i}.routing": routing for i, routing in enumerate(routings)}}


def intervals(**options):
    env = TipPoseEnv(**options)
    count = env.episodes.model.grid.per_piece
    env.close()
    return count


@pytest.mark.cases("name", scene_names())
def test_presets_of_shipped_scenes(name):
    """Four intervals, four to six, under water one more, and at least eight; the finest preset with more of the arm's own fields than the
    coarsest; no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        models = [build_model(load_scene(name), fidelity) for fidelity in PRESETS]
    counts = [model.grid.per_piece for model in models]
    assert counts[0] == 4 and 4 <= counts[1] <= (7 if name == "underwater" else 6) and counts[2] >= 8
    fast, standard, fine = (model.scene.strain.passive.fields for model in models)
    assert 3 <= fast <= standard <= fine and fast < fine


def test_an_arm_of_helices_gets_more_and_the_finer_preset_the_most():
    scene = load_scene("three_tendon").replace({key: value for key, value in helices(6).items() if key != "scene"})
    scenes = {fidelity: at_fidelity(scene, fidelity) for fidelity in PRESETS}
    counts = {fidelity: quadrature_estimate(scene).intervals for fidelity, scene in scenes.items()}
    assert 4 < counts["fast"] <= counts["standard"] < counts["fine"]
    assert quadrature_estimate(scenes["fine"]).error <= 0.4 * TIP_TOLERANCE < TIP_TOLERANCE < quadrature_estimate(scenes["fast"]).error
    assert counts == {fidelity: intervals(scene=helices(6), fidelity=fidelity) for fidelity in PRESETS}


def test_what_a_scene_leaves_open_is_standard_and_what_it_says_stays():
    scene = load_scene("three_tendon")
    assert at_fidelity(scene, None) == at_fidelity(scene, "standard")
    moments = {"strain.passive": [{"strains": ["torsion"], "order": 1, "span": "rod"}]}
    for changes in (moments, {"quadrature.intervals": 9}, {"integrator.step": 0.01}):
        (part,) = {key.split(".")[0] for key in changes}
        own = scene.replace(changes)
        kept, standard = at_fidelity(own, None), at_fidelity(scene, "standard")
        for name in ("strain", "quadrature", "integrator"):
            assert getattr(kept, name) == getattr(own if name == part else standard, name)
        assert at_fidelity(own, "scene") == own and at_fidelity(own, "standard") == standard


def test_rigid_strains_and_borders_stay():
    scene = load_scene("three_tendon").replace({"strain.strains": ["bend_y", "bend_z"], "strain.borders": [0.1]})
    with pytest.warns(FieldsWarning, match="no passive fields of its own"):
        made = at_fidelity(scene, "standard")
    assert made.strain.strains == ("bend_y", "bend_z") and made.strain.borders == (0.1,)
    assert made.strain.passive[0].strains == ("bend_y", "bend_z")


@pytest.mark.parametrize("name", ("paper", "four_tendon", "helical"))
def test_standard_is_near_full_physics_and_fast_not_far(name):
    """As shares of the length, on a motion that no field was made from."""
    scene = load_scene(name)
    tensions = motion_tensions(scene, "smooth", 11, 1.0)
    length = rod_length(scene)
    (exact,) = reference_motions(scene, [tensions], 5e-5 * length).tips
    for fidelity, allowed in (("fast", 1e-2), ("standard", 2e-3), ("fine", 2e-4)):
        model = build_model(scene, fidelity)
        assert distance(tips(model, tensions), exact) < allowed * length, fidelity


def test_a_fidelity_that_nobody_said_is_told_where_it_matters():
    """Of a scene that leaves its strain open a model has other coordinates than `gym.make`."""
    with pytest.warns(FidelityWarning, match="'paper' leaves its strain open.*fidelity='standard'") as caught:
        left_out = build_model(load_scene("paper"))
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert left_out.scene == build_model(load_scene("paper"), "scene").scene
        build_model(load_scene("paper_19dof"))


NAMES = "it should be 'fast', 'standard', 'fine', 'scene' or a length"


@pytest.mark.cases("fidelity, said", [*((name, NAMES) for name in ("quick", "", "Standard", "5", "1 inch")), ("0mm", ""), ("-1mm", "")])
def test_unknown_fidelities_and_lengths_that_are_not_positive_are_refused(fidelity, said):
    with pytest.raises(ConfigurationError, match=f"fidelity is .*{said}"):
        TipPoseEnv(fidelity=fidelity)


def test_a_length_takes_the_calibrated_scene(monkeypatch):
    scene = load_scene("three_tendon")
    asked = []
    monkeypatch.setattr("soft_tendon_env.accuracy.fidelity.calibrated", lambda scene, tolerance: asked.append(tolerance) or scene)
    assert at_fidelity(scene, "0.2mm") == scene and asked == [2e-4]
