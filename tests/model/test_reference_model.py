"""Reference models: their orders, parts and intervals, and the strain that they take over."""

import numpy as np
import pytest

from soft_tendon_env.model import reference_model as judged
from soft_tendon_env.model.reference_model import (
    HIGHEST_ORDER,
    INTERVALS,
    LEVELS,
    MOST_HALVINGS,
    SPARE_INTERVALS,
    equilibrium_error,
    nearest_strain,
    part_borders,
    reference_model,
)
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import MOST_COLUMNS

ARM = load_scene("three_tendon")
TWO_PIECES = ARM.replace({"tendons.0.end": 0.2})


def test_the_order_falls_where_there_are_more_parts_and_pieces():
    """By one for each doubling of the parts, and half of one for each doubling of the pieces."""
    strains = len(ARM.strain.free)
    for level in LEVELS[:4]:
        assert reference_model(ARM, level).coordinate_count == strains * (level.order + 1)
    halves = reference_model(ARM, LEVELS[4])
    assert LEVELS[4] == (12, 2)
    assert halves.coordinate_count == 2 * strains * (11 + 1)
    quarters = reference_model(ARM, LEVELS[5])
    assert LEVELS[5] == (13, 4)
    assert quarters.coordinate_count == 4 * strains * (11 + 1)
    pieces = reference_model(TWO_PIECES, LEVELS[2])
    assert LEVELS[2].order == 10
    assert pieces.coordinate_count == 2 * strains * (8 + 1)
    assert LEVELS[3].order <= HIGHEST_ORDER


def test_every_level_keeps_an_order_of_its_own():
    """However many parts there are: with 33 of them, in two pieces, the first would have none."""
    changes = {"segments.0.curvature": [0.0, 0.0, 64.0 * np.pi / 0.3]}
    turning = TWO_PIECES.replace(changes)
    assert len(part_borders(turning)) + 2 == 33
    strains = len(ARM.strain.free)
    assert LEVELS[0].order == 6
    assert reference_model(turning, LEVELS[0]).coordinate_count == 33 * strains * (1 + 1)


def test_intervals_resolve_the_polynomials():
    """As many for each order along the rod, and some more than the order in each part."""
    whole = reference_model(ARM, LEVELS[0])
    assert whole.grid.per_piece == INTERVALS * LEVELS[0].order
    quarters = reference_model(ARM, LEVELS[5])
    assert quarters.grid.per_piece == 17  # 5 * 13 / 4
    changes = {"segments.0.curvature": [0.0, 0.0, 32.0 * np.pi / 0.3]}
    turning = ARM.replace(changes)
    many = reference_model(turning, LEVELS[0])
    assert many.grid.per_piece == 2 + SPARE_INTERVALS


def test_steps_of_a_tolerance_have_the_most_columns():
    integrator = reference_model(ARM, LEVELS[0], 1e-7).scene.integrator
    assert integrator.tolerance == 1e-7
    assert integrator.columns == MOST_COLUMNS
    assert integrator.max_halvings == MOST_HALVINGS
    assert reference_model(ARM, LEVELS[0]).scene.integrator == ARM.integrator


def test_the_nearest_strain_is_that_of_the_model():
    """Of an arm whose tendons end at 0.2 m and at the tip."""
    fine = reference_model(TWO_PIECES, LEVELS[2])
    model = reference_model(TWO_PIECES, LEVELS[0])
    amplitude = 2.0 * model.coordinate_scale()
    q = amplitude * np.cos(np.arange(model.coordinate_count))
    coordinates = nearest_strain(model, q, fine)
    places = [0.02, 0.05, 0.17, 0.23, 0.28]
    expected, _ = model.strain_at(q, places)
    strain, _ = fine.strain_at(coordinates, places)
    scale = np.abs(expected).max(axis=0)
    # between two points of either grid it is linear
    np.testing.assert_allclose(strain / scale, expected / scale, atol=0.02)
    way = fine.tip_pose(coordinates) - model.tip_pose(q)
    off = np.linalg.norm(way[:3, 3])
    assert off < 1e-3 * model.length


class TipAt:
    """A model of an arm of a metre whose tip rests at a place [m], or that has no rest."""

    scene = ARM
    length = 1.0

    def __init__(self, place):
        self.place = place

    def tip_pose(self, q):
        pose = np.eye(4)
        pose[0, 3] = self.place
        return pose

    def rest(self, *conditions):
        if self.place is None:
            return None
        return np.zeros(1)


@pytest.fixture
def error_of(monkeypatch):
    """error_of(tips): the error of a tip at 0, and how many levels were looked at, whose reference
    models have their tips at these places."""

    def judge(tips):
        levels = iter([TipAt(place) for place in tips])
        monkeypatch.setattr(judged, "reference_model", lambda scene, level: next(levels))
        monkeypatch.setattr(judged, "nearest_strain", lambda *models: np.zeros(1))
        monkeypatch.setattr(judged, "rest_near", TipAt.rest)
        model = TipAt(0.0)
        q = np.zeros(1)
        tension = np.zeros(3)
        error = equilibrium_error(model, q, tension, 1.0, True)
        not_looked_at = list(levels)
        return error, len(tips) - len(not_looked_at)

    return judge


@pytest.mark.parametrize(
    ("tips", "error", "levels"),
    [
        ([1.0, 1.19], 1.19, 2),
        ([1.0, 1.5, 1.6], 1.6, 3),
        ([1.0, 2.0, 4.0, 8.0, 16.0], 16.0 + 8.0, 5),
        ([None, 1.0, 1.1], 1.1, 3),
        ([1.0, None, 1.0, 1.0], 1.0, 4),
        ([None] * 5, np.inf, 5),
        ([1e-10, 5e-10], 5e-10, 2),
    ],
    ids=["agreed", "later", "never", "none at first", "none between", "none", "round-off"],
)
def test_levels_are_refined_until_the_error_hardly_changes(error_of, tips, error, levels):
    """By a fifth of it from one level to the next. Where it does change to the end its last change
    is added."""
    found, looked_at = error_of(tips)
    assert found == pytest.approx(error)
    assert looked_at == levels
