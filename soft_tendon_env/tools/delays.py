"""Delays in control periods."""

SAME = 1e-9
"""Of a period, what a delay may differ from whole periods and count as them."""


def whole_periods(delay: float, period: float) -> tuple[int, float]:
    """The whole periods of a delay [s], and the rest [s]."""
    whole = int(delay / period + SAME)
    rest = delay - whole * period
    return whole, rest if rest > SAME * period else 0.0
