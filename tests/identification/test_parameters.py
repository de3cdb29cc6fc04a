"""Parameters: keys with wildcards, bounds, priors, and where they lead."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env.identification.fit import Intervals
from soft_tendon_env.identification.identify import randomize
from soft_tendon_env.identification.markers import Marker, MarkerSet
from soft_tendon_env.identification.parameters import read_parameters
from soft_tendon_env.identification.readings import Plants
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene


def test_a_wildcard_of_the_scene_is_one_factor_and_one_of_the_measurement_is_many(placed):
    scene = load_scene("two_segment_six")
    E, *offsets = read_parameters(["segments.*.young_modulus", "markers.*.offset"], scene, placed)
    assert E.of_scene.keys == ("segments.0.young_modulus", "segments.1.young_modulus")
    assert E.is_factor
    assert E.prior is None
    assert len(offsets) == 9
    assert (offsets[1].name, offsets[1].value) == (
        "markers.base.offset.1",
        0.012,
    )
    assert offsets[1].prior == pytest.approx(0.01)


def test_entries_of_a_list_change_together_and_angles_by_differences(placed):
    elastic = {"stiffness": 3e3, "slack": [0.0, 0.0, 0.0], "displacement_limits": [-0.01, 0.03]}
    changes = {
        "effects.tendon_elasticity": elastic,
        "tendons.1.routing": {"type": "surface", "angle": 10.0},
    }
    asked = ["effects.tendon_elasticity.slack.0,2=-0.002..0.002", "tendons.1.routing.angle"]
    scene = load_scene("three_tendon").replace(changes)
    slack, angle = read_parameters(asked, scene, placed)
    assert slack.of_scene.keys == (
        "effects.tendon_elasticity.slack.0",
        "effects.tendon_elasticity.slack.2",
    )
    assert not angle.is_factor
    assert (angle.low, angle.high) == (-20.0, 40.0)


def test_bounds_stop_where_the_scene_does(arm, placed):
    (nu,) = read_parameters(
        ["segments.0.poisson_ratio=0.1..0.7"],
        arm.replace({"segments.0.poisson_ratio": 0.4}),
        placed,
    )
    assert 0.4999999 < nu.high <= 0.5


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("segments.0,7.density", "segments.7.density is no number of the scene"),
        (
            "segments.*.young",
            "segments.*.young is no number of the scene: did you mean 'segments.*.young_modulus'?",
        ),
        (
            "markers.top.offset",
            (
                "parameter 'markers.top.offset' is none of the measurement: did you mean"
                " 'markers.tip.offset.2'?"
            ),
        ),
        ("segments.*.density=5..1", "should be KEY or KEY=LOW..HIGH with LOW < HIGH"),
        ("segments.*.density=1..2", "bounds should be of one sign around its number"),
        (
            "effects.gravity.acceleration.1",
            "zero has no usual range, give effects.gravity.acceleration.1=LOW..HIGH",
        ),
        ("base.quaternion.1", "none of the measurement: did you mean 'base.rotation.1'?"),
    ],
)
def test_bad_parameters_are_told(arm, placed, asked, message):
    with pytest.raises(ValueError) as raised:
        read_parameters([asked], arm, placed)
    assert message in str(raised.value)


def test_a_base_that_is_elsewhere_takes_the_markers_along(arm, placed):
    parameters = read_parameters(["base", "commands.*.gain", "commands.delay"], arm, placed)
    model = build_model(arm)
    plants = Plants(arm, model, placed, parameters)
    x = np.zeros(len(parameters))
    x[:6] = [
        0.0,
        0.0,
        2.0,
        parameters[3].coordinate(5e-3),
        0.0,
        0.0,
    ]  # 6 degrees about z, 5 mm along x
    x[6] = np.log(1.1)
    x[-1] = 0.0
    measurement = plants.measurement(x)
    scene = plants.scene_at(x, arm)
    R = Rotation.from_rotvec([0.0, 0.0, 6.0], degrees=True).as_matrix()
    straight = plants.model.with_scene(scene).backbone_at(
        np.zeros(plants.model.coordinate_count), placed.arc_lengths
    )
    straight[:, :3, 3] -= scene.base.position
    inside = placed.arc_lengths[:, None] * [1.0, 0.0, 0.0] + placed.offsets
    assert np.allclose(measurement.positions(straight), inside @ R.T + [5e-3, 0.0, 0.0])
    assert np.allclose(measurement.gain, [1.1, 1.0, 1.0])


@pytest.mark.parametrize(
    ("changes", "moves"),
    [
        ({}, False),
        ({"effects.contact.obstacles": [{"type": "plane", "position": [0, 0, -0.1]}]}, True),
    ],
)
def test_the_place_of_the_base_changes_what_an_arm_does_among_obstacles_alone(
    arm, placed, changes, moves
):
    scene = arm.replace(changes)
    plants = Plants(
        scene,
        build_model(arm),
        placed,
        read_parameters(["base.position", "base.rotation", "markers.tip"], scene, placed),
    )
    assert plants.moves_arm == [moves] * 3 + [True] * 3 + [False] * 3


def test_priors_are_shares_of_the_arms_length_and_of_its_actuators_ranges():
    elastic = {
        "effects.tendon_elasticity": {"stiffness": 3e3, "displacement_limits": [-0.01, 0.03]}
    }
    placed = MarkerSet(markers={"tip": Marker(arc_length=0.2)})
    for changes, key, prior in (
        (elastic, "commands.1.offset", 2e-3),
        ({}, "commands.1.offset", 0.25),
        ({}, "base.position.2", 3.75e-3),
    ):
        scene = load_scene("three_tendon").replace(changes)
        (parameter,) = read_parameters([key], scene, placed)
        assert parameter.prior == pytest.approx(prior)
        assert parameter.high - parameter.value == pytest.approx(5.0 * prior)


def test_offsets_of_displacements_are_randomised_as_the_tensions_that_environments_make_them_of(
    placed,
):
    elastic = {"stiffness": 3e3, "displacement_limits": [-0.01, 0.03]}
    scene = load_scene("three_tendon").replace({"effects.tendon_elasticity": elastic})
    parameters = read_parameters(["commands.*.offset", "commands.0.gain"], scene, placed)
    low = np.array([-2e-3, -1e-3, -1e-3, 0.9])
    high = np.array([1e-3, 1e-3, 4e-3, 1.2])
    spread = Intervals(low, high, np.ones(4, dtype=bool), [])
    table = randomize(
        SimpleNamespace(
            scene=scene, parameters=parameters, value=0.5 * (low + high), intervals=spread
        )
    )
    assert table == {
        "tension_gain": [0.9, 1.2],
        "tension_offset": [pytest.approx(-0.25), pytest.approx(0.5)],
    }  # 5 N for 40 mm


def test_a_parameter_itself_says_what_it_moves_whatever_its_name(arm, placed):
    rotation, offset, gain = read_parameters(
        ["base.rotation.2", "markers.tip.offset.1", "commands.1.gain"], arm, placed
    )
    renamed = (
        replace(rotation, name="markers.tip.arc_length"),
        replace(offset, name="segments.0.density"),
        replace(gain, name="base.position.0"),
    )
    model = build_model(arm)
    plants = Plants(arm, model, placed, renamed)
    assert plants.moves_arm == [True, False, True]
    measurement = plants.measurement(np.array([0.0, 1.0, np.log(1.2)]))
    moved = measurement.offsets - placed.offsets
    assert moved[2, 1] == pytest.approx(offset.prior)
    assert np.count_nonzero(moved) == 1
    assert np.allclose(measurement.gain, [1.0, 1.2, 1.0])
    assert np.array_equal(measurement.position, arm.base.position)
