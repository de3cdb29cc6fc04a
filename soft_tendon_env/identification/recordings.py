"""Recordings of a real arm: still holds and sampled motions, from CSV or Parquet files.

One row is a hold (`hold`, its name), or with a column `time` [s] a sample, of which those with one `hold` follow each other as one motion.
Commands are `tension_i` [N] or `displacement_i` [m], one for each tendon from 0 on; a marker has `NAME_x`, `NAME_y`, `NAME_z` [m], all of
them empty where it was not seen. Orientations, tendon lengths and strains are read where the markers' file names them, see sensed.py.
Its table `[columns]` gives quantities other names and units.
"""

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.markers import UNIT, UNITS, MarkerSet, Source
from soft_tendon_env.identification.parameters import command_limits
from soft_tendon_env.identification.sampling import steps_of
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.tables import Table, read_table
from soft_tendon_env.tools.types import Array

COMMANDS = {"N": "tension", "m": "displacement"}
"""Names of command columns by the unit of the scene's commands."""
REACH = 1.5
"""Share of the rod's length, from its base, within which a marker may be."""
LEAST = 0.05
"""Share of what is allowed from which numbers in another unit are plausible."""
ABSENT = {"", "nan", "na", "n/a", "null", "none"}
"""Cells that hold no number."""
CURVED, CHANGED = 4.0 * math.pi, 2.0
"""Largest changes that sensors may measure: of bending and twist over the rod's length [rad], and of what has no unit."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded commands and marker positions: one hold (a single sample), or a motion that begins at rest.

    command (samples, n_a) in the scene's unit, each held until the next sample; positions (samples, m, 3) [m] in the scene's world frame,
    NaN where a marker was not seen; period [s] between samples, 0 for a hold; columns: the other numbers of its first row. sensed
    (samples, k): numbers of `MarkerSet.sensed`, NaN where there are none. notes: what was done to the data, in sentences.
    """

    name: str
    where: str  # file and line of its first row
    command: Array
    positions: Array
    period: float
    columns: Mapping[str, float]
    sensed: Array | None = None
    notes: tuple[str, ...] = ()


class _Row(NamedTuple):
    """Cells of a line by column."""

    where: str
    cells: Mapping[str, str]

    def number(self, source: Source) -> float:
        """A cell as a number in SI units, NaN where there is none. Raises ValueError for other text and infinity."""
        text = self.cells[source.name]
        if text.casefold() in ABSENT:
            return math.nan
        try:
            value = math.nan if "_" in text else float(text.replace(",", ".")) * source.factor
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{self.where}: {source.name} is {text!r}: it should be a finite number, or empty where a marker was not seen")
        return value


class _Sheet(NamedTuple):
    """Rows of a file, and the columns of its quantities."""

    rows: list[_Row]
    commands: list[Source]
    places: list[Source]
    sensed: list[Source]
    time: Source | None
    hold: Source | None
    others: list[str]
    notes: tuple[str, ...]


def read_recordings(paths: Sequence[str | Path], scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of several files together. Raises ValueError, in one line that says where, and FileNotFoundError."""
    found = [recording for path in paths for recording in _read(Path(path), scene, markers)]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"hold {twice[0]!r} is there {names.count(twice[0])} times: every hold should have a name of its own")
    return found


def _read(path: Path, scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of one file."""
    sheet = _sheet(path, scene, markers)
    groups = itertools.groupby(sheet.rows, lambda row: row.cells[sheet.hold.name] if sheet.hold else path.stem)
    found = [_recording(name, list(group), sheet, markers) for name, group in groups]
    if sheet.notes:
        found[0] = replace(found[0], notes=(*sheet.notes, *found[0].notes))
    for recording in found:
        check_commands(recording, scene)
    _check_sensed(found, markers.sensed(len(scene.tendons)), rod_length(scene))
    _check_unit(found, rod_length(scene), path, next(iter(markers.markers)))
    return found


def _sheet(path: Path, scene: Scene, markers: MarkerSet) -> _Sheet:
    """Rows of a file with the columns of its quantities."""
    unit, n_a = scene.effects.command_unit, len(scene.tendons)
    commands = {f"{COMMANDS[unit]}_{i}": unit for i in range(n_a)}
    places = {f"{name}_{axis}": "m" for name in markers.markers for axis in "xyz"}
    sensed = markers.sensed(n_a)
    sources = markers.sources({**commands, **places, **sensed, "time": "s", "hold": ""})
    table = read_table(path, [source.name for source in sources.values()])
    found = _found(table, sources, optional={"time", "hold"} - markers.columns.keys())
    if not table.rows:
        raise ValueError(f"{table.where}: there are no rows beneath the header")
    rows = []
    for where, cells in table.rows:
        if len(cells) != len(table.header):
            raise ValueError(f"{where}: there are {len(cells)} cells, the header has {len(table.header)}: {table.where}")
        rows.append(_Row(where, dict(zip(table.header, cells, strict=True))))
    first, second, third = ([found[quantity] for quantity in part] for part in (commands, places, sensed))
    names = {source.name for source in found.values()}
    others = [name for name in table.header if name not in names and table.header.count(name) == 1]
    return _Sheet(rows, first, second, third, found.get("time"), found.get("hold"), others, _notes(path, table, rows, found))


def _found(table: Table, sources: Mapping[str, Source], optional: Set[str]) -> dict[str, Source]:
    """Sources with the names of their columns as the header has them. Raises ValueError for a column that is not there, or twice."""
    found = {}
    for quantity, source in sources.items():
        same = [name for name in table.header if name == source.name]
        same = same or [name for name in table.header if name.casefold() == source.name.casefold()]
        if len(same) > 1:
            raise ValueError(f"{table.where}: column {source.name} is there {len(same)} times")
        if same:
            found[quantity] = source._replace(name=same[0])
    missing = [source.name for quantity, source in sources.items() if quantity not in found and quantity not in optional]
    if missing or not found.keys() & {"time", "hold"}:
        text = f"there is no column {', '.join(missing or ['hold', 'time'])}: [columns] of the markers' file gives columns other names"
        raise ValueError(f"{table.where}: {text}; {not_among((missing or ['hold'])[0], table.header)}")
    return found


def _notes(path: Path, table: Table, rows: Sequence[_Row], sources: Mapping[str, Source]) -> tuple[str, ...]:
    """Notes on how a file was read, in sentences. Raises ValueError for numbers with decimal points and commas."""
    notes = []
    if table.skipped:
        lines = ", ".join(map(str, table.skipped[:5])) + (", ..." if len(table.skipped) > 5 else "")
        notes.append(f"{path}: {len(table.skipped)} lines above the header or with comments were skipped: {lines}.")
    numbers = [source.name for quantity, source in sources.items() if quantity != "hold"]
    marks = {mark: next(((row, name) for row in rows for name in numbers if mark in row.cells[name]), None) for mark in ".,"}
    if marks[","] is not None:
        if marks["."] is not None:
            (row, name), (other, another) = marks[","], marks["."]
            what = f"{name} is {row.cells[name]!r}, but in {other.where} {another} is {other.cells[another]!r}"
            raise ValueError(f"{row.where}: {what}: numbers should have one decimal mark, and no others")
        notes.append(f"{path}: numbers have decimal commas.")
    return tuple(notes)


def _recording(name: str, rows: Sequence[_Row], sheet: _Sheet, markers: MarkerSet) -> Recording:
    """Recording of rows with one name."""
    command = _numbers(rows, sheet.commands)
    if np.isnan(command).any():
        sample, tendon = np.argwhere(np.isnan(command))[0]
        raise ValueError(f"{rows[sample].where}: {sheet.commands[tendon].name} is empty: it should be a number")
    positions, notes = _positions(name, rows, sheet.places, markers)
    sensed = _numbers(rows, sheet.sensed)
    _check_quaternions(rows, sensed, [name for name, marker in markers.markers.items() if marker.orientation])
    others, period = _others(rows[0], sheet.others), 0.0
    times = _numbers(rows, [sheet.time] if sheet.time else [])[:, :1].ravel()
    if len(times) > 1 or (times >= 0.0).any():  # one row before time 0 is a log that was cut off behind the row at rest, which is a hold
        steps = steps_of(times, [row.where for row in rows])
        period = steps.period
        command, positions, sensed = steps.held(command), steps.spread(positions), steps.spread(sensed)
        notes += [f"Motion {name!r}: {steps.note}."] if steps.note else []
    elif len(rows) > 1:
        raise ValueError(f"{rows[1].where}: hold {name!r} has a second row: samples of a motion need a column time [s]")
    return Recording(name, rows[0].where, command, markers.frame.to_scene(positions), period, others, sensed, tuple(notes))


def _numbers(rows: Sequence[_Row], sources: Sequence[Source]) -> Array:
    """Numbers (rows, sources). Raises ValueError."""
    return np.array([[row.number(source) for source in sources] for row in rows]).reshape(len(rows), len(sources))


def _others(row: _Row, columns: Sequence[str]) -> dict[str, float]:
    """Numbers of a row in further columns; text is left out."""
    found = {}
    for column in columns:
        with contextlib.suppress(ValueError):
            found[column] = row.number(Source(column))
    return found


def _positions(name: str, rows: Sequence[_Row], places: Sequence[Source], markers: MarkerSet) -> tuple[Array, list[str]]:
    """Positions (rows, m, 3) [m] in the frame of the data, NaN where a marker was not seen, and what was left out, in sentences."""
    positions = _numbers(rows, places).reshape(len(rows), -1, 3)
    seen = np.isfinite(positions)
    names = [*markers.markers]
    if (partial := seen.any(axis=2) & ~seen.all(axis=2)).any():
        sample, marker = np.argwhere(partial)[0]
        raise ValueError(f"{rows[sample].where}: marker {names[marker]!r} has some of x, y, z: it should have all, or none")
    zero = (positions == 0.0).all(axis=2) & (markers.arc_lengths > 0.0)  # as some trackers write it
    positions[zero] = np.nan
    notes = [
        f"Marker {names[marker]!r} is at exactly 0, 0, 0 in {count} samples of {name!r}: it counts as not seen there."
        for marker, count in enumerate(zero.sum(axis=0))
        if count
    ]
    return positions, notes


def _check_quaternions(rows: Sequence[_Row], sensed: Array, names: Sequence[str]) -> None:
    """Raises ValueError for orientations of markers that are no unit quaternions; empty ones are left out."""
    for i, name in enumerate(names):
        own = sensed[:, 4 * i : 4 * i + 4]
        length = np.linalg.norm(own, axis=1)
        odd = np.flatnonzero(~np.isnan(own).all(axis=1) & ~(np.abs(length - 1.0) <= UNIT))
        if odd.size:
            what = f"{name}_qw to {name}_qz have the length {length[odd[0]]:.4g}"
            raise ValueError(f"{rows[odd[0]].where}: {what}: they should be a unit quaternion, or all of them empty")


def check_commands(recording: Recording, scene: Scene) -> None:
    """Raises ValueError for commands outside of the scene's limits."""
    unit = scene.effects.command_unit
    for i, (least, greatest) in enumerate(command_limits(scene)):
        values, kind = recording.command[:, i], COMMANDS[unit]
        odd = values[(values < least) | (values > greatest)]
        if odd.size:
            text = f"{kind}_{i} is {odd[0]:g} {unit}: the scene's {kind}_limits are {least:g} to {greatest:g} {unit}"
            guess = unit_guess(f"{kind}_{i}", float(np.abs(values).max()), max(-least, greatest), unit)
            raise ValueError(f"{recording.where}: {text}{guess}")


def _check_sensed(recordings: Sequence[Recording], units: Mapping[str, str], length: float) -> None:
    """Raises ValueError for numbers of sensors in a file that differ by more than those of an arm can."""
    most = {"m": REACH * length, "1/m": CURVED / length, "1": CHANGED}
    every = np.concatenate([own.sensed for own in recordings if own.sensed is not None])
    for (quantity, unit), values in zip(units.items(), every.T, strict=True):
        change = float(np.ptp(values[np.isfinite(values)])) if np.isfinite(values).any() else 0.0
        if change > most[unit]:
            text = f"{quantity} changes by {change:g} {unit}, on a rod of {length:g} m"
            raise ValueError(f"{recordings[0].where}: {text}{unit_guess(quantity, change, most[unit], unit)}")


def unit_guess(quantity: str, value: float, most: float, unit: str) -> str:
    """End of an error about a value that should be at most `most`: units in which it would be plausible, and where to say so."""
    like = [name for name, factor in UNITS[unit].items() if name != unit and LEAST * most <= value * factor <= most]
    text = f"; is it in {' or '.join(like)}? [columns] of the markers' file says so: {quantity} = {{ unit = "
    return f'{text}"{like[0]}" }}' if like else ""


def _check_unit(recordings: Sequence[Recording], length: float, path: Path, marker: str) -> None:
    """Raises ValueError where markers lie further from the base than the rod reaches, or all of them lie at it."""
    distances = [np.linalg.norm(recording.positions, axis=-1) for recording in recordings]
    distance = max((float(np.nanmax(own)) for own in distances if not np.isnan(own).all()), default=math.nan)
    if math.isnan(distance):
        raise ValueError(f"{path}: no marker was seen")
    reach = REACH * length
    if distance > reach:
        guess = unit_guess(f'"{marker}_*"', distance, reach, "m") or "; is the [frame] of --markers right?"
        raise ValueError(f"{path}: markers are up to {distance:.4g} m from the base of a rod of {length:g} m{guess}")
    if distance < 0.01 * length:
        text = "is the arm's length or the unit wrong? Positions are in m"
        raise ValueError(f"{path}: all markers are within {distance:.4g} m of the base of a rod of {length:g} m: {text}")
