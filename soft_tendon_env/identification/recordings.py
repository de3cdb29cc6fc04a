"""Recordings of a real arm: still holds and sampled motions, from CSV or Parquet files in SI units.

One row is a hold (`hold`, its name), or with a column `time` [s] a sample, of which those with one `hold` follow each other as one motion.
Commands are `tension_i` [N] or `displacement_i` [m], one for each tendon from 0 on; a marker has `NAME_x`, `NAME_y`, `NAME_z` [m], all of
them empty where it was not seen. Orientations, tendon lengths and strains are read where the markers' file names them, see sensed.py.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soft_tendon_env.identification.markers import UNIT, MarkerSet
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.tables import rows_of
from soft_tendon_env.tools.types import Array

COMMANDS = {"N": "tension", "m": "displacement"}
"""Names of command columns by the unit of the scene's commands."""
REACH = 1.5
"""Share of the rod's length, from its base, within which a marker may be."""
LIKE = {1e3: "millimetres", 1e2: "centimetres"}
"""Units of lengths that are met by mistake, as factors of metres."""
UNEVEN = 1e-3
"""Share of the sample period by which times of samples may be off it."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded commands and marker positions: one hold (a single sample), or a motion that begins at rest.

    command (samples, n_a) in the scene's unit, each held until the next sample; positions (samples, m, 3) [m] in the scene's world frame,
    NaN where a marker was not seen; period [s] between samples, 0 for a hold; columns: the other numbers of its first row. sensed
    (samples, k): numbers of `MarkerSet.columns`, NaN where there are none.
    """

    name: str
    where: str  # file and line of its first row
    command: Array
    positions: Array
    period: float
    columns: Mapping[str, float]
    sensed: Array | None = None


class _Row(dict[str, str]):
    """Cells of a line by column."""

    def __init__(self, cells: Iterable[tuple[str, str]], where: str) -> None:
        super().__init__(cells)
        self.where = where

    def number(self, column: str) -> float:
        """A cell as a number, NaN for an empty one. Raises ValueError for text, "nan" and infinity."""
        text = self[column].strip()
        try:
            value = float(text) if text else math.nan
        except ValueError:
            value = math.inf
        if text and not math.isfinite(value):
            raise ValueError(f"{self.where}: {column} is {text!r}: it should be a finite number, or empty where a marker was not seen")
        return value


def read_recordings(paths: Sequence[str | Path], scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of several files together. Raises ValueError, in one line that says where, and FileNotFoundError."""
    found = [recording for path in paths for recording in _read(Path(path), scene, markers)]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"hold {twice[0]!r} is there {names.count(twice[0])} times: every hold should have a name of its own")
    if not found:
        raise ValueError(f"{', '.join(map(str, paths))}: there are no rows beneath the first line")
    return found


def _read(path: Path, scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of one file."""
    table = rows_of(path)
    header = [name.strip() for name in next(table, ("", []))[1]]
    commands = [f"{COMMANDS[scene.effects.command_unit]}_{i}" for i in range(len(scene.tendons))]
    places = [f"{name}_{axis}" for name in markers.markers for axis in "xyz"]
    sensed = markers.columns(len(scene.tendons))
    needed = [*commands, *places, *sensed, *([] if "time" in header else ["hold"])]
    if missing := [name for name in needed if name not in header]:
        raise ValueError(f"{path}: there is no column {', '.join(missing)}: the first line should have {', '.join(needed)}")
    rows = []
    for where, cells in table:
        if len(cells) != len(header):
            raise ValueError(f"{where}: there are {len(cells)} cells, the first line has {len(header)}")
        rows.append(_Row(zip(header, cells, strict=True), where))
    groups = itertools.groupby(rows, lambda row: row.get("hold", path.stem))
    known = {*needed, "hold", "time"}
    found = [_recording(name, list(group), commands, places, sensed, known, markers) for name, group in groups]
    for recording in found:
        _check_tensions(recording, scene)
    _check_unit(found, rod_length(scene), path)
    return found


def _recording(
    name: str,
    rows: Sequence[_Row],
    commands: Sequence[str],
    places: Sequence[str],
    sensed: Sequence[str],
    known: set[str],
    markers: MarkerSet,
) -> Recording:
    """Recording of rows with one name."""
    first = rows[0]
    command = np.array([[row.number(column) for column in commands] for row in rows])
    if np.isnan(command).any():
        sample, tendon = np.argwhere(np.isnan(command))[0]
        raise ValueError(f"{rows[sample].where}: {commands[tendon]} is empty: it should be a number")
    positions = np.array([[row.number(column) for column in places] for row in rows]).reshape(len(rows), -1, 3)
    seen = np.isfinite(positions)
    if (partial := seen.any(axis=2) & ~seen.all(axis=2)).any():
        sample, marker = np.argwhere(partial)[0]
        raise ValueError(f"{rows[sample].where}: marker {[*markers.markers][marker]!r} has some of x, y, z: it should have all, or none")
    others = {column: first.number(column) for column in first if column not in known}
    more = np.array([[row.number(column) for column in sensed] for row in rows]).reshape(len(rows), -1)
    _check_quaternions(rows, more, [name for name, marker in markers.markers.items() if marker.orientation])
    return Recording(name, first.where, command, markers.frame.to_scene(positions), _period(rows), others, more)


def _check_quaternions(rows: Sequence[_Row], sensed: Array, names: Sequence[str]) -> None:
    """Raises ValueError for orientations of markers that are no unit quaternions; empty ones are left out."""
    for i, name in enumerate(names):
        length = np.linalg.norm(sensed[:, 4 * i : 4 * i + 4], axis=1)
        empty = np.isnan(sensed[:, 4 * i : 4 * i + 4]).all(axis=1)
        odd = np.flatnonzero(~empty & ~(np.abs(length - 1.0) <= UNIT))
        if odd.size:
            what = f"{name}_qw to {name}_qz have the length {length[odd[0]]:.4g}"
            raise ValueError(f"{rows[odd[0]].where}: {what}: they should be a unit quaternion, or all of them empty")


def _period(rows: Sequence[_Row]) -> float:
    """Sample period [s] of rows with times, 0 for a hold."""
    if "time" not in rows[0]:
        if len(rows) > 1:
            raise ValueError(f"{rows[1].where}: hold {rows[1]['hold']!r} has a second row: samples of a motion need a column time [s]")
        return 0.0
    times = np.array([row.number("time") for row in rows])
    if len(times) < 2:
        if times[0] < 0.0:  # a log that was cut off behind the row at rest, which is a hold
            return 0.0
        raise ValueError(f"{rows[0].where}: a motion should have at least two samples")
    period = float((times[-1] - times[0]) / (len(times) - 1))
    off = np.abs(times - times[0] - period * np.arange(len(times)))
    if not (period > 0.0 and off.max() <= UNEVEN * period):
        where = rows[int(np.argmax(off))].where if np.isfinite(off).all() else rows[0].where
        raise ValueError(f"{where}: time should go on in equal steps, which are {period:.6g} s in the mean")
    return period


def _check_tensions(recording: Recording, scene: Scene) -> None:
    """Raises ValueError for tensions outside of the tendons' limits."""
    if scene.effects.command_unit != "N":
        return
    for i, tendon in enumerate(scene.tendons):
        least, greatest = tendon.tension_limits
        values = recording.command[:, i]
        odd = values[(values < least) | (values > greatest)]
        if odd.size:
            raise ValueError(f"{recording.where}: tension_{i} is {odd[0]:g} N: the scene's tension_limits are {least:g} to {greatest:g} N")


def _check_unit(recordings: Sequence[Recording], length: float, path: Path) -> None:
    """Raises ValueError where markers lie further from the base than the rod reaches, or all of them lie at it."""
    distances = [np.linalg.norm(recording.positions, axis=-1) for recording in recordings]
    distance = max((float(np.nanmax(own)) for own in distances if np.isfinite(own).any()), default=math.nan)
    if math.isnan(distance):
        raise ValueError(f"{path}: no marker was seen")
    reach = REACH * length
    if distance > reach:
        unit = next((name for factor, name in LIKE.items() if 0.3 * length < distance / factor <= reach), None)
        guess = f"are they in {unit}?" if unit else "is the [frame] of --markers right?"
        raise ValueError(f"{path}: markers are up to {distance:.4g} m from the base of a rod of {length:g} m: {guess} Positions are in m")
    if distance < 0.01 * length:
        text = "is the arm's length or the unit wrong? Positions are in m"
        raise ValueError(f"{path}: all markers are within {distance:.4g} m of the base of a rod of {length:g} m: {text}")
