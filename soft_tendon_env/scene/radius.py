"""Radius profiles of a segment: constant, linear taper, or a table interpolated by PCHIP.

To add a profile, write its class here and name it in `Radius` with its type as the tag.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import SHORTEST, Array, Length, Number


class AlongRod(Configuration):
    """Base of what varies along the rod: radius profiles of a segment and routings of a tendon."""

    def misfit(self, place: Any) -> str | None:
        """Error message for what does not fit a segment's length, or a tendon's (first, last) arc lengths [m]; None if it fits."""
        return None

    def wavelength(self) -> float:
        """Shortest wavelength [m], which quadrature has to resolve; infinite for a line, twice the least distance of a table."""
        table = getattr(self, "arc_length", ())
        return 2 * float(np.diff(table).min()) if table else float("inf")

    @field_validator("arc_length", check_fields=False)
    @classmethod
    def _increases(cls, arc_length: tuple[float, ...]) -> tuple[float, ...]:
        if not np.all(np.diff(arc_length) >= SHORTEST):
            raise ValueError(f"should increase, by at least {SHORTEST:g} m")
        return arc_length

    @field_validator("radius", "y", "z", check_fields=False)
    @classmethod
    def _one_per_arc_length(cls, values: Any, info: ValidationInfo) -> Any:
        if "arc_length" in info.data and len(values) != len(info.data["arc_length"]):
            raise ValueError(f"should have one entry per arc_length, {len(info.data['arc_length'])}")
        return values


class RadiusProfile(AlongRod):
    """Base of the radius profiles: a radius that varies along its segment."""

    @abstractmethod
    def radius_and_slope(self, arc_length: Array, segment_length: float) -> tuple[Array, Array]:
        """Radius [m] and its derivative d radius/dX [-] at `arc_length` [m] from the segment's start, both of its shape."""


class LinearRadius(RadiusProfile):
    """Linear taper over the whole segment, from `base` to `tip` [m]."""

    type: Literal["linear"] = "linear"
    base: Length
    tip: Length

    def radius_and_slope(self, arc_length: Array, segment_length: float) -> tuple[Array, Array]:
        slope = (self.tip - self.base) / segment_length
        return self.base + slope * arc_length, np.full_like(arc_length, slope)


class RadiusTable(RadiusProfile):
    """Tabulated radii [m] at arc lengths [m] from the segment's start to its end, interpolated by PCHIP.

    PCHIP (Fritsch and Carlson 1980) never overshoots, so the radius stays positive between positive values.
    """

    type: Literal["table"] = "table"
    arc_length: tuple[Number, ...] = Field(min_length=2)
    radius: tuple[Length, ...]

    def radius_and_slope(self, arc_length: Array, segment_length: float) -> tuple[Array, Array]:
        from scipy.interpolate import PchipInterpolator  # here: it takes longer to import than all else that most scenes need

        curve = PchipInterpolator(self.arc_length, self.radius)
        return curve(arc_length), curve.derivative()(arc_length)

    def misfit(self, segment_length: float) -> str | None:
        first, last = self.arc_length[0], self.arc_length[-1]
        if first == 0.0 and abs(last - segment_length) <= 1e-9 * segment_length:
            return None
        return f"should cover the segment, 0 to {segment_length:g}, but its arc_length runs from {first:g} to {last:g}"


Radius = Annotated[
    Annotated[Length, Tag("number")] | Annotated[LinearRadius, Tag("linear")] | Annotated[RadiusTable, Tag("table")],
    Discriminator(lambda value: value.get("type") if isinstance(value, Mapping) else getattr(value, "type", "number")),
]
