"""Types of arrays and of physical quantities, with bounds.

Within these, products, powers and ratios neither overflow nor vanish.

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

LEAST = 1e-20
"""Smallest size of a quantity in SI units, but zero: those of all arms, from cells to ships, are
greater with room to spare."""
GREATEST = 1e20
"""Greatest size of a quantity in SI units, likewise."""
SHORTEST = 1e-9
"""Shortest length [m]: sections and stiffnesses take the fourth power of it."""
LONGEST = 1e6
"""Greatest length [m], likewise."""
SOONEST = 1e-7
"""Shortest time step [s]: a second takes minutes."""
FASTEST = 1e5
"""Highest frequency [Hz] of what is prescribed in time, and speed [rad/s] of what turns."""


def _between(least: float, greatest: float, unit: str = "") -> AfterValidator:
    """Refuses a number, but zero, whose size is not between these.

    Zero is for the type to judge.
    """

    def check(value: float) -> float:
        if value and not least <= abs(value) <= greatest:
            message = f"should be {least:g} to {greatest:g}{unit}"
            raise ValueError(message)
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
UNIT = 1e-3
"""By how much the length of a unit quaternion may be off: numbers with four digits have it."""


def _is_unit(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    problem = None
    size = math.hypot(*quaternion)
    if len(quaternion) != 4:
        problem = f"four numbers, not {len(quaternion)}"
    elif abs(size - 1.0) > UNIT:
        problem = f"length 1, not {size:.4g}"
    if problem is not None:
        raise ValueError(
            f"should have {problem}: (w, x, y, z) of a rotation within {UNIT:g}, (1, 0, 0, 0) for"
            " none"
        )
    return quaternion


Quaternion = Annotated[tuple[Number, ...], AfterValidator(_is_unit)]
"""(w, x, y, z), whose length is for its user to make 1."""


def _is_direction(vector: Triple) -> Triple:
    if max(map(abs, vector)) < LEAST:
        raise ValueError("should be a direction, not zero")
    return vector


Direction = Annotated[Triple, AfterValidator(_is_direction)]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
"""Metres by unit of length."""
COMMANDS = {"N": "tension", "m": "displacement"}
"""Names of commands by their unit; displacements are those by which actuators pull tendons in."""
LENGTH = re.compile(rf"\s*([-+.\de]+)\s*({'|'.join(UNITS)})\s*")
"""Texts of a number and a unit of length."""


def is_length(text: str) -> bool:
    """Whether a text is a number with a unit of length, such as "1mm"."""
    return LENGTH.fullmatch(text) is not None


def read_length(text: object) -> float:
    """Metres of a text such as "1mm" or "0.05 cm".

    Raises ValueError.
    """
    metres = math.nan
    match = LENGTH.fullmatch(str(text))
    if match is not None:
        with contextlib.suppress(ValueError):  # such as of "1e", which stays NaN
            number = float(match[1])
            unit = UNITS[match[2]]
            metres = number * unit
    if not 0.0 < metres < math.inf:
        raise ValueError(
            f"should be a positive length with its unit ({', '.join(UNITS)}), such as 1mm"
        )
    return metres


GivenLength = Annotated[float, BeforeValidator(read_length)]
"""Metres, given as a text with its unit."""


def length_text(metres: float) -> str:
    """Text of a length in millimetres, as `read_length` takes it."""
    return f"{1e3 * metres:.3g}mm"
