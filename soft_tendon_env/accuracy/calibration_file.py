"""Files of calibrations in the user's cache: what names them, how they are read and written, and that one process at a time makes one."""

import functools
import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from filelock import FileLock

from soft_tendon_env.accuracy.pareto import Point
from soft_tendon_env.accuracy.reference import Level, Reference
from soft_tendon_env.accuracy.settings import Setting, strain_fields
from soft_tendon_env.compiler.cache_folder import PACKAGE, data_folders
from soft_tendon_env.compiler.code_digest import code_digest, file_digest
from soft_tendon_env.scene.artifacts.artifact import arm_of
from soft_tendon_env.scene.artifacts.passive_fields import PassiveFields
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.files import parse_json, read_arrays, replacing
from soft_tendon_env.tools.messages import say_unless_quiet
from soft_tendon_env.tools.types import Array

SIMULATED_BY = ("evaluation_cost.toml", "pareto.py", "reference.py", "settings.py", "test_inputs.py")
SOURCES = ("mechanics/**/*.py", "effects/**/*.py", "scene/**/*.py", "model/*.py", *(f"accuracy/{name}" for name in SIMULATED_BY))
"""The files of the package that the points of a calibration depend on; which of them is chosen is not kept."""


def calibration_digest(scene: Scene, inputs: Sequence[Array], fields: PassiveFields | None, error: float) -> str:
    """16 hex digits of all that a calibration depends on: arm, limits, loads, candidates, motions, and the code that simulates them."""
    limits = [tendon.tension_limits for tendon in scene.tendons]
    loads = {name: (effect.model_dump(mode="json"), code_digest(type(effect))) for name, effect in scene.effects.chosen().items()}
    made_of = [arm_of(scene), limits, loads, strain_fields(scene, fields), scene.integrator.max_halvings, error, _sources()]
    digest = hashlib.sha256(json.dumps(made_of, sort_keys=True).encode())
    for tensions in inputs:
        digest.update(repr(tensions.shape).encode() + np.ascontiguousarray(tensions).tobytes())
    return digest.hexdigest()[:16]


@functools.cache
def _sources() -> str:
    files = sorted(file for pattern in SOURCES for file in PACKAGE.glob(pattern))
    return hashlib.sha256("".join(f"{file.relative_to(PACKAGE)} {file_digest(file)}\n" for file in files).encode()).hexdigest()


def kept_calibration(name: str) -> tuple[tuple[Point, ...], Reference] | None:
    """Points and reference motions in a file of the cache; None where there is none, or a damaged one."""
    for folder in data_folders("calibrations"):
        try:
            return _read(folder / name)
        except FileNotFoundError:
            continue
        except (OSError, ValueError, KeyError, TypeError) as error:
            say_unless_quiet(f"{folder / name} is damaged, and made anew: {error}")
    return None


def _read(path: Path) -> tuple[tuple[Point, ...], Reference]:
    arrays = read_arrays(path, ("table", "backbones"), "calibration")
    table = parse_json(str(arrays["table"]))
    points = tuple(_point(own) for own in table["points"])
    present = [None if np.isnan(motion).all() else motion for motion in arrays["backbones"]]
    errors = tuple(table["tip_errors"]), tuple(table["backbone_errors"])
    return points, Reference(tuple(present), *errors, Level(**table["level"]))


def _point(table: dict[str, Any]) -> Point:
    errors = {key: tuple(table[key]) for key in ("tip_errors", "backbone_errors")}
    return Point(**{**table, **errors, "setting": Setting(**table["setting"])})


def save_calibration(points: Sequence[Point], reference: Reference, path: Path) -> None:
    """The file appears whole or not at all. Raises OSError."""
    shape = next(motion.shape for motion in reference.backbones if motion is not None)
    backbones = np.array([np.full(shape, np.nan) if motion is None else motion for motion in reference.backbones])
    table = {
        "points": [{**point._asdict(), "setting": point.setting._asdict()} for point in points],
        "tip_errors": reference.tip_errors,
        "backbone_errors": reference.backbone_errors,
        "level": reference.level._asdict(),
    }
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, table=json.dumps(table), backbones=backbones)


Made = TypeVar("Made")


def found_or_made(find: Callable[[], Made | None], path: Path, make: Callable[[], Made]) -> Made:
    """Result of `find`, or of `make`, which saves it at `path`, where there is none: one process at a time makes, the others find."""
    if (found := find()) is not None:
        return found
    with FileLock(path.with_suffix(".lock")):
        return make() if (found := find()) is None else found
