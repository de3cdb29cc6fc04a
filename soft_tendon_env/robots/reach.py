"""Bounds of where an arm's tip can be, and how fast it can move: what is measured beyond them is a tracker's mistake."""

from typing import NamedTuple

import numpy as np
import scipy.linalg

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.tools.types import Array

STRETCH = 1.25
"""Greatest distance of the tip from the base, in lengths of the arm: soft rubber stretches by some percent, trackers err by millimetres."""
NOISE = 0.1
"""Share of the length by which a tip that stands still may seem to jump: ten times the noise of a poor tracker."""
UNITS = {"cm": 100.0, "mm": 1000.0}
"""Units in which trackers send positions, by how many there are in a metre."""


class Reach(NamedTuple):
    """Bounds of a tip's motion: greatest distance from the base [m], greatest speed [m/s], jump that noise may make [m], and the time [s]
    that is between two measurements at least."""

    distance: float
    speed: float
    noise: float
    period: float

    def check(self, tip: Array, before: Array, time: float) -> None:
        """Raises ValueError for a tip (3,) beyond reach, or further from where it was `time` [s] before than it can move meanwhile."""
        if (far := float(np.linalg.norm(tip))) > self.distance:
            units = [name for name, factor in UNITS.items() if 0.1 * self.distance < far / factor <= self.distance]
            hint = f": it seems to be in {' or '.join(units)}" if units else ": is it in the scene's world frame?"
            text = f"puts the tip {far:.3g} m from the base, and the arm reaches {self.distance:.3g} m{hint}"
            raise ValueError(f"measurement.tip_pose {text}")
        jump, most = float(np.linalg.norm(tip - before)), self.speed * max(time, self.period) + self.noise
        if jump > most:
            text = f"jumps by {jump:.3g} m in {time:.3g} s, and the arm can move {most:.3g} m: is it another marker?"
            raise ValueError(f"measurement.tip_pose {text}")


def reach_of(episodes: Episodes) -> Reach:
    """Bounds of an environment's arm; none where its base moves.

    The speed is that of the tip when all tendons that pull one way jump from slack to their limits: the root of the sum of squares of its
    vibrations about the straight arm, and the speed of a fall through its length. Arms that ship, 40 % softer than drawn and driven from
    limit to limit at random, jump by at most 0.6 of that in a period.
    """
    model, actions, effects = episodes.model, episodes.actions, episodes.model.scene.effects
    if effects.moving_base is not None:
        return Reach(np.inf, np.inf, np.inf, episodes.period)
    rest, pull = np.zeros(model.coordinate_count), actions.greatest
    terms = model.terms(rest, rest)
    squares, modes = scipy.linalg.eigh(model.metric, terms.mass)
    if model.command_unit == "m":  # tensions that make these displacements
        pull = (pull - actions.least) / np.diag(terms.actuation.T @ np.linalg.solve(model.metric, terms.actuation))
    drive = modes.T @ terms.actuation * pull
    strongest = np.maximum(drive.clip(min=0.0).sum(axis=1), (-drive).clip(min=0.0).sum(axis=1))
    falling = 0.0 if effects.gravity is None else 2.0 * np.sqrt(model.length * np.linalg.norm(effects.gravity.acceleration))
    speed = float(np.linalg.norm(terms.tip_jacobian[3:] @ modes * strongest / np.sqrt(squares)) + falling)
    return Reach(STRETCH * model.length, speed, NOISE * model.length, episodes.period)
