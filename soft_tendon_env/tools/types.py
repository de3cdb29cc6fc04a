"""Types of arrays and of physical quantities, with bounds within which products, powers and ratios
neither overflow nor vanish.

Lengths with a unit, such as "1mm", are read and written here too.
"""

import contextlib
import math
import re
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field

Array = NDArray[np.float64]  # of numbers; its shape stands beside it
Single = NDArray[np.float32]  # numbers of policy networks, in single precision

LEAST, GREATEST = (
    1e-20,
    1e20,
    # of quantities in SI units: those of all arms, from cells to ships, lie between with room to
    # spare
)
SHORTEST, LONGEST = (
    1e-9,
    1e6,
)  # of lengths [m], of which sections and stiffnesses take the fourth power
SOONEST = 1e-7  # shortest time step [s]: a second takes minutes
FASTEST = (
    1e5  # highest frequency [Hz] of what is prescribed in time, and speed [rad/s] of what turns
)


def _between(least: float, greatest: float, unit: str = "") -> AfterValidator:
    """Refuses a number, but zero, whose size is not between these; that of zero is for the type to
    judge."""

    def check(value: float) -> float:
        if value and not least <= abs(value) <= greatest:
            raise ValueError(f"should be {least:g} to {greatest:g}{unit}")
        return value

    return AfterValidator(check)


Number = Annotated[float, Field(ge=-GREATEST, le=GREATEST)]
Positive = Annotated[float, Field(gt=0), _between(LEAST, GREATEST)]
NotNegative = Annotated[float, Field(ge=0), _between(LEAST, GREATEST)]
TimeStep = Annotated[float, Field(gt=0), _between(SOONEST, GREATEST, " s")]
Frequency = Annotated[float, Field(ge=0, le=FASTEST)]
Turning = Annotated[float, Field(ge=-FASTEST, le=FASTEST)]
Length = Annotated[float, Field(gt=0), _between(SHORTEST, LONGEST, " m")]
Triple = tuple[Number, Number, Number]
UNIT = 1e-3  # by which the length of a unit quaternion may be off: numbers with four digits have it


def _is_unit(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    size = math.hypot(*quaternion)
    if len(quaternion) != 4 or abs(size - 1.0) > UNIT:
        what = (
            f"length 1, not {size:.4g}"
            if len(quaternion) == 4
            else f"four numbers, not {len(quaternion)}"
        )
        raise ValueError(
            f"should have {what}: (w, x, y, z) of a rotation within {UNIT:g}, (1, 0, 0, 0) for none"
        )
    return quaternion


Quaternion = Annotated[
    tuple[Number, ...], AfterValidator(_is_unit)
]  # its length is for its user to make 1


def _is_direction(vector: Triple) -> Triple:
    if max(map(abs, vector)) < LEAST:
        raise ValueError("should be a direction, not zero")
    return vector


Direction = Annotated[Triple, AfterValidator(_is_direction)]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
COMMANDS = {
    "N": "tension",
    "m": "displacement",
}  # what is commanded by its unit; displacements: by which actuators pull tendons in
LENGTH = re.compile(rf"\s*([-+.\de]+)\s*({'|'.join(UNITS)})\s*")


def is_length(text: str) -> bool:
    """Whether a text is a number with a unit of length, such as "1mm"."""
    return LENGTH.fullmatch(text) is not None


def read_length(text: object) -> float:
    """Metres of a text such as "1mm" or "0.05 cm". Raises ValueError."""
    with contextlib.suppress(ValueError):
        if (match := LENGTH.fullmatch(str(text))) and 0.0 < (
            value := float(match[1]) * UNITS[match[2]]
        ) < float("inf"):
            return value
    raise ValueError(f"should be a positive length with its unit ({', '.join(UNITS)}), such as 1mm")


GivenLength = Annotated[
    float, BeforeValidator(read_length)
]  # metres, given as a text with its unit


def length_text(metres: float) -> str:
    """Text of a length in millimetres, as `read_length` takes it."""
    return f"{1e3 * metres:.3g}mm"
