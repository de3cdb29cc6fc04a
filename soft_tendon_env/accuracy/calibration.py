"""Calibration of a scene: the cheapest setting that keeps its tip within a tolerance of full physics, chosen once and kept in the cache."""

import contextlib
import hashlib
import inspect
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from filelock import FileLock

from soft_tendon_env.accuracy.input_motions import CALIBRATED, motion_tensions
from soft_tendon_env.accuracy.pareto import Point, Setting, explore, pareto_front, worst
from soft_tendon_env.accuracy.proper_orthogonal_fields import fields_path, make_passive_fields
from soft_tendon_env.accuracy.reference import Level, Reference, reference_motions
from soft_tendon_env.scene.passive_fields import PassiveFields, find_fields
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.checks import checked_number, checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import digest, new_data_folder, read_json, replacing, sources_digest
from soft_tendon_env.tools.messages import say_once
from soft_tendon_env.tools.types import Array, length_text

SEEDS = range(500, 505)  # of the motions of each kind that a scene is calibrated on
MARGIN = 2.0  # by which the error on those motions stays below what is asked for, see docs/appendix/accuracy.md
REFERENCE = 3e-5  # of the rod's length, error of the reference motions
SOURCES = tuple(f"{folder}/**/*.py" for folder in ("mechanics", "effects", "scene", "model", "accuracy"))


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
        return MARGIN * worst(np.add(point.tip_errors, np.nan_to_num(self.reference.tip_errors, posinf=0.0)))


def calibrated(scene: Scene, tolerance: float) -> Scene:
    """The scene with the cheapest strain field, quadrature and integrator that keep its tip within a tolerance [m] of full physics.

    It holds for motions from rest of the CALIBRATED kinds under the scene's loads. The calibration is made on first use, in a minute or
    two, and kept in the user's cache, with the arm's own passive fields if there are none yet.

    Raises TypeError, ValueError, OSError, ConfigurationError where no setting reaches the tolerance or the arm may meet obstacles.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    tolerance = checked_number("tolerance", tolerance, 1e-12, "a positive length in metres")
    check_calibration(scene, tolerance)
    calibration = calibrate(scene, usual_inputs(scene), ensure_fields(scene))
    return cheapest_point(scene, calibration, tolerance).setting.of(scene)


def check_calibration(scene: Scene, tolerance: float = np.inf) -> None:
    """Raises ConfigurationError among obstacles, where reference motions hardly converge, and for a tolerance [m] below their error."""
    for name, effect in scene.effects.chosen().items():
        if effect.is_contact:
            text = "cannot be calibrated, where the arm touches something: take a preset, or leave this table out"
            raise ConfigurationError([Problem(("effects", name), text)])
    if tolerance < (least := REFERENCE * rod_length(scene)):
        text = f"{length_text(tolerance)} cannot be told from full physics: the tolerance should be at least {length_text(least)}"
        raise ConfigurationError([Problem((), text)])


def cheapest_point(scene: Scene, calibration: Calibration, tolerance: float) -> Point:
    """The cheapest setting for a tolerance [m]. Raises ConfigurationError that says the best there is."""
    good = [point for point in calibration.points if calibration.within(point) <= tolerance]
    if not good:
        best = min(map(calibration.within, calibration.points), default=np.inf)
        text = f"no setting keeps the tip of {scene.name!r} within {length_text(tolerance)} of full physics"
        raise ConfigurationError([Problem((), f"{text}: the best there is keeps within {length_text(best)}")])
    return min(good, key=lambda point: (point.cost, point.tip_error))


def usual_inputs(scene: Scene) -> list[Array]:
    """Tensions [N] of the motions that a scene is calibrated on."""
    return [motion_tensions(scene, motion, seed) for motion in CALIBRATED for seed in SEEDS]


def own_fields(scene: Scene) -> PassiveFields | None:
    """The passive fields that were made for this arm, its limits and loads, if there are any."""
    fields = find_fields(scene)
    return fields if fields is not None and not fields.misfit(scene) else None


def ensure_fields(scene: Scene) -> PassiveFields:
    """The arm's own passive fields, made and kept in the user's cache where there are none. Raises ConfigurationError, OSError."""
    path = fields_path(scene)
    with FileLock(path.with_suffix(".lock")):  # one process makes them, the others find them
        if (found := own_fields(scene)) is None:
            say_once(f"the passive strain fields of {scene.name!r} are made from simulated motions, once: {path}")
            (found := make_passive_fields(scene)).save(path)
        return found


def calibrate(scene: Scene, inputs: Sequence[Array], fields: PassiveFields | None) -> Calibration:
    """The calibration of a scene on inputs (rows, n_a) [N], from the cache or made now. Raises ConfigurationError, OSError."""
    scene = scene.replace({"effects": scene.effects.on_arm()})  # inputs are tensions
    path = new_data_folder("calibrations") / f"{calibration_digest(scene, inputs, fields)}.json"
    with FileLock(path.with_suffix(".lock")):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # none, or damaged
            return read_calibration(path)
        say_once(f"{scene.name!r} is calibrated against full physics, once: {path}")
        reference = reference_motions(scene, inputs, REFERENCE * rod_length(scene))
        if all(tips is None for tips in reference.tips):
            text = f"full physics of {scene.name!r} has none of the motions: its strain diverges under these tensions and loads"
            raise ConfigurationError([Problem((), text)])
        found = Calibration(tuple(explore(scene, inputs, reference, fields)), reference)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(found._asdict(), default=np.ndarray.tolist))
        return found


def calibration_digest(scene: Scene, inputs: Sequence[Array], fields: PassiveFields | None) -> str:
    """16 hex digits of all that a calibration depends on: arm, limits, loads, fields, motions, and the code that simulates them."""
    arm = scene.model_dump(mode="json", include={"segments", "tendons", "base", "effects"})
    kept = scene.strain.model_dump(mode="json", exclude={"passive", "modes"}), scene.integrator.max_halvings, scene.strain.free
    code = [sources_digest(*SOURCES), *(digest(Path(inspect.getfile(type(effect)))) for effect in scene.effects.chosen().values())]
    made_of = [arm, kept, fields and fields.digest, code, [table.tolist() for table in inputs]]
    return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:16]


def read_calibration(path: Path) -> Calibration:
    """The calibration in a file. Raises OSError, ValueError, KeyError, TypeError."""
    table = read_json(path)
    points = tuple(Point(Setting(*setting), count, tuple(errors), *cost) for setting, count, errors, *cost in table["points"])
    tips, errors, level = table["reference"]
    motions = tuple(None if motion is None else np.array(motion) for motion in tips)
    return Calibration(points, Reference(motions, tuple(errors), Level(*level)))
