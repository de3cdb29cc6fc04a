"""Motions that a trial judges by: of several draws of each usual kind the hardest to follow.

By how much a model errs differs from draw to draw: on 57 random arms, 7 of 100 new draws were more
than twice as far off as one drawn before. A motion that is hard to follow for one model is hard for
others, so two models of few coordinates tell which is: 0.6 of 100 new draws were more than twice as
far off as the hardest of eight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from soft_tendon_env.accuracy.candidates import ANGULAR, bare_rod
from soft_tendon_env.accuracy.choice import SPARE_INTERVALS
from soft_tendon_env.accuracy.input_motions import Motion, motion_tensions, slack_tensions
from soft_tendon_env.accuracy.reference import distance, start_at_rest, tip_path
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.reference_model import MOST_HALVINGS, part_borders
from soft_tendon_env.scene.scene import Scene, breakpoints, rod_length
from soft_tendon_env.tools.types import Array

DRAWS = 8
"""Draws of a kind of motion, of which a trial takes the hardest."""

COARSE = 2
"""Order of the moments of soft strains of a model that errs."""

RICH = 4
"""Order of the moments of all strains of a model that errs less."""

STEPS = 5e-4
"""Tolerance of the time steps of both, as a share of the rod's length: those of "fast"."""


class HardestMotions:
    """Draws of the usual motions of an arm, and two models of it that tell which is hardest."""

    def __init__(self, scene: Scene) -> None:
        """scene: whose loads the motions have.

        Raises ConfigurationError.
        """
        self.scene = scene
        free = scene.strain.free
        angular = [strain for strain in ANGULAR if strain in free]
        self._coarse = _with_moments(scene, angular or free, COARSE)
        self._rich = _with_moments(scene, free, RICH)
        self._coarse_start = start_at_rest(self._coarse)
        self._rich_start = start_at_rest(self._rich)

    @property
    def slack(self) -> Array:
        """Command (n_a,) of slack tendons, at which motions begin."""
        tensions = slack_tensions(self.scene)
        return self._commands(tensions[None])[0]

    def hardest(self, kind: Motion, seed: int, duration: float) -> Array:
        """Commands (rows, n_a) of the hardest of DRAWS motions of a kind.

        seed: of the first one, which it is where no model moves.
        """
        draws = []
        for other in range(DRAWS):
            tensions = motion_tensions(self.scene, kind, seed + other, duration)
            draws.append(self._commands(tensions))
        hardness = [self._hardness(commands) for commands in draws]
        return draws[int(np.argmax(hardness))]

    def _commands(self, tensions: Array) -> Array:
        """Commands (rows, n_a) of tensions (rows, n_a) [N], see `pulling_commands`."""
        shape = np.zeros(self._coarse.coordinate_count)
        if self._coarse_start is not None:
            shape = self._coarse_start.q
        return pulling_commands(self._coarse, tensions, shape)

    def _hardness(self, commands: Array) -> float:
        """Distance [m] of both models' tips in a motion; -1 where the richer one has none."""
        if self._coarse_start is None or self._rich_start is None:
            return -1.0
        rich_path = tip_path(self._rich, commands, self._rich_start)
        if rich_path is None:
            return -1.0
        coarse_path = tip_path(self._coarse, commands, self._coarse_start)
        return distance(coarse_path, rich_path)


def pulling_commands(model: Model, tensions: Array, shape: Array) -> Array:
    """Commands (rows, n_a) that pull with tensions (rows, n_a) [N] at an arm held in a shape.

    They are displacements [m] of elastic tendons within `displacement_limits`, whose tensions fall
    as the arm gives way, and the tensions themselves of others. shape: coordinates (n,).
    """
    if not model.arm.effects.transmission.elastic:
        return tensions
    pulls = np.array([model.command(row, shape) for row in tensions])
    limits = model.scene.effects.command_limits(model.discretisation.tension_limits)
    least, greatest = limits.T
    return np.clip(pulls, least, greatest)


def _with_moments(scene: Scene, strains: Sequence[str], order: int) -> Model:
    """Model with Legendre moments of some strains over the rod."""
    moments = {"strains": [*strains], "order": order, "span": "rod"}
    passive = {"passive": [moments]}
    strain = bare_rod(scene) | passive
    steps = STEPS * rod_length(scene)
    integrator = {"tolerance": steps, "max_halvings": MOST_HALVINGS}
    changed = scene.replace({"strain": strain, "integrator": integrator})

    # as many intervals of each part that turns once as its polynomials need
    pieces = breakpoints(scene).size - 1
    parts = pieces + len(part_borders(scene))
    turns = parts / pieces
    per_turn = RICH + SPARE_INTERVALS
    intervals = math.ceil(turns * per_turn)
    return model_on(changed, intervals)
