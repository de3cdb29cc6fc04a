"""Calibration of a scene: the cheapest setting that keeps its tip within a tolerance of full physics, chosen once and kept in the cache.

The choice is deterministic: errors are those of fixed motions, and costs those of a cost model, never measured times.
"""

import hashlib
import inspect
import json
import sys
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from filelock import FileLock

from soft_tendon_env.accuracy.pareto import Point, explore, pareto_front, worst
from soft_tendon_env.accuracy.proper_orthogonal_fields import fields_path, make_passive_fields
from soft_tendon_env.accuracy.reference import Level, Reference, reference_motions
from soft_tendon_env.accuracy.settings import Setting, strain_fields
from soft_tendon_env.accuracy.test_inputs import CALIBRATED, Motion, motion_tensions
from soft_tendon_env.scene.passive_fields import PassiveFields, arm_of, find_fields
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.checks import checked_number, checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import read_json, replacing, sources_digest
from soft_tendon_env.tools.messages import say_unless_quiet
from soft_tendon_env.tools.types import Array, length_text
from soft_tendon_env.tools.user_cache import data_folders, new_data_folder

FIRST_SEED, FEWEST, RUNS = 500, 3, {"noisy": 6, "pulses": 4}
"""Seeds of the motions that a scene is calibrated on begin with it; how many of a kind, and of those that are more uneven."""
MARGIN = 2.0
"""Factor by which the error on those motions must stay below what is asked for: the largest of few is no bound of others. What was within
on other motions: docs/appendix/accuracy_command.md."""
REFERENCE = 1e-4  # of the rod's length, error of the reference motions
PART, FINER, FINEST = 8.0, 4.0, 3  # that is this part of the tolerance, or smaller in steps of this factor, so many at most
SHORTEST = 1e-12  # [m]
SIMULATED_BY = ("evaluation_cost.toml", "pareto.py", "reference.py", "settings.py", "test_inputs.py")
SOURCES = ("mechanics/**/*.py", "effects/**/*.py", "scene/**/*.py", "model/*.py", *(f"accuracy/{name}" for name in SIMULATED_BY))
"""The files of the package that the points of a calibration depend on; which of them is chosen is not kept."""


class Calibration(NamedTuple):
    """Settings of a scene with their errors on some motions, and the reference motions that these are measured from."""

    points: tuple[Point, ...]
    reference: Reference

    @property
    def front(self) -> list[Point]:
        """The Pareto front of cost and largest tip error, cheapest first."""
        return pareto_front(self.points, lambda point: (point.cost, point.tip_error))

    def within(self, point: Point) -> float:
        """Tolerance [m] that a setting is good for: MARGIN times its largest error, the reference's own added."""
        uncertain = [bar if np.isfinite(bar) else 0.0 for bar in self.reference.tip_errors]
        return MARGIN * worst(np.add(point.tip_errors, uncertain))

    def cheapest(self, tolerance: float) -> Point | None:
        """The cheapest setting for a tolerance [m]."""
        good = [point for point in self.points if self.within(point) <= tolerance]
        return min(good, key=lambda point: (point.cost, point.tip_error), default=None)


def calibrated(scene: Scene, tolerance: float) -> Scene:
    """The scene with the cheapest strain field, quadrature and integrator that keep its tip within a tolerance [m] of full physics.

    It holds for motions from rest of the CALIBRATED kinds under the scene's loads, and is taken from a calibration that is made on first
    use, which takes a minute or two, and then kept in the user's cache, with the arm's own passive fields if there are none yet.

    Raises TypeError, ValueError, ConfigurationError where no setting reaches the tolerance or the arm may meet obstacles, OSError where
    there is no cache folder.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    tolerance = checked_number("tolerance", tolerance, SHORTEST, "a positive length in metres")
    refuse_obstacles(scene)
    check_tolerance(scene, tolerance)
    calibration = calibrate(scene, usual_inputs(scene), made_fields(scene), tolerance)
    return recommended(scene, calibration, tolerance).setting.of(scene)


def refuse_obstacles(scene: Scene) -> None:
    """Raises ConfigurationError that names obstacles: where an arm touches is not smooth, and reference motions hardly converge."""
    for name, effect in scene.effects.chosen().items():
        if effect.is_contact:
            text = "cannot be calibrated: no error on some motions holds for others where the arm touches something; take a preset"
            raise ConfigurationError([Problem(("effects", name), f"{text}, or calibrate the arm without this table")])


def check_tolerance(scene: Scene, tolerance: float) -> None:
    """Raises ConfigurationError where a tolerance [m] is below the error of the finest reference motions: a calibration could not tell."""
    if tolerance < (least := _finest_reference(scene)):
        what = f"{length_text(tolerance)} cannot be told from full physics, whose own error is {length_text(least)} at its finest"
        raise ConfigurationError([Problem((), f"{what}: the tolerance should be at least that")])


def recommended(scene: Scene, calibration: Calibration, tolerance: float) -> Point:
    """The cheapest setting for a tolerance [m]. Raises ConfigurationError that says the best there is."""
    found = calibration.cheapest(tolerance)
    if found is None:
        best = min(map(calibration.within, calibration.points), default=np.inf)
        most = f"the best there is keeps within {length_text(best)}" if np.isfinite(best) else "none has these motions"
        text = f"no setting keeps the tip of {scene.name!r} within {length_text(tolerance)} of full physics: {most}"
        raise ConfigurationError([Problem((), text)])
    return found


def usual_inputs(scene: Scene, motions: Sequence[Motion] = CALIBRATED, seeds: Sequence[int] | None = None) -> list[Array]:
    """Tensions [N] of the motions that a scene is calibrated on; seeds: of each kind, by default as many as RUNS says."""
    own = {motion: range(FIRST_SEED, FIRST_SEED + RUNS.get(motion, FEWEST)) if seeds is None else seeds for motion in motions}
    return [motion_tensions(scene, motion, seed) for motion in motions for seed in own[motion]]


def own_fields(scene: Scene) -> PassiveFields | None:
    """The passive fields that were made for this arm, its limits and loads, if there are any."""
    fields = find_fields(scene)
    return fields if fields is not None and not fields.misfit(scene) else None


def made_fields(scene: Scene) -> PassiveFields:
    """The arm's own passive fields, made and kept in the user's cache where there are none. Raises ConfigurationError, OSError."""

    def make() -> PassiveFields:
        say_unless_quiet(f"the passive strain fields of {scene.name!r} are made from simulated motions, once: {path}")
        (fields := make_passive_fields(scene)).save(path)
        return fields

    path = fields_path(scene)
    return found_or_made(lambda: own_fields(scene), path, make)


def calibrate(scene: Scene, inputs: Sequence[Array], fields: PassiveFields | None, tolerance: float | None = None) -> Calibration:
    """The calibration of a scene on inputs (rows, n_a) [N], from the cache, or made and kept there.

    fields: the arm's own. tolerance: [m] for which it is to serve, since the reference is to be finer; by default a share of the length.
    Raises ConfigurationError where full physics has none of the motions, OSError.
    """
    refuse_obstacles(scene)
    scene = scene.replace({"effects": scene.effects.on_arm()})  # inputs are tensions
    error = reference_error(scene, tolerance)
    path = new_data_folder("calibrations") / f"{calibration_digest(scene, inputs, fields, error)}.json"

    def make() -> Calibration:
        say_unless_quiet(f"{scene.name!r} is calibrated against full physics, once: {path}")
        reference = reference_motions(scene, inputs, error)
        if all(backbone is None for backbone in reference.backbones):
            text = f"full physics of {scene.name!r} has none of the motions: its strain diverges under these tensions and loads"
            raise ConfigurationError([Problem((), text)])
        found = Calibration(tuple(explore(scene, inputs, reference, fields)), reference)
        with replacing(path) as temporary:
            table = {"points": found.points, "reference": reference}
            temporary.write_text(json.dumps(table, default=np.ndarray.tolist))
        return found

    return found_or_made(lambda: kept_calibration(path.name), path, make)


def reference_error(scene: Scene, tolerance: float | None) -> float:
    """Error [m] that reference motions are refined to."""
    error = REFERENCE * rod_length(scene)
    while tolerance is not None and error > tolerance / PART and error > _finest_reference(scene):
        error /= FINER
    return error


def _finest_reference(scene: Scene) -> float:
    return REFERENCE * rod_length(scene) / FINER**FINEST


def calibration_digest(scene: Scene, inputs: Sequence[Array], fields: PassiveFields | None, error: float) -> str:
    """16 hex digits of all that a calibration depends on: arm, limits, loads, candidates, motions, and the code that simulates them."""
    limits = [tendon.tension_limits for tendon in scene.tendons]
    loads = {name: (effect.model_dump(mode="json"), _source_of(type(effect))) for name, effect in scene.effects.chosen().items()}
    made_of = [arm_of(scene), limits, loads, strain_fields(scene, fields), scene.integrator.max_halvings, error, sources_digest(*SOURCES)]
    digest = hashlib.sha256(json.dumps(made_of, sort_keys=True).encode())
    for tensions in inputs:
        digest.update(repr(tensions.shape).encode() + np.ascontiguousarray(tensions).tobytes())
    return digest.hexdigest()[:16]


def _source_of(effect: type) -> str:
    """The source of the module of an effect; of one that is typed into an interpreter, something new."""
    try:
        return inspect.getsource(sys.modules[effect.__module__])
    except (OSError, TypeError):
        return uuid.uuid4().hex


def kept_calibration(name: str) -> Calibration | None:
    """The calibration in a file of the cache; None where there is none, or a damaged one."""
    for folder in data_folders("calibrations"):
        try:
            table = read_json(folder / name)
            backbones, tips, along, level = table["reference"]
            present = tuple(None if own is None else np.array(own) for own in backbones)
            points = tuple(Point(Setting(*own), n, tuple(tip), tuple(rest), *cost) for own, n, tip, rest, *cost in table["points"])
            return Calibration(points, Reference(present, tuple(tips), tuple(along), Level(*level)))
        except FileNotFoundError:
            continue
        except (OSError, ValueError, KeyError, TypeError) as error:
            say_unless_quiet(f"{folder / name} is damaged, and made anew: {error}")
    return None


Made = TypeVar("Made")


def found_or_made(find: Callable[[], Made | None], path: Path, make: Callable[[], Made]) -> Made:
    """Result of `find`, or of `make`, which saves it at `path`, where there is none: one process at a time makes, the others find."""
    if (found := find()) is not None:
        return found
    with FileLock(path.with_suffix(".lock")):
        return make() if (found := find()) is None else found
