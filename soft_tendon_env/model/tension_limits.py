"""Limits of commands: a word where an analysis goes beyond what actuators can do, which it may."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from soft_tendon_env.tools.types import Array

# share of its range by which a command may be beyond it
ROUND_OFF = 1e-9

_erring = ContextVar("_erring", default=False)


class TensionLimitWarning(UserWarning):
    """A tendon is pulled, or pushed, beyond its `tension_limits`."""


@contextmanager
def erring_actuators() -> Iterator[None]:
    """Context in which commands are those of actuators that err, as an estimator believes.

    Beyond limits they are not warned of.
    """
    before = _erring.set(True)
    try:
        yield
    finally:
        _erring.reset(before)


def warn_beyond_limits(limits: Sequence[Sequence[float]], command: Array, unit: str = "N") -> None:
    """Warns of the first tendon whose commands are beyond its limits, in words that do not change.

    Args:
        limits: least and greatest command of each tendon (n_a, 2).
        command: (.., n_a).
        unit: of both.
    """
    if _erring.get():
        return
    if command.ndim == 1:
        low = command
        high = command
    else:
        rows = command.reshape(-1, len(limits))
        low = rows.min(axis=0, initial=np.inf)
        high = rows.max(axis=0, initial=-np.inf)
    columns = zip(limits, low.tolist(), high.tolist(), strict=True)
    for i, ((least, greatest), lowest, highest) in enumerate(columns):
        slack = ROUND_OFF * (greatest - least)
        is_below = lowest < least - slack
        is_above = highest > greatest + slack
        if is_below or is_above:
            text = (
                f"tendons[{i}] goes beyond its tension_limits, {least:g} to {greatest:g} {unit}:"
                " computed as asked, where actuators and environments stop at the limit"
            )
            warnings.warn(text, TensionLimitWarning, stacklevel=3)
            return
