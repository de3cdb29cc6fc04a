"""Summaries as tables: on the screen and in Markdown, and as CSV. Millimetres, degrees and milliseconds where people read them."""

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from soft_tendon_env.envs import Summary

FLAG = "!"
LEGEND = f"{FLAG}: episodes diverged; errors, effort and rate are those of the episodes that lived."
UNITS = {
    "position_error": ("position [mm]", 1e3),
    "angle_error": ("angle [deg]", 180.0 / math.pi),
    "backbone_error": ("backbone [mm]", 1e3),
    "coordinate_error": ("coordinates", 1.0),
}


class Column(NamedTuple):
    header: str
    cell: Callable[[Summary], str]


def number(value: float | None, digits: int = 3) -> str:
    """Significant digits, "-" where there is no number."""
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 10.0**digits - 0.5 else f"{value:#.{digits}g}".removesuffix(".")


def flagged(summary: Summary, text: str) -> str:
    return f"{text} {FLAG}" if summary.flagged else text


def columns_of(summary: Summary) -> list[Column]:
    """Every number of a task's summaries; divergences stand beside the return."""
    columns = []
    for name in summary.errors:
        label, scale = UNITS[name]
        columns += [
            Column(f"{label} RMS", lambda s, name=name, scale=scale: flagged(s, number(scale * s.errors[name].rms))),
            Column("p95", lambda s, name=name, scale=scale: flagged(s, number(scale * s.errors[name].percentile_95))),
        ]
    if summary.reached is not None:
        columns.append(Column("reached", lambda s: f"{100 * s.reached:.0f} %"))
    return [
        *columns,
        Column("settled", lambda s: f"{s.settled}/{s.episodes}"),
        Column("after [s]", lambda s: number(s.settling_time)),
        Column("effort [N]", lambda s: flagged(s, number(s.effort))),
        Column("rate [N/s]", lambda s: flagged(s, number(s.tension_rate))),
        Column("violations", lambda s: str(s.bound_violations)),
        Column("return", lambda s: flagged(s, number(s.mean_return, 4))),
        Column("diverged", lambda s: f"{s.diverged}/{s.episodes}"),
        Column("time [ms]", lambda s: number(1e3 * s.action_time.median)),
        Column("p99 [ms]", lambda s: number(1e3 * s.action_time.percentile_99)),
    ]


def full_table(label: str, summaries: dict[str, Summary], left_out: Sequence[str] = ()) -> str:
    """A row per summary, with all numbers but those whose headers are left out."""
    columns = [column for column in columns_of(next(iter(summaries.values()))) if column.header not in left_out]
    rows = [(name, *(column.cell(summary) for column in columns)) for name, summary in summaries.items()]
    table = markdown_table((label, *(column.header for column in columns)), rows)
    return f"{table}\n\n{LEGEND}" if any(summary.flagged for summary in summaries.values()) else table


def error_table(summaries: dict[tuple[str, str], Summary]) -> str:
    """Root mean square errors by policy (rows) and model error (columns); the task's first two numbers to a cell."""
    first = next(iter(summaries.values()))
    columns = columns_of(first)
    shown = [columns[0], columns[2]]  # RMS of the first error, and of the second or, for goals, the share reached
    policies, errors = (dict.fromkeys(key[i] for key in summaries) for i in (0, 1))
    rows = [(policy, *(" / ".join(c.cell(summaries[policy, error]) for c in shown) for error in errors)) for policy in policies]
    table = markdown_table((" / ".join(column.header for column in shown), *errors), rows)
    return f"{table}\n\n{LEGEND}" if any(summary.flagged for summary in summaries.values()) else table


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table that reads well as it is and as Markdown."""
    cells = [tuple(header), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]])


def csv_record(policy: str, error: str, summary: Summary) -> dict[str, Any]:
    """In SI units; empty where there is no number."""
    errors = {f"{name}_{kind}": value for name, score in summary.errors.items() for kind, value in score._asdict().items()}
    rest = {name: getattr(summary, name) for name in SUMMARY_COLUMNS}
    times = {f"action_time_{kind}": value for kind, value in summary.action_time._asdict().items()}
    record = {"policy": policy, "model_error": error, **errors, **rest, **times}
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in record.items()}


SUMMARY_COLUMNS = (
    "reached",
    "settled",
    "settling_time",
    "effort",
    "tension_rate",
    "bound_violations",
    "mean_return",
    "diverged",
    "episodes",
)


def write_csv(path: Path, summaries: dict[tuple[str, str], Summary]) -> None:
    """A row per policy and model error."""
    records = [csv_record(policy, error, summary) for (policy, error), summary in summaries.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(records[0]))
        writer.writeheader()
        writer.writerows(records)
    print(f"written: {path}")


def write_between_markers(path: Path, name: str, text: str) -> None:
    """Replace what stands between `<!-- name -->` and `<!-- /name -->` in a file. Raises as `around_markers` does."""
    before, after = around_markers(path, name)
    path.write_text(f"{before}\n{text}\n{after}")
    print(f"written: {path}")


def around_markers(path: Path, name: str) -> tuple[str, str]:
    """What stands before and after, with the markers. Raises OSError, ValueError without them."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    content = path.read_text()
    if content.count(begin) != 1 or content.count(end) != 1 or content.index(end) < content.index(begin):
        raise ValueError(f"{path} should have the lines {begin} and {end}, once each and in this order")
    return content.partition(begin)[0] + begin, end + content.partition(end)[2]
