"""Parameters of a scene: keys with wildcards, values that are alike or not, and the messages for
what is none."""

import pytest

from soft_tendon_env import ConfigurationError, load_scene
from soft_tendon_env.scene.parameters import ranges_of, scene_parameters


@pytest.fixture(scope="module")
def scene():
    gravity = {
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "effects.contact.obstacles": [{"type": "plane", "position": [0, 0, -1]}],
    }
    return load_scene("two_segment_six").replace({"segments.0.young_modulus": 3e5, **gravity})


def test_wildcards_of_changes_stand_for_every_entry(scene):
    changes = {"segments.*.density": 1.0, "tendons[*].tension_limits": [0.0, 7.0]}
    changed = scene.replace(changes)
    assert [segment.density for segment in changed.segments] == [1.0, 1.0]
    assert {tendon.tension_limits for tendon in changed.tendons} == {(0.0, 7.0)}
    with pytest.raises(
        ConfigurationError,
        match=r"segments.0.density.colour cannot be set: segments.0.density is .*, not a table",
    ):
        scene.replace({"segments.*.density.colour": 1.0})


def test_values_that_are_alike_are_one_number_and_others_share_a_factor(scene):
    density, modulus, side = scene_parameters(
        scene, ["segments.*.density", "segments[*].young_modulus", "effects.gravity.acceleration.0"]
    )
    assert (density.value, density.is_factor) == (scene.segments[0].density, False)
    assert density.changes(5.0) == {"segments.0.density": 5.0, "segments.1.density": 5.0}
    assert (modulus.value, modulus.is_factor) == (1.0, True)
    assert modulus.changes(2.0) == {
        "segments.0.young_modulus": 6e5,
        "segments.1.young_modulus": 2e6,
    }
    assert (side.value, side.size) == (0.0, 9.81)
    assert scene_parameters(scene, ["tendons.*.routing.*.0"])[0].keys == tuple(
        f"tendons.{i}.routing.offset.0" for i in range(6)
    )


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "segments.0.yong_modulus",
            (
                "segments.0.yong_modulus is no number of the scene: did you mean"
                " 'segments.*.young_modulus'?.*valid:"
            ),
        ),
        (
            "effects.fluid.density",
            r"effects.fluid.density is no number yet: the scene has no \[effects.fluid\]: add it",
        ),
        (
            "effects.gravity.size",
            "effects.gravity.size is no number of the scene.*valid: .*effects.gravity.acceleration",
        ),
        (
            "effects.gravity.acceleration",
            r"is a vector of 3 numbers: name one, .*ion.0, or all by a common factor, .*ion.\*",
        ),
        ("integrator.step", "integrator.step is no number of the scene"),
        (
            "segments.0.length",
            "segments.0.length is no parameter: it decides where the quadrature points lie",
        ),
        (
            "tendons.0.tension_limits.1",
            "tendons.0.tension_limits.1 is no parameter: it bounds the commands",
        ),
        (
            "tendons.0.routing.type",
            "tendons.0.routing.type is no parameter: 'straight' is no number",
        ),
    ],
)
def test_what_is_no_parameter_is_refused_by_name(scene, name, message):
    with pytest.raises(ConfigurationError, match=message):
        scene_parameters(scene, [name])


def test_ranges_are_of_values_factors_offsets_and_entries_of_vectors(scene):
    wanted = {
        "segments.*.density": {"factor": [0.5, 2.0]},
        "effects.tip_load.mass": [0.0, 0.1],
        "effects.gravity.acceleration": [0, 0, [-9, -8]],
    }
    factor, mass, *_, down = ranges_of(scene, wanted)
    assert factor.changes(2.0) == {
        f"segments.{i}.density": 2.0 * scene.segments[i].density for i in (0, 1)
    }
    assert mass.changes(0.05) == {"effects.tip_load.mass": 0.05}
    assert (
        down.least,
        down.greatest,
    ) == (-9.0, -8.0)
    with pytest.raises(
        ConfigurationError,
        match="segments.0.density draws what 'segments.\\*.density' draws already",
    ):
        ranges_of(scene, {"segments.*.density": 5.0, "segments.0.density": [1.0, 2.0]})
