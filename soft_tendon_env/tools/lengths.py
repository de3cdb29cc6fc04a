"""Lengths with a unit, such as "1mm", read and written."""

import re

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
LENGTH = re.compile(r"\s*([-+.\de]+)\s*([a-z]+)\s*")


def is_length(text: str) -> bool:
    """Whether a text is a number with a unit of length."""
    match = LENGTH.fullmatch(text)
    return match is not None and match[2] in UNITS


def read_length(text: str) -> float:
    """Metres of a text such as "1mm" or "0.05 cm". Raises ValueError."""
    match = LENGTH.fullmatch(text)
    try:
        if match is None or not 0.0 < (value := float(match[1]) * UNITS[match[2]]) < float("inf"):
            raise ValueError
    except (ValueError, KeyError):
        raise ValueError(f"{text!r} should be a positive length with its unit ({', '.join(UNITS)}), such as 1mm") from None
    return value


def length_text(metres: float) -> str:
    """A length in millimetres, as `read_length` takes it."""
    return f"{1e3 * metres:.3g}mm"
