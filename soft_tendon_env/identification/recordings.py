"""Recordings of a real arm: still holds and sampled motions, from CSV files.

One row is a hold (`hold`, its name), or with a column `time` [s] a sample, of which those with one `hold` follow each other as one motion.
Commands are `tension_i` [N] or `displacement_i` [m], one for each tendon from 0 on; a marker has `NAME_x`, `NAME_y`, `NAME_z` [m], all of
them empty where it was not seen. Orientations, tendon lengths and strains are read where the markers' file names them, see sensed.py.
Its table `[columns]` gives quantities other names and units.
"""

import contextlib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.markers import UNIT, UNITS, MarkerSet, Source
from soft_tendon_env.identification.parameters import command_limits
from soft_tendon_env.identification.sampling import steps_of
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.tables import Table, read_number, read_table
from soft_tendon_env.tools.types import Array

COMMANDS = {"N": "tension", "m": "displacement"}
"""Names of command columns by the unit of the scene's commands."""
REACH = 1.5
"""Share of the rod's length, from its base, within which a marker may be."""
LEAST = 0.05
"""Share of what is allowed from which numbers in another unit are plausible."""
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


class _Sheet(NamedTuple):
    """Table of a file and the columns of its quantities, with the names that its header has."""

    table: Table
    sources: Mapping[str, Source]

    def numbers(self, quantities: Iterable[str]) -> Array:
        """Numbers (rows, quantities) in SI units, NaN where there are none. Raises ValueError."""
        return self.table.numbers(self.sources[quantity] for quantity in quantities)

    def others(self, row: int) -> dict[str, float]:
        """Numbers of a row in further columns; text is left out."""
        (where, cells), header = self.table.rows[row], self.table.header
        found, known = dict[str, float](), {source.name for source in self.sources.values()}
        for name, cell in zip(header, cells, strict=True):
            if name not in known and header.count(name) == 1:
                with contextlib.suppress(ValueError):
                    found[name] = read_number(where, name, cell)
        return found


def read_recordings(paths: Sequence[str | Path], scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of several files together. Raises ValueError, in one line that says where, and FileNotFoundError."""
    found = [recording for path in paths for recording in _read(Path(path), scene, markers)]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"hold {twice[0]!r} is there {names.count(twice[0])} times: every hold should have a name of its own")
    return found


def _read(path: Path, scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of one file."""
    unit, n_a, length = scene.effects.command_unit, len(scene.tendons), rod_length(scene)
    kinds = {f"{COMMANDS[unit]}_{i}": unit for i in range(n_a)}
    places = {f"{name}_{axis}": "m" for name in markers.markers for axis in "xyz"}
    of_sensors = markers.sensed(n_a)
    sources = markers.sources({**kinds, **places, **of_sensors, "time": "s", "hold": ""})
    sheet = _sheet(path, sources, {"time", "hold"} - markers.columns.keys())
    rows, notes = [where for where, _ in sheet.table.rows], _notes(path, sheet)
    command = sheet.numbers(kinds)
    if np.isnan(command).any():
        row, tendon = np.argwhere(np.isnan(command))[0]
        raise ValueError(f"{rows[row]}: {sheet.sources[[*kinds][tendon]].name} is empty: it should be a number")
    positions, unseen = _positions(sheet, places, markers)
    sensed = sheet.numbers(of_sensors)
    _check_unit(positions, length, path, next(iter(markers.markers)))
    _check_quaternions(rows, sensed, [name for name, marker in markers.markers.items() if marker.orientation])
    _check_sensed(path, sensed, of_sensors, length)
    times = sheet.numbers({"time"} & sheet.sources.keys())
    named, found = sheet.sources.get("hold"), list[Recording]()
    names = [cells[sheet.table.header.index(named.name)] if named else path.stem for _, cells in sheet.table.rows]
    for name, group in itertools.groupby(range(len(rows)), key=names.__getitem__):
        own = [*group]
        data = command[own], positions[own], 0.0, sheet.others(own[0]), sensed[own]
        found.append(_in_steps(Recording(name, rows[own[0]], *data), times[own].ravel(), [rows[i] for i in own]))
        check_commands(found[-1], scene)
    found[0] = replace(found[0], notes=(*notes, *unseen, *found[0].notes))
    return found


def _sheet(path: Path, sources: Mapping[str, Source], optional: Set[str]) -> _Sheet:
    """Table with the columns of quantities. Raises ValueError for columns that are not there, or twice."""
    table, found = read_table(path, [source.name for source in sources.values()]), dict[str, Source]()
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
    if not table.rows:
        raise ValueError(f"{table.where}: there are no rows beneath the header")
    return _Sheet(table, found)


def _notes(path: Path, sheet: _Sheet) -> list[str]:
    """Notes on how a file was read, in sentences. Raises ValueError for numbers with decimal points and commas."""
    notes, (_, header, rows, skipped) = [], sheet.table
    if skipped:
        lines = ", ".join(map(str, skipped[:5])) + (", ..." if len(skipped) > 5 else "")
        notes.append(f"{path}: {len(skipped)} lines above the header or with comments were skipped: {lines}.")
    names = [source.name for quantity, source in sheet.sources.items() if quantity != "hold"]
    cells = ((where, name, row[header.index(name)]) for where, row in rows for name in names)
    marked = [own for own in cells if "." in own[2] or "," in own[2]]
    comma, point = (next((own for own in marked if mark in own[2]), None) for mark in ",.")
    if comma and point:
        what = f"{comma[1]} is {comma[2]!r}, but in {point[0]} {point[1]} is {point[2]!r}"
        raise ValueError(f"{comma[0]}: {what}: numbers should have one decimal mark, and no others")
    return [*notes, f"{path}: numbers have decimal commas."] if comma else notes


def _in_steps(own: Recording, times: Array, wheres: Sequence[str]) -> Recording:
    """A recording of rows at times (rows,) [s], none for holds, in equal steps. Raises ValueError."""
    if len(times) > 1 or (times >= 0.0).any():  # one row before time 0 is a log that was cut off behind the row at rest, which is a hold
        steps = steps_of(times, wheres)
        note = (f"Motion {own.name!r}: {steps.note}.",) if steps.note else ()
        sensed = None if own.sensed is None else steps.spread(own.sensed)
        command, positions = steps.held(own.command), steps.spread(own.positions)
        return replace(own, command=command, positions=positions, sensed=sensed, period=steps.period, notes=note)
    if len(wheres) > 1:
        raise ValueError(f"{wheres[1]}: hold {own.name!r} has a second row: samples of a motion need a column time [s]")
    return own


def _positions(sheet: _Sheet, places: Iterable[str], markers: MarkerSet) -> tuple[Array, list[str]]:
    """Positions (rows, m, 3) [m] in the scene's frame, NaN where a marker was not seen, and what was left out, in sentences."""
    positions = sheet.numbers(places).reshape(len(sheet.table.rows), -1, 3)
    seen, names = np.isfinite(positions), [*markers.markers]
    if (partial := seen.any(axis=2) & ~seen.all(axis=2)).any():
        row, marker = np.argwhere(partial)[0]
        raise ValueError(f"{sheet.table.rows[row][0]}: marker {names[marker]!r} has some of x, y, z: it should have all, or none")
    zero = (positions == 0.0).all(axis=2) & (markers.arc_lengths > 0.0)  # as some trackers write it
    positions[zero] = np.nan
    counts = zip(names, zero.sum(axis=0), strict=True)
    notes = [f"Marker {name!r} is at exactly 0, 0, 0 in {count} rows: it counts as not seen there." for name, count in counts if count]
    return markers.frame.to_scene(positions), notes


def _check_quaternions(rows: Sequence[str], sensed: Array, names: Sequence[str]) -> None:
    """Raises ValueError for orientations of markers that are no unit quaternions; empty ones are left out."""
    for i, name in enumerate(names):
        own = sensed[:, 4 * i : 4 * i + 4]
        length = np.linalg.norm(own, axis=1)
        odd = np.flatnonzero(~np.isnan(own).all(axis=1) & ~(np.abs(length - 1.0) <= UNIT))
        if odd.size:
            what = f"{name}_qw to {name}_qz have the length {length[odd[0]]:.4g}"
            raise ValueError(f"{rows[odd[0]]}: {what}: they should be a unit quaternion, or all of them empty")


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


def _check_sensed(path: Path, sensed: Array, units: Mapping[str, str], length: float) -> None:
    """Raises ValueError for numbers (rows, k) of sensors in a file that differ by more than those of an arm can."""
    most = {"m": REACH * length, "1/m": CURVED / length, "1": CHANGED}
    for (quantity, unit), values in zip(units.items(), sensed.T, strict=True):
        change = float(np.ptp(values[np.isfinite(values)])) if np.isfinite(values).any() else 0.0
        if change > most[unit]:
            text = f"{quantity} changes by {change:g} {unit}, on a rod of {length:g} m"
            raise ValueError(f"{path}: {text}{unit_guess(quantity, change, most[unit], unit)}")


def unit_guess(quantity: str, value: float, most: float, unit: str) -> str:
    """End of an error about a value that should be at most `most`: units in which it would be plausible, and where to say so."""
    like = [name for name, factor in UNITS[unit].items() if name != unit and LEAST * most <= value * factor <= most]
    text = f"; is it in {' or '.join(like)}? [columns] of the markers' file says so: {quantity} = {{ unit = "
    return f'{text}"{like[0]}" }}' if like else ""


def _check_unit(positions: Array, length: float, path: Path, marker: str) -> None:
    """Raises ValueError where markers (rows, m, 3) lie further from the base than the rod reaches, or all of them lie at it."""
    distances = np.linalg.norm(positions, axis=-1)
    if np.isnan(distances).all():
        raise ValueError(f"{path}: no marker was seen")
    distance, reach = float(np.nanmax(distances)), REACH * length
    if distance > reach:
        guess = unit_guess(f'"{marker}_*"', distance, reach, "m") or "; is the [frame] of --markers right?"
        raise ValueError(f"{path}: markers are up to {distance:.4g} m from the base of a rod of {length:g} m{guess}")
    if distance < 0.01 * length:
        text = "is the arm's length or the unit wrong? Positions are in m"
        raise ValueError(f"{path}: all markers are within {distance:.4g} m of the base of a rod of {length:g} m: {text}")
