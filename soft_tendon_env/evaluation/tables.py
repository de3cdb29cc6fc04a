"""Tables of summaries, in Markdown and as CSV. Millimetres, degrees and milliseconds where people read them, SI units in CSV."""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import BAD, METRICS
from soft_tendon_env.evaluation.summaries import HIGH, Summary

MODEL = "model in the loop"
FLAG = "!"
LEGEND = f"{FLAG}: episodes diverged; errors, effort and rate are those of the episodes that lived."
TAILS = f"mean, p{HIGH}: mean and {HIGH}th percentile over episodes; bad: share of episodes that diverged, or are off by more than "
TAILS += f"{100 * BAD:g} % of the rod's length (RMS; steady-state error of targets that jump)"
SEEDS_LEGEND = "A (B-C): the interquartile mean over seeds of training, and its 95 % bootstrap interval; the rest is of all seeds together."
SEEDS_LEGEND += f" {TAILS}."


class Column(NamedTuple):
    """Column of a table: its heading, its cell as a function of a row's summary, and whether it is among the few that tables have by
    default."""

    header: str
    cell: Callable[[Summary], str]
    usual: bool = False


def number(value: float | None, digits: int = 3) -> str:
    """A number to some significant digits; "-" where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 10.0**digits - 0.5 else f"{value:#.{digits}g}".removesuffix(".")


def format_interval(summary: Summary, key: str, scale: float = 1.0, digits: int = 3) -> str:
    """Interval of a number of `Summary.numbers`, " (low-high)"; "" where that is not of several seeds."""
    if key not in summary.intervals:
        return ""
    low, high = (number(scale * float(bound), digits) for bound in summary.intervals[key])
    return f" ({low} to {high})" if "-" in (low[0], high[0]) else f" ({low}-{high})"


def with_seeds(name: str, count: int | None) -> str:
    """A name, with the number of seeds behind it if there are any."""
    return name if count is None else f"{name} ({count} {'seed' if count == 1 else 'seeds'})"


def format_value(summary: Summary, key: str, scale: float = 1.0, digits: int = 3) -> str:
    """A number of `Summary.numbers`, marked where episodes diverged."""
    found = summary.numbers[key]
    text = number(None if found is None else scale * found, digits) + format_interval(summary, key, scale, digits)
    return f"{text} {FLAG}" if summary.flagged else text


def format_tails(summary: Summary, name: str) -> tuple[str, ...]:
    """Mean and HIGH percentile of an error over episodes, and the share that is bad."""
    return *(number(error_unit(name).factor * value) for value in summary.tails[name]), f"{100 * summary.bad:.0f} %"


def columns_of(summary: Summary) -> list[Column]:
    """Columns for every number of a task's summaries; divergences stand beside the return."""
    columns = list[Column]()
    for place, (name, error) in enumerate(summary.errors.items()):
        headings = [("rms", f"{error_unit(name).heading} RMS"), ("percentile_95", "p95")]
        headings += [] if math.isnan(error.steady_state) else [("steady_state", "steady state")]
        for kind, heading in headings:
            value = partial(format_value, key=f"{name}_{kind}", scale=error_unit(name).factor)
            columns.append(Column(heading, value, usual=kind != "percentile_95"))
        for k, heading in enumerate(("mean", f"p{HIGH}", "bad")[: 2 + (place == 0)]):
            tail = lambda s, name=name, k=k: format_tails(s, name)[k]  # noqa: E731
            columns.append(Column(heading, tail, usual=place == 0 and summary.seeds is not None))
    if summary.reached is not None:
        interval = partial(format_interval, key="reached", scale=100.0, digits=2)
        columns.append(Column("reached", lambda s: "-" if s.reached is None else f"{100 * s.reached:.0f} %{interval(s)}", usual=True))
    return [
        *columns,
        Column("settled", lambda s: f"{s.settled}/{s.episodes}", usual=True),
        Column("after [s]", lambda s: number(s.settling_time)),
        *(Column(METRICS[name].heading, partial(format_value, key=name), METRICS[name].usual) for name in summary.metrics),
        Column("violations", lambda s: str(s.bound_violations)),
        Column("return", lambda s: format_value(s, "mean_return", digits=4)),
        Column("diverged", lambda s: f"{s.diverged}/{s.episodes}"),
        Column("time [ms]", lambda s: number(1e3 * s.action_time.median), usual=True),
        Column("p99 [ms]", lambda s: number(1e3 * s.action_time.percentile_99)),
    ]


def summary_table(label: str, summaries: Mapping[str, Summary], every: bool = False, models: Mapping[str, str] | None = None) -> str:
    """Table with a row per summary: errors, settled, chatter, time of an action; or every number. models: a last column by name, the
    policies' use of a model at run time, see `entrants.model_in_the_loop`."""
    first = next((summary for summary in summaries.values() if summary.seeds), next(iter(summaries.values())))
    columns = [column for column in columns_of(first) if every or column.usual]
    rows = [
        (with_seeds(name, summary.seeds), *(column.cell(summary) for column in columns), *([] if models is None else [models[name]]))
        for name, summary in summaries.items()
    ]
    header = (label, *(column.header for column in columns), *([] if models is None else [MODEL]))
    return with_legends(markdown_table(header, rows), summaries.values())


def error_table(summaries: Mapping[tuple[str, str], Summary]) -> str:
    """Table of root mean square errors by policy (rows) and model error (columns); the task's first two numbers to a cell, and of several
    seeds what their interquartile means leave out."""
    first = next(iter(summaries.values()))
    # RMS of the first error, and its steady state, or the RMS of the second or, for goals, the share reached
    shown = [column for column in columns_of(replace(first, seeds=None)) if column.usual][:2]
    policies, errors = ([*dict.fromkeys(key[i] for key in summaries)] for i in (0, 1))

    def cell(summary: Summary) -> str:
        mean, high, bad = format_tails(summary, next(iter(first.errors)))
        tails = f", mean {mean}, p{HIGH} {high}, {bad} bad" if summary.seeds else ""
        return " / ".join(column.cell(summary) for column in shown) + tails

    rows = [
        (with_seeds(policy, summaries[policy, errors[0]].seeds), *(cell(summaries[policy, error]) for error in errors))
        for policy in policies
    ]
    header = (" / ".join(column.header for column in shown), *errors)
    return with_legends(markdown_table(header, rows), summaries.values())


def with_legends(table: str, summaries: Iterable[Summary]) -> str:
    """Table with the legends that its summaries need."""
    shown = list(summaries)
    flags = [LEGEND] if any(summary.flagged for summary in shown) else []
    seeds = [SEEDS_LEGEND] if any(summary.seeds for summary in shown) else []
    return "\n\n".join([table, *flags, *seeds])


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table that reads well as it is and as Markdown."""
    cells = [tuple(header), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]])


def write_csv(path: Path, records: Sequence[dict[str, Any]]) -> None:
    """Write a CSV file: a row per record, a column per key that any of them has. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for record in records for key in record)))
        writer.writeheader()
        writer.writerows(records)
    print(f"written: {path}")
