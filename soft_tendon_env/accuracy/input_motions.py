"""Test inputs of a tendon-driven arm: tables of tensions as agents and controllers make them, drawn
from a seed.

Each kind keeps to a band of every tendon's range of tension. On the paper's arm (0 to 60 N) they
are tensions redrawn in 0 to 15 N every 100 ms, a walk in 0 to 20 N, sin² of about 0.8 Hz up to 20
N, tensions redrawn in 0 to 60 N every 20 ms, and a step to tensions within 20 N.
"""

from collections.abc import Callable, Mapping
from typing import Literal, get_args

import numpy as np

from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

Motion = Literal["redrawn", "increments", "smooth", "wild", "step"]

MOTIONS: tuple[Motion, ...] = get_args(Motion)
USUAL: tuple[Motion, ...] = MOTIONS[
    :3
]  # of agents and controllers, for which errors of passive fields and presets are stated
HOLD = (
    0.02  # [s], for which each row of a table of tensions is held: the environments' control period
)
REDRAWN_EVERY = 5  # rows
INCREMENT = 0.1  # of the band, the largest change from row to row
FREQUENCY, DETUNED = 0.8, 0.1  # [Hz], and by what share it differs from tendon to tendon


def _redrawn(random: np.random.Generator, rows: int, slack: Array) -> Array:
    knots = random.random((-(-rows // REDRAWN_EVERY), slack.size))
    return np.repeat(knots, REDRAWN_EVERY, axis=0)[:rows]


def _increments(random: np.random.Generator, rows: int, slack: Array) -> Array:
    walk = [slack]
    for change in random.uniform(-INCREMENT, INCREMENT, (rows, slack.size)):
        walk.append(np.clip(walk[-1] + change, 0.0, 1.0))
    return np.array(walk[1:])


def _smooth(random: np.random.Generator, rows: int, slack: Array) -> Array:
    time = HOLD * (np.arange(rows) + 0.5)
    frequency = FREQUENCY * random.uniform(1.0 - DETUNED, 1.0 + DETUNED, slack.size)
    return (
        slack + (random.random(slack.size) - slack) * np.sin(np.pi * frequency * time[:, None]) ** 2
    )


KINDS: Mapping[Motion, tuple[float, Callable[[np.random.Generator, int, Array], Array]]] = {
    "redrawn": (1 / 4, _redrawn),
    "increments": (1 / 3, _increments),
    "smooth": (1 / 3, _smooth),
    "wild": (1.0, lambda random, rows, slack: random.random((rows, slack.size))),
    "step": (1 / 3, lambda random, rows, slack: np.tile(random.random(slack.size), (rows, 1))),
}
"""The band, as a share of the range of tension, and tables of values in it, from 0 to 1; slack is
where the arm begins."""


def motion_tensions(scene: Scene, motion: Motion, seed: int, duration: float = 2.0) -> Array:
    """Table of tensions (rows, n_a) [N] of a test input, each row held for `HOLD` [s]; the same
    seed gives the same table.

    The band of a tendon reaches as far into its range on either side of the tension nearest to zero
    that it allows.
    """
    limits = np.array([tendon.tension_limits for tendon in scene.tendons]).T
    slack, (band, table) = np.clip(0.0, *limits), KINDS[motion]
    least, greatest = slack + band * (limits - slack)
    random = np.random.default_rng([seed, MOTIONS.index(motion)])
    share = table(random, round(duration / HOLD), (slack - least) / (greatest - least))
    return np.asarray(least + (greatest - least) * share)
