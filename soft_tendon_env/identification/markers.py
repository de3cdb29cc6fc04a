"""Markers of motion capture: where they sit on the arm, the frame of their positions, and the columns of the data, from a TOML file."""

import os
import re
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator
from scipy.spatial.transform import Rotation

from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, read_toml
from soft_tendon_env.tools.types import Array, NotNegative, Number, Triple

UNIT = 1e-3
"""How far the length of a quaternion may be from 1."""
UNITS: Mapping[str, Mapping[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "N": {"N": 1.0, "mN": 1e-3, "kg": 9.80665, "g": 9.80665e-3},  # of a mass, its weight
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "1/m": {"1/m": 1.0, "1/mm": 1e3, "deg/m": np.pi / 180.0, "deg/mm": 1e3 * np.pi / 180.0},
    "1": {"1": 1.0, "%": 1e-2},
    "": {},
}
"""Units of columns as factors of the SI unit that their quantity has."""


class Marker(Configuration):
    """Marker that is fixed to a section of the rod, `[markers.NAME]`.

    Attributes:
        arc_length: of the section, from the rod's base [m].
        offset: of the marker in the section's frame (x along the rod, y, z) [m].
        orientation: whether the section's orientation is measured there too, as a unit quaternion.
    """

    arc_length: NotNegative
    offset: Triple = (0.0, 0.0, 0.0)
    orientation: bool = False


class Sensing(Configuration):
    """Sensors in the arm whose columns are used, `[sensors]`.

    Attributes:
        tendon_lengths: whether the lengths of all tendons are measured.
        strain: arc lengths [m] of strain sensors, in the order of their columns.
    """

    tendon_lengths: bool = False
    strain: tuple[NotNegative, ...] = ()


class Frame(Configuration):
    """Rigid motion from the frame of the data to the scene's world frame, `[frame]`: R p + translation.

    Attributes:
        quaternion: the rotation R as a unit quaternion (w, x, y, z).
        translation: (x, y, z) [m].
    """

    quaternion: tuple[Number, Number, Number, Number] = (1.0, 0.0, 0.0, 0.0)
    translation: Triple = (0.0, 0.0, 0.0)

    @field_validator("quaternion")
    @classmethod
    def _is_a_rotation(cls, quaternion: tuple[float, ...]) -> tuple[float, ...]:
        if abs(float(np.linalg.norm(quaternion)) - 1.0) > UNIT:
            raise ValueError(f"should have length 1, not {np.linalg.norm(quaternion):.4g}")
        return quaternion

    @property
    def matrix(self) -> Array:
        """Homogeneous matrix (4, 4), by which poses of the data's frame are multiplied from the left."""
        found = np.eye(4)
        found[:3, :3] = Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix()
        found[:3, 3] = self.translation
        return found

    def to_scene(self, positions: Array) -> Array:
        """Positions (..., 3) of the data's frame in the scene's, [m]."""
        return np.asarray(positions @ self.matrix[:3, :3].T + self.translation)

    def to_base(self, rotation: Array, shift: Array) -> "Frame":
        """Frame that leads to a base which is turned (3, 3) and then shifted (3,) [m] in the scene's world frame."""
        turned = Rotation.from_matrix(rotation.T @ self.matrix[:3, :3]).as_quat(canonical=True, scalar_first=True)
        return Frame(quaternion=tuple(turned.tolist()), translation=tuple((rotation.T @ (self.translation - shift)).tolist()))


class Column(Configuration):
    """Column of the data that holds a quantity, `[columns]`, by the quantity's name; a `*` there stands for what `*` in `name` does.

    Attributes:
        name: of the column; None: the quantity's own.
        unit: one of `UNITS`; None: the SI unit.
        sign: by which the numbers are multiplied.
    """

    name: str | None = None
    unit: str | None = None
    sign: Literal[1, -1] = 1


class Source(NamedTuple):
    """Name of a quantity's column, and the factor from its numbers to SI units."""

    name: str
    factor: float = 1.0


class MarkerSet(Configuration):
    """Markers by name, in the order of all arrays, the frame and the columns of the data, and what else is measured."""

    markers: dict[str, Marker] = Field(min_length=1)
    frame: Frame = Frame()
    sensors: Sensing = Sensing()
    columns: dict[str, Column] = {}

    @property
    def arc_lengths(self) -> Array:
        """Arc lengths (m,) [m]."""
        return np.array([marker.arc_length for marker in self.markers.values()])

    @property
    def offsets(self) -> Array:
        """Offsets in the sections' frames (m, 3) [m]."""
        return np.array([marker.offset for marker in self.markers.values()])

    def sensed(self, tendons: int) -> dict[str, str]:
        """SI units by quantity (k,) of what is measured besides positions, see sensed.py."""
        found = {f"{name}_q{part}": "1" for name, marker in self.markers.items() if marker.orientation for part in "wxyz"}
        found |= {f"tendon_length_{i}": "m" for i in range(tendons * self.sensors.tendon_lengths)}
        kinds = {strain: "1/m" if strain.startswith(("torsion", "bend")) else "1" for strain in STRAINS}
        return found | {f"strain_{i}_{strain}": kind for i in range(len(self.sensors.strain)) for strain, kind in kinds.items()}

    def sources(self, units: Mapping[str, str], strict: bool = True) -> dict[str, Source]:
        """Columns of quantities, which are given with their SI units. Raises ValueError for units that `[columns]` should not have and,
        where it is strict, for keys of other quantities."""
        found, given = {quantity: Source(quantity) for quantity in units}, dict[str, str]()
        for key, column in sorted(self.columns.items(), key=lambda item: "*" not in item[0]):  # a name of its own beats a pattern
            pattern = re.escape(key).replace(r"\*", "(.+)")
            matches = [(quantity, match.groups()) for quantity in units if (match := re.fullmatch(pattern, quantity))]
            if strict and not matches:
                raise ValueError(f"columns.{key} is no quantity that is read here: {not_among(key, units)}")
            for quantity, parts in matches:
                if "*" in key and quantity in given:
                    raise ValueError(f"columns.{key} and columns.{given[quantity]} are both for {quantity}: give it a key of its own")
                given[quantity] = key
                allowed = UNITS[units[quantity]]
                if column.unit is not None and column.unit not in allowed:
                    raise ValueError(f"columns.{key}.unit is {column.unit!r}: it should be one of {', '.join(allowed)}")
                name = (column.name or quantity).replace("*", parts[0] if parts else "*")
                found[quantity] = Source(name, column.sign * (1.0 if column.unit is None else allowed[column.unit]))
        return found

    def with_offsets(self, offsets: Array, frame: Frame) -> "MarkerSet":
        """The markers with other offsets (m, 3) [m], in another frame."""
        pairs = zip(self.markers.items(), offsets.tolist(), strict=True)
        moved = {name: Marker(**{**dict(marker), "offset": tuple(offset)}) for (name, marker), offset in pairs}
        return MarkerSet(markers=moved, frame=frame, sensors=self.sensors, columns=self.columns)


def load_markers(path: str | os.PathLike[str], scene: Scene) -> MarkerSet:
    """Markers, frame and columns of a TOML file, for the arm of a scene. Raises ConfigurationError, see `check_places`."""
    found = MarkerSet.parse(read_toml(path), os.fspath(path))
    check_places(found, scene, os.fspath(path))
    return found


def check_places(markers: MarkerSet, scene: Scene, source: str) -> None:
    """Raises ConfigurationError for markers and sensors beyond the rod's tip, and for offsets that are longer than the rod."""
    length = rod_length(scene)
    places = {("markers", name, "arc_length"): marker.arc_length for name, marker in markers.markers.items()}
    places |= {("sensors", "strain", str(i)): place for i, place in enumerate(markers.sensors.strain)}
    places |= {("markers", name, "offset"): float(np.linalg.norm(marker.offset)) for name, marker in markers.markers.items()}
    problems = [
        Problem(key, f"is {place:g}: it should be at most the rod's length, {length:g} m{'; is it in mm?' * (place > 10.0 * length)}")
        for key, place in places.items()
        if place > length * (1 + 1e-9)
    ]
    if problems:
        raise ConfigurationError(problems, source)
