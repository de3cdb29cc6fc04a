"""Clusters of recordings whose errors are common, and recordings held out of a fit to judge it."""

import itertools
from collections.abc import Sequence

import numpy as np

from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.tables import read_number
from soft_tendon_env.tools.types import Array

SHARE = "0.25"  # of recordings that are held out by default
# how far apart commands may be that are the same
SAME = 0.02  # of a tendon's range in the data
EXACT = 0.005  # of the strongest command


def split(recordings: Sequence[Recording], held_out: str = SHARE) -> list[list[Recording]]:
    """Splits recordings into those to fit to and held-out ones, cluster by cluster.

    Args:
        recordings: in the order of the data.
        held_out: a share below 1 of the clusters, evenly over the data, or a column that is not
            zero in held-out recordings.

    Returns:
        Recordings to fit to, and held-out ones, each in the order of the data.

    Raises:
        ValueError: for a share outside of 0 to 1, a column that is missing or has no numbers, and
            where nothing is left to fit to.
    """
    try:
        share = float(held_out)
    except ValueError:
        is_out = _held_out_by_column(recordings, held_out)
    else:
        is_out = _held_out_by_share(recordings, share)
    if is_out.all():
        text = (
            f"held_out is {held_out!r}, which leaves nothing to fit to of {len(recordings)}"
            " recordings"
        )
        raise ValueError(f"{text}: those with the same commands, or of one group, stay together")
    is_kept = np.logical_not(is_out)
    fit_part = [*itertools.compress(recordings, is_kept)]
    judge_part = [*itertools.compress(recordings, is_out)]
    return [fit_part, judge_part]


def _held_out_by_column(recordings: Sequence[Recording], column: str) -> Array:
    """Which recordings (recordings,) have another number than zero in a column.

    Raises ValueError.
    """
    cells = [recording.columns.get(column, "") for recording in recordings]
    numbers = np.array(
        [
            read_number(recording.where, column, cell)
            for recording, cell in zip(recordings, cells, strict=True)
        ]
    )
    if np.isnan(numbers).any():
        columns = {name for recording in recordings for name in recording.columns}
        raise ValueError(
            f"held_out is {column!r}: there is no column of that name with numbers:"
            f" {not_among(column, columns)}"
        ) from None
    return np.asarray(numbers != 0.0)


def _held_out_by_share(recordings: Sequence[Recording], share: float) -> Array:
    """Which recordings (recordings,) are of a share of the clusters, spread evenly.

    Raises ValueError.
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(
            f"held_out is {share:g}: it should be a share from 0 to below 1, or a column"
        )
    cluster = clusters(recordings)
    count = cluster.max(initial=-1) + 1
    out_count = round(share * count)
    # the middle cluster of each of as many equal stretches of the data as are held out
    middle_of_stretch = np.arange(out_count) + 0.5
    middles = middle_of_stretch * count / max(out_count, 1)
    chosen = middles.astype(int)
    return np.asarray(np.isin(cluster, chosen))


def clusters(recordings: Sequence[Recording]) -> Array:
    """Returns clusters of recordings with common errors.

    They are those of a group, or where there are no groups those with the same commands.

    Args:
        recordings: in the order of the data.

    Returns:
        Index (recordings,) that those of a cluster share, from 0 in the order of the data.
    """
    names = [recording.group for recording in recordings]
    if not any(names):
        return same_commands(recordings)
    in_order = [*dict.fromkeys(names)]
    indices = [in_order.index(name) for name in names]
    return np.array(indices)


def same_commands(recordings: Sequence[Recording]) -> Array:
    """Clusters of recordings with the same commands.

    Of motions the difference is the mean over their samples, since a start may be a sample late;
    the last command is held on.

    Args:
        recordings: in the order of the data.

    Returns:
        Index (recordings,) that those of a cluster share, from 0 in the order of the data.
    """
    if not recordings:
        return np.zeros(0, dtype=int)
    lengths = (len(recording.command) for recording in recordings)
    longest = max(lengths)
    samples = np.arange(longest)
    rows = list[Array]()
    for recording in recordings:
        last = len(recording.command) - 1
        held_on = np.minimum(samples, last)
        rows.append(recording.command[held_on])
    commands = np.array(rows)  # (recordings, samples, n_a)
    spans = np.ptp(commands, axis=(0, 1))
    spread = SAME * spans
    largest = np.abs(commands).max()
    exact = EXACT * largest
    tiny = np.finfo(float).tiny
    tolerance = np.maximum(spread, exact) + tiny
    cluster = np.full(len(recordings), -1)
    while (cluster < 0).any():
        # the first that has no cluster makes one, of all that are near
        first = np.argmax(cluster < 0)
        way = commands - commands[first]
        difference = np.abs(way)
        of_tendons = difference / tolerance
        of_samples = of_tendons.max(axis=2)
        is_near = of_samples.mean(axis=1) <= 1.0
        is_free = cluster < 0
        cluster[is_near & is_free] = cluster.max() + 1
    return cluster
