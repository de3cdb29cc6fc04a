"""Quadrature and time steps of a trial, so fine that finer ones hardly move the tip.

They are intervals and a tolerance.
"""

from __future__ import annotations

import math

import numpy as np

from soft_tendon_env.accuracy.candidates import ANGULAR, bare_rod
from soft_tendon_env.accuracy.choice import Accuracy, Choice
from soft_tendon_env.accuracy.trial import Trial
from soft_tendon_env.model.coordinates import coordinate_count
from soft_tendon_env.model.reference_model import part_borders
from soft_tendon_env.scene.scene import MOST_INTERVALS, breakpoints, rod_length

FEW = 3
"""Order of the moments that time steps are settled with."""

RICH = 5
"""Order of the explicit strain that the quadrature is settled with, on a rod of one piece."""

DENSER = 2.0
"""Factor of the intervals that a quadrature is compared with."""

MORE_INTERVALS = 1.3
"""Factor of its intervals where these change the tip."""

FINER_STEPS = 10.0
"""Factor of the time steps' tolerance that steps are compared with: its inverse."""

TIGHTER = 5.0
"""Factor by which the tolerance is reduced where these change the tip."""

MOST_HALVINGS = 16
"""Halvings of the longest step that a choice allows: ten, as a scene has them, end the motion of a
lightly damped arm whose tolerance was reduced."""

MOST_TIGHTENED = 5
"""How often it is, at most."""


def settle(trial: Trial, asked: Accuracy) -> Choice:
    """Choice with few moments, with settled intervals and time steps.

    They are so fine that finer ones hardly move the tip.
    """
    scene = trial.scene
    free = list(scene.strain.free)
    choice = settled_quadrature(trial, asked)

    angular = [strain for strain in ANGULAR if strain in free]
    moments = {"strains": angular or free, "order": FEW, "span": "rod"}
    choice = choice.with_strain(scene, bare_rod(scene) | {"passive": [moments]})
    choice = settled_steps(trial, choice)
    count = coordinate_count(choice.applied_to(scene))
    return choice._replace(coordinates=count)


def settled_steps(trial: Trial, choice: Choice) -> Choice:
    """The choice with time steps so fine that finer ones hardly move the tip."""
    for _ in range(MOST_TIGHTENED):
        finer = choice.with_finer_steps(FINER_STEPS)
        if trial.agree_in_motion(choice, finer):
            break
        choice = choice.with_finer_steps(TIGHTER)
    return choice


def settled_quadrature(trial: Trial, asked: Accuracy) -> Choice:
    """Choice of explicit strain with settled intervals, per piece of the bare rod.

    They are so many that more hardly move the tip.
    """
    scene = trial.scene
    pieces = breakpoints(scene).size - 1
    doublings = 2 * int(math.log2(pieces))
    order = max(1, RICH - doublings)  # less on many pieces
    strains = list(scene.strain.free)
    modes = {"strains": strains, "order": order, "span": "piece"}
    rich = {
        "type": "explicit",
        "modes": [modes],
        "borders": [*scene.strain.borders, *part_borders(scene)],
    }
    quadrature = {"tolerance": asked.quadrature, "least": RICH - 1}
    tolerance = asked.tolerance * rod_length(scene)
    integrator = {"tolerance": tolerance, "max_halvings": MOST_HALVINGS}
    choice = Choice(rich, quadrature, integrator, 0, np.inf)

    # intervals of a part, while the rod is in parts
    borders = breakpoints(choice.applied_to(scene))
    cut = borders.size - 1
    parts = cut / pieces  # of each piece
    fewest = math.ceil(asked.least / parts)
    choice.quadrature["least"] = max(fewest, RICH - 1)
    while choice.quadrature["least"] < MOST_INTERVALS:
        denser = choice.with_intervals(DENSER)
        if trial.agree_at_rest(choice, denser):
            break
        choice = choice.with_intervals(MORE_INTERVALS)

    # as many of a piece of the bare rod
    in_piece = parts * choice.quadrature["least"]
    choice.quadrature["least"] = math.ceil(in_piece)
    return choice
