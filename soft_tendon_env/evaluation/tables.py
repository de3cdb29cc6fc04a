"""Tables of summaries and standings, in Markdown and as CSV.

Millimetres, degrees and milliseconds where people read them, SI in CSV.
"""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import BAD, METRICS
from soft_tendon_env.evaluation.summaries import HIGH, Standing, Standings, Summary, tails

MODEL = "model in the loop"
FLAG = "!"
LEGEND = f"{FLAG}: episodes diverged; errors and metrics are those of the episodes that lived."
ERRORS_LEGEND = (
    "Root mean squares of episodes: interquartile mean / mean, and the share of bad episodes where"
    f" there are any. A bad episode diverged, or has more than {100 * BAD:g} % of the rod's length."
)
NUMBERS_LEGEND = (
    "- **A (B)**: interquartile mean and mean over episodes; errors are root mean squares.\n"
    f"- **Bad**: the episode diverged, or is off by more than {100 * BAD:g} % of the rod's"
    " length."
)
NARROW_DIGITS = 2
"""Digits in tables that fit the text's width with seven policies; the CSV file has more."""
STATISTICS = ("", "_low", "_high", "_mean", f"_percentile_{HIGH}")
"""Endings of columns: interquartile mean, its interval, mean and percentile."""


def number(value: float | None, digits: int = 3) -> str:
    """A number to some significant digits; "-" where there is none."""
    if value is None or math.isnan(value):
        return "-"
    largest = 10.0**digits - 0.5
    if abs(value) >= largest:  # all digits are before the point
        return f"{value:.0f}"
    without_sign_of_zero = value + 0.0
    return f"{without_sign_of_zero:#.{digits}g}".removesuffix(".")


def measured_number(value: float) -> str:
    """A measured error to some digits; "-" where there was no motion to measure it on."""
    return number(value if math.isfinite(value) else None)


def with_seeds(name: str, count: int | None) -> str:
    """A name, with the number of seeds behind it if there are any."""
    if count is None:
        return name
    if count == 1:
        unit = "seed"
    else:
        unit = "seeds"
    return f"{name} ({count} {unit})"


def summary_cells(summary: Summary) -> dict[str, str]:
    """Cells of a row by the headings of their columns."""
    if summary.diverged > 0:
        flag = f" {FLAG}"
    else:
        flag = ""
    cells = dict[str, str]()
    for name, error in summary.errors.items():
        unit = error_unit(name)
        text = number(unit.factor * error.rms)
        cells[f"{unit.heading} RMS"] = text + flag
    if summary.reached is not None:
        percent = 100 * summary.reached
        cells["reached"] = f"{percent:.0f} %"
    cells["settled"] = f"{summary.settled} of {summary.episodes}"
    for name, value in summary.metrics.items():
        metric = METRICS[name]
        text = number(metric.factor * value)
        cells[metric.heading] = text + flag
    cells["time [ms]"] = number(1e3 * summary.action_time)
    return cells


def summary_table(
    label: str,
    summaries: Mapping[str, Summary],
    models: Mapping[str, str],
) -> str:
    """Table with a row per summary: errors, settled, metrics, time of an action.

    models: by name, the policies' use of a model at run time, see `entrants.model_in_the_loop`.
    """
    rows = []
    for name, summary in summaries.items():
        row = {label: name, **summary_cells(summary), MODEL: models[name]}
        rows.append(row)
    table = record_table(rows)
    diverged = (summary.diverged for summary in summaries.values())
    if any(diverged):
        return f"{table}\n\n{LEGEND}"
    return table


def error_text(standing: Standing) -> str:
    """Root mean squares of the task's first error in words, see ERRORS_LEGEND."""
    factor = error_unit(standing.error).factor
    key = f"{standing.error}_rms"
    interquartile = standing.mean(key).value
    values = standing.values(key)
    mean, _ = tails(values)
    first = number(factor * interquartile)
    second = number(factor * mean)
    text = f"{first} / {second}"
    bad_shares = [score.bad for score in standing.episodes]
    bad = float(np.mean(bad_shares))
    if bad:
        return f"{text}, {100 * bad:.0f} % bad"
    return text


def error_table(standings: Standings) -> str:
    """Table of the task's first error by policy (rows) and condition (columns).

    Cells are those of ERRORS_LEGEND, "-" where a policy did not play.
    """
    condition_names = (condition for _, condition in standings)
    conditions = list(dict.fromkeys(condition_names))
    first = next(iter(standings.values()))
    heading = f"{error_unit(first.error).heading} RMS"
    rows = dict[str, dict[str, str]]()
    for (policy, condition), standing in standings.items():
        if policy not in rows:
            name = _name_with_seeds(policy, standing)
            not_played = dict.fromkeys(conditions, "-")
            rows[policy] = {heading: name, **not_played}
        row = rows[policy]
        row[condition] = error_text(standing)
    records = list(rows.values())
    return record_table(records)


def number_tables(standings: Standings) -> list[str]:
    """Narrow tables by condition (rows) and policy (columns), see NUMBERS_LEGEND.

    There is one for each of the task's errors, one for the return, one for the bad episodes.
    """
    first = next(iter(standings.values()))
    tables = []
    for name in first.episodes[0].errors:
        unit = error_unit(name)
        text = _mean_text(f"{name}_rms", unit.factor)
        title = f"{unit.heading} RMS"
        tables.append(_narrow_table(title, standings, text))
    returns = _narrow_table("return", standings, _mean_text("return", 1.0))
    tables.append(returns)
    tables.append(_narrow_table("bad episodes [%]", standings, _bad_text))
    return tables


def _narrow_table(
    heading: str,
    standings: Standings,
    text: Callable[[Standing], str],
) -> str:
    """Table by condition (rows) and policy (columns), "-" where a policy did not play.

    heading: of the first column; text: of a cell.
    """
    rows = dict[str, dict[str, str]]()
    for (policy, condition), standing in standings.items():
        row = rows.setdefault(condition, {heading: condition})
        row[_name_with_seeds(policy, standing)] = text(standing)
    return record_table([*rows.values()])


def _name_with_seeds(policy: str, standing: Standing) -> str:
    """A policy's name, with the number of its seeds where there are several."""
    members = len(standing.scores)
    return with_seeds(policy, members if members > 1 else None)


def _mean_text(key: str, factor: float) -> Callable[[Standing], str]:
    """Text of a cell: the interquartile mean of a number of episodes times a factor, (the mean)."""

    def text(standing: Standing) -> str:
        values = standing.values(key)
        mean, _ = tails(values)
        mean_of_key = standing.mean(key)
        interquartile = number(factor * mean_of_key.value, NARROW_DIGITS)
        text = number(factor * mean, NARROW_DIGITS)
        return f"{interquartile} ({text})"

    return text


def _bad_text(standing: Standing) -> str:
    """Share of bad episodes in percent."""
    bad_shares = [score.bad for score in standing.episodes]
    bad_share = np.mean(bad_shares)
    return f"{100 * bad_share:.0f}"


def record_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Markdown table with a row per record.

    It has a column per key that any of them has, "-" where one lacks it.
    """
    keys = (key for row in rows for key in row)
    header = list(dict.fromkeys(keys))
    cells = [[row.get(key, "-") for key in header] for row in rows]
    return markdown_table(header, cells)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table that reads well as it is and as Markdown."""
    rest = map(tuple, rows)
    cells = [tuple(header), *rest]
    columns = zip(*cells, strict=True)
    widths = [max(map(len, column)) for column in columns]
    lines = []
    for row in cells:
        pairs = zip(row, widths, strict=True)
        padded = [cell.ljust(width) for cell, width in pairs]
        lines.append(f"| {' | '.join(padded)} |")
    dashes = ["-" * (width + 2) for width in widths]
    rule = f"|{'|'.join(dashes)}|"
    lines.insert(1, rule)
    return "\n".join(lines)


def records(standings: Standings) -> list[dict[str, Any]]:
    """Errors, metrics and time of an action of every policy under every condition.

    They are for CSV, in SI units, see STATISTICS.
    """
    rows = []
    for (policy, condition), standing in standings.items():
        row: dict[str, Any] = {
            "policy": policy,
            "condition": condition,
            "members": len(standing.scores),
            "episodes": len(standing.episodes),
            "bad": sum(score.bad for score in standing.episodes),
        }
        for key in standing.episodes[0].numbers:
            tails_of_key = tails(standing.values(key))
            mean_of_key = standing.mean(key)
            numbers = (*mean_of_key, *tails_of_key)
            for ending, value in zip(STATISTICS, numbers, strict=True):
                row[f"{key}{ending}"] = float(f"{value:.5g}")
        rows.append(row)
    return rows


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Writes a CSV file: a row per record, a column per key that any of them has.

    There is nothing where it is NaN. Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    keys = (key for row in rows for key in row)
    columns = list(dict.fromkeys(keys))
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        for row in rows:
            cells = {}
            for key, value in row.items():
                is_missing = isinstance(value, float) and math.isnan(value)
                if not is_missing:
                    cells[key] = value
            writer.writerow(cells)
    print(f"written: {path}")


def write_markdown(path: Path, text: str) -> None:
    """Write a Markdown file, and print its path. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n", encoding="utf-8")
    print(f"written: {path}")
