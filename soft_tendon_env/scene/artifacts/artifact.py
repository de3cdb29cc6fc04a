"""Files that were made for an arm: which of those there are fit a scene, and the one that a scene names."""

import functools
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.polynomial import legendre

from soft_tendon_env.compiler.cache_folder import data_folders
from soft_tendon_env.scene.file import SHIPPED
from soft_tendon_env.scene.scene import Scene, breakpoints, tendon_ends
from soft_tendon_env.scene.strain import STRAINS, LearnedLoads, Snapshots
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array

MATERIAL = ("young_modulus", "density", "damping")
"""Properties of a segment that are none of its geometry."""


@dataclass(frozen=True, eq=False)
class Artifact:
    """Base of what is made for one arm, with fields along it as piecewise Legendre polynomials.

    Attributes:
        arm: tables of segments and tendons that it was made for, see `arm_of`.
        tension_limits: (n_a, 2) [N], within which tensions were drawn.
        borders: arc lengths [m] between the polynomials, (pieces + 1,).
        coefficients: (fields, pieces, 6, orders), moments [N m] and forces [N].
    """

    arm: Mapping[str, Any]
    tension_limits: Array
    borders: Array
    coefficients: Array

    @property
    def digest(self) -> str:
        """16 hex digits of the numbers that it is made of."""
        raise NotImplementedError

    def misfit(self, scene: Scene) -> str:
        """Difference between the scene and that which it was made for, in words; empty where it fits."""
        raise NotImplementedError

    def at(self, points: Array, count: int | None = None) -> Array:
        """The leading fields, all by default, at arc lengths (...) [m]: (count, ..., 6)."""
        return polynomials_at(self.borders, self.coefficients[:count], points)

    def fits(self, scene: Scene) -> bool:
        """Whether it is of an arm of this geometry."""
        return _geometry(self.arm) == _geometry(arm_of(scene))

    def other_material(self, scene: Scene, names: Iterable[str], alike: Callable[[float, float], bool]) -> str:
        """The first of these properties of a segment that is not alike in the scene, in words; empty where all are."""
        for i, (own, wanted) in enumerate(zip(self.arm["segments"], arm_of(scene)["segments"], strict=True)):
            for name in names:
                if not alike(own[name], wanted[name]):
                    return f"{name} of {own[name]:g} in segment {i}, not {wanted[name]:g}"
        return ""

    def other_limits(self, scene: Scene, room: float = 0.0) -> str:
        """The first tendon whose limits in the scene lie outside of its own by more than `room` times their range, in words."""
        for i, (tendon, (low, high)) in enumerate(zip(scene.tendons, self.tension_limits, strict=True)):
            (least, greatest), more = tendon.tension_limits, room * (high - low)
            if least < low - more or greatest > high + more:
                return f"{low:g} to {high:g} N at tendon {i}, not {least:g} to {greatest:g} N"
        return ""


Made = TypeVar("Made", bound=Artifact)


@dataclass(frozen=True)
class Kind(Generic[Made]):
    """A kind of artifact: what it is called, where its files lie, how they are read, and the key by which a scene names one."""

    name: str
    command: str  # that makes it
    key: Key
    folder: str  # in the user's cache
    suffix: str
    read: Callable[[Path], Made]  # raises ValueError, OSError

    def known(self, scene: Scene, digest: str | None = None) -> list[Made]:
        """Artifacts of the scene's arm, among those that ship and those in the user's cache; with a digest: that one alone."""
        paths = [path for folder in (*data_folders(self.folder), SHIPPED) for path in sorted(folder.glob(f"*{self.suffix}"))]
        everything = [_read_once(self.read, path, path.stat().st_mtime_ns) for path in paths]
        return [made for made in everything if digest in (None, made.digest) and made.fits(scene)]

    def named_by(self, scene: Scene, table: Snapshots | LearnedLoads, found: Callable[[Scene, str | None], Made | None]) -> Made:
        """The one that a table of the scene names by its file or its digest, or that is `found` for it. Raises ConfigurationError."""
        if table.file is None:
            made = found(scene, table.digest)
            if made is None:
                which = "" if table.digest is None else f" with the digest {table.digest}"
                text = f"names {self.name}{which}, and there is none for this arm: `soft-tendon {self.command} SCENE` makes it"
                raise ConfigurationError([Problem(self.key, text)])
            return made
        try:
            made = _read_once(self.read, path := Path(table.file), path.stat().st_mtime_ns)
        except (OSError, ValueError) as error:
            raise ConfigurationError([Problem((*self.key, "file"), f"is {table.file!r}: {error}")]) from error
        if table.digest not in (None, made.digest):
            raise ConfigurationError([Problem((*self.key, "digest"), f"is {table.digest!r}, but {table.file} has {made.digest!r}")])
        if not made.fits(scene):
            text = f"is {table.file!r}: it is of an arm of other segments, tendons, strains or borders"
            raise ConfigurationError([Problem((*self.key, "file"), text)])
        return made


@functools.lru_cache(maxsize=256)
def _read_once(read: Callable[[Path], Made], path: Path, _changed: int) -> Made:
    return read(path)


def arm_of(scene: Scene) -> dict[str, Any]:
    """Tables of the arm that artifacts are made for: segments, tendons, the strains that the rod has and the borders of its pieces."""
    segments = [segment.model_dump(mode="json") for segment in scene.segments]
    tendons = [{"routing": tendon.routing.model_dump(mode="json"), "ends": tendon_ends(scene, tendon)} for tendon in scene.tendons]
    strains = [strain for strain in STRAINS if strain in scene.strain.free]
    table = {"segments": segments, "tendons": tendons, "strains": strains, "borders": breakpoints(scene).tolist()}
    return dict(json.loads(json.dumps(table)))


def _geometry(arm: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of `arm_of` without the material."""
    segments = [{name: value for name, value in segment.items() if name not in MATERIAL} for segment in arm["segments"]]
    return {**arm, "segments": segments}


def polynomials_at(borders: Array, coefficients: Array, points: Array) -> Array:
    """Piecewise Legendre polynomials with coefficients (fields, pieces, 6, orders) at arc lengths (...) [m]: (fields, ..., 6)."""
    values = np.zeros((len(coefficients), *points.shape, 6))
    for piece, (a, b) in enumerate(zip(borders[:-1], borders[1:], strict=True)):
        inside = (points > a) & (points < b)
        basis = legendre.legvander(2 * (points - a) / (b - a) - 1, coefficients.shape[-1] - 1) * inside[..., None]
        values += np.einsum("...o,fco->f...c", basis, coefficients[:, piece])
    return values
