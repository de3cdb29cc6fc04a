"""Passive fields from snapshots (proper orthogonal decomposition): their file, and which of those
there are fit a scene.

They are wrenches along the rod that its tendons cannot make, see
accuracy/proper_orthogonal_fields.py. For another material or load than a file says they stay a
basis, and lose accuracy: how much, a trial finds, see accuracy/trial.py.
"""

import functools
import hashlib
import json
import os
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.scene.file import SHIPPED
from soft_tendon_env.scene.scene import Scene, breakpoints, tendon_ends
from soft_tendon_env.scene.strain import SNAPSHOT_ORDER, STRAINS, ExplicitStrain, Snapshots
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import data_folders, read_json, replacing
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

MATERIAL, ALIKE = (
    ("young_modulus", "density", "damping"),
    1.25,
)  # of a segment, and the factor up to which it may differ from the fields'
ARRAYS, SUFFIX = ("tension_limits", "borders", "singular_values", "coefficients"), ".fields.json"


class FidelityWarning(UserWarning):
    """A model is less accurate than its fidelity says, or no fidelity was given."""


@dataclass(frozen=True, eq=False)
class PassiveFields:
    """Wrench fields along a rod, piecewise Legendre polynomials, the leading ones of a proper
    orthogonal decomposition."""

    arm: Mapping[str, Any]  # tables of segments and tendons that they were made for, see `arm_of`
    tension_limits: Array  # (n_a, 2) [N], within which tensions were drawn
    borders: Array  # (pieces + 1,) arc lengths [m] between the polynomials
    # (fields, pieces, 6, orders) moments [N m] and forces [N] of unit energy: int F^T Sigma^-1 F dX
    # = 1
    coefficients: Array
    # the loads, none or those up to whose size they were drawn, see Effects.sample_smaller
    effects: Effects
    singular_values: Array  # (fields,), as shares of the first
    errors: Mapping[
        str, tuple[float, ...]
    ]  # [m] largest of the tip, by kind of motion, for each of the numbers of fields in "fields"

    @cached_property
    def digest(self) -> str:
        """16 hex digits of the numbers that they are made of."""
        return hashlib.sha256(
            json.dumps([self.borders.tolist(), self.coefficients.tolist()]).encode()
        ).hexdigest()[:16]

    def needed(self, tolerance: float, motions: Iterable[str]) -> int | None:
        """The fewest fields whose errors on these motions are within the tolerance [m]; None: not
        even all are, or that is not known."""
        worst = np.max([self.errors.get(motion, ()) for motion in motions], axis=0)
        return next(
            (
                int(count)
                for count, error in zip(self.errors.get("fields", ()), worst, strict=True)
                if error <= tolerance
            ),
            None,
        )

    def at(self, points: Array, count: int | None = None) -> Array:
        """The leading fields, all by default, at arc lengths (...) [m]: (count, ..., 6)."""
        coefficients = self.coefficients[:count]
        values = np.zeros((len(coefficients), *points.shape, 6))
        for piece, (a, b) in enumerate(zip(self.borders[:-1], self.borders[1:], strict=True)):
            inside = (points > a) & (points < b)
            basis = (
                legendre.legvander(2 * (points - a) / (b - a) - 1, coefficients.shape[-1] - 1)
                * inside[..., None]
            )
            values += np.einsum("...o,fco->f...c", basis, coefficients[:, piece])
        return values

    def fits(self, scene: Scene) -> bool:
        """Whether they are of an arm of this geometry."""
        arms = self.arm, arm_of(scene)
        here, there = (
            {**arm, "segments": [{**part, **dict.fromkeys(MATERIAL)} for part in arm["segments"]]}
            for arm in arms
        )
        return here == there

    def misfit(self, scene: Scene) -> str:
        """Difference between the scene and that which they were made for, in words; empty where
        they fit."""
        for i, segment in enumerate(scene.segments):
            for name in MATERIAL:
                made_for, given = self.arm["segments"][i].get(name), getattr(segment, name)
                if given is not None and not made_for / ALIKE <= given <= made_for * ALIKE:
                    return f"{name} of {made_for:g} in segment {i}, not {given:g}"
        (low, high), limits = (
            self.tension_limits.T,
            np.array([tendon.tension_limits for tendon in scene.tendons]).T,
        )
        more = (ALIKE - 1.0) * (high - low)
        if (limits[0] < low - more).any() or (limits[1] > high + more).any():
            return (
                f"tensions of {low.min():g} to {high.max():g} N, not {limits.min():g} to"
                f" {limits.max():g} N"
            )
        if not self.effects.includes(scene.effects):
            made, wanted = (
                effects.model_dump(mode="json", exclude_none=True)
                for effects in (self.effects, scene.effects)
            )
            return f"{made or 'no loads'}, not {wanted}"
        return ""

    def save(self, path: Path) -> None:
        """Saves them as JSON. The file appears whole or not at all. Raises OSError."""
        arrays = {name: getattr(self, name).tolist() for name in ARRAYS}
        table = {
            "arm": self.arm,
            "effects": self.effects.model_dump(mode="json", exclude_none=True),
            "errors": self.errors,
            **arrays,
        }
        with replacing(path) as temporary:
            temporary.write_text(
                "{\n"
                + ",\n".join(
                    f"{json.dumps(key)}: {json.dumps(value)}" for key, value in table.items()
                )
                + "\n}\n"
            )


def read_fields(path: Path) -> PassiveFields:
    """Fields that `PassiveFields.save` wrote. Raises ValueError, FileNotFoundError."""
    table = read_json(path)
    try:
        arrays = {name: np.array(table[name], dtype=float) for name in ARRAYS}
        errors = {name: tuple(values) for name, values in table["errors"].items()}
        fields = PassiveFields(
            arm=table["arm"], effects=Effects(**table["effects"]), errors=errors, **arrays
        )
        shape = (fields.singular_values.size, fields.borders.size - 1, 6, SNAPSHOT_ORDER + 1)
        if fields.coefficients.shape != shape or not np.isfinite(fields.coefficients).all():
            raise ValueError(
                f"its coefficients should be finite and of shape {shape}, not"
                f" {fields.coefficients.shape}"
            )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{path} holds no passive fields that soft-tendon fields wrote: {type(error).__name__}"
            f" {error}"
        ) from error
    return fields


@functools.lru_cache(maxsize=256)
def _read_once(path: Path, _changed: int) -> PassiveFields:
    return read_fields(path)


def arm_of(scene: Scene) -> dict[str, Any]:
    """Tables of the arm that fields are made for: segments, tendons, the strains that the rod has
    and the borders of its pieces."""
    segments = [segment.model_dump(mode="json", exclude_none=True) for segment in scene.segments]
    tendons = [
        {"routing": tendon.routing.model_dump(mode="json"), "ends": [*tendon_ends(scene, tendon)]}
        for tendon in scene.tendons
    ]
    strains = [strain for strain in STRAINS if strain in scene.strain.free]
    return {
        "segments": segments,
        "tendons": tendons,
        "strains": strains,
        "borders": breakpoints(scene).tolist(),
    }


def find_fields(scene: Scene, digest: str | None = None) -> PassiveFields | None:
    """Passive fields of the scene's arm that ship or are in the user's cache, those made for its
    loads first; digest: those alone."""
    paths = [
        path
        for folder in (*data_folders("fields"), SHIPPED)
        for path in sorted(folder.glob(f"*{SUFFIX}"))
    ]
    everything = [_read_once(path, path.stat().st_mtime_ns) for path in paths]
    known = [
        fields for fields in everything if digest in (None, fields.digest) and fields.fits(scene)
    ]
    ranks = [
        (
            bool(fields.misfit(scene)),
            not scene.effects.includes(fields.effects),
            len(fields.effects.chosen()),
        )
        for fields in known
    ]
    return known[ranks.index(min(ranks))] if known else None


def fields_of(scene: Scene) -> PassiveFields:
    """The passive fields that a scene with `Snapshots` names. Raises ConfigurationError; warns
    where they were made for other loads."""
    assert not isinstance(scene.strain, ExplicitStrain) and isinstance(
        scene.strain.passive, Snapshots
    )
    table, key, problem = scene.strain.passive, "file", ""
    try:
        found = (
            find_fields(scene, table.digest)
            if table.file is None
            else _read_once(Path(table.file), os.stat(table.file).st_mtime_ns)
        )
    except (OSError, ValueError) as error:
        found, problem = None, f"is {table.file!r}: {error}"
    if found is None:
        problem = (
            problem
            or "names passive fields that this arm has not: `soft-tendon fields SCENE` makes them"
        )
    elif table.digest not in (None, found.digest):
        key, problem = "digest", f"is {table.digest!r}, but {table.file} has {found.digest!r}"
    elif not found.fits(scene):
        problem = (
            f"is {table.file!r}: it is of an arm of other segments, tendons, strains or borders"
        )
    elif table.fields > len(found.coefficients):
        key, problem = (
            "fields",
            f"is {table.fields}: there are {len(found.coefficients)} of this arm",
        )
    if found is None or problem:
        raise ConfigurationError([Problem(("strain", "passive", key), problem)])
    if table.digest is None and (
        misfit := found.misfit(scene)
    ):  # else they were chosen as they are
        text = (
            f"the passive fields of {scene.name!r} were made for {misfit}: fidelity='standard'"
            " finds what its accuracy takes"
        )
        warnings.warn(text, FidelityWarning, stacklevel=2)
    return found
