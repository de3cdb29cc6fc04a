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
    return model_on(load_scene("three_tendon").replace(changes), 5)


def borders_of(model, work):
    """Rows w_k (n_a, points, n) and turns (n_a, points) of the borders."""
    borders = make_scratch(model.arm, 1).first.borders
    find_borders(model.arm, work.strain, borders)
    count = model.tendon_count
    turn = borders.turn.reshape(count, -1)
    rows = borders.row.reshape(*turn.shape, -1)
    assert not rows[..., model.coordinate_count :].any()
    return borders, rows[..., : model.coordinate_count], turn


def test_rows_of_borders_are_what_slides_past_them(workspace_at):
    """The first one the whole shortening of a tendon, B^T; where it is not none; their product with
    rates what the shares of friction are made of."""
    model = rubbing(0.3)
    work = workspace_at(model, Q, RATES)
    work.tendons.tension[:] = TENSION
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    _, rows, turn = borders_of(model, work)
    B = model.terms(Q, RATES).actuation
    tendons = model.arm.tendons
    np.testing.assert_array_equal(tendons.pack_begin, [0, 1, 0])
    np.testing.assert_array_equal(tendons.pack_end, [3, 4, 4])
    first = tendons.pack_begin * 2 * LANES
    at_actuators = rows[range(3), first]
    np.testing.assert_allclose(at_actuators, B.T, rtol=1e-9, atol=1e-15)
    sliding = rows @ RATES
    np.testing.assert_allclose(work.friction.rate.reshape(turn.shape), sliding, atol=1e-12)
    np.testing.assert_array_equal(work.friction.turn.reshape(turn.shape), turn)
    # what remains beyond a point is the shortening of the rest of the tendon
    places = np.append(model.grid.points.ravel(), np.inf)
    behind_end = places[:-1] > 0.2
    assert behind_end.any()
    np.testing.assert_allclose(rows[0][behind_end], 0.0, atol=1e-15)


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
    geometry = model.grid.at_points(tendons.geometry.reshape(3, -1), 5)
    is_there = geometry[tendon, ..., 4].ravel() > 0.0
    is_there &= np.repeat(model.grid.real, 2)
    own = turns[tendon, begin:behind]
    np.testing.assert_array_equal(own > 0.0, is_there[begin:behind])
    others = np.delete(turns, tendon, axis=0)
    np.testing.assert_array_equal(others, 9.0)


def falls(rows, turn, tension, rates):
    """Generalised force (n,) of what friction takes: sum_k (T_k - T_k-1) w_k."""
    sliding = rows @ rates
    directions = sliding / np.hypot(sliding, SLOW)
    signs = np.sign(tension)[:, None]
    turned = np.cumsum(signs * turn * directions, axis=1)
    at_actuators = tension[:, None]
    left = at_actuators * np.exp(-turned)
    falls = np.diff(left, axis=1, prepend=at_actuators)
    return np.einsum("ik,ikn->n", falls, rows)


@pytest.mark.parametrize("push", [1.0, -1.0], ids=["pulled", "pushed"])
def test_friction_damps_by_the_derivative_of_its_force(workspace_at, push):
    """Of a little friction, which hardly changes the tensions behind a place."""
    model = rubbing(1e-3)
    tension = push * TENSION
    work = workspace_at(model, Q, RATES)
    work.tendons.tension[:] = tension
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    borders, rows, turn = borders_of(model, work)
    damping = np.ones((6, 6))
    add_friction_damping(model.arm, work.tendons, work.friction, borders, damping)
    found = damping - 1.0
    columns = []
    for way in 1e-4 * np.eye(6):
        change = falls(rows, turn, tension, RATES - way) - falls(rows, turn, tension, RATES + way)
        columns.append(change / 2e-4)
    expected = np.transpose(columns)
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=5e-3 * size)
    np.testing.assert_allclose(found, found.T, atol=1e-9 * size)
    assert np.linalg.eigvalsh(found)[0] > -1e-9 * size


def test_friction_damps_by_the_tension_that_is_left(workspace_at):
    """sum |T_k| mu dphi_k v_s^2 / (v_k^2 + v_s^2)^(3/2) w_k w_k^T."""
    model = rubbing(0.5)
    work = workspace_at(model, Q, RATES)
    work.tendons.tension[:] = TENSION
    find_shares(model.arm, work.strain, work.tendons, work.friction)
    borders, rows, turn = borders_of(model, work)
    found = np.zeros((6, 6))
    add_friction_damping(model.arm, work.tendons, work.friction, borders, found)
    sliding = rows @ RATES
    speeds = np.hypot(sliding, SLOW)
    turned = np.cumsum(turn * sliding / speeds, axis=1)
    left = TENSION[:, None] * np.exp(-turned)
    assert np.abs(left / TENSION[:, None] - 1.0).max() > 0.1
    drag = left * turn * SLOW**2 / speeds**3
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
        np.testing.assert_allclose(out, rows[k : k + 4] @ x, rtol=1e-12)
