"""Recordings of a real arm: still holds and sampled motions, from CSV files.

One row is a hold (`hold`, its name), or with a column `time` [s] a sample, of which those with one
`hold` follow each other as one motion. Commands are `tension_i` [N] or `displacement_i` [m], one
for each tendon from 0 on; a marker has `NAME_x`, `NAME_y`, `NAME_z` [m], all of them empty where it
was not seen. The table `[columns]` of the markers' file gives quantities other names and units, and
may name a column `group`, of recordings whose errors are common.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soft_tendon_env.identification.columns import Source, read_columns
from soft_tendon_env.identification.markers import UNITS, MarkerSet
from soft_tendon_env.identification.parameters import command_limits
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.tables import Table
from soft_tendon_env.tools.types import COMMANDS, Array

REACH = 1.5  # share of the rod's length, from its base, within which a marker may be
NEAR = 0.01  # share of it within which not all markers can be: a rod has a length
LEAST = 0.05  # share of what is allowed from which numbers in another unit are plausible
UNEVEN = 0.3  # share of the sample period by which times may be off equal steps
# sample periods [s] by which a unit of time is guessed
SHORTEST_USUAL = 1e-3
LONGEST_USUAL = 1.0
LONGEST = 4.0  # sample period [s] from which on the unit of time is wrong
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
    names = [recording.name for recording in recordings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(
            f"hold {twice[0]!r} is there {names.count(twice[0])} times: every hold should have a"
            " name of its own"
        )
    return recordings


def _read(path: Path, scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of one file."""
    table, sources = _read_columns(path, scene, markers)
    rows = [where for where, _ in table.rows]
    command = _commands(table, sources, scene)
    positions = _positions(table, sources, markers)
    times = table.numbers([sources["time"]]).ravel() if "time" in sources else None
    from_base = positions - scene.base.position
    _check_reach(from_base, rod_length(scene), path, next(iter(markers.markers)))
    if "hold" in sources:
        place = table.header.index(sources["hold"].column)
        names = [cells[place] for _, cells in table.rows]
    else:
        names = [path.stem] * len(rows)
    recordings = list[Recording]()
    # rows of one hold that follow each other are samples of a motion
    for name, group in itertools.groupby(range(len(rows)), key=names.__getitem__):
        samples = [*group]
        where, cells = table.rows[samples[0]]
        wheres = [rows[i] for i in samples]
        own_times = np.empty(0) if times is None else times[samples]
        period = _period(name, own_times, wheres)
        columns = dict(zip(table.header, cells, strict=True))
        recording = Recording(
            name=name,
            where=where,
            command=command[samples],
            positions=positions[samples],
            period=period,
            columns=columns,
            group=columns[sources["group"].column] if "group" in sources else "",
        )
        check_commands(recording, scene)
        recordings.append(recording)
    return recordings


def _read_columns(path: Path, scene: Scene, markers: MarkerSet) -> tuple[Table, dict[str, Source]]:
    """Table of a file, and the columns that hold its quantities."""
    units = dict.fromkeys(_command_names(scene), scene.effects.command_unit)
    units |= dict.fromkeys(_position_names(markers), "m")
    units["time"] = "s"
    # of text
    units["hold"] = ""
    if "group" in markers.columns:
        units["group"] = ""
    return read_columns(path, markers, units)


def _command_names(scene: Scene) -> list[str]:
    """Quantities of the commands, tendon by tendon."""
    command = COMMANDS[scene.effects.command_unit]
    return [f"{command}_{i}" for i in range(len(scene.tendons))]


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
        raise ValueError(f"{where}: {columns[tendon].column} is empty: it should be a number")
    return command


def _positions(table: Table, sources: Mapping[str, Source], markers: MarkerSet) -> Array:
    """Positions (rows, m, 3) [m] of markers in the world, NaN where they were not seen."""
    columns = [sources[name] for name in _position_names(markers)]
    inside = table.numbers(columns).reshape(len(table.rows), -1, 3)
    # three zeros are what some trackers write for what was not seen; a marker may be at the base
    is_zero = (inside == 0.0).all(axis=2)
    inside[is_zero & (markers.arc_lengths > 0.0)] = np.nan
    frame = markers.frame
    return np.asarray(inside @ frame.rotation.T + frame.translation)


def _period(name: str, times: Array, wheres: Sequence[str]) -> float:
    """Sample period [s] of a motion at times (rows,) [s] in equal steps.

    It is 0 for a hold, without them. Raises ValueError.
    """
    # one row before time 0 is a log that was cut off behind the row at rest
    is_cut_log = len(times) == 1 and not times[0] >= 0.0
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
    period, first = map(float, np.polyfit(steps, elapsed, 1))
    deviation = np.abs(elapsed - first - period * steps)
    if deviation.max() > UNEVEN * period:
        row = int(np.argmax(np.abs(change - middle)))
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
    for i, (least, greatest) in enumerate(command_limits(scene)):
        values = recording.command[:, i]
        outside = values[(values < least) | (values > greatest)]
        if outside.size:
            name = f"{COMMANDS[unit]}_{i}"
            text = (
                f"{name} is {outside[0]:g} {unit}: the scene's {COMMANDS[unit]}_limits are"
                f" {least:g} to {greatest:g} {unit}"
            )
            largest = float(np.abs(values).max())
            guess = _unit_guess(name, largest, max(-least, greatest), unit)
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
        raise ValueError(
            text + (guess or "; are the [frame] of --markers and the scene's [base] right?")
        )
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
