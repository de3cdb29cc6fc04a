"""Borders of tendons that rub: their rows and turns, what friction damps, and the products of rows
longer than a pack."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, store
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.mechanics.motion.sliding import row_products
from soft_tendon_env.mechanics.terms.tendon_friction import (
    add_friction_damping,
    find_borders,
    find_shares,
    find_turns,
)
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

SLOW = 0.02  # [m/s]
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
MODES = [{"strains": STRAINS, "order": 0, "span": "rod"}]
SIX = {"strain": {"type": "explicit", "modes": MODES}}
ENDS = {"tendons.0.end": 0.2, "tendons.1.start": 0.1}
TENSION = np.array([2.0, 1.0, 3.0])
Q = np.array([2.0, 1.0, -3.0, 0.02, 0.05, -0.03])
RATES = np.array([5.0, 2.0, 4.0, 0.1, -0.2, 0.1])


def rubbing(coefficient):
    """An arm with six constant strains, in four packs of intervals, whose tendons rub."""
    friction = {"coefficient": coefficient, "stiction_speed": SLOW}
    changes = {**SIX, **ENDS, "effects.tendon_friction": friction}
    scene = load_scene("three_tendon").replace(changes)
    return model_on(scene, 5)


def borders_of(model, work):
    """Rows w_k (n_a, points, n) and turns (n_a, points) of the borders."""
    scratch = make_scratch(model.arm, 1)
    borders = scratch.first.borders
    find_borders(model.arm, work.strain, borders)
    turn = borders.turn.reshape(model.tendon_count, -1)
    filled = borders.row.reshape(*turn.shape, -1)
    n = model.coordinate_count
    rows = filled[..., :n]
    padding = filled[..., n:]
    assert not padding.any()
    return borders, rows, turn


def shares_at(model, workspace_at, tension):
    """The workspace with the shares of tensions (n_a,) that friction leaves."""
    work = workspace_at(model, Q, RATES)
    work.tendons.tension[:] = tension
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    return work


def test_rows_of_borders_are_what_slides_past_them(workspace_at):
    """The first one the whole shortening of a tendon, B^T; where it is not none; their product with
    rates what the shares of friction are made of."""
    model = rubbing(0.3)
    work = shares_at(model, workspace_at, TENSION)
    _, rows, turn = borders_of(model, work)
    terms = model.terms(Q, RATES)
    tendons = model.arm.tendons
    np.testing.assert_array_equal(tendons.pack_begin, [0, 1, 0])
    np.testing.assert_array_equal(tendons.pack_end, [3, 4, 4])
    first = tendons.pack_begin * 2 * LANES
    at_actuators = rows[range(3), first]
    shortening = terms.actuation.T
    np.testing.assert_allclose(at_actuators, shortening, rtol=1e-9, atol=1e-15)
    sliding = rows @ RATES
    friction = work.friction
    rates = friction.rate.reshape(turn.shape)
    turns = friction.turn.reshape(turn.shape)
    np.testing.assert_allclose(rates, sliding, atol=1e-12)
    np.testing.assert_array_equal(turns, turn)
    # what remains beyond a point is the shortening of the rest of the tendon
    places = model.grid.points.ravel()
    is_beyond = places > 0.2
    assert is_beyond.any()
    first_rows = rows[0]
    np.testing.assert_allclose(first_rows[is_beyond], 0.0, atol=1e-15)


@pytest.mark.parametrize("tendon", [0, 1, 2])
def test_tendons_turn_nowhere_but_where_they_are(workspace_at, tendon):
    """Whatever stood there before."""
    model = rubbing(0.3)
    work = workspace_at(model, Q, RATES)
    work.friction.turn[:] = 9.0
    find_turns(model.arm, tendon, work.strain, work.friction.turn)
    tendons = model.arm.tendons
    turns = work.friction.turn.reshape(3, -1)
    begin = tendons.pack_begin[tendon] * 2 * LANES
    behind = tendons.pack_end[tendon] * 2 * LANES
    # in every pack the two points of an interval follow each other
    by_tendon = tendons.geometry.reshape(3, -1)
    geometry = model.grid.at_points(by_tendon, 5)
    presence = geometry[tendon, ..., 4]
    is_there = presence.ravel() > 0.0
    is_there &= np.repeat(model.grid.real, 2)
    own = slice(begin, behind)
    turns_of_own = turns[tendon, own]
    np.testing.assert_array_equal(turns_of_own > 0.0, is_there[own])
    others = np.delete(turns, tendon, axis=0)
    np.testing.assert_array_equal(others, 9.0)


def falls(rows, turn, tension, rates):
    """Generalised force (n,) of what friction takes: sum_k (T_k - T_k-1) w_k."""
    sliding = rows @ rates
    speeds = np.hypot(sliding, SLOW)
    directions = sliding / speeds
    at_actuators = tension[:, None]
    signs = np.sign(at_actuators)
    fallen = signs * turn * directions
    turned = np.cumsum(fallen, axis=1)
    left = at_actuators * np.exp(-turned)
    falls = np.diff(left, axis=1, prepend=at_actuators)
    return np.einsum("ik,ikn->n", falls, rows)


@pytest.mark.parametrize("push", [1.0, -1.0], ids=["pulled", "pushed"])
def test_friction_damps_by_the_derivative_of_its_force(workspace_at, push):
    """Of a little friction, which hardly changes the tensions behind a place."""
    model = rubbing(1e-3)
    tension = push * TENSION
    work = shares_at(model, workspace_at, tension)
    borders, rows, turn = borders_of(model, work)
    damping = np.ones((6, 6))
    add_friction_damping(model.arm, work.tendons, work.friction, borders, damping)
    found = damping - 1.0
    columns = []
    for way in 1e-4 * np.eye(6):
        slower = falls(rows, turn, tension, RATES - way)
        faster = falls(rows, turn, tension, RATES + way)
        change = slower - faster
        columns.append(change / 2e-4)
    expected = np.transpose(columns)
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=5e-3 * size)
    np.testing.assert_allclose(found, found.T, atol=1e-9 * size)
    least, *_ = np.linalg.eigvalsh(found)
    assert least > -1e-9 * size


def test_friction_damps_by_the_tension_that_is_left(workspace_at):
    """sum |T_k| mu dphi_k v_s^2 / (v_k^2 + v_s^2)^(3/2) w_k w_k^T."""
    model = rubbing(0.5)
    work = shares_at(model, workspace_at, TENSION)
    borders, rows, turn = borders_of(model, work)
    found = np.zeros((6, 6))
    add_friction_damping(model.arm, work.tendons, work.friction, borders, found)
    sliding = rows @ RATES
    speeds = np.hypot(sliding, SLOW)
    directions = sliding / speeds
    turned = np.cumsum(turn * directions, axis=1)
    share = np.exp(-turned)
    change = np.abs(share - 1.0)
    assert change.max() > 0.1
    left = TENSION[:, None] * share
    slopes = SLOW**2 / speeds**3
    drag = left * turn * slopes
    expected = np.einsum("ik,ika,ikb->ab", drag, rows, rows)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


@kernel
def products_of(rows, k, x, out):
    store(out, 0, row_products(rows, k, x))


@pytest.mark.parametrize("size", [LANES, 3 * LANES])
def test_products_of_four_rows_are_theirs(size):
    """Also of rows that are longer than a pack."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(8, size))
    x = rng.normal(size=size)
    out = np.empty(LANES)
    for k in (0, 4):
        products_of(rows.ravel(), k, x, out)
        expected_out = rows[k : k + 4] @ x
        np.testing.assert_allclose(out, expected_out, rtol=1e-12)
