"""Delays in control periods."""

SAME = 1e-9
"""Share of a period by which a delay may differ from whole periods and still count as them."""


def whole_periods(delay: float, period: float) -> tuple[int, float]:
    """Number of whole periods in a delay [s], and the rest [s]."""
    whole = int(delay / period + SAME)
    rest = delay - whole * period
    return whole, rest if rest > SAME * period else 0.0
