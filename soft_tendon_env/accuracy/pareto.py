"""Accuracy against computing time: errors of settings against full physics, and the Pareto front of them.

The error of a setting is about that of its strain field and quadrature and that of its time integration together, so they are sought one
after the other: strain fields on a fine quadrature and converged in time, then quadratures, then integrators, each time only for what
nothing else beats in both cost and error.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from soft_tendon_env.accuracy.reference import Reference, backbones, distances, trajectories, trajectory
from soft_tendon_env.accuracy.settings import QUADRATURE_TOLERANCE, Setting, evaluation_cost, integrators, quadratures, strain_fields
from soft_tendon_env.accuracy.test_inputs import HOLD
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.quadrature import needed_intervals
from soft_tendon_env.model.simulation import Trajectory
from soft_tendon_env.scene.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import Array, Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError

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
        """Of the worst motion [m]."""
        return worst(self.tip_errors)

    @property
    def backbone_error(self) -> float:
        """Of the worst motion [m]."""
        return worst(self.backbone_errors)


def worst(errors: Iterable[float]) -> float:
    """The largest error that is a number; inf where there is none."""
    return max((error for error in errors if not np.isnan(error)), default=np.inf)


Item = TypeVar("Item")


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
    found = trajectories(model, inputs)
    errors = [_errors(model, motion, own) for motion, own in zip(found, reference.backbones, strict=True)]
    tips, all_along = zip(*errors, strict=True)
    evaluations = evaluation_rate(found)
    return Point(setting, model.coordinate_count, tips, all_along, evaluations, evaluations * evaluation_cost(model))


def _errors(model: Model, motion: Trajectory | None, reference: Array | None) -> tuple[float, float]:
    if reference is None:
        return np.nan, np.nan
    return (np.inf, np.inf) if motion is None else distances(backbones(model, motion.q), reference)


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

    @property
    def rank(self) -> tuple[float, float]:
        return evaluation_cost(self.model), self.error


def explore(
    scene: Scene,
    inputs: Sequence[Array],
    reference: Reference,
    fields: PassiveFields | None,
    progress: Callable[[float], None] | None = None,
) -> list[Point]:
    """Settings that may lie on the Pareto front, with what they cost and their errors under inputs (rows, n_a) [N].

    fields: the arm's own, if there are any. progress: called with the part that is done, now and then.
    """
    say = progress or (lambda part: None)
    found = []
    tables = strain_fields(scene, fields)
    for done, (name, table) in enumerate(tables.items()):
        if (field := _fine_field(scene, name, table, inputs, reference)) is not None:
            found.append(field)
        say(0.3 * (done + 1) / len(tables))
    on_grids = []
    kept = pareto_front(found, lambda field: field.rank)
    for done, field in enumerate(kept):
        on_grids += _coarser(scene, field, inputs, reference)
        say(0.3 + 0.3 * (done + 1) / len(kept))
    kept = pareto_front(on_grids, lambda field: field.rank)
    chosen = _integrators(scene, kept[-1], inputs) if kept else []
    points = []
    for done, field in enumerate(kept):
        for step, columns, tolerance in chosen:
            setting = field.setting._replace(step=step, columns=columns, tolerance=tolerance)
            points.append(measure(_model(scene, setting), setting, inputs, reference))
        say(0.6 + 0.4 * (done + 1) / len(kept))
    return points


def _model(scene: Scene, setting: Setting) -> Model:
    return model_on(setting.of(scene), setting.intervals)


def _fine(scene: Scene, name: str, table: dict[str, Any], intervals: int) -> Setting:
    return Setting(name, table, intervals, FINE_STEP, None, FINE_TOLERANCE * rod_length(scene))


def _fine_field(scene: Scene, name: str, table: dict[str, Any], inputs: Sequence[Array], reference: Reference) -> _Field | None:
    """A strain field on a fine quadrature; None where it has no independent coordinates or no quadrature suffices."""
    try:
        least = needed_intervals(scene.replace({"strain": table, "quadrature": {"tolerance": QUADRATURE_TOLERANCE, "least": 2}}))
        if least.problem:
            return None
        setting = _fine(scene, name, table, max(FINE_INTERVALS, 2 * least.intervals))
        model = _model(scene, setting)
    except ConfigurationError:
        return None
    return _Field(setting, model, least.intervals, measure(model, setting, inputs, reference).tip_error)


def _coarser(scene: Scene, field: _Field, inputs: Sequence[Array], reference: Reference) -> list[_Field]:
    """The field on every quadrature from the coarsest that it needs to the first that is as good as the fine one."""
    found = []
    for intervals in quadratures(scene, field.least):
        setting = field.setting._replace(intervals=intervals)
        model = _model(scene, setting)
        own = _Field(setting, model, field.least, measure(model, setting, inputs, reference).tip_error)
        found.append(own)
        if own.error <= CONVERGED * field.error or intervals >= field.setting.intervals:
            break
    return found


def _integrators(scene: Scene, field: _Field, inputs: Sequence[Array]) -> list[tuple[float, int | None, float | None]]:
    """Integrators on the Pareto front of evaluations and error to the same model's converged motion."""
    exact = [None if motion is None else backbones(field.model, motion.q) for motion in trajectories(field.model, inputs)]
    ranks = {}
    for step, columns, tolerance in integrators(scene):
        model = _model(scene, field.setting._replace(step=step, columns=columns, tolerance=tolerance))
        found = trajectories(model, inputs)
        error = worst(_errors(model, motion, own)[0] for motion, own in zip(found, exact, strict=True))
        ranks[step, columns, tolerance] = evaluation_rate(found), error
    return pareto_front(ranks, lambda which: ranks[which], SLACK)
