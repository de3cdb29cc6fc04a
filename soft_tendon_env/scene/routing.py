"""Geometry along the rod: tapers of a segment's sizes, and routings of tendons.

A routing is the offset d = (0, y, z) of a tendon from the axis, and d' = dd/dX.

One is a class under `@register("taper", "name")` or `@register("routing", "name")`, here or in a
user's own file as `examples/own_routing.py`.
"""

from abc import abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AliasChoices,
    BeforeValidator,
    Discriminator,
    Field,
    SerializeAsAny,
    Tag,
    field_validator,
)
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.registry import TableRegistry, register
from soft_tendon_env.tools.types import SHORTEST, Array, Length, NotNegative, Number

Offset = tuple[Number, Number]
Ends = tuple[float, float]
ROUND_OFF = 1e-9  # relative, by which a table may end before what it has to cover


class AlongRod(Configuration):
    """Base of what varies along the rod: tapers of a segment's sizes and routings of a tendon."""

    def misfit(self, place: Any) -> str | None:
        """Error message for what does not fit the place along the rod; None if it fits.

        The place is a segment's length, or a tendon's (first, last) arc lengths [m].
        """
        return None

    def wavelength(self) -> float:
        """Shortest wavelength [m], which quadrature has to resolve.

        It is infinite for a line, twice the least distance of a table.
        """
        table = getattr(self, "arc_length", ())
        if not table:
            return float("inf")
        distances = np.diff(table)
        return 2 * float(distances.min())

    @field_validator("arc_length", check_fields=False)
    @classmethod
    def _increases(cls, arc_length: tuple[float, ...]) -> tuple[float, ...]:
        distances = np.diff(arc_length)
        if not np.all(distances >= SHORTEST):
            raise ValueError(f"should increase, by at least {SHORTEST:g} m")
        return arc_length

    @field_validator("size", "y", "z", check_fields=False)
    @classmethod
    def _one_per_arc_length(cls, values: Any, info: ValidationInfo) -> Any:
        if "arc_length" in info.data:  # if not, it is wrong itself
            count = len(info.data["arc_length"])
            if len(values) != count:
                raise ValueError(f"should have one entry per arc_length, {count}")
        return values


class Taper(AlongRod):
    """Base of the tapers: a size of a segment, such as its radius, that varies along it."""

    @abstractmethod
    def size_and_slope(self, arc_length: Array, segment_length: float) -> tuple[Array, Array]:
        """Computes the size and its derivative along the rod.

        Args:
            arc_length: (...) [m] from the segment's start.
            segment_length: of the segment [m].

        Returns:
            Size [m] and derivative [-], each (...).
        """


TAPERS: TableRegistry[Taper] = TableRegistry("taper", Taper)
"""Registered tapers, by the `type` that tables name."""


@register("taper", "linear")
class LinearTaper(Taper):
    """Linear taper over the whole segment, from `base` to `tip` [m]."""

    type: Literal["linear"] = "linear"
    base: Length  # at the start of the segment [m]
    tip: Length  # at its end [m]

    def size_and_slope(self, arc_length: Array, segment_length: float) -> tuple[Array, Array]:
        change = self.tip - self.base
        slope = change / segment_length
        size = self.base + slope * arc_length
        return size, np.full_like(arc_length, slope)


@register("taper", "table")
class TaperTable(Taper):
    """Tabulated sizes at arc lengths, interpolated by PCHIP.

    Both are in [m], the arc lengths from the segment's start to its end.

    PCHIP (Fritsch and Carlson 1980) never overshoots, so the size stays positive between positive
    values. Scenes may say `radius` for `size`.
    """

    type: Literal["table"] = "table"
    # increasing, from 0 to the length of the segment [m]
    arc_length: tuple[Number, ...] = Field(min_length=2)
    # one per arc length [m]
    size: tuple[Length, ...] = Field(validation_alias=AliasChoices("size", "radius"))

    def size_and_slope(self, arc_length: Array, segment_length: float) -> tuple[Array, Array]:
        # here: it takes longer to import than all else that most scenes need
        from scipy.interpolate import PchipInterpolator

        curve = PchipInterpolator(self.arc_length, self.size)
        slope = curve.derivative()
        return curve(arc_length), slope(arc_length)

    def misfit(self, segment_length: float) -> str | None:
        first, *_, last = self.arc_length
        distance = abs(last - segment_length)
        ends_there = distance <= ROUND_OFF * segment_length
        if first == 0.0 and ends_there:
            return None
        return (
            f"should cover the segment, 0 to {segment_length:g}, but its arc_length runs from"
            f" {first:g} to {last:g}"
        )


def _kind_of_size(value: Any) -> Any:
    """Tag of a size: whether it is a taper or a number."""
    if isinstance(value, Taper):
        return "taper"
    return "number"


Size = Annotated[
    Annotated[Length, Tag("number")] | Annotated[SerializeAsAny[Taper], Tag("taper")],
    Discriminator(_kind_of_size),
    BeforeValidator(TAPERS.parse),
]
"""A length [m], or a taper, also as a table with its `type`."""


class TendonRouting(AlongRod):
    """Base of the tendon routings.

    Arc lengths are measured from the rod's base; y, z span the section.
    """

    @property
    def direction(self) -> float | None:
        """Direction [rad] from y towards z in which `radius` is that of the rod's outline.

        By default there is none: `radius` is then that of the circle around the section.
        """
        return None

    @abstractmethod
    def offset_and_slope(
        self, arc_length: Array, radius: Array, radius_slope: Array, ends: Ends
    ) -> tuple[Array, Array]:
        """Offset of the tendon from the axis and its derivative along the rod.

        Args:
            arc_length: (m,) [m] from the rod's base.
            radius: (m,) of the rod there [m], see `direction`.
            radius_slope: (m,) d radius/dX there [-].
            ends: the tendon's first and last arc length [m].

        Returns:
            y and z [m], and their d/dX [-], each (m, 2).
        """

    def turn_rate(self) -> float:
        """Returns the greatest angle per arc length by which the tendon winds around the axis.

        Returns:
            The rate [rad/m], 0 for one that does not wind.
        """
        return 0.0


ROUTINGS: TableRegistry[TendonRouting] = TableRegistry("routing", TendonRouting)
"""Registered tendon routings, by the `type` that tables name."""


@register("routing", "straight")
class StraightRouting(TendonRouting):
    """Straight tendon, parallel to the axis at `offset` (y, z) [m]."""

    type: Literal["straight"] = "straight"
    offset: Offset  # (y, z) from the axis [m]

    def offset_and_slope(
        self, arc_length: Array, radius: Array, radius_slope: Array, ends: Ends
    ) -> tuple[Array, Array]:
        yz = np.array(self.offset)
        repeats = (len(arc_length), 1)
        offset = np.tile(yz, repeats)
        return offset, np.zeros_like(offset)


@register("routing", "converging")
class ConvergingRouting(TendonRouting):
    """Converging tendon, along a line between two offsets (y, z) [m].

    It begins at `start_offset` and ends at `end_offset`.
    """

    type: Literal["converging"] = "converging"
    start_offset: Offset  # (y, z) from the axis where the tendon begins [m]
    end_offset: Offset  # (y, z) where it ends [m]

    def offset_and_slope(
        self, arc_length: Array, radius: Array, radius_slope: Array, ends: Ends
    ) -> tuple[Array, Array]:
        start, end = ends
        end_offset = np.array(self.end_offset)
        way = end_offset - self.start_offset
        slope = way / (end - start)
        from_start = arc_length - start
        change = np.outer(from_start, slope)
        offset = self.start_offset + change
        # the same at all arc lengths
        repeats = (len(arc_length), 1)
        slopes = np.tile(slope, repeats)
        return offset, slopes


@register("routing", "surface")
class SurfaceRouting(TendonRouting):
    """Tendon at a fixed fraction of the way from the axis to the rod's outline.

    It follows a taper, and stays inside of a flat section up to the fraction 1.

    y = fraction r(X) cos(angle), z = fraction r(X) sin(angle), `angle` in degrees from y towards z,
    with the distance r of the outline in that direction.
    """

    type: Literal["surface"] = "surface"
    fraction: NotNegative = 1.0  # of the way from the axis to the outline [-]
    angle: Number  # from y towards z [deg]

    @property
    def direction(self) -> float:
        """Direction [rad] in which the outline's distance counts."""
        return float(np.deg2rad(self.angle))

    def offset_and_slope(
        self, arc_length: Array, radius: Array, radius_slope: Array, ends: Ends
    ) -> tuple[Array, Array]:
        y = np.cos(self.direction)
        z = np.sin(self.direction)
        yz = np.array([y, z])
        way = self.fraction * yz
        offset = np.outer(radius, way)
        slope = np.outer(radius_slope, way)
        return offset, slope


@register("routing", "helix")
class HelixRouting(TendonRouting):
    """Helical tendon around the axis at a fixed `radius` [m].

    y = radius cos(phase + angular_rate X), z = radius sin(phase + angular_rate X); `phase` in
    degrees, `angular_rate` in rad/m, positive from y towards z.
    """

    type: Literal["helix"] = "helix"
    radius: Length  # distance from the axis [m]
    angular_rate: Number  # angle per arc length, from y towards z [rad/m]
    phase: Number = 0.0  # angle at the base [deg]

    def offset_and_slope(
        self, arc_length: Array, radius: Array, radius_slope: Array, ends: Ends
    ) -> tuple[Array, Array]:
        phase = np.deg2rad(self.phase)
        turned = self.angular_rate * arc_length
        angle = phase + turned
        y = self.radius * np.cos(angle)
        z = self.radius * np.sin(angle)
        offset = np.stack([y, z], axis=-1)
        across = [-z, y]
        tangent = np.stack(across, axis=-1)
        slope = self.angular_rate * tangent
        return offset, slope

    def turn_rate(self) -> float:
        return abs(self.angular_rate)

    def wavelength(self) -> float:
        if not self.angular_rate:
            return float("inf")
        return 2 * np.pi / abs(self.angular_rate)


@register("routing", "table")
class TableRouting(TendonRouting):
    """Tabulated tendon through points, by not-a-knot cubic splines.

    The points (`y`, `z`) [m] stand at `arc_length` [m], and are at least four.

    The table has to cover the tendon from end to end.
    """

    type: Literal["table"] = "table"
    # increasing, from the tendon's start to its end at least [m]
    arc_length: tuple[Number, ...] = Field(min_length=4)
    y: tuple[Number, ...]  # offsets from the axis, one per arc length [m]
    z: tuple[Number, ...]  # likewise [m]

    def offset_and_slope(
        self, arc_length: Array, radius: Array, radius_slope: Array, ends: Ends
    ) -> tuple[Array, Array]:
        # here: it takes longer to import than all else that most scenes need
        from scipy.interpolate import CubicSpline

        columns = [self.y, self.z]
        points = np.column_stack(columns)
        curve = CubicSpline(self.arc_length, points)
        offset = curve(arc_length)
        slope = curve(arc_length, 1)
        return offset, slope

    def misfit(self, ends: Ends) -> str | None:
        first, *_, last = self.arc_length
        slack = ROUND_OFF * (last - first)
        start, end = ends
        begins_before = first - slack <= start
        is_covered = begins_before and end <= last + slack
        if is_covered:
            return None
        return (
            f"should cover the tendon, {start:g} to {end:g}, but its arc_length runs from"
            f" {first:g} to {last:g}"
        )


Routing = Annotated[SerializeAsAny[TendonRouting], BeforeValidator(ROUTINGS.parse)]
"""A tendon routing, also as a table with its `type`."""
