"""Held-out recordings: which of them judge a fit, and which it is made from. Repeats of the same commands stay together."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.types import Array

SHARE = "0.25"
"""Share of recordings that are held out by default."""
SAME, EXACT = 0.02, 0.005
"""Difference up to which commands are the same, in parts of a tendon's range in the data, and least one, in parts of the strongest command:
motors and load cells repeat no better."""


class Split(NamedTuple):
    """Recordings to fit to, and those held out, each in the order of the data."""

    fit: list[Recording]
    held_out: list[Recording]


def split(recordings: Sequence[Recording], held_out: str = SHARE) -> Split:
    """Recordings to fit to and held-out ones.

    held_out: a share below 1 or a number of recordings, stratified by tension, where those with the same commands stay together; a column,
    of which those that are not zero are held out; or COLUMN=NUMBER, those with this number. "0" holds none out. Raises ValueError.
    """
    try:
        wanted = float(held_out)
    except ValueError:
        chosen = _by_column(recordings, held_out)
    else:
        group = same_commands(recordings)
        first = [recordings[i] for i in np.unique(group, return_index=True)[1]]
        kept = _stratified(first, _count(wanted, len(recordings), len(first)))
        chosen = set(np.flatnonzero(np.isin(group, [*kept])).tolist())
    found = Split([own for i, own in enumerate(recordings) if i not in chosen], [own for i, own in enumerate(recordings) if i in chosen])
    if not found.fit:
        text = f"held_out is {held_out!r}, which leaves nothing to fit to of {len(recordings)} recordings"
        raise ValueError(f"{text}: those with the same commands stay together")
    return found


def same_commands(recordings: Sequence[Recording]) -> Array:
    """Index (recordings,) that recordings with the same commands share, counted from 0 in the order of the data.

    Of motions the difference is the mean over their samples, since a start may be a sample late; the last command is held on.
    """
    if not recordings:
        return np.zeros(0, dtype=int)
    samples = np.arange(max(len(own.command) for own in recordings))
    table = np.array([own.command[np.minimum(samples, len(own.command) - 1)] for own in recordings])
    tolerance = np.maximum(SAME * np.ptp(table, axis=(0, 1)), EXACT * np.abs(table).max()) + np.finfo(float).tiny
    group = np.full(len(recordings), -1)
    while (group < 0).any():
        near = (np.abs(table - table[np.argmax(group < 0)]) / tolerance).max(axis=2).mean(axis=1) <= 1.0
        group[near & (group < 0)] = group.max() + 1
    return group


def without_twins(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings without those that are there twice, number for number, and the names of what was left out, as "b (as a)"."""
    first = dict[bytes, Recording]()
    twins = []
    for own in recordings:
        numbers = [own.command, own.positions, [own.period], [] if own.sensed is None else own.sensed]
        other = first.setdefault(b"".join(np.asarray(part).tobytes() for part in numbers), own)
        if other is not own:
            twins.append(f"{own.name} (as {other.name})")
    return [*first.values()], twins


def _count(wanted: float, recordings: int, groups: int) -> int:
    """Number of groups of recordings to hold out."""
    if not (0.0 <= wanted < 1.0 or wanted in range(recordings)):
        allowed = f"should be a share from 0 to below 1, a whole number below {recordings}, a column or COLUMN=NUMBER"
        raise ValueError(f"held_out is {wanted:g}: it {allowed}")
    return round(wanted * groups) if wanted < 1.0 else max(round(wanted * groups / recordings), 1)


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
