"""Accuracy against computing time: errors of settings against full physics, and the Pareto front of them.

The error of a setting is about that of strain field, quadrature and time integration together, so these are sought one after the other:
strain fields on a fine quadrature and converged in time, then quadratures, then integrators, each time for what nothing else beats.
"""

import contextlib
import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from soft_tendon_env.accuracy.reference import Reference, backbones, errors, trajectory
from soft_tendon_env.accuracy.settings import QUADRATURE_TOLERANCE, Setting, evaluation_cost, integrators, quadratures, strain_fields
from soft_tendon_env.accuracy.test_inputs import HOLD
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.quadrature import quadrature_estimate
from soft_tendon_env.model.simulation import Trajectory
from soft_tendon_env.scene.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

FINE_INTERVALS = 16  # at least, on which strain fields are compared
FINE_STEP, FINE_TOLERANCE = 0.01, 1e-6  # [s]; of the rod's length: converged in time
CONVERGED = 1.05  # factor of the error on the fine quadrature, at which more intervals are not tried
SLACK = 1.3  # factor by which an integrator may be worse than a cheaper one, since its error adds to others in any direction
REPEATS = 2  # of measured times


class Point(NamedTuple):
    """A setting, what it costs and how far its motions are from full physics.

    tip_errors, backbone_errors: largest distances [m] over each motion, inf where the model has no such motion, nan where full physics has
    none. cost: CPU seconds of a simulated second by the cost model.
    """

    setting: Setting
    coordinates: int
    tip_errors: tuple[float, ...]
    backbone_errors: tuple[float, ...]
    evaluations: float  # of a simulated second
    cost: float

    @property
    def tip_error(self) -> float:
        """Largest distance of the tip [m] over all motions."""
        return worst(self.tip_errors)

    @property
    def backbone_error(self) -> float:
        """Largest distance along the backbone [m] over all motions."""
        return worst(self.backbone_errors)


def worst(errors: Iterable[float]) -> float:
    """The largest error that is a number; inf where there is none."""
    return max((error for error in errors if not np.isnan(error)), default=np.inf)


Item = TypeVar("Item")
Result = TypeVar("Result")


def pareto_front(items: Iterable[Item], key: Callable[[Item], tuple[float, float]], slack: float = 1.0) -> list[Item]:
    """Items than which none is both cheaper and better, by `key` (cost, error), cheapest first; slack: see SLACK."""
    front: list[Item] = []
    best = np.inf
    for item in sorted(items, key=key):
        error = key(item)[1]
        if np.isfinite(error) and error < slack * best:
            front.append(item)
            best = min(best, error)
    return front


def measure(model: Model, setting: Setting, inputs: Sequence[Array], reference: Reference) -> Point:
    """Errors of a model, which has this setting, under inputs (rows, n_a) [N]."""
    found = [trajectory(model, tensions) for tensions in inputs]
    apart = [errors(model, None if motion is None else motion.q, own) for motion, own in zip(found, reference.backbones, strict=True)]
    tips, all_along = zip(*apart, strict=True)
    evaluations = evaluation_rate(found)
    return Point(setting, model.coordinate_count, tips, all_along, evaluations, evaluations * evaluation_cost(model))


def evaluation_rate(motions: Iterable[Trajectory | None]) -> float:
    """Evaluations of the equation of motion per simulated second; inf where there is no motion."""
    present = [motion for motion in motions if motion is not None]
    seconds = HOLD * sum(len(motion.time) - 1 for motion in present)
    return sum(motion.evaluations for motion in present) / seconds if present else np.inf


def cpu_time(model: Model, inputs: Sequence[Array]) -> float:
    """Measured CPU time [s] of a simulated second on one thread, preparations included: the least of REPEATS over all inputs."""
    times = []
    for _ in range(REPEATS):
        started = time.thread_time()
        for tensions in inputs:
            trajectory(model, tensions)
        times.append(time.thread_time() - started)
    return min(times) / (HOLD * sum(len(tensions) for tensions in inputs))


class _Field(NamedTuple):
    """A strain field on a quadrature, converged in time."""

    setting: Setting
    model: Model
    least: int  # intervals that it needs at rest
    error: float  # [m] of the tip


def explore(scene: Scene, inputs: Sequence[Array], reference: Reference, fields: PassiveFields | None) -> list[Point]:
    """Settings that may lie on the Pareto front, with what they cost and their errors under inputs (rows, n_a) [N].

    fields: the arm's own, if there are any.
    """
    search = _Search(scene, inputs, reference)
    found = search.side_by_side(search.fine_field, list(strain_fields(scene, fields).items()), "strain fields")
    on_grids = search.side_by_side(search.coarser, _best(field for field in found if field is not None), "quadratures")
    kept = _best(itertools.chain(*on_grids))
    chosen = search.integrators(kept[-1]) if kept else []
    settings = [field.setting.integrated(*integrator) for field in kept for integrator in chosen]
    return search.side_by_side(search.measured, settings, "integrators")


def _best(fields: Iterable[_Field]) -> list[_Field]:
    return pareto_front(fields, lambda field: (evaluation_cost(field.model), field.error))


class _Search(NamedTuple):
    """Stages of the search for one scene."""

    scene: Scene
    inputs: Sequence[Array]
    reference: Reference

    def side_by_side(self, call: Callable[[Item], Result], items: Sequence[Item], label: str) -> list[Result]:
        return run_all(call, items, processors(), label, unit="setting", threads=True)

    def measured(self, setting: Setting) -> Point:
        return measure(model_on(setting.of(self.scene), setting.intervals), setting, self.inputs, self.reference)

    def field(self, setting: Setting, least: int) -> _Field:
        model = model_on(setting.of(self.scene), setting.intervals)
        return _Field(setting, model, least, measure(model, setting, self.inputs, self.reference).tip_error)

    def fine_field(self, named: tuple[str, dict[str, Any]]) -> _Field | None:
        """A strain field on a fine quadrature; None where it has no independent coordinates or no quadrature suffices."""
        name, table = named
        coarsest = {"tolerance": QUADRATURE_TOLERANCE, "least": 2}
        with contextlib.suppress(ConfigurationError):
            needed = quadrature_estimate(self.scene.replace({"strain": table, "quadrature": coarsest}))
            if not needed.problem:
                intervals, tolerance = max(FINE_INTERVALS, 2 * needed.intervals), FINE_TOLERANCE * rod_length(self.scene)
                return self.field(Setting(name, table, intervals, FINE_STEP, None, tolerance), needed.intervals)
        return None

    def coarser(self, field: _Field) -> list[_Field]:
        """The field on every quadrature from the coarsest that it needs to the first that is as good as the fine one."""
        found: list[_Field] = []
        for intervals in quadratures(self.scene, field.least):
            found.append(self.field(field.setting._replace(intervals=intervals), field.least))
            if found[-1].error <= CONVERGED * field.error or intervals >= field.setting.intervals:
                break
        return found

    def integrators(self, field: _Field) -> list[tuple[float, int | None, float | None]]:
        """Integrators on the Pareto front of evaluations and error to the same model's converged motion."""
        converged = [trajectory(field.model, tensions) for tensions in self.inputs]
        exact = tuple(None if motion is None else backbones(field.model, motion.q) for motion in converged)
        own, tried = self._replace(reference=self.reference._replace(backbones=exact)), list(integrators(self.scene))
        points = own.side_by_side(own.measured, [field.setting.integrated(*each) for each in tried], "time integration")
        front = pareto_front(zip(tried, points, strict=True), lambda pair: (pair[1].evaluations, pair[1].tip_error), SLACK)
        return [integrator for integrator, _ in front]
