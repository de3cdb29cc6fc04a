"""Limits of the strain in words: the tendon that is nearest to its own, and what it does there."""

import re

import numpy as np
import pytest

from soft_tendon_env import StrainLimitError
from soft_tendon_env.control.rigid_motions import skew
from soft_tendon_env.model.strain_limits import _chords_and_give, nearest_limit


@pytest.fixture(scope="module")
def helical(build):
    return build("helical", {"quadrature.intervals": 4})


def test_chords_add_up_to_the_lengths_of_the_tendons(helical, random_state):
    """Integrals of |p + k x r + r'| over the rod."""
    q, _ = random_state(helical, 0)
    xi = helical.packed_strain(q)
    grid = helical.grid
    chord_size, _ = _chords_and_give(helical.arm, grid, xi)
    # chords of the packs' empty intervals count nothing
    lengths = (chord_size * grid.weights).sum(axis=(1, 2))
    expected_lengths = helical.tendon_lengths(q)
    np.testing.assert_allclose(lengths, expected_lengths, rtol=1e-9)


def test_a_section_gives_way_by_its_compliance_at_the_tendon(helical):
    """tr C S S^T with the rows S = (r~, 1) of a force's wrench at the place r."""
    grid = helical.grid
    arm = helical.arm
    xi = helical.packed_strain(np.zeros(helical.coordinate_count))
    _, give = _chords_and_give(arm, grid, xi)
    by_tendon = arm.tendons.geometry.reshape(arm.tendons.size, -1)
    geometry = grid.at_points(by_tendon, 5)
    compliance = grid.at_points(arm.rod.root_compliance, 6) ** 2
    places = np.zeros((*geometry.shape[:-1], 3))
    places[..., 1:] = geometry[..., :2]
    forces = np.broadcast_to(np.eye(3), (*places.shape[:-1], 3, 3))
    wrenches = np.concatenate([skew(places), forces], axis=-2)
    squares = (wrenches**2).sum(axis=-1)
    expected = (compliance * squares).sum(axis=-1)
    np.testing.assert_allclose(give, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("tension", "cause"),
    [
        (300.0, "pulls its own chord down to"),
        (-300.0, "pushes the section as far as its stiffness holds"),
    ],
)
def test_causes_say_whether_a_tendon_pulls_or_pushes(build, tension, cause):
    """By the sign of the tension that is reached, of the tendon that has it."""
    model = build("three_tendon", {"quadrature.intervals": 4})
    tensions = np.zeros(3)
    tensions[1] = tension
    with pytest.raises(StrainLimitError, match=f"tendon 1 at arc length .* {cause}"):
        model.tip_pose(model.rest_coordinates(tensions))


@pytest.mark.parametrize("reached", [None, 0.5])
def test_the_tension_that_is_named_is_that_of_the_part_reached(build, reached):
    """Of all where nothing else is said."""
    model = build("three_tendon", {"quadrature.intervals": 4})
    q = model.rest_coordinates([0.0, 20.0, 5.0])
    parts = []
    if reached is not None:
        parts.append(reached)
    limit = nearest_limit(model.arm, model.grid, q, model.packed_strain(q), *parts)
    named = 20.0 * (reached or 1.0)
    assert f"with {named:.4g} N" in limit


@pytest.mark.parametrize("tension", [300.0, -150.0])
def test_the_tension_that_is_named_is_the_one_at_which_the_strain_ends(build, tension):
    model = build("three_tendon", {"quadrature.intervals": 4})
    alone = np.array([0.0, 1.0, 0.0])
    with pytest.raises(StrainLimitError) as error:
        model.tip_pose(model.rest_coordinates(tension * alone))
    named = re.search(r"with ([-\d.]+) N", str(error.value))
    limit = float(named[1])
    model.tip_pose(model.rest_coordinates(0.99 * limit * alone))
    with pytest.raises(StrainLimitError):
        model.tip_pose(model.rest_coordinates(1.01 * limit * alone))
