"""Limits of commands: a word where an analysis goes beyond what actuators can do, which it may."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from soft_tendon_env.tools.types import Array

ROUND_OFF = 1e-9  # share of its range by which a command may be beyond it
_erring = ContextVar("_erring", default=False)


class TensionLimitWarning(UserWarning):
    """A tendon is pulled, or pushed, beyond its `tension_limits`."""


@contextmanager
def erring_actuators() -> Iterator[None]:
    """Context in which commands are those of actuators that err, as an estimator believes: beyond
    limits they are not warned of."""
    before = _erring.set(True)
    try:
        yield
    finally:
        _erring.reset(before)


def warn_beyond_limits(limits: Sequence[Sequence[float]], asked: Array, unit: str = "N") -> None:
    """Warns where commands (.., n_a) are beyond their limits (n_a, 2), of the first tendon, in
    words that do not change."""
    if _erring.get():
        return
    rows = asked.reshape(-1, len(limits))
    low, high = (
        (asked, asked)
        if asked.ndim == 1
        else (rows.min(axis=0, initial=np.inf), rows.max(axis=0, initial=-np.inf))
    )
    for i, ((least, greatest), lowest, highest) in enumerate(
        zip(limits, low.tolist(), high.tolist(), strict=True)
    ):
        slack = ROUND_OFF * (greatest - least)
        if lowest < least - slack or highest > greatest + slack:
            text = (
                f"tendons[{i}] goes beyond its tension_limits, {least:g} to {greatest:g} {unit}:"
                " computed as asked"
            )
            warnings.warn(
                f"{text}, where actuators and environments stop at the limit",
                TensionLimitWarning,
                stacklevel=3,
            )
            return
