"""Markers of motion capture from a TOML file: places, frame and columns.

The file says where they sit on the arm, the frame of their positions, and the columns of the data.
"""

import os
from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    read_toml,
)
from soft_tendon_env.tools.types import Array, NotNegative, Positive, Quaternion, Triple

TOLERANCE = 1e-9  # relative, by which a marker may be beyond the tip: of round-off
MILLIMETRES = 10.0  # rod's lengths from which on a place is in another unit, likely mm

UNITS: Mapping[str, Mapping[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "N": {"N": 1.0, "mN": 1e-3, "kg": 9.80665, "g": 9.80665e-3},  # of a mass, its weight
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
"""Units of columns as factors of the SI unit that their quantity has."""
COUNTS = "counts"
"""Unit of a converter's or an encoder's numbers: `scale` says how many SI units a count is."""


class Marker(Configuration):
    """Marker that is fixed to a section of the rod, `[markers.NAME]`."""

    arc_length: NotNegative  # of the section, from the rod's base [m]
    # of the marker in the section's frame (x along the rod, y, z) [m]
    offset: Triple = (0.0, 0.0, 0.0)


class Frame(Configuration):
    """Rigid motion R p + translation from the frame of the data to the scene's world frame.

    It is the table `[frame]`.
    """

    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)  # of the rotation R, (w, x, y, z)
    translation: Triple = (0.0, 0.0, 0.0)  # [m]

    @property
    def rotation(self) -> Array:
        """Rotation matrix R (3, 3)."""
        rotation = Rotation.from_quat(self.quaternion, scalar_first=True)
        return np.asarray(rotation.as_matrix())


class Column(Configuration):
    """Column of the data that holds a quantity, `[columns]`, by the quantity's name.

    A `*` there stands for what `*` in `name` does.
    """

    name: str | None = None  # of the column; None: the quantity's own
    unit: str | None = None  # one of `UNITS`, or `COUNTS`; None: that of the file, or the SI unit
    scale: Positive = 1.0  # of `unit` in 1 of the column's numbers: N per count, m per tick
    sign: Literal[1, -1] = 1


class MarkerSet(Configuration):
    """Markers by name, in the order of all arrays, and the frame and the columns of the data."""

    # places on the arm, by the marker's name
    markers: dict[str, Marker] = Field(min_length=1)
    frame: Frame = Frame()  # from the data's frame to the world frame
    columns: dict[str, Column] = {}  # names and units of the data's columns

    @property
    def arc_lengths(self) -> Array:
        """Arc lengths (m,) [m]."""
        arc_lengths = [marker.arc_length for marker in self.markers.values()]
        return np.array(arc_lengths)

    @property
    def offsets(self) -> Array:
        """Offsets in the sections' frames (m, 3) [m]."""
        offsets = [marker.offset for marker in self.markers.values()]
        return np.array(offsets)

    def with_offsets(self, offsets: Array) -> "MarkerSet":
        """Returns the markers with other offsets.

        Args:
            offsets: in the sections' frames (m, 3) [m].

        Returns:
            The new markers, with the same frame and columns.
        """
        moved = dict[str, Marker]()
        for name, offset in zip(self.markers, offsets.tolist(), strict=True):
            marker = self.markers[name]
            change = {"offset": tuple(offset)}
            moved[name] = marker.model_copy(update=change)
        return MarkerSet(markers=moved, frame=self.frame, columns=self.columns)


def load_markers(path: str | os.PathLike[str], scene: Scene) -> MarkerSet:
    """Reads markers, frame and columns from a TOML file.

    Args:
        path: of the file.
        scene: the arm that has the markers.

    Returns:
        The markers in the order of the file.

    Raises:
        ConfigurationError: for a file that cannot be read, for keys and values that are not
            allowed, and see `check_places`.
    """
    source = os.fspath(path)
    markers = MarkerSet.parse(read_toml(path), source)
    check_places(markers, scene, source)
    return markers


def check_places(markers: MarkerSet, scene: Scene, source: str) -> None:
    """Checks that markers are on the rod.

    Args:
        markers: to check.
        scene: the arm that has them.
        source: where they are from, for messages.

    Raises:
        ConfigurationError: for markers beyond the rod's tip, and for offsets that are longer than
            the rod.
    """
    length = rod_length(scene)
    longest = length * (1 + TOLERANCE)
    problems = list[Problem]()
    for name, marker in markers.markers.items():
        sizes = {
            "arc_length": marker.arc_length,
            "offset": float(np.linalg.norm(marker.offset)),
        }
        for key, size in sizes.items():
            if size > longest:
                if size > MILLIMETRES * length:
                    hint = "; is it in mm?"
                else:
                    hint = ""
                text = f"is {size:g}: it should be at most the rod's length, {length:g} m{hint}"
                problems.append(Problem(("markers", name, key), text))
    if problems:
        raise ConfigurationError(problems, source)
