"""Recordings of a real arm: still holds and sampled motions, from CSV files; and which of them
judge a fit.

One row is a hold (`hold`, its name), or with a column `time` [s] a sample, of which those with one
`hold` follow each other as one motion. Commands are `tension_i` [N] or `displacement_i` [m], one
for each tendon from 0 on; a marker has `NAME_x`, `NAME_y`, `NAME_z` [m], all of them empty where it
was not seen. The table `[columns]` of the markers' file gives quantities other names and units, and
may name a column `group`, of recordings whose errors are common.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soft_tendon_env.identification.markers import UNITS, MarkerSet
from soft_tendon_env.identification.parameters import command_limits
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.tables import Table, read_number, read_table
from soft_tendon_env.tools.types import COMMANDS, Array

REACH = 1.5  # share of the rod's length, from its base, within which a marker may be
LEAST = 0.05  # share of what is allowed from which numbers in another unit are plausible
UNEVEN = 0.3  # share of the sample period by which times may be off equal steps
USUAL = (1e-3, 1.0)  # sample periods [s] by which a unit of time is guessed
LONGEST, LATEST = (
    4.0,
    1e11,
    # sample period and time [s] from which on the unit of time is wrong: the latter is in the year
    # 5000
)
SHARE = "0.25"  # of recordings that are held out by default
SAME, EXACT = (
    0.02,
    0.005,
    # of a tendon's range in the data, and of the strongest command: how far apart commands may be
    # that are the same
)


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded commands and marker positions: one hold (a single sample), or a motion that begins
    at rest."""

    name: str
    where: str  # file and line of its first row
    command: Array  # (samples, n_a) in the scene's unit, each held until the next sample
    positions: (
        Array  # (samples, m, 3) [m] in the scene's world frame, NaN where they were not measured
    )
    period: float  # [s] between samples, 0 for a hold
    columns: Mapping[str, str]  # cells of its first row, by the header
    group: str = ""  # its cell in the column of groups, if there is one


def read_recordings(
    paths: Sequence[str | Path], scene: Scene, markers: MarkerSet
) -> list[Recording]:
    """Recordings of several files together. Raises ValueError, in one line that says where, and
    FileNotFoundError."""
    found = [recording for path in paths for recording in _read(Path(path), scene, markers)]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(
            f"hold {twice[0]!r} is there {names.count(twice[0])} times: every hold should have a"
            " name of its own"
        )
    return found


def _read(path: Path, scene: Scene, markers: MarkerSet) -> list[Recording]:
    """Recordings of one file."""
    unit = scene.effects.command_unit
    commands = {f"{COMMANDS[unit]}_{i}": unit for i in range(len(scene.tendons))}
    places = {f"{name}_{axis}": "m" for name in markers.markers for axis in "xyz"}
    texts = dict.fromkeys(("hold", "group") if "group" in markers.columns else ("hold",), "")
    table, sources = _table(path, markers, {**commands, **places, "time": "s", **texts})
    rows = [where for where, _ in table.rows]
    command, placed, times = (
        table.numbers(sources[name] for name in names)
        for names in (commands, places, {"time"} & sources.keys())
    )
    if np.isnan(command).any():
        row, tendon = np.argwhere(np.isnan(command))[0]
        raise ValueError(
            f"{rows[row]}: {sources[[*commands][tendon]][0]} is empty: it should be a number"
        )
    placed = placed.reshape(len(rows), -1, 3)
    placed[(placed == 0.0).all(axis=2) & (markers.arc_lengths > 0.0)] = (
        np.nan
    )  # as some trackers write what was not seen
    positions = placed @ markers.frame.rotation.T + markers.frame.translation
    _check_reach(
        positions - scene.base.position, rod_length(scene), path, next(iter(markers.markers))
    )
    names = [
        cells[table.header.index(sources["hold"][0])] if "hold" in sources else path.stem
        for _, cells in table.rows
    ]
    found = list[Recording]()
    for name, group in itertools.groupby(range(len(rows)), key=names.__getitem__):
        samples = [*group]
        where, cells = table.rows[samples[0]]
        period = _period(name, times[samples].ravel(), [rows[i] for i in samples])
        columns = dict(zip(table.header, cells, strict=True))
        group_name = columns[sources["group"][0]] if "group" in sources else ""
        found.append(
            Recording(
                name, where, command[samples], positions[samples], period, columns, group_name
            )
        )
        check_commands(found[-1], scene)
    return found


def _table(
    path: Path, markers: MarkerSet, units: Mapping[str, str]
) -> tuple[Table, dict[str, tuple[str, float]]]:
    """Table of a file; and by quantity, given with its SI unit, name and factor of its column.
    Raises ValueError for wrong columns."""
    wanted, found = (
        {quantity: (quantity, 1.0) for quantity in units},
        dict[str, tuple[str, float]](),
    )
    for key, column in sorted(
        markers.columns.items(), key=lambda item: "*" not in item[0]
    ):  # a whole name beats a pattern
        matches = [
            match
            for quantity in units
            if (match := re.fullmatch(re.escape(key).replace(r"\*", "(.+)"), quantity))
        ]
        if not matches:
            raise ValueError(
                f"columns.{key} is no quantity that is read here: {not_among(key, units)}"
            )
        for match in matches:
            factors = {units[match[0]]: 1.0, **UNITS.get(units[match[0]], {})}
            if (unit := units[match[0]] if column.unit is None else column.unit) not in factors:
                raise ValueError(
                    f"columns.{key}.unit is {unit!r}: it should be one of {', '.join(factors)}"
                )
            name = (column.name or match[0]).replace("*", match[1] if "*" in key else "*")
            wanted[match[0]] = name, column.sign * factors[unit]
    table = read_table(path, [name for name, _ in wanted.values()])
    for quantity, (name, factor) in wanted.items():
        same = [head for head in table.header if head.casefold() == name.casefold()]
        if len(same := [name] * same.count(name) or same) > 1:
            raise ValueError(f"{table.where}: column {name} is there {len(same)} times")
        if same:
            found[quantity] = same[0], factor
    missing = [
        wanted[quantity][0]
        for quantity in wanted.keys() - found.keys() - ({"time", "hold"} - markers.columns.keys())
    ]
    if missing := sorted(missing) or ([] if found.keys() & {"time", "hold"} else ["hold", "time"]):
        text = (
            f"there is no column {', '.join(missing)}: [columns] of the markers' file gives columns"
            " other names"
        )
        raise ValueError(f"{table.where}: {text}; {not_among(missing[0], table.header)}")
    if not table.rows:
        raise ValueError(f"{table.where}: there are no rows beneath the header")
    places = [
        table.header.index(name)
        for quantity, (name, _) in found.items()
        if quantity not in ("hold", "group")
    ]
    marks = {
        mark: where
        for where, cells in table.rows
        for i in places
        for mark in ",."
        if mark in cells[i]
    }
    if len(marks) > 1:
        raise ValueError(
            f"{marks[',']} has decimal commas and {marks['.']} points: numbers should have one"
            " decimal mark, and no others"
        )
    return table, found


def _period(name: str, times: Array, wheres: Sequence[str]) -> float:
    """Sample period [s] of a motion at times (rows,) [s] in equal steps; 0 for a hold, without
    them. Raises ValueError."""
    if not len(times) or (
        len(times) == 1 and not times[0] >= 0.0
    ):  # one row before time 0: a log that was cut off behind the row at rest
        if len(wheres) > 1:
            raise ValueError(
                f"{wheres[1]}: hold {name!r} has a second row: samples of a motion need a column"
                " time [s]"
            )
        return 0.0
    if len(times) == 1:
        raise ValueError(f"{wheres[0]}: a motion should have at least two samples")
    change, steps = np.diff(times), np.arange(len(times))
    if not (change > 0.0).all():
        at = int(np.argmin(change > 0.0)) + 1
        raise ValueError(
            f"{wheres[at]}: time is {times[at]:.9g} s after {times[at - 1]:.9g} s: it should be a"
            " number, and grow"
        )
    middle = float(np.median(change))
    if middle >= LONGEST or times[-1] > LATEST:
        like = next(
            (unit for unit, factor in UNITS["s"].items() if USUAL[0] <= middle * factor < USUAL[1]),
            "...",
        )
        guess = (
            f"is it in {like}? [columns] of the markers' file says so: time = {{ unit ="
            f' "{like}" }}'
        )
        raise ValueError(f"{wheres[0]}: samples are {middle:.4g} s apart in time: {guess}")
    period, first = map(float, np.polyfit(steps, times - times[0], 1))
    if np.abs(times - times[0] - first - period * steps).max() > UNEVEN * period:
        at = int(np.argmax(np.abs(change - middle)))
        text = (
            f"time goes on by {change[at]:.6g} s: it should in equal steps, which are {middle:.6g}"
            " s in the middle"
        )
        raise ValueError(
            f"{wheres[at + 1]}: {text}; a row that was lost goes in with its command and empty"
            " markers"
        )
    return period


def check_commands(recording: Recording, scene: Scene) -> None:
    """Raises ValueError for commands outside of the scene's limits."""
    unit = scene.effects.command_unit
    for i, (least, greatest) in enumerate(command_limits(scene)):
        values, name = recording.command[:, i], f"{COMMANDS[unit]}_{i}"
        if (odd := values[(values < least) | (values > greatest)]).size:
            text = (
                f"{name} is {odd[0]:g} {unit}: the scene's {COMMANDS[unit]}_limits are {least:g} to"
                f" {greatest:g} {unit}"
            )
            largest, allowed = float(np.abs(values).max()), max(-least, greatest)
            guess = _unit_guess(name, largest, allowed, unit)
            raise ValueError(f"{recording.where}: {text}{guess}")


def _check_reach(positions: Array, length: float, path: Path, marker: str) -> None:
    """Raises ValueError where markers (rows, m, 3), seen from the base, lie further than the rod
    reaches, or all of them lie at it."""
    distances = np.linalg.norm(positions, axis=-1)
    if np.isnan(distances).all():
        raise ValueError(f"{path}: no marker was seen")
    distance, reach = float(np.nanmax(distances)), REACH * length
    text = f"{path}: markers are up to {distance:.4g} m from the base of a rod of {length:g} m"
    if distance > reach:
        raise ValueError(
            text
            + (
                _unit_guess(f'"{marker}_*"', distance, reach, "m")
                or "; are the [frame] of --markers and the scene's [base] right?"
            )
        )
    if distance < 0.01 * length:
        raise ValueError(f"{text}: is the arm's length or the unit wrong? Positions are in m")


def _unit_guess(quantity: str, value: float, most: float, unit: str) -> str:
    """End of an error about a value that should be at most `most`: units in which it would be
    plausible, and where to say so."""
    like = [
        name
        for name, factor in UNITS[unit].items()
        if name != unit and LEAST * most <= value * factor <= most
    ]
    text = (
        f"; is it in {' or '.join(like)}? [columns] of the markers' file says so: {quantity} = {{"
        " unit = "
    )
    return f'{text}"{like[0]}" }}' if like else ""


def split(recordings: Sequence[Recording], held_out: str = SHARE) -> list[list[Recording]]:
    """Recordings to fit to, and held-out ones, each in the order of the data; those of a cluster
    stay together in a share. held_out: a share below 1, evenly over the data, or a column that is
    not zero there. Raises ValueError."""
    try:
        wanted = float(held_out)
    except ValueError:
        chosen = np.array(
            [read_number(one.where, held_out, one.columns.get(held_out, "")) for one in recordings]
        )
        if np.isnan(chosen).any():
            known = not_among(held_out, {column for one in recordings for column in one.columns})
            raise ValueError(
                f"held_out is {held_out!r}: there is no column of that name with numbers: {known}"
            ) from None
    else:
        if not 0.0 <= wanted < 1.0:
            raise ValueError(
                f"held_out is {wanted:g}: it should be a share from 0 to below 1, or a column"
            )
        group = clusters(recordings)
        count = group.max(initial=-1) + 1
        groups = round(wanted * count)
        chosen = np.isin(group, ((np.arange(groups) + 0.5) * count / max(groups, 1)).astype(int))
    if chosen.all():
        text = (
            f"held_out is {held_out!r}, which leaves nothing to fit to of {len(recordings)}"
            " recordings"
        )
        raise ValueError(f"{text}: those with the same commands, or of one group, stay together")
    return [
        [one for one, is_out in zip(recordings, chosen, strict=True) if bool(is_out) == kind]
        for kind in (False, True)
    ]


def clusters(recordings: Sequence[Recording]) -> Array:
    """Index (recordings,), from 0 in the order of the data, that recordings with common errors
    share: those of a group, or where there are no groups those with the same commands."""
    names = [*dict.fromkeys(one.group for one in recordings)]
    return (
        np.array([names.index(one.group) for one in recordings])
        if any(names)
        else same_commands(recordings)
    )


def same_commands(recordings: Sequence[Recording]) -> Array:
    """Index (recordings,) that recordings with the same commands share, from 0 in the order of the
    data. Of motions the difference is the mean over their samples, since a start may be a sample
    late; the last command is held on."""
    if not recordings:
        return np.zeros(0, dtype=int)
    samples = np.arange(max(len(one.command) for one in recordings))
    table = np.array([one.command[np.minimum(samples, len(one.command) - 1)] for one in recordings])
    tolerance = (
        np.maximum(SAME * np.ptp(table, axis=(0, 1)), EXACT * np.abs(table).max())
        + np.finfo(float).tiny
    )
    group = np.full(len(recordings), -1)
    while (group < 0).any():
        near = (np.abs(table - table[np.argmax(group < 0)]) / tolerance).max(axis=2).mean(
            axis=1
        ) <= 1.0
        group[near & (group < 0)] = group.max() + 1
    return group
