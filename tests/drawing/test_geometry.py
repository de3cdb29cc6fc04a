import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from soft_tendon_env.drawing.shapes import camera, label_place, rotation_from_z, side_by_side


@example((0.0, 0.0, -2.0))
@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3).filter(lambda d: np.linalg.norm(d) > 1e-3))
def test_rotation_takes_z_to_the_direction(direction):
    turned = Rotation.from_quat(rotation_from_z(np.array(direction))).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, direction / np.linalg.norm(direction), atol=1e-7)


GRAVITIES = [None, (9.81, 0.0, 0.0), (-9.81, 0.0, 0.0), (0.0, -9.81, 0.0), (0.0, 0.0, -9.81)]


@pytest.fixture(params=GRAVITIES, ids=str)
def pulled(build, request):
    return build("three_tendon", {"effects.gravity.acceleration": request.param} if request.param else None)


@pytest.mark.cases("arms", [1, 2, 4, 7])
def test_the_camera_sees_arms_whole_and_large(pulled, arms):
    aspect, field_of_view = 3.0, np.radians(55.0)
    places = np.array([side_by_side(pulled, k) for k in range(arms)])
    position, target, up = camera(pulled, places)
    towards = position - target
    distance = np.linalg.norm(towards)
    towards /= distance
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    stretched = np.linspace(0.0, pulled.length, 5)[:, None] * [1.0, 0.0, 0.0]
    points = (np.concatenate([stretched, label_place(pulled)[None]]) + places[:, None]).reshape(-1, 3) - target
    sight = np.stack([points @ right / aspect, points @ np.cross(towards, right)], axis=1)
    share = np.abs(sight) / ((distance - points @ towards)[:, None] * np.tan(0.5 * field_of_view))
    assert share.max() < 1.0 + 1e-9, "within the view"
    assert share.max() > 0.3, "and not in a corner of it, with room for what arms do"
