"""Faults of the drawing and of the tensions are told by the residuals of holds; clean data seldom raise a finding."""

import functools

import numpy as np
import pytest

from soft_tendon_env.identification import Marker, MarkerSet
from soft_tendon_env.identification.findings import misfit_texts, over_fitting_texts
from soft_tendon_env.identification.fit import fit
from soft_tendon_env.identification.parameters import distance_parameter, read_parameters
from soft_tendon_env.identification.plant import Plants
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.identification.split import split
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import rod_length

HOLDS, NOISE = 18, 5e-4  # [m]
ASKED = ["segments.*.young_modulus", "segments.*.density"]
FAULTS = {"none": (0.0, 0.0), "further": (0.12, 0.0), "closer": (-0.12, 0.0), "higher": (0.0, 0.2)}
"""Distance of the tendons from the axis, as a change in parts, and what is added to all tensions [N]."""


@functools.cache
def arm(name, fault):
    """Plants of an arm in horizontal rest, its commands, and measured positions without noise when it has a fault."""
    scene = load_scene(name).replace({"effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    places = rod_length(scene) * np.array([0.3, 0.6, 0.99])
    markers = MarkerSet(markers={f"m{i}": Marker(arc_length=own, offset=(0.0, 0.01, 0.0)) for i, own in enumerate(places)})
    further, higher = FAULTS[fault]
    distance = distance_parameter(scene)
    drawn, real = (
        Plants(own, build_model(own), markers, read_parameters(ASKED, own, markers))
        for own in (scene, scene.replace(distance.changes(distance.at(np.log1p(further)))))
    )
    limits = np.array([own.tension_limits[1] for own in scene.tendons])
    commands = 0.8 * limits * np.random.default_rng(3).uniform(size=(HOLDS, len(limits)))
    return drawn, commands, Readings(real, holds(commands + higher, np.zeros((HOLDS, 3, 3)))).positions(np.zeros(2))


def holds(commands, positions):
    return [Recording(f"{i}", "simulated", u[None], p[None], 0.0, {}) for i, (u, p) in enumerate(zip(commands, positions, strict=True))]


def findings(name, fault, seed):
    """Findings about residuals with noise."""
    drawn, commands, positions = arm(name, fault)
    noise = NOISE * np.random.default_rng(seed).normal(size=positions.shape)
    fitted, unseen = (Readings(drawn, part) for part in split(holds(commands, positions + noise)))
    found = fit(fitted)
    return misfit_texts(found, fitted, None) + over_fitting_texts(found, fitted, unseen, "linear")


@pytest.mark.cases(
    "name, fault, words",
    [
        ("three_tendon", "further", "% further from the axis than drawn"),
        ("two_segment_six", "closer", "% closer to the axis than drawn"),
        ("three_tendon", "higher", "all tensions were 0.2"),
        ("three_tendon", "none", None),
    ],
)
def test_tendons_at_another_distance_and_an_offset_of_tensions_are_told(name, fault, words):
    told = [text for text in findings(name, fault, 0) if "as if" in text]
    assert (
        (words in told[0] and "N higher than recorded" in told[0])
        if fault == "higher"
        else (words is None and not told) or words in told[0]
    )


def test_errors_that_repeats_of_the_same_commands_have_in_common_are_no_structure():
    drawn, commands, positions = arm("three_tendon", "none")
    told = 0
    for seed in range(5):
        random = np.random.default_rng(seed)
        common = np.tile(positions + NOISE * random.normal(size=positions.shape), (3, 1, 1))
        readings = Readings(drawn, holds(np.tile(commands, (3, 1)), common + 0.2 * NOISE * random.normal(size=common.shape)))
        told += bool(misfit_texts(fit(readings), readings, None))
    assert told <= 1


@pytest.mark.slow
@pytest.mark.parametrize("name, data_sets", [("three_tendon", 100), ("two_segment_six", 40), ("four_tendon", 40)])
def test_at_most_5_of_100_clean_data_sets_have_a_finding(name, data_sets):
    assert sum(bool(findings(name, "none", seed)) for seed in range(data_sets)) <= 0.05 * data_sets


@pytest.mark.slow
def test_faults_are_told_in_most():
    assert sum(any("further from" in text for text in findings("three_tendon", "further", seed)) for seed in range(20)) >= 18
