"""Accuracy against computing time: settings of a simulation, their cost and errors against full physics, and their Pareto front."""

import contextlib
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from soft_tendon_env.accuracy.input_motions import HOLD
from soft_tendon_env.accuracy.reference import Reference, distance, trajectory
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.build import quadrature_estimate
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.scene.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import TIP_TOLERANCE, Scene, breakpoints, rod_length
from soft_tendon_env.scene.strain import STRAINS, ExplicitStrain
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

OWN_FIELDS, LEGENDRE_ORDERS = (3, 6, 9, 12, 18, 24), (2, 3)  # numbers of the arm's own passive fields, and orders of moments, tried
QUADRATURES = 3  # numbers of intervals that every strain field is tried with
TOLERANCES = (1e-3, 3e-4, 1e-4, 5e-5, 3e-5, 2e-5, 1e-5, 3e-6)  # of the integrator, as shares of the rod's length
PACKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # of quadrature intervals that are tried: what fills a pack costs no more than a part of it
QUADRATURE_TOLERANCE = 5.0 * TIP_TOLERANCE  # of the tip at rest, beyond which intervals are too few whatever motions say
FIXED, PER_PACK, PER_FIELD, SOLVE = 3.37e-6, 4.87e-7, 9.81e-8, 4.51e-9
"""Cost model [s], as `python benchmarks/evaluation_cost.py` fits it to measured times on an AMD EPYC."""


def evaluation_cost(model: Model) -> float:
    """CPU time [s] of one evaluation by the cost model, FIXED + packs (PER_PACK + PER_FIELD n) + SOLVE n^2, alike in every process."""
    n = model.coordinate_count
    return FIXED + model.grid.packs * (PER_PACK + PER_FIELD * n) + SOLVE * n**2


class Setting(NamedTuple):
    """Strain field, quadrature and integrator that a scene is simulated with."""

    name: str  # of the strain field
    strain: dict[str, Any]  # the scene's table
    intervals: int  # of quadrature, per piece
    tolerance: float  # [m] of the integrator

    def of(self, scene: Scene) -> Scene:
        """The scene with this setting."""
        quadrature = {"intervals": self.intervals, "tolerance": QUADRATURE_TOLERANCE}
        integrator = {"tolerance": self.tolerance, "max_halvings": scene.integrator.max_halvings}
        return scene.replace({"strain": self.strain, "quadrature": quadrature, "integrator": integrator})


def strain_fields(scene: Scene, fields: PassiveFields | None) -> dict[str, dict[str, Any]]:
    """Tables of the strain fields that are tried, by name; fields: the arm's own, where there are any."""
    free = list(scene.strain.free)
    kept: dict[str, Any] = {"type": "statics_based", "strains": free, "borders": list(scene.strain.borders)}
    if not isinstance(scene.strain, ExplicitStrain):
        kept |= scene.strain.model_dump(include={"passive_coordinates", "rank_tolerance", "include_loads"})
    passive: dict[str, Any] = {"tendons alone": []}
    if fields is not None:
        counts = [count for count in OWN_FIELDS if count <= len(fields.coefficients)]
        passive |= {f"own {count}": {"type": "snapshots", "fields": count, "digest": fields.digest} for count in counts}
    angular = [strain for strain in STRAINS[:3] if strain in free] or free
    passive |= {f"Legendre {order}": [{"strains": angular, "order": order, "span": "rod"}] for order in LEGENDRE_ORDERS}
    return {name: {**kept, "passive": table} for name, table in passive.items()}


def quadratures(scene: Scene, least: int) -> list[int]:
    """Intervals per piece that are tried, at least `least`: the most that each number of packs holds."""
    pieces = len(breakpoints(scene)) - 1
    counts = {max(1, packs * LANES // pieces) for packs in (*PACKS, -(-least * pieces // LANES))}
    return sorted(count for count in counts if count >= least)


class Point(NamedTuple):
    """A setting, what it costs and how far its motions are from full physics."""

    setting: Setting
    coordinates: int
    tip_errors: tuple[float, ...]  # [m] largest over each motion, inf where the model has no such motion, nan where full physics has none
    evaluations: float  # of a simulated second
    cost: float  # CPU seconds of a simulated second by the cost model

    @property
    def tip_error(self) -> float:
        """Largest distance of the tip [m] over all motions."""
        return worst(self.tip_errors)


def worst(errors: Iterable[float]) -> float:
    """The largest error that is a number; inf where there is none."""
    return max((error for error in errors if not np.isnan(error)), default=np.inf)


Item = TypeVar("Item")


def pareto_front(items: Iterable[Item], key: Callable[[Item], tuple[float, float]]) -> list[Item]:
    """Items than which none is both cheaper and better, by `key` (cost, error), cheapest first."""
    front: list[Item] = []
    for item in sorted(items, key=key):
        if key(item)[1] < (key(front[-1])[1] if front else np.inf):
            front.append(item)
    return front


def measure(model: Model, setting: Setting, inputs: Sequence[Array], reference: Reference) -> Point:
    """Errors of a model, which has this setting, under inputs (rows, n_a) [N]."""
    found = [trajectory(model, tensions) for tensions in inputs]
    errors = tuple(map(distance, found, reference.tips))
    present = [motion for motion in found if motion is not None]
    periods = sum(len(motion.time) - 1 for motion in present)
    evaluations = sum(motion.evaluations for motion in present) / (HOLD * periods) if present else np.inf
    return Point(setting, model.coordinate_count, errors, evaluations, evaluations * evaluation_cost(model))


def cpu_time(model: Model, inputs: Sequence[Array]) -> float:
    """Measured CPU time [s] of a simulated second on one thread, preparations included: the lesser of two over all inputs."""
    times = []
    for _ in range(2):
        started = time.thread_time()
        for tensions in inputs:
            trajectory(model, tensions)
        times.append(time.thread_time() - started)
    return min(times) / (HOLD * sum(len(tensions) for tensions in inputs))


def explore(scene: Scene, inputs: Sequence[Array], reference: Reference, fields: PassiveFields | None) -> list[Point]:
    """Settings that may lie on the Pareto front, with costs and errors under inputs (rows, n_a) [N]; fields: the arm's own, if any."""
    tolerances = [share * rod_length(scene) for share in TOLERANCES]

    def point_of(setting: Setting) -> Point:
        return measure(model_on(setting.of(scene), setting.intervals), setting, inputs, reference)

    def finest(named: tuple[str, dict[str, Any]]) -> list[Point]:
        name, table = named
        with contextlib.suppress(ConfigurationError):  # no independent coordinates
            needed = quadrature_estimate(scene.replace({"strain": table, "quadrature": {"tolerance": QUADRATURE_TOLERANCE, "least": 2}}))
            tried = [] if needed.problem else quadratures(scene, needed.intervals)[:QUADRATURES]
            return [point_of(Setting(name, table, intervals, tolerances[-1])) for intervals in tried]
        return []

    strains = run_all(finest, list(strain_fields(scene, fields).items()), processors(), "strain fields", unit="field", threads=True)
    front = pareto_front((point for points in strains for point in points), lambda point: (point.cost, point.tip_error))
    others = [point.setting._replace(tolerance=tolerance) for point in front for tolerance in tolerances[:-1]]
    return [*front, *run_all(point_of, others, processors(), "tolerances", unit="setting", threads=True)]
