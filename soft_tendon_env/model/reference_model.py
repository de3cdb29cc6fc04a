"""Reference model of a rod: an explicit Legendre basis of every strain that it has.

With it the error of an equilibrium of another model is found. The rod is cut into parts that turn
once at most: polynomials over several turns could all miss the same strain and agree.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.load_continuation import LoadPath
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import MOST_COLUMNS, Scene, breakpoints
from soft_tendon_env.tools.types import Array

INTERVALS = 5
"""Quadrature intervals along the rod, per order of the polynomials."""

SPARE_INTERVALS = 3
"""Quadrature intervals of a part, above the order of its polynomials."""

HIGHEST_ORDER = 12
"""Order of the polynomials at most: higher ones are round-off."""

WHOLE_TURN = 1e-3
"""Share of a turn by which a part may turn more than once."""

AGREED = 0.2
"""Part of the distance to a model by which it may still change from one level to the next."""

NEGLIGIBLE = 1e-9
"""Share of the rod's length below which an error is round-off."""


class Level(NamedTuple):
    """Refinement of the reference model."""

    order: int  # of the polynomials where the rod is one part; on many parts and pieces it is less
    cuts: int  # of every piece, besides those by its turns


LEVELS = (Level(6, 1), Level(8, 1), Level(10, 1), Level(12, 1), Level(12, 2), Level(13, 4))
"""Levels of refinement, the coarsest first."""

MOST_HALVINGS = 20
"""Halvings of the longest step. Ten, as a scene has them, end the motion of a lightly damped arm
whose errors should be that small."""

FIRST = 1
"""The first level that equilibria are judged by."""


def part_borders(scene: Scene, cuts: int = 1) -> list[float]:
    """Arc lengths that cut every piece of a rod into parts which turn once at most.

    Args:
        scene: whose rod and tendons turn.
        cuts: parts in place of each one.

    Returns:
        Arc lengths [m] of the cuts within the pieces.
    """
    rates = [math.hypot(*segment.curvature) for segment in scene.segments]
    for tendon in scene.tendons:
        rates.append(tendon.routing.turn_rate())
    fastest = max(rates)
    cut_lengths = list[float]()
    for start, end in pairwise(breakpoints(scene)):
        length = end - start
        turns = length * fastest / (2.0 * math.pi)
        whole_turns = max(1, math.ceil(turns - WHOLE_TURN))
        count = cuts * whole_turns
        shares = np.arange(1, count) / count
        places = start + length * shares
        cut_lengths += places.tolist()
    return cut_lengths


def reference_model(scene: Scene, level: Level, tolerance: float | None = None) -> Model:
    """Model of a scene with an explicit basis of every strain that the rod has.

    With a tolerance its time steps have the most columns, damped or not. Undamped arms need a tenth
    of the error that two columns leave them. The growth of more columns on undamped oscillations
    is held by the tolerance.

    Args:
        scene: of the arm.
        level: one of LEVELS.
        tolerance: of its time steps [m]; None: the scene's.
    """
    cuts = part_borders(scene, level.cuts)
    pieces = breakpoints(scene).size - 1
    parts = pieces + len(cuts)
    # short pieces need lower orders than parts that turn once
    by_parts = math.log2(parts)
    by_pieces = 0.5 * math.log2(pieces)
    reduction = math.ceil(by_parts + by_pieces)
    reduced_order = min(level.order - reduction, HIGHEST_ORDER)
    least_order = LEVELS.index(level) + 1
    order = max(least_order, reduced_order)
    strains = list(scene.strain.free)
    modes = [{"strains": strains, "order": order, "span": "piece"}]
    borders = [*scene.strain.borders, *cuts]
    strain = {"type": "explicit", "modes": modes, "borders": borders}
    integrator: dict[str, float] = {}
    if tolerance is not None:
        integrator = {
            "tolerance": tolerance,
            "columns": MOST_COLUMNS,
            "max_halvings": MOST_HALVINGS,
        }
    changes = {"strain": strain, "integrator": integrator}
    per_part = INTERVALS * level.order / parts
    intervals = math.ceil(per_part)
    resolving = order + SPARE_INTERVALS
    finest = max(resolving, intervals)
    return model_on(scene.replace(changes), finest)


def nearest_strain(model: Model, q: Array, fine: Model) -> Array:
    """Coordinates of a reference model whose strain is nearest to that of a model.

    Args:
        model: any model of the arm.
        q: its coordinates (n,).
        fine: the reference model.

    Returns:
        Coordinates (m,) of the reference model, by least squares at its points.

    Raises:
        StrainLimitError: the model has no strain at q.
    """
    grid = fine.grid
    arc_lengths = grid.points[grid.real].ravel()
    strain, *_ = model.strain_at(q, arc_lengths)
    reference_strain = grid.unpacked(fine.arm.rod.reference_strain)
    change = strain - reference_strain
    # columns of an explicit basis are its fields, at all coordinates
    packed = make_workspace(fine.arm).strain.Phi
    rows = packed.reshape(fine.coordinate_count, -1)
    fields = grid.unpacked(rows)
    basis = fields.reshape(len(fields), -1).T
    coordinates, *_ = np.linalg.lstsq(basis, change.ravel())
    return np.asarray(coordinates)


def equilibrium_error(model: Model, q: Array, tension: Array, part: float, stable: bool) -> float:
    """Distance of the tip from the reference at an equilibrium.

    The reference is refined until the distance hardly changes. Where it does change to the end the
    last change is added.

    Args:
        model: whose equilibrium is judged.
        q: its coordinates (n,).
        tension: (n_a,) [N].
        part: of tensions and loads that act, 0 to 1.
        stable: whether the equilibrium is stable.

    Returns:
        Distance [m]; infinite where the reference has no equilibrium near, or no stable one beside
        a stable one.
    """
    tip = model.tip_pose(q)[:3, 3]
    # the finest model so far, from whose equilibrium the next level starts
    finest = model
    coordinates = q
    bound = np.inf
    last_tip: Array | None = None
    for level in LEVELS[FIRST:]:
        fine = reference_model(model.scene, level)
        try:
            guess = nearest_strain(finest, coordinates, fine)
            equilibrium = rest_near(fine, guess, tension, part, stable)
        except StrainLimitError:
            equilibrium = None
        if equilibrium is None:
            last_tip = None
            continue
        finest = fine
        coordinates = equilibrium
        reference_tip = fine.tip_pose(equilibrium)[:3, 3]
        error = float(np.linalg.norm(reference_tip - tip))
        change = np.inf
        if last_tip is not None:
            change = float(np.linalg.norm(reference_tip - last_tip))
        negligible = NEGLIGIBLE * model.length
        allowed = max(AGREED * error, negligible)
        if change <= allowed:
            return error
        bound = error + change
        last_tip = reference_tip
    return bound


def rest_near(
    model: Model, guess: Array, tension: Array, part: float, stable: bool
) -> Array | None:
    """Coordinates of the equilibrium that Newton's method finds from a guess.

    Args:
        model: of the arm.
        guess: coordinates (n,) to begin from.
        tension: (n_a,) [N].
        part: of tensions and loads that act, 0 to 1.
        stable: whether it should be stable; where none is, that of a slowly loaded arm is taken.

    Returns:
        Coordinates (n,), None where there is no equilibrium.
    """
    with model.workspace() as work:
        path = LoadPath(Balance(model, tension, work))
        equilibrium = path.equilibrium(guess, part)
        is_unstable = equilibrium is None or not equilibrium.stability.stable
        if part == 1.0 and stable and is_unstable:
            equilibrium, reason = path.rest()
            if reason:
                return None
    if equilibrium is None:
        return None
    return equilibrium.evaluation.q
