import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from soft_tendon_env.recording.geometry import PULL_COLORS, body, rotation_from_z, tension_colors, upwards
from soft_tendon_env.scene import rod_radius
from soft_tendon_env.shapes import backbones, drawing_stations


@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3).filter(lambda d: np.linalg.norm(d) > 1e-3))
def test_rotation_takes_z_to_the_direction(direction):
    turned = Rotation.from_quat(rotation_from_z(np.array(direction))).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, direction / np.linalg.norm(direction), atol=1e-7)


def test_rotation_to_minus_z():
    turned = Rotation.from_quat(rotation_from_z(np.array([[0.0, 0.0, -2.0]]))).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, [[0.0, 0.0, -1.0]], atol=1e-15)


def test_stations_run_from_base_to_tip_through_the_ends_of_tendons(build):
    model = build("paper")
    stations = drawing_stations(model, 24)
    assert stations[0] == 0.0 and stations[-1] == 1.0 and 0.5 in stations
    assert np.all(np.diff(stations) > 0) and 24 <= stations.size <= 26


def test_body_of_a_straight_arm_is_the_arm(build):
    model = build("paper")
    stations = drawing_stations(model, 25)
    position = backbones(model, model.arm.rod.reference_strain[None], stations)[..., :3, 3]
    pieces = body(model, stations, position)
    middle = 0.5 * (stations[1:] + stations[:-1])
    np.testing.assert_allclose(pieces.center[0], np.outer(middle, [1.0, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(pieces.radius, rod_radius(model.scene, middle)[0])
    axes = Rotation.from_quat(pieces.quaternion[0]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(axes, np.tile([1.0, 0.0, 0.0], (middle.size, 1)), atol=1e-12)


def test_colours_run_from_slack_to_the_limit(build):
    model = build("paper", {"tendons.0.tension_limits": [-60.0, 60.0]})
    tension = np.zeros((3, model.tendon_count))
    tension[:, 0] = [-60.0, 60.0, 1e3]
    colors = tension_colors(model, tension)
    wanted = [[r << 24 | g << 16 | b << 8 | 255 for r, g, b in PULL_COLORS[[i]].tolist()][0] for i in (0, 3, 3, 1)]
    assert [*colors[:, 0], colors[0, 1]] == wanted


@pytest.mark.parametrize(
    ("gravity", "up"), [(None, [0, 0, 1]), ([0.0, 0.0, 0.0], [0, 0, 1]), ([9.81, 0.0, 0.0], [-1, 0, 0]), ([0.0, -9.81, 0.0], [0, 1, 0])]
)
def test_up_is_against_gravity(build, gravity, up):
    model = build("three_tendon", {"effects.gravity.acceleration": gravity} if gravity else None)
    np.testing.assert_array_equal(upwards(model), up)
