"""Equal steps of recorded times: the sample period, how far times are off it, and which samples were lost."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.markers import UNITS
from soft_tendon_env.tools.types import Array

UNEVEN, LARGEST = 1e-3, 0.3
"""Shares of the sample period: up to the first times count as even; further off than the other they are refused."""
MOST_LOST = 5
"""Samples that may be lost one after another: their commands are not known."""
SHORTEST, LONGEST = 1e-5, 100.0
"""Sample periods [s] beyond which the unit of time is wrong."""
LATEST = 1e11
"""Time [s] beyond which its unit is wrong: three thousand years after 1970."""
USUAL = (1e-3, 1.0)
"""Sample periods [s] by which a unit of time is guessed."""


class Steps(NamedTuple):
    """Equal steps of times, in which the recorded samples have their places."""

    period: float  # [s]
    places: Array  # (n,) of the samples, 0, 1, ... but for lost ones
    note: str | None  # what is done to the times, as a sentence; None where they are even

    def held(self, commands: Array) -> Array:
        """Commands (steps, n_a) of recorded ones (n, n_a), of which each is held until the next."""
        return commands[np.searchsorted(self.places, np.arange(self.places[-1] + 1), side="right") - 1]

    def spread(self, values: Array) -> Array:
        """Values (steps, ...) of recorded ones (n, ...), NaN where a sample was lost."""
        found = np.full((int(self.places[-1]) + 1, *values.shape[1:]), np.nan)
        found[self.places] = values
        return found


def steps_of(times: Array, wheres: Sequence[str]) -> Steps:
    """Equal steps of recorded times (n,) [s], which stand at `wheres`. Raises ValueError for times in no equal steps."""
    if len(times) < 2:
        raise ValueError(f"{wheres[0]}: a motion should have at least two samples")
    change = np.diff(times)
    if (odd := np.flatnonzero(~(change > 0.0))).size:
        at = int(odd[0]) + (not np.isnan(times[odd[0]]))
        raise ValueError(f"{wheres[at]}: time is {times[at]:.9g} s after {times[odd[0]]:.9g} s: it should be a number, and grow")
    middle = float(np.median(change))
    if not SHORTEST <= middle <= LONGEST or times[-1] > LATEST:
        like = next((unit for unit, factor in UNITS["s"].items() if USUAL[0] <= middle * factor < USUAL[1]), "...")
        guess = f'is it in {like}? [columns] of the markers\' file says so: time = {{ unit = "{like}" }}'
        raise ValueError(f"{wheres[0]}: samples are {middle:.4g} s apart in time: {guess}")
    gaps = np.rint(change / middle).astype(int)
    places = np.concatenate([[0], np.cumsum(gaps)])
    period, first = map(float, np.polyfit(places, times - times[0], 1))
    off = times - times[0] - first - period * places
    far = np.abs(off) > LARGEST * period
    if gaps.min() < 1 or far.any():
        at = int(np.argmax(far)) if far.any() else int(np.argmin(gaps)) + 1
        raise ValueError(f"{wheres[at]}: time should go on in equal steps, which are {middle:.6g} s in the middle")
    if gaps.max() > 1 + MOST_LOST:
        text = f"{gaps.max() - 1} samples are missing behind it, and their commands with them: give what follows as a motion of its own"
        raise ValueError(f"{wheres[int(np.argmax(gaps))]}: {text}")
    notes = []
    if np.abs(off).max() > UNEVEN * period:
        notes.append(f"times are up to {1e3 * np.abs(off).max():.3g} ms off steps of {1e3 * period:.6g} ms, which are taken")
    if lost := int((gaps - 1).sum()):
        notes.append(
            f"{lost} of {places[-1] + 1} samples of {1e3 * period:.6g} ms were lost, the first behind {wheres[int(np.argmax(gaps > 1))]}"
        )
    return Steps(period, places, "; ".join(notes) or None)
