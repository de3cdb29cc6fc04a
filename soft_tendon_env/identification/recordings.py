"""Recordings of a real arm: still holds and sampled motions, from CSV files.

One row is a hold (`hold`, its name), or with a column `time` [s] a sample, of which those with one
`hold` follow each other as one motion. Commands are `tension_i` [N] or `displacement_i` [m], one
for each tendon from 0 on; a marker has `NAME_x`, `NAME_y`, `NAME_z` [m], all of them empty where it
was not seen. The table `[columns]` of the markers' file gives quantities other names and units, and
may name a column `group`, of recordings whose errors are common.
"""

import contextlib
import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta
from pathlib import Path

import numpy as np

from soft_tendon_env.identification.columns import Source, read_columns
from soft_tendon_env.identification.markers import UNITS, MarkerSet
from soft_tendon_env.identification.parameters import command_limits
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.tables import Table, read_number
from soft_tendon_env.tools.types import COMMANDS, Array

REACH = 1.5  # share of the rod's length, from its base, within which a marker may be
NEAR = 0.01  # share of it within which not all markers can be: a rod has a length
LEAST = 0.05  # share of what is allowed from which numbers in another unit are plausible
UNEVEN = 0.3  # share of the sample period by which times may be off equal steps
# sample periods [s] by which a unit of time is guessed
SHORTEST_USUAL = 1e-3
LONGEST_USUAL = 1.0
LONGEST = 4.0  # sample period [s] from which on the unit of time is wrong
LOST = 1e20  # number from which on it is a tracker's sign, as NDI's -3.697314e28 for a lost tool
LATEST = 1e11  # time [s] from which on it is: in the year 5000, for seconds since 1970


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded commands and marker positions.

    They are of one hold (a single sample), or of a motion that begins at rest.
    """

    name: str
    where: str  # file and line of its first row
    command: Array  # (samples, n_a) in the scene's unit, each held until the next sample
    # (samples, m, 3) [m] in the scene's world frame, NaN where they were not measured
    positions: Array
    period: float  # [s] between samples, 0 for a hold
    columns: Mapping[str, str]  # cells of its first row, by the header
    group: str = ""  # its cell in the column of groups, if there is one
    # commands (rows, n_a) of its whole file in order, its own among them; None: its own alone
    session: Array | None = None
    row: int = 0  # of its first sample in the session


def read_recordings(
    paths: Sequence[str | Path], scene: Scene, markers: MarkerSet
) -> list[Recording]:
    """Reads recordings of several files together.

    Args:
        paths: CSV files.
        scene: the arm that was recorded.
        markers: its markers, with the frame and the columns of the data.

    Returns:
        The recordings in the order of the files.

    Raises:
        ValueError: in one line that says where, for data that cannot be used.
        FileNotFoundError: for a file that is missing.
    """
    recordings = list[Recording]()
    for path in paths:
        recordings += _read(Path(path), scene, markers)
    times = Counter(recording.name for recording in recordings)
    for name in sorted(times):
        if times[name] > 1:
            raise ValueError(
                f"hold {name!r} is there {times[name]} times: every hold should have a name of its"
                " own"
            )
    return recordings


def _read(path: Path, scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of one file."""
    table, sources = _read_columns(path, scene, markers)
    rows = [where for where, _ in table.rows]
    command = _commands(table, sources, scene)
    positions = _positions(table, sources, markers)
    times = None
    if "time" in sources:
        times = _times(table, sources["time"])
    from_base = positions - scene.base.position
    first_marker = next(iter(markers.markers))
    _check_reach(from_base, rod_length(scene), path, first_marker)
    if "hold" in sources:
        place = table.header.index(sources["hold"].column)
        names = [cells[place] for _, cells in table.rows]
    else:
        names = [path.stem] * len(rows)
    recordings = list[Recording]()
    # rows of one hold that follow each other are samples of a motion
    row_range = range(len(rows))
    for name, group in itertools.groupby(row_range, key=names.__getitem__):
        samples = [*group]
        first = samples[0]
        where, cells = table.rows[first]
        wheres = [rows[i] for i in samples]
        own_times = np.empty(0)
        if times is not None:
            own_times = times[samples]
        period = _period(name, own_times, wheres)
        columns = dict(zip(table.header, cells, strict=True))
        group_name = ""
        if "group" in sources:
            group_name = columns[sources["group"].column]
        recording = Recording(
            name=name,
            where=where,
            command=command[samples],
            positions=positions[samples],
            period=period,
            columns=columns,
            group=group_name,
            row=first,
            session=command,
        )
        check_commands(recording, scene)
        recordings.append(recording)
    return recordings


def _read_columns(path: Path, scene: Scene, markers: MarkerSet) -> tuple[Table, dict[str, Source]]:
    """Table of a file, and the columns that hold its quantities."""
    commands = _command_names(scene)
    positions = _position_names(markers)
    units = dict.fromkeys(commands, scene.effects.command_unit)
    units |= dict.fromkeys(positions, "m")
    units["time"] = "s"
    # of text
    units["hold"] = ""
    if "group" in markers.columns:
        units["group"] = ""
    return read_columns(path, markers, units)


def _command_names(scene: Scene) -> list[str]:
    """Quantities of the commands, tendon by tendon."""
    command = COMMANDS[scene.effects.command_unit]
    tendon_count = len(scene.tendons)
    return [f"{command}_{i}" for i in range(tendon_count)]


def _position_names(markers: MarkerSet) -> list[str]:
    """Quantities of the markers' positions, marker by marker."""
    return [f"{name}_{axis}" for name in markers.markers for axis in "xyz"]


def _commands(table: Table, sources: Mapping[str, Source], scene: Scene) -> Array:
    """Commands (rows, n_a) in the scene's unit.

    Raises ValueError for an empty one.
    """
    columns = [sources[name] for name in _command_names(scene)]
    command = table.numbers(columns)
    empty = np.argwhere(np.isnan(command))
    if len(empty):
        row, tendon = empty[0]
        where, _ = table.rows[row]
        name = columns[tendon].column
        raise ValueError(f"{where}: {name} is empty: it should be a number")
    return command


def _positions(table: Table, sources: Mapping[str, Source], markers: MarkerSet) -> Array:
    """Positions (rows, m, 3) [m] of markers in the world, NaN where they were not seen."""
    columns = [sources[name] for name in _position_names(markers)]
    numbers = table.numbers(columns)
    inside = numbers.reshape(len(table.rows), -1, 3)
    # of a tool that NDI's trackers lost
    largest = np.abs(inside).max(axis=2)
    is_lost = largest > LOST
    inside[is_lost] = np.nan
    # three zeros are what some trackers write for what was not seen; a marker may be at the base
    is_at_origin = (inside == 0.0).all(axis=2)
    is_beyond_base = markers.arc_lengths > 0.0
    is_unseen = is_at_origin & is_beyond_base
    inside[is_unseen] = np.nan
    frame = markers.frame
    turned = inside @ frame.rotation.T
    return np.asarray(turned + frame.translation)


def _times(table: Table, source: Source) -> Array:
    """Times (rows,) [s] of a column of numbers, or of dates and times of day by ISO 8601.

    Raises ValueError.
    """
    place = table.header.index(source.column)
    times = np.empty(len(table.rows))
    for row, (where, cells) in enumerate(table.rows):
        text = cells[place]
        if ":" in text:
            times[row] = _iso_seconds(where, source.column, text)
        else:
            times[row] = read_number(where, source.column, text, source.factor)
    return times


def _iso_seconds(where: str, name: str, text: str) -> float:
    """Seconds since 1970 of a date and time; of a time alone, since midnight. Raises ValueError."""
    with contextlib.suppress(ValueError):
        of_day = time.fromisoformat(text)
        since_midnight = timedelta(
            hours=of_day.hour,
            minutes=of_day.minute,
            seconds=of_day.second,
            microseconds=of_day.microsecond,
        )
        return since_midnight.total_seconds()
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(
            f"{where}: {name} is {text!r}: it should be a number, or a time by ISO 8601"
        ) from error
    # a time without a zone is read as UTC: only differences matter
    if moment.tzinfo:
        in_zone = moment
    else:
        in_zone = moment.replace(tzinfo=UTC)
    return in_zone.timestamp()


def _period(name: str, times: Array, wheres: Sequence[str]) -> float:
    """Sample period [s] of a motion at times (rows,) [s] in equal steps.

    It is 0 for a hold, without them. Raises ValueError.
    """
    # one row before time 0 is a log that was cut off behind the row at rest
    is_alone = len(times) == 1
    is_cut_log = is_alone and not times[0] >= 0.0
    if not len(times) or is_cut_log:
        if len(wheres) > 1:
            raise ValueError(
                f"{wheres[1]}: hold {name!r} has a second row: samples of a motion need a column"
                " time [s]"
            )
        return 0.0
    if len(times) == 1:
        raise ValueError(f"{wheres[0]}: a motion should have at least two samples")
    change = np.diff(times)
    if not (change > 0.0).all():
        row = int(np.argmin(change > 0.0)) + 1
        raise ValueError(
            f"{wheres[row]}: time is {times[row]:.9g} s after {times[row - 1]:.9g} s: it should be"
            " a number, and grow"
        )
    middle = float(np.median(change))
    if middle >= LONGEST or times[-1] > LATEST:
        raise ValueError(f"{wheres[0]}: {_time_unit_guess(middle)}")
    # a line through the times, from which none is far
    steps = np.arange(len(times))
    elapsed = times - times[0]
    line = np.polyfit(steps, elapsed, 1)
    period, first = map(float, line)
    on_line = first + period * steps
    deviation = np.abs(elapsed - on_line)
    if deviation.max() > UNEVEN * period:
        from_middle = np.abs(change - middle)
        row = int(np.argmax(from_middle))
        text = (
            f"time goes on by {change[row]:.6g} s: it should in equal steps, which are"
            f" {middle:.6g} s in the middle"
        )
        raise ValueError(
            f"{wheres[row + 1]}: {text}; a row that was lost goes in with its command and empty"
            " markers"
        )
    return period


def _time_unit_guess(period: float) -> str:
    """Text of an error about samples that are too far apart in time [s].

    It says a unit in which they would have a usual period.
    """
    unit = "..."
    for name, factor in UNITS["s"].items():
        if SHORTEST_USUAL <= period * factor < LONGEST_USUAL:
            unit = name
            break
    return (
        f"samples are {period:.4g} s apart in time: is it in {unit}? [columns] of the markers' file"
        f' says so: time = {{ unit = "{unit}" }}'
    )


def check_commands(recording: Recording, scene: Scene) -> None:
    """Checks that commands are within the scene's limits.

    Args:
        recording: with commands (samples, n_a) in the scene's unit.
        scene: the arm.

    Raises:
        ValueError: with the command's row, value and limits, and a unit that it may be in.
    """
    unit = scene.effects.command_unit
    kind = COMMANDS[unit]
    for i, (least, greatest) in enumerate(command_limits(scene)):
        values = recording.command[:, i]
        is_outside = (values < least) | (values > greatest)
        outside = values[is_outside]
        if outside.size:
            name = f"{kind}_{i}"
            text = (
                f"{name} is {outside[0]:g} {unit}: the scene's {kind}_limits are {least:g} to"
                f" {greatest:g} {unit}"
            )
            largest = float(np.abs(values).max())
            most = max(-least, greatest)
            guess = _unit_guess(name, largest, most, unit)
            raise ValueError(f"{recording.where}: {text}{guess}")


def _check_reach(positions: Array, length: float, path: Path, marker: str) -> None:
    """Raises ValueError where markers lie further than the rod reaches, or all at the base.

    Markers (rows, m, 3) are seen from the base.
    """
    distances = np.linalg.norm(positions, axis=-1)
    if np.isnan(distances).all():
        raise ValueError(f"{path}: no marker was seen")
    distance = float(np.nanmax(distances))
    reach = REACH * length
    text = f"{path}: markers are up to {distance:.4g} m from the base of a rod of {length:g} m"
    if distance > reach:
        guess = _unit_guess(f'"{marker}_*"', distance, reach, "m")
        if not guess:
            guess = "; are the [frame] of --markers and the scene's [base] right?"
        raise ValueError(f"{text}{guess}")
    if distance < NEAR * length:
        raise ValueError(f"{text}: is the arm's length or the unit wrong? Positions are in m")


def _unit_guess(quantity: str, value: float, most: float, unit: str) -> str:
    """End of an error about a value that should be at most `most`.

    It says units in which the value would be plausible, and where to say so.
    """
    likely = [
        name
        for name, factor in UNITS[unit].items()
        if name != unit and LEAST * most <= value * factor <= most
    ]
    if not likely:
        return ""
    return (
        f"; is it in {' or '.join(likely)}? [columns] of the markers' file says so: {quantity} ="
        f' {{ unit = "{likely[0]}" }}'
    )
