"""Passive fields from snapshots (proper orthogonal decomposition): their file, and which of those there are fit a scene.

The fields are wrenches along the rod that its tendons cannot make, most important first; accuracy/proper_orthogonal_fields.py makes them.
A file says which arm and which tensions and loads they were made for. They are a basis: for another material or load they stay valid, and
lose accuracy, which is warned of.
"""

import functools
import hashlib
import json
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.scene.artifacts.artifact import MATERIAL, Artifact, Kind
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.strain import SNAPSHOT_ORDER, ExplicitStrain, Snapshots
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.files import read_json, replacing
from soft_tendon_env.tools.types import Array

ALIKE = 2.0
"""Factor up to which the material may differ from that which fields were made for."""
SUFFIX = ".fields.json"
DIGITS = 9  # of the coefficients


class FieldsWarning(UserWarning):
    """Passive fields were made for something else than the scene, or there are none, so that its accuracy is not known."""


@dataclass(frozen=True, eq=False)
class PassiveFields(Artifact):
    """Wrench fields along a rod, piecewise Legendre polynomials, the leading ones of a proper orthogonal decomposition.

    Their coefficients are moments [N m] and forces [N] of unit energy: int F^T Sigma^-1 F dX = 1.

    Attributes:
        effects: the loads, none or those up to whose size they were drawn, see Effects.varied.
        singular_values: (fields,), as shares of the first.
        errors: largest tip distance [m] from full physics on motions that the fields were not made from: by kind of motion, for each of
            the numbers of fields in "fields".
    """

    effects: Effects
    singular_values: Array
    errors: Mapping[str, tuple[float, ...]]

    @functools.cached_property
    def digest(self) -> str:
        return hashlib.sha256(json.dumps([self.borders.tolist(), self.coefficients.tolist()]).encode()).hexdigest()[:16]

    def needed(self, tolerance: float, motions: Iterable[str]) -> int | None:
        """The fewest fields whose errors on these motions are within the tolerance [m]; None: not even all are, or that is not known."""
        if not self.errors:
            return None
        worst = np.max([self.errors[motion] for motion in motions], axis=0)
        return next((int(count) for count, error in zip(self.errors["fields"], worst, strict=True) if error <= tolerance), None)

    def misfit(self, scene: Scene) -> str:
        other = self.other_material(scene, MATERIAL, lambda own, wanted: own / ALIKE <= wanted <= own * ALIKE)
        if other := other or self.other_limits(scene, room=ALIKE - 1.0):
            return other
        if not self.effects.covers(scene.effects):
            made, wanted = (effects.model_dump(mode="json", exclude_none=True) for effects in (self.effects, scene.effects))
            return f"{shown(made) if made else 'no loads'}, not {shown(wanted)}"
        return ""

    def save(self, path: Path) -> None:
        """Saves them as JSON. The file appears whole or not at all. Raises OSError."""
        table = {
            "arm": self.arm,
            "tension_limits": self.tension_limits.tolist(),
            "effects": self.effects.model_dump(mode="json", exclude_none=True),
            "borders": self.borders.tolist(),
            "singular_values": [float(f"{value:.4g}") for value in self.singular_values],
            "errors": {name: [float(f"{value:.4g}") for value in values] for name, values in self.errors.items()},
            "coefficients": self.coefficients.tolist(),
        }
        with replacing(path) as temporary:
            temporary.write_text("{\n" + ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in table.items()) + "\n}\n")


def rounded(coefficients: Array) -> Array:
    """Coefficients to DIGITS significant digits of the largest of each field."""
    largest = np.abs(coefficients).max(axis=(1, 2, 3), keepdims=True)
    unit = 10.0 ** (np.floor(np.log10(np.where(largest > 0.0, largest, 1.0))) + 1 - DIGITS)
    return np.array([float(f"{value:.{DIGITS}g}") for value in (np.round(coefficients / unit) * unit).ravel()]).reshape(coefficients.shape)


def read_fields(path: Path) -> PassiveFields:
    """Fields that `PassiveFields.save` wrote. Raises ValueError, FileNotFoundError."""
    table = read_json(path)
    try:
        fields = PassiveFields(
            arm=table["arm"],
            tension_limits=np.array(table["tension_limits"], dtype=float).reshape(-1, 2),
            effects=Effects(**table["effects"]),
            borders=np.array(table["borders"], dtype=float),
            coefficients=np.array(table["coefficients"], dtype=float),
            singular_values=np.array(table["singular_values"], dtype=float),
            errors={name: tuple(values) for name, values in table["errors"].items()},
        )
        shape = (fields.singular_values.size, fields.borders.size - 1, 6, SNAPSHOT_ORDER + 1)
        if fields.coefficients.shape != shape or not np.isfinite(fields.coefficients).all():
            raise ValueError(f"its coefficients should be finite and of shape {shape}, not {fields.coefficients.shape}")
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} holds no passive fields that soft-tendon fields wrote: {type(error).__name__} {error}") from error
    return fields


KIND = Kind("passive fields from snapshots", "fields", ("strain", "passive"), "fields", SUFFIX, read_fields)


def find_fields(scene: Scene, digest: str | None = None) -> PassiveFields | None:
    """Passive fields of the scene's arm, among those that ship and those in the user's cache; None where there are none.

    Those that were made for the scene's loads go before those made for more, and these before the others. With a digest: those alone.
    """
    return min(KIND.known(scene, digest), key=lambda fields: _excess(fields, scene), default=None)


def _excess(fields: PassiveFields, scene: Scene) -> tuple[bool, bool, int]:
    """Order of preference: those that fit first, then those of the same loads, then those of the fewest."""
    return bool(fields.misfit(scene)), not scene.effects.covers(fields.effects), len(fields.effects.chosen())


def fields_of(scene: Scene) -> PassiveFields:
    """The passive fields that a scene with `Snapshots` names. Raises ConfigurationError where there are none or they do not fit; warns
    (FieldsWarning) where they were made for another material or load."""
    assert not isinstance(scene.strain, ExplicitStrain) and isinstance(scene.strain.passive, Snapshots)
    wanted, found = scene.strain.passive.fields, KIND.named_by(scene, scene.strain.passive, find_fields)
    if wanted > len(found.coefficients):
        text = f"is {wanted}: there are {len(found.coefficients)} of this arm"
        raise ConfigurationError([Problem((*KIND.key, "fields"), text)])
    if misfit := found.misfit(scene):
        text = f"the passive fields of {scene.name!r} were made for {misfit}: `soft-tendon fields` makes those of this scene"
        warnings.warn(text, FieldsWarning, stacklevel=2)
    return found
