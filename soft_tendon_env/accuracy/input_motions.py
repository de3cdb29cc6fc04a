"""Test inputs of a tendon-driven arm: tables of tensions, drawn from a seed.

Agents and controllers make such tensions.

Each kind keeps to a band of every tendon's range of tension. On the paper's arm (0 to 60 N) they
are tensions redrawn in 0 to 15 N every 100 ms, a walk in 0 to 20 N, sin² of about 0.8 Hz up to 20
N, tensions redrawn in 0 to 60 N every 20 ms, and a step to tensions within 20 N.
"""

import math
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple, get_args

import numpy as np

from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

Motion = Literal["redrawn", "increments", "smooth", "wild", "step"]

MOTIONS: tuple[Motion, ...] = get_args(Motion)

USUAL: tuple[Motion, ...] = MOTIONS[:3]
"""Motions of agents and controllers, for which errors of passive fields and presets are stated."""

HOLD = 0.02
"""Time [s] for which each row of a table of tensions is held: the environments' control period."""

DURATION = 2.0
"""Duration [s] of the usual motions, from rest, for which errors are stated."""

REDRAWN_EVERY = 5
"""Rows between new tensions of the redrawn kind: 100 ms."""

INCREMENT = 0.1
"""Largest change from row to row of a walk, as a share of the band."""

FREQUENCY = 0.8
"""Mean frequency [Hz] of the smooth kind."""

DETUNED = 0.1
"""Share by which that frequency differs from tendon to tendon at most."""


def _redrawn(random: np.random.Generator, rows: int, slack: Array) -> Array:
    count = math.ceil(rows / REDRAWN_EVERY)
    knots = random.random((count, slack.size))
    table = np.repeat(knots, REDRAWN_EVERY, axis=0)
    return table[:rows]


def _increments(random: np.random.Generator, rows: int, slack: Array) -> Array:
    shape = (rows, slack.size)
    changes = random.uniform(-INCREMENT, INCREMENT, shape)
    walk = np.empty_like(changes)
    share = slack
    for row, change in enumerate(changes):
        share = np.clip(share + change, 0.0, 1.0)
        walk[row] = share
    return walk


def _smooth(random: np.random.Generator, rows: int, slack: Array) -> Array:
    half_way = np.arange(rows) + 0.5
    middle = HOLD * half_way
    detuning = random.uniform(1.0 - DETUNED, 1.0 + DETUNED, slack.size)
    highest = random.random(slack.size)
    # sin² has twice the frequency of its sine
    rate = np.pi * FREQUENCY * detuning
    angle = middle[:, None] * rate
    part = np.sin(angle) ** 2
    pull = (highest - slack) * part
    return np.asarray(slack + pull)


def _wild(random: np.random.Generator, rows: int, slack: Array) -> Array:
    return random.random((rows, slack.size))


def _step(random: np.random.Generator, rows: int, slack: Array) -> Array:
    shares = random.random(slack.size)
    return np.tile(shares, (rows, 1))


class Kind(NamedTuple):
    """A kind of test input."""

    band: float  # share of a tendon's range of tension
    # values in the band (rows, n_a), from 0 to 1; slack (n_a,) is where the arm begins
    table: Callable[[np.random.Generator, int, Array], Array]


KINDS: Mapping[Motion, Kind] = {
    "redrawn": Kind(1 / 4, _redrawn),
    "increments": Kind(1 / 3, _increments),
    "smooth": Kind(1 / 3, _smooth),
    "wild": Kind(1.0, _wild),
    "step": Kind(1 / 3, _step),
}


def slack_tensions(scene: Scene) -> Array:
    """Tensions (n_a,) [N] at which an arm begins: those nearest to zero within limits."""
    low, high = tension_limits(scene)
    return np.clip(0.0, low, high)


def tension_limits(scene: Scene) -> tuple[Array, Array]:
    """Lowest and highest tensions (n_a,) [N] of the tendons."""
    tension_limits = [tendon.tension_limits for tendon in scene.tendons]
    limits = np.array(tension_limits)
    low = limits[:, 0]
    high = limits[:, 1]
    return low, high


def motion_tensions(scene: Scene, motion: Motion, seed: int, duration: float = DURATION) -> Array:
    """Table of tensions (rows, n_a) [N] of a test input, each row held for `HOLD` [s].

    The same seed gives the same table.

    The band of a tendon reaches as far into its range on either side of the tension nearest to zero
    that it allows.
    """
    kind = KINDS[motion]
    low, high = tension_limits(scene)
    slack = slack_tensions(scene)
    reach = kind.band * (low - slack)
    least = slack + reach
    reach_up = kind.band * (high - slack)
    greatest = slack + reach_up

    # each kind draws other numbers from the same seed
    place = MOTIONS.index(motion)
    random = np.random.default_rng([seed, place])
    rows = round(duration / HOLD)

    # a table of shares of the band
    width = greatest - least
    start = (slack - least) / width
    share = kind.table(random, rows, start)
    return np.asarray(least + width * share)
