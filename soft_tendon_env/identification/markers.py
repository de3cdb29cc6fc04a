"""Markers of motion capture: where they sit on the arm, and the frame that their positions are measured in, from a TOML file."""

import os

import numpy as np
from pydantic import Field, field_validator
from scipy.spatial.transform import Rotation

from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, read_toml
from soft_tendon_env.tools.types import Array, NotNegative, Number, Triple

UNIT = 1e-3
"""How far the length of a quaternion may be from 1."""


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


class MarkerSet(Configuration):
    """Markers by name, in the order of all arrays, the frame of the data, and what else is measured."""

    markers: dict[str, Marker] = Field(min_length=1)
    frame: Frame = Frame()
    sensors: Sensing = Sensing()

    @property
    def arc_lengths(self) -> Array:
        """Arc lengths (m,) [m]."""
        return np.array([marker.arc_length for marker in self.markers.values()])

    @property
    def offsets(self) -> Array:
        """Offsets in the sections' frames (m, 3) [m]."""
        return np.array([marker.offset for marker in self.markers.values()])

    def columns(self, tendons: int) -> list[str]:
        """Names of the columns (k,) of what is measured besides positions, see sensed.py."""
        found = [f"{name}_q{part}" for name, marker in self.markers.items() if marker.orientation for part in "wxyz"]
        found += [f"tendon_length_{i}" for i in range(tendons * self.sensors.tendon_lengths)]
        return found + [f"strain_{i}_{strain}" for i in range(len(self.sensors.strain)) for strain in STRAINS]

    def with_offsets(self, offsets: Array, frame: Frame) -> "MarkerSet":
        """The markers with other offsets (m, 3) [m], in another frame."""
        pairs = zip(self.markers.items(), offsets.tolist(), strict=True)
        moved = {name: Marker(**{**dict(marker), "offset": tuple(offset)}) for (name, marker), offset in pairs}
        return MarkerSet(markers=moved, frame=frame, sensors=self.sensors)


def load_markers(path: str | os.PathLike[str], scene: Scene) -> MarkerSet:
    """Markers and frame of a TOML file, for the arm of a scene. Raises ConfigurationError, also for a marker beyond the rod's tip."""
    found, length = MarkerSet.parse(read_toml(path), os.fspath(path)), rod_length(scene)
    places = {("markers", name, "arc_length"): marker.arc_length for name, marker in found.markers.items()}
    places |= {("sensors", "strain", str(i)): place for i, place in enumerate(found.sensors.strain)}
    problems = [
        Problem(key, f"is {place:g}: it should be at most the rod's length, {length:g} m")
        for key, place in places.items()
        if place > length * (1 + 1e-9)
    ]
    if problems:
        raise ConfigurationError(problems, os.fspath(path))
    return found
