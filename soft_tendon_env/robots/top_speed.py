"""Top speed of an arm's tip, by which a measured pose that jumps is told from motion."""

import math

import numpy as np

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.step_control import RESOLVED, linear_rate
from soft_tendon_env.tools.types import Array

MARGIN = 2.0
"""Factor above the simulated speed, which no arm exceeds: it may be lighter than its model, and
speeds are looked at once in a control period."""

MOST_PERIODS = 100
"""Control periods of a motion that is looked at, at most: simulation takes time."""

ROW = np.zeros(1, dtype=np.int64)


def half_swing(episodes: Episodes) -> float:
    """Time [s] of half a period of the slowest vibration of the arm."""
    rate = linear_rate(episodes.model)
    return float(np.pi / (RESOLVED * rate))


def top_speed(episodes: Episodes) -> float:
    """Largest speed of the tip, simulated.

    Tendons that bend the arm alike pull at once, as hard as they may, and let go where the arm has
    swung over.

    Args:
        episodes: of one arm, whose simulated state is left at rest.

    Returns:
        The speed [m/s], MARGIN times the simulated one; infinite where the simulation fails.
    """
    swing = half_swing(episodes) / episodes.period  # in control periods
    if swing < MOST_PERIODS:
        periods = math.ceil(swing)
    else:
        periods = MOST_PERIODS
    rest = episodes.start_command
    strongest = episodes.actuation.actions.greatest
    fastest = 0.0
    for pulls in _alike(episodes):
        start = episodes.starts.q[None]
        episodes.arms.place(ROW, start, episodes.start_tension)
        pulled = np.where(pulls, strongest, rest)
        for command in (pulled, rest):
            for _ in range(periods):
                commands = command[None, None]
                episodes.arms.step(commands, ROW)
                code = episodes.arms.outcome.status[0]
                if code != OK:
                    return np.inf
                velocity = episodes.arms.reading.tip_twist[0, 3:]
                speed = float(np.linalg.norm(velocity))
                fastest = max(fastest, speed)
    start_again = episodes.starts.q[None]
    episodes.arms.place(ROW, start_again, episodes.start_tension)
    return MARGIN * fastest


def _alike(episodes: Episodes) -> Array:
    """Sets of tendons (m, n_a) bool, each with those that bend the arm as one of them does."""
    model = episodes.model
    still = np.zeros(model.coordinate_count)
    terms = model.terms(still, still)
    flexibility = np.linalg.solve(terms.stiffness, terms.actuation)
    compliance = terms.actuation.T @ flexibility
    return np.unique(compliance > 0.0, axis=0)
