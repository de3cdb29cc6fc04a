"""Scenes in other units than SI's get a word that names the unit, and arms that there are get
none."""

import warnings

import numpy as np
import pytest

from soft_tendon_env import Scene, load_scene, scene_names
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.units import UnitsWarning, warn_of_units

SILICONE = {
    "length": 0.25,
    "radius": 0.012,
    "offset": 0.01,
    "modulus": 6e5,
    "density": 1100.0,
    "limit": 8.0,
}
WIRE = {
    "length": 0.2,
    "radius": 0.0005,
    "offset": 0.0045,
    "modulus": 6e10,
    "density": 6450.0,
    "limit": 20.0,
}
MM = {"length": 1e3, "radius": 1e3, "offset": 1e3}


def arm(base, factor):
    """A straight arm with three tendons; its numbers times factors by name."""
    numbers = {name: value * factor.get(name, 1.0) for name, value in base.items()}
    segment = {
        "length": numbers["length"],
        "radius": numbers["radius"],
        "young_modulus": numbers["modulus"],
        "density": numbers["density"],
    }
    around = np.arange(3) * 2.0 * np.pi / 3.0
    offsets = numbers["offset"] * np.stack([np.cos(around), np.sin(around)], axis=1)
    tendons = [
        {
            "routing": {"type": "straight", "offset": at.tolist()},
            "tension_limits": [0.0, numbers["limit"]],
        }
        for at in offsets
    ]
    return Scene.parse(
        {
            "name": "arm",
            "segments": [{**segment, "poisson_ratio": 0.4, "damping": 0.0}],
            "tendons": tendons,
        },
        "arm",
    )


def said(scene):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_units(scene)
    return " ".join(str(warning.message) for warning in caught)


@pytest.mark.parametrize(
    ("base", "factor", "words"),
    [
        (
            SILICONE,
            {"length": 1e2, "radius": 1e2, "offset": 1e2},
            ["the rod is 25 m long: is it cm?"],
        ),
        (
            SILICONE,
            {**MM, "modulus": 1e-6, "density": 1e-12},
            ["is it mm?", "is it MPa?", "density is 1.1e-09 kg/m^3: is it t/mm^3?"],
        ),
        (SILICONE, {"modulus": 1e-3}, ["segments[0].young_modulus is 600 Pa: is it kPa?"]),
        (SILICONE, {"density": 1e-3}, ["segments[0].density is 1.1 kg/m^3: is it g/cm^3?"]),
        (
            SILICONE,
            {"limit": 1e3},
            ["tendons[0].tension_limits are up to 8000 N, which strain the rod by ", "is it mN"],
        ),
        (
            SILICONE,
            {"offset": 1e3},
            ["tendons[0] is up to 10 m off the axis of a rod of 0.25 m: is it mm?"],
        ),
        (
            SILICONE,
            {"radius": 1e3, "offset": 0.1},
            ["the rod has a radius of 12 m on a length of 0.25 m: is it mm?"],
        ),
        (
            WIRE,
            {"modulus": 1e-6},
            [
                "young_modulus is 60000 Pa, and its density, 6450 kg/m^3, that of a metal: is it"
                " MPa?"
            ],
        ),
        (WIRE, {"limit": 1e3}, ["tension_limits are up to 20000 N", "is it mN"]),
        (
            {**SILICONE, "length": 0.012, "radius": 4e-4, "offset": 2e-4, "limit": 0.01},
            MM,
            # T o L / (E I) of the rod of 12 m, with I = pi r^4 / 4
            ["bend the rod by at most 2e-06 rad", "lengths in mm?"],
        ),
        (
            {**SILICONE, "length": 0.012, "radius": 4e-4, "offset": 2e-4},
            {**MM, "modulus": 2e-3},
            ["crushed by its own weight"],
        ),
    ],
)
def test_other_units_get_a_word(base, factor, words):
    text = said(arm(base, factor))
    assert text, text
    assert all(word in text for word in words), text


@pytest.mark.parametrize(
    "numbers",
    [
        SILICONE,
        WIRE,
        {
            "length": 0.1,
            "radius": 0.01,
            "offset": 0.007,
            "modulus": 1e3,
            "density": 1000.0,
            "limit": 0.01,
        },  # gel
        {
            "length": 2.0,
            "radius": 3e-4,
            "offset": 4e-4,
            "modulus": 6e10,
            "density": 6450.0,
            "limit": 15.0,
        },  # a guide wire
        {
            "length": 0.001,
            "radius": 4e-5,
            "offset": 2e-5,
            "modulus": 4e5,
            "density": 1070.0,
            "limit": 6e-5,
        },
        {
            "length": 20.0,
            "radius": 0.2,
            "offset": 0.15,
            "modulus": 5e6,
            "density": 1000.0,
            "limit": 5e3,
        },
        {
            "length": 0.06,
            "radius": 1e-3,
            "offset": 8e-4,
            "modulus": 9e5,
            "density": 5600.0,
            "limit": 0.5,
        },  # rubber full of magnets
        {
            "length": 0.1,
            "radius": 0.003,
            "offset": 0.002,
            "modulus": 1e5,
            "density": 1070.0,
            "limit": 50.0,
        },  # limits left as they are
    ],
)
def test_arms_that_there_are_get_none(numbers):
    assert said(arm(numbers, {})) == ""


def test_scenes_that_ship_get_none_and_models_say_it_once():
    assert [name for name in scene_names() if said(load_scene(name))] == []
    with pytest.warns(UnitsWarning, match="is it MPa") as caught:
        build_model(arm(SILICONE, {"modulus": 1e-6}))
    assert len([warning for warning in caught if warning.category is UnitsWarning]) == 1
