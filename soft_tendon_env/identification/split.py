"""Held-out recordings: which of them judge a fit, and which it is made from."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.tools.configuration import not_among

SHARE = "0.25"
"""Share of recordings that are held out by default."""


class Split(NamedTuple):
    """Recordings to fit to, and those held out, each in the order of the data."""

    fit: list[Recording]
    held_out: list[Recording]


def split(recordings: Sequence[Recording], held_out: str = SHARE) -> Split:
    """Recordings to fit to and held-out ones.

    held_out: a share below 1 or a number of recordings, stratified by tension; a column, of which those that are not zero are held out; or
    COLUMN=NUMBER, those with this number. "0" holds none out. Raises ValueError.
    """
    try:
        wanted = float(held_out)
    except ValueError:
        chosen = _by_column(recordings, held_out)
    else:
        chosen = _stratified(recordings, _count(wanted, len(recordings)))
    found = Split([own for i, own in enumerate(recordings) if i not in chosen], [own for i, own in enumerate(recordings) if i in chosen])
    if not found.fit:
        raise ValueError(f"held_out is {held_out!r}, which leaves nothing to fit to of {len(recordings)} recordings")
    return found


def _count(wanted: float, recordings: int) -> int:
    if not (0.0 <= wanted < 1.0 or wanted in range(recordings)):
        allowed = f"should be a share from 0 to below 1, a whole number below {recordings}, a column or COLUMN=NUMBER"
        raise ValueError(f"held_out is {wanted:g}: it {allowed}")
    return round(wanted * recordings) if wanted < 1.0 else int(wanted)


def _by_column(recordings: Sequence[Recording], held_out: str) -> set[int]:
    name, equals, text = held_out.partition("=")
    columns = {column for own in recordings for column in own.columns}
    if name not in columns:
        raise ValueError(
            f"held_out is {held_out!r}: there is no column {name!r} of numbers: {not_among(name, columns) if columns else 'none'}"
        )
    try:
        value = float(text) if equals else None
    except ValueError:
        raise ValueError(f"held_out is {held_out!r}: behind = there should be a number") from None
    found = [own.columns.get(name, np.nan) for own in recordings]
    return {i for i, own in enumerate(found) if (own == value if value is not None else np.isfinite(own) and own != 0.0)}


def _stratified(recordings: Sequence[Recording], count: int) -> set[int]:
    """Every so many-th of the recordings in the order of their strongest tendon and how strongly it is pulled."""
    if not count:
        return set()
    command = np.array([np.abs(own.command).max(axis=0) for own in recordings])
    order = np.lexsort((command.max(axis=1), command.argmax(axis=1)))
    places = (np.arange(count) + 0.5) * len(order) / count
    return {int(order[int(place)]) for place in places}
