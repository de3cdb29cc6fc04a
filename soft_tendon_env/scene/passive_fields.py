"""Passive fields from snapshots (proper orthogonal decomposition), their file and their choice.

They are wrenches along the rod that its tendons cannot make, see
accuracy/proper_orthogonal_fields.py. For another material or load than a file says they stay a
basis, and lose accuracy: how much, a trial finds, see accuracy/trial.py.
"""

import functools
import hashlib
import itertools
import json
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
from soft_tendon_env.scene.strain import SNAPSHOT_ORDER, STRAINS, Snapshots, StaticsBased
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import data_folders, read_json, replacing
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

MATERIAL = ("young_modulus", "density", "damping")  # of a segment
ALIKE = 1.25  # factor up to which material and tensions may differ from the fields'
ARRAYS = ("tension_limits", "borders", "singular_values", "coefficients")  # of a file, by its keys
SUFFIX = ".fields.json"  # of the files' names
READ_AT_MOST = 256  # files that are kept in memory


class FidelityWarning(UserWarning):
    """A model is less accurate than its fidelity says, or no fidelity was given."""


@dataclass(frozen=True, eq=False)
class PassiveFields:
    """Wrench fields along a rod by proper orthogonal decomposition, the leading ones.

    They are piecewise Legendre polynomials.
    """

    arm: Mapping[str, Any]  # tables of segments and tendons that they were made for, see `arm_of`
    tension_limits: Array  # (n_a, 2) [N], within which tensions were drawn
    borders: Array  # (pieces + 1,) arc lengths [m] between the polynomials
    # (fields, pieces, 6, orders) moments [N m] and forces [N] of unit energy: int F^T Sigma^-1 F dX
    # = 1
    coefficients: Array
    # the loads, none or those up to whose size they were drawn, see Effects.sample_smaller
    effects: Effects
    singular_values: Array  # (fields,), as shares of the first
    # [m] largest of the tip, by kind of motion, for each of the numbers of fields in "fields"
    errors: Mapping[str, tuple[float, ...]]

    @cached_property
    def digest(self) -> str:
        """16 hex digits of the numbers that they are made of."""
        borders = self.borders.tolist()
        coefficients = self.coefficients.tolist()
        arrays = [borders, coefficients]
        numbers = json.dumps(arrays)
        digest = hashlib.sha256(numbers.encode())
        return digest.hexdigest()[:16]

    def needed(self, tolerance: float, motions: Iterable[str]) -> int | None:
        """Returns the fewest fields whose errors are within a tolerance.

        Args:
            tolerance: of the tip [m].
            motions: kinds of motion, keys of `errors`.

        Returns:
            Their number; None: not even all are, or that is not known.
        """
        counts = self.errors.get("fields", ())
        errors = [self.errors.get(motion, ()) for motion in motions]
        worst = np.max(errors, axis=0)
        for count, error in zip(counts, worst, strict=True):
            if error <= tolerance:
                return int(count)
        return None

    def at(self, points: Array, count: int | None = None) -> Array:
        """Computes the wrench fields along the rod.

        Args:
            points: arc lengths (...) [m].
            count: how many of the fields, the leading ones; None: all.

        Returns:
            Moments [N m] and forces [N], (count, ..., 6).
        """
        coefficients = self.coefficients[:count]
        order = coefficients.shape[-1] - 1
        shape = (len(coefficients), *points.shape, 6)
        values = np.zeros(shape)
        for piece, (start, end) in enumerate(itertools.pairwise(self.borders)):
            is_inside = (points > start) & (points < end)
            # from -1 to 1 over the piece
            from_start = points - start
            doubled_share = 2 * from_start / (end - start)
            scaled = doubled_share - 1
            polynomials = legendre.legvander(scaled, order)
            basis = polynomials * is_inside[..., None]
            of_piece = coefficients[:, piece]
            values += np.einsum("...o,fco->f...c", basis, of_piece)
        return values

    def fits(self, scene: Scene) -> bool:
        """Tells whether the fields are of an arm of this geometry.

        Args:
            scene: of the arm.

        Returns:
            True if segments and tendons have the same geometry.
        """
        own = _geometry(self.arm)
        expected = _geometry(arm_of(scene))
        return own == expected

    def is_of(self, scene: Scene) -> bool:
        """Tells whether the fields were made for an arm of this material and these limits.

        Args:
            scene: of an arm of the same geometry.

        Returns:
            True if their errors are those of this arm; False if they may be larger.
        """
        limits = [tendon.tension_limits for tendon in scene.tendons]
        low, high = np.transpose(limits)
        least, greatest = self.tension_limits.T
        is_inside = (low >= least) & (high <= greatest)
        is_within = np.all(is_inside)
        return bool(is_within) and self.arm == arm_of(scene)

    def misfit(self, scene: Scene) -> str:
        """Describes how a scene differs from that which the fields were made for.

        Args:
            scene: of an arm of the same geometry.

        Returns:
            The first difference in words; empty where they fit.
        """
        for i, segment in enumerate(scene.segments):
            for name in MATERIAL:
                value = getattr(segment, name)
                if value is None:
                    continue
                made_for = self.arm["segments"][i].get(name)
                is_alike = made_for / ALIKE <= value <= made_for * ALIKE
                if not is_alike:
                    return f"{name} of {made_for:g} in segment {i}, not {value:g}"
        low, high = self.tension_limits.T
        tension_limits = [tendon.tension_limits for tendon in scene.tendons]
        limits = np.array(tension_limits)
        least, greatest = limits.T
        margin = (ALIKE - 1.0) * (high - low)
        is_above = least >= low - margin
        is_below = greatest <= high + margin
        is_within = is_above & is_below
        if not is_within.all():
            return (
                f"tensions of {low.min():g} to {high.max():g} N, not {least.min():g} to"
                f" {greatest.max():g} N"
            )
        if not self.effects.includes(scene.effects):
            loads = self.effects.model_dump(mode="json", exclude_none=True)
            scene_loads = scene.effects.model_dump(mode="json", exclude_none=True)
            return f"{loads or 'no loads'}, not {scene_loads}"
        return ""

    def save(self, path: Path) -> None:
        """Saves the fields as JSON.

        The file appears whole or not at all.

        Args:
            path: of the file.

        Raises:
            OSError: if the file cannot be written.
        """
        arrays = {name: getattr(self, name).tolist() for name in ARRAYS}
        table = {
            "arm": self.arm,
            "effects": self.effects.model_dump(mode="json", exclude_none=True),
            "errors": self.errors,
            **arrays,
        }
        # one key per line: an array's numbers stay together
        lines = []
        for key, value in table.items():
            lines.append(f"{json.dumps(key)}: {json.dumps(value)}")
        text = "{\n" + ",\n".join(lines) + "\n}\n"
        with replacing(path) as temporary:
            temporary.write_text(text)


def _geometry(arm: Mapping[str, Any]) -> dict[str, Any]:
    no_material = dict.fromkeys(MATERIAL)
    segments = [{**segment, **no_material} for segment in arm["segments"]]
    return {**arm, "segments": segments}


def read_fields(path: Path) -> PassiveFields:
    """Reads passive fields from a file.

    Args:
        path: of a file that `PassiveFields.save` wrote.

    Returns:
        The fields.

    Raises:
        ValueError: for a file of something else.
        FileNotFoundError: for one that is missing.
    """
    table = read_json(path)
    try:
        arrays = {}
        for name in ARRAYS:
            arrays[name] = np.array(table[name], dtype=float)
        errors = {name: tuple(values) for name, values in table["errors"].items()}
        effects = Effects(**table["effects"])
        fields = PassiveFields(
            arm=table["arm"],
            effects=effects,
            errors=errors,
            **arrays,
        )
        coefficients = fields.coefficients
        count = fields.singular_values.size
        pieces = fields.borders.size - 1
        shape = (count, pieces, 6, SNAPSHOT_ORDER + 1)
        is_finite = np.isfinite(coefficients).all()
        is_other = coefficients.shape != shape
        if is_other or not is_finite:
            raise ValueError(
                f"its coefficients should be finite and of shape {shape}, not {coefficients.shape}"
            )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{path} holds no passive fields that soft-tendon fields wrote: {type(error).__name__}"
            f" {error}"
        ) from error
    return fields


@functools.lru_cache(maxsize=READ_AT_MOST)
def _read_at(path: Path, _changed: int) -> PassiveFields:
    """Fields of a file that changed last at a time [ns]."""
    return read_fields(path)


def _read_once(path: Path) -> PassiveFields:
    """Fields of a file, read again only where it changed.

    Raises OSError, ValueError.
    """
    return _read_at(path, path.stat().st_mtime_ns)


def arm_of(scene: Scene) -> dict[str, Any]:
    """Tables of the arm that fields are made for.

    They are segments, tendons, the strains that the rod has and the borders of its pieces.
    """
    segments = [segment.model_dump(mode="json", exclude_none=True) for segment in scene.segments]
    tendons = []
    for tendon in scene.tendons:
        routing = tendon.routing.model_dump(mode="json")
        ends = [*tendon_ends(scene, tendon)]
        tendons.append({"routing": routing, "ends": ends})
    strains = [strain for strain in STRAINS if strain in scene.strain.free]
    return {
        "segments": segments,
        "tendons": tendons,
        "strains": strains,
        "borders": breakpoints(scene).tolist(),
    }


def find_fields(scene: Scene, digest: str | None = None) -> PassiveFields | None:
    """Passive fields of an arm, among those that ship or are in the user's cache.

    Args:
        scene: the arm.
        digest: of the fields, None: any that fit.

    Returns:
        Those made for loads like the scene's, if possible; None: there are none of this arm.
    """
    candidates = list[PassiveFields]()
    for folder in (*data_folders("fields"), SHIPPED):
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            fields = _read_once(path)
            is_named = digest in (None, fields.digest)
            if is_named and fields.fits(scene):
                candidates.append(fields)

    def rank(fields: PassiveFields) -> tuple[bool, bool, int]:
        """Less for fields that fit better; of those that fit alike, the ones with fewer loads."""
        has_misfit = bool(fields.misfit(scene))
        has_other_loads = not scene.effects.includes(fields.effects)
        loads = len(fields.effects.chosen())
        return has_misfit, has_other_loads, loads

    return min(candidates, key=rank, default=None)


def fields_of(scene: Scene) -> PassiveFields:
    """Passive fields that a scene with `Snapshots` names.

    Warns where they were made for other loads.

    Args:
        scene: the arm.

    Returns:
        The fields.

    Raises:
        ConfigurationError: where there are none, or not these.
    """
    assert isinstance(scene.strain, StaticsBased)
    passive = scene.strain.passive
    assert isinstance(passive, Snapshots)
    fields = _named_fields(scene, passive)
    if passive.digest not in (None, fields.digest):
        text = f"is {passive.digest!r}, but {passive.file} has {fields.digest!r}"
        raise _passive_error("digest", text)
    if not fields.fits(scene):
        text = (
            f"is {passive.file!r}: it is of an arm of other segments, tendons, strains or borders"
        )
        raise _passive_error("file", text)
    count = len(fields.coefficients)
    if passive.fields > count:
        message = f"is {passive.fields}: there are {count} of this arm"
        raise _passive_error("fields", message)
    # those that are named by their digest were chosen as they are
    if passive.digest is None:
        misfit = fields.misfit(scene)
    else:
        misfit = ""
    if misfit:
        text = (
            f"the passive fields of {scene.name!r} were made for {misfit}: fidelity='standard'"
            " finds what its accuracy takes"
        )
        warnings.warn(text, FidelityWarning, stacklevel=2)
    return fields


def _named_fields(scene: Scene, passive: Snapshots) -> PassiveFields:
    """Fields of the file that is named, or else of the arm.

    Raises ConfigurationError.
    """
    try:
        if passive.file is not None:
            return _read_once(Path(passive.file))
        fields = find_fields(scene, passive.digest)
    except (OSError, ValueError) as error:
        message = f"is {passive.file!r}: {error}"
        raise _passive_error("file", message) from None
    if fields is None:
        text = "names passive fields that this arm has not: `soft-tendon fields SCENE` makes them"
        raise _passive_error("file", text)
    return fields


def _passive_error(key: str, text: str) -> ConfigurationError:
    """Error about a key of the table `strain.passive`."""
    problem = Problem(("strain", "passive", key), text)
    return ConfigurationError([problem])
