"""Full physics of a rod: an explicit Legendre basis of every strain that it has, and what an
equilibrium of another model is off by.

The rod is cut into parts that turn once at most, since polynomials over several turns could all
miss the same strain and agree.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.load_continuation import LoadPath
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import Scene, breakpoints
from soft_tendon_env.tools.types import Array

INTERVALS, SPARE = 5, 3  # of quadrature: along the rod per order, and per part above the order
AGREED = (
    0.2  # part of the distance to a model by which that may still change from one level to the next
)
NEGLIGIBLE = 1e-9  # share of the length below which an error is round-off


class Level(NamedTuple):
    """How fine full physics is."""

    order: int  # of the polynomials where the rod is one part; on many parts and pieces it is less
    cuts: int  # of every piece, besides those by its turns


LEVELS = (Level(6, 1), Level(8, 1), Level(10, 1), Level(12, 1), Level(12, 2), Level(13, 4))
FIRST = 1  # the first level that equilibria are judged by


def part_borders(scene: Scene, cuts: int = 1) -> list[float]:
    """Arc lengths [m] that cut every piece of a rod into parts which turn once at most, rod and
    tendons, or into `cuts` times as many."""
    rates = [math.hypot(*segment.curvature) for segment in scene.segments]
    rates += [abs(getattr(tendon.routing, "angular_rate", 0.0)) for tendon in scene.tendons]
    borders, found = breakpoints(scene), list[float]()
    for a, b in zip(borders[:-1], borders[1:], strict=True):
        count = cuts * max(1, math.ceil((b - a) * max(rates) / (2.0 * math.pi) - 1e-3))
        found += (a + (b - a) * np.arange(1, count) / count).tolist()
    return found


def full_physics(scene: Scene, level: Level, tolerance: float | None = None) -> Model:
    """Model of a scene with an explicit basis of every strain that the rod has; tolerance: of its
    time steps [m]."""
    added = part_borders(scene, level.cuts)
    pieces = breakpoints(scene).size - 1
    parts = pieces + len(added)
    coarser = math.ceil(
        math.log2(parts) + 0.5 * math.log2(pieces)
    )  # short pieces need lower orders than parts that turn once
    order = max(LEVELS.index(level) + 1, min(level.order - coarser, 12))
    modes = [{"strains": list(scene.strain.free), "order": order, "span": "piece"}]
    strain = {"type": "explicit", "modes": modes, "borders": [*scene.strain.borders, *added]}
    changes = {"strain": strain, "integrator": {"tolerance": tolerance}}
    return model_on(
        scene.replace(changes), max(order + SPARE, math.ceil(INTERVALS * level.order / parts))
    )


def nearest_strain(model: Model, q: Array, fine: Model) -> Array:
    """Coordinates of full physics (m,) whose strain is nearest to that of a model at q (n,). Raises
    StrainLimitError."""
    places = fine.grid.points[fine.grid.real].ravel()
    wanted = model.strain_at(q, places)[0] - fine.grid.unpacked(fine.arm.rod.reference_strain)
    fields = fine.grid.unpacked(
        make_workspace(fine.arm).strain.Phi.reshape(fine.coordinate_count, -1)
    )
    return np.asarray(np.linalg.lstsq(fields.reshape(len(fields), -1).T, wanted.ravel())[0])


def equilibrium_error(model: Model, q: Array, tension: Array, part: float, stable: bool) -> float:
    """Distance [m] of the tip from full physics at an equilibrium q (n,) under a part of tensions
    (n_a,) and loads, 0 to 1.

    Full physics is refined until the distance hardly changes. Where it does change to the end the
    last change is added; infinite where full physics has no equilibrium near, or no stable one
    beside a stable one.
    """
    tip, here, found = model.tip_pose(q)[:3, 3], (model, q), np.inf
    last: Array | None = None
    for level in LEVELS[FIRST:]:
        fine = full_physics(model.scene, level)
        try:
            answer = rest_near(fine, nearest_strain(*here, fine), tension, part, stable)
        except StrainLimitError:
            answer = None
        if answer is None:
            last = None
            continue
        here, now = (fine, answer), fine.tip_pose(answer)[:3, 3]
        error = float(np.linalg.norm(now - tip))
        change = np.inf if last is None else float(np.linalg.norm(now - last))
        if change <= max(AGREED * error, NEGLIGIBLE * model.length):
            return error
        found, last = error + change, now
    return found


def rest_near(
    model: Model, guess: Array, tension: Array, part: float, stable: bool
) -> Array | None:
    """Coordinates (n,) of the equilibrium that Newton's method finds from a guess (n,); where it
    should be stable and none is, that of a slowly loaded arm."""
    with model.workspace() as work:
        path = LoadPath(Balance(model, tension, work))
        found = path.equilibrium(guess, part)
        if part == 1.0 and stable and (found is None or not found.stability.stable):
            found, reason = path.rest()
            found = None if reason else found
    return None if found is None else found.at.q
