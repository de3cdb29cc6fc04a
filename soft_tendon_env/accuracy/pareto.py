"""Accuracy against computing time: errors of settings against full physics, and the Pareto front of them."""

import contextlib
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from soft_tendon_env.accuracy.reference import Reference, distance, trajectory
from soft_tendon_env.accuracy.settings import QUADRATURE_TOLERANCE, TOLERANCES, Setting, evaluation_cost, quadratures, strain_fields
from soft_tendon_env.accuracy.test_inputs import HOLD
from soft_tendon_env.model.model import Model, model_on
from soft_tendon_env.model.quadrature import quadrature_estimate
from soft_tendon_env.scene.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.parallel import processors, run_all
from soft_tendon_env.tools.types import Array

QUADRATURES = 3  # numbers of intervals that every strain field is tried with


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
