"""Surfaces of solids: closed, seen from outside, where the obstacles of contact have theirs."""

import numpy as np
import pytest

from soft_tendon_env.drawing.renderer import normals
from soft_tendon_env.drawing.solids import surface
from soft_tendon_env.effects.contact import Contact

BOX = np.array([-0.5, -0.5, -0.5]), np.array([0.5, 0.5, 0.5])
VOLUMES = [
    ({"type": "sphere", "radius": 0.1}, 4.0 / 3.0 * np.pi * 1e-3),
    ({"type": "capsule", "radius": 0.1, "length": 0.3, "axis": [1.0, 2.0, 0.0]}, 4.0 / 3.0 * np.pi * 1e-3 + 0.3 * np.pi * 1e-2),
    ({"type": "cylinder", "radius": 0.1, "length": 0.3, "axis": [1.0, 2.0, 0.0]}, 0.3 * np.pi * 1e-2),
    ({"type": "box", "size": [0.1, 0.2, 0.3], "rotation": [10.0, 20.0, 30.0]}, 0.006),
]


@pytest.mark.parametrize(("obstacle", "volume"), VOLUMES, ids=lambda value: value["type"] if isinstance(value, dict) else "")
def test_surfaces_hold_the_volume_and_lie_on_the_obstacle(obstacle, volume):
    contact = Contact(obstacles=[{**obstacle, "position": [0.1, 0.2, 0.3]}])
    (solid,) = contact.solids()
    corners = surface(solid, BOX)
    area = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    assert np.sum(area * (corners.mean(axis=1) - solid.pose[:3, 3])) / 3.0 == pytest.approx(volume, rel=0.05)
    assert np.abs(contact.distances(corners.reshape(-1, 3))).max() < 1e-12


def test_a_plane_is_shown_where_the_view_is():
    contact = Contact(obstacles=[{"type": "plane", "position": [5.0, 5.0, -0.2], "axis": [0.0, 0.1, 1.0]}])
    (solid,) = contact.solids()
    corners = surface(solid, BOX)
    np.testing.assert_allclose((corners - solid.pose[:3, 3]) @ solid.pose[:3, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(normals(corners) @ solid.pose[:3, 2], 1.0)
    assert np.abs(corners.mean(axis=(0, 1))).max() < 1.0
