"""Presets: the shipped arms keep their quadrature, other arms get what they need, and the finer preset the more."""

import warnings

import numpy as np
import pytest

from soft_tendon_env.envs import TipPoseEnv
from soft_tendon_env.envs.fidelity import PRESETS, at_fidelity
from soft_tendon_env.model.model import build_model
from soft_tendon_env.model.quadrature import intervals_in_use, quadrature_estimate
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.scene import TIP_TOLERANCE


def helices(turns):
    routings = ({"type": "helix", "radius": 0.008, "angular_rate": 2 * np.pi * turns / 0.3, "phase": 120.0 * i} for i in range(3))
    return {"scene": "three_tendon", **{f"tendons.{i}.routing": routing for i, routing in enumerate(routings)}}


def intervals(**options):
    env = TipPoseEnv(**options)
    count = env.episodes.model.grid.per_piece
    env.close()
    return count


@pytest.mark.parametrize("name", scene_names())
def test_presets_of_shipped_scenes(name):
    """Four, four, and at least the six of the scene itself; without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        counts = [build_model(at_fidelity(load_scene(name), fidelity)).grid.per_piece for fidelity in PRESETS]
    assert counts[:2] == [4, 4] and 6 <= counts[2] <= 8


def test_an_arm_of_helices_gets_more_and_the_finer_preset_the_most():
    scene = load_scene("three_tendon").replace({key: value for key, value in helices(6).items() if key != "scene"})
    scenes = {fidelity: at_fidelity(scene, fidelity) for fidelity in PRESETS}
    counts = {fidelity: intervals_in_use(scene) for fidelity, scene in scenes.items()}
    assert 4 < counts["fast"] <= counts["standard"] < counts["fine"]
    assert quadrature_estimate(scenes["fine"]).error <= 0.4 * TIP_TOLERANCE < TIP_TOLERANCE < quadrature_estimate(scenes["fast"]).error
    assert counts == {fidelity: intervals(scene=helices(6), fidelity=fidelity) for fidelity in PRESETS}


def test_a_preset_replaces_the_number_that_a_scene_gives():
    """Too few of the scene's own do not make the preset coarse."""
    too_few = {**helices(6), "quadrature.intervals": 2}
    assert intervals(scene=too_few, fidelity="standard") == intervals(scene=helices(6), fidelity="standard") > 4


def test_the_limits_of_the_environment_count():
    assert intervals(fidelity="standard", tension_limits=[0.0, 150.0]) > intervals(fidelity="standard", tension_limits=[0.0, 15.0]) == 4
