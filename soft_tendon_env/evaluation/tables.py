"""Tables of summaries and standings, in Markdown and as CSV. Millimetres, degrees and milliseconds
where people read them, SI in CSV."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
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
STATISTICS = ("", "_low", "_high", "_mean", f"_percentile_{HIGH}")
"""Endings of columns: interquartile mean, its interval, mean and percentile."""


def number(value: float | None, digits: int = 3) -> str:
    """A number to some significant digits; "-" where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return (
        f"{value:.0f}"
        if abs(value) >= 10.0**digits - 0.5
        else f"{value:#.{digits}g}".removesuffix(".")
    )


def with_seeds(name: str, count: int | None) -> str:
    """A name, with the number of seeds behind it if there are any."""
    return name if count is None else f"{name} ({count} {'seed' if count == 1 else 'seeds'})"


def summary_cells(summary: Summary) -> dict[str, str]:
    """Cells of a row by the headings of their columns."""
    flag, cells = f" {FLAG}" * (summary.diverged > 0), dict[str, str]()
    for name, error in summary.errors.items():
        unit = error_unit(name)
        cells[f"{unit.heading} RMS"] = number(unit.factor * error.rms) + flag
    if summary.reached is not None:
        cells["reached"] = f"{100 * summary.reached:.0f} %"
    cells["settled"] = f"{summary.settled} of {summary.episodes}"
    cells |= {
        METRICS[name].heading: number(METRICS[name].factor * value) + flag
        for name, value in summary.metrics.items()
    }
    return {**cells, "time [ms]": number(1e3 * summary.action_time)}


def summary_table(label: str, summaries: Mapping[str, Summary], models: Mapping[str, str]) -> str:
    """Table with a row per summary: errors, settled, metrics, time of an action. models: by name,
    the policies' use of a model at run time, see `entrants.model_in_the_loop`."""
    table = record_table(
        [
            {label: name, **summary_cells(summary), MODEL: models[name]}
            for name, summary in summaries.items()
        ]
    )
    return (
        f"{table}\n\n{LEGEND}" if any(summary.diverged for summary in summaries.values()) else table
    )


def error_text(standing: Standing) -> str:
    """Root mean squares of the task's first error in words, see ERRORS_LEGEND."""
    factor, key = error_unit(standing.error).factor, f"{standing.error}_rms"
    text = (
        f"{number(factor * standing.mean(key).value)} /"
        f" {number(factor * tails(standing.values(key))[0])}"
    )
    bad = float(np.mean([score.bad for score in standing.episodes]))
    return f"{text}, {100 * bad:.0f} % bad" if bad else text


def error_table(
    found: Standings,
    models: Mapping[str, str] | None = None,
    more: Sequence[Mapping[str, str]] = (),
) -> str:
    """Table of the task's first error by policy (rows) and condition (columns), "-" where a policy
    did not play.

    models: a column, see `summary_table`. more: rows below by condition, whose first cells are
    those of "".
    """
    conditions, rows = (
        dict.fromkeys((condition for _, condition in found), "-"),
        dict[str, dict[str, str]](),
    )
    heading = f"{error_unit(next(iter(found.values())).error).heading} RMS"
    for (policy, condition), standing in found.items():
        members = len(standing.scores)
        named = {
            heading: with_seeds(policy, members if members > 1 else None),
            **({MODEL: models[policy]} if models else {}),
        }
        rows.setdefault(policy, {**named, **conditions})[condition] = error_text(standing)
    below = [{heading: row[""], **{key: row.get(key, "-") for key in conditions}} for row in more]
    return record_table([*rows.values(), *below])


def record_table(rows: Sequence[Mapping[str, str]]) -> str:
    """A Markdown table with a row per record: a column per key that any of them has, "-" where one
    lacks it."""
    header = [*dict.fromkeys(key for row in rows for key in row)]
    return markdown_table(header, [[row.get(key, "-") for key in header] for row in rows])


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table that reads well as it is and as Markdown."""
    cells = [tuple(header), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in cells
    ]
    return "\n".join(
        [lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]]
    )


def records(found: Standings) -> list[dict[str, Any]]:
    """Errors, metrics and time of an action of every policy under every condition for CSV, in SI
    units, see STATISTICS."""
    rows = []
    for (policy, condition), standing in found.items():
        row: dict[str, Any] = {"policy": policy, "condition": condition}
        row |= {
            "members": len(standing.scores),
            "episodes": len(standing.episodes),
            "bad": sum(score.bad for score in standing.episodes),
        }
        for key in standing.episodes[0].numbers:
            numbers = (*standing.mean(key), *tails(standing.values(key)))
            row |= {
                f"{key}{ending}": float(f"{value:.5g}")
                for ending, value in zip(STATISTICS, numbers, strict=True)
            }
        rows.append(row)
    return rows


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a CSV file: a row per record, a column per key that any of them has, nothing where it
    is NaN. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {
                    key: None if isinstance(value, float) and math.isnan(value) else value
                    for key, value in row.items()
                }
            )
    print(f"written: {path}")
