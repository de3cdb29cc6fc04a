"""Types of the numbers in scenes: bounds within which products, powers and ratios of physical quantities neither overflow nor vanish."""

from typing import Annotated

from pydantic import AfterValidator, Field

LEAST, GREATEST = 1e-20, 1e20
"""In SI units: between them lie the quantities of all arms, from those of cells to those of ships, with room to spare."""
SHORTEST, LONGEST = 1e-9, 1e6
"""Lengths [m], of which sections and stiffnesses take the fourth power."""
SOONEST = 1e-7
"""Shortest time step [s]: a second takes minutes."""
FASTEST = 1e5
"""Highest frequency [Hz] of what is prescribed in time, which steps of a sixteenth of a period follow, and [rad/s] of what turns."""


def _between(least: float, greatest: float, unit: str = "") -> AfterValidator:
    """Refuses a number, but zero, whose size is not between these; that of zero is for the type to judge."""

    def check(value: float) -> float:
        if value and not least <= abs(value) <= greatest:
            raise ValueError(f"should be {least:g} to {greatest:g}{unit}")
        return value

    return AfterValidator(check)


def _bounded(value: float) -> float:
    if abs(value) > GREATEST:
        raise ValueError(f"should be within ±{GREATEST:g}")
    return value


def _stepping(value: float) -> float:
    if value < SOONEST:
        raise ValueError(f"should be at least {SOONEST:g} s")
    return value


Number = Annotated[float, AfterValidator(_bounded)]
Positive = Annotated[float, Field(gt=0), _between(LEAST, GREATEST)]
NotNegative = Annotated[float, Field(ge=0), _between(LEAST, GREATEST)]
TimeStep = Annotated[float, Field(gt=0, le=GREATEST), AfterValidator(_stepping)]
Frequency = Annotated[float, Field(ge=0, le=FASTEST)]
Turning = Annotated[float, Field(ge=-FASTEST, le=FASTEST)]
Length = Annotated[float, Field(gt=0), _between(SHORTEST, LONGEST, " m")]
Triple = tuple[Number, Number, Number]
