"""Tables of summaries and standings, in Markdown and as CSV. Millimetres, degrees and milliseconds where people read them, SI in CSV."""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import BAD, METRICS
from soft_tendon_env.evaluation.summaries import HIGH, Standing, Standings, Summary, Tails

MODEL = "model in the loop"
FLAG = "!"
LEGEND = f"{FLAG}: episodes diverged; errors, effort and rate are those of the episodes that lived."
ERRORS_LEGEND = f"""Root mean square of an episode: interquartile mean (95 % bootstrap interval) / mean / {HIGH}th percentile / share bad,
episodes that diverged, or are off by more than {100 * BAD:g} % of the rod's length (RMS; steady-state error of targets that jump)."""


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


def with_seeds(name: str, count: int | None) -> str:
    """A name, with the number of seeds behind it if there are any."""
    return name if count is None else f"{name} ({count} {'seed' if count == 1 else 'seeds'})"


def columns_of(first: Summary) -> list[Column]:
    """Columns for every number of a task's summaries; divergences stand beside the return."""

    def flagged(heading: str, value: Callable[[Summary], float], usual: bool = False, digits: int = 3) -> Column:
        return Column(heading, lambda s: number(value(s), digits) + f" {FLAG}" * s.flagged, usual)

    columns = list[Column]()
    for name, error in first.errors.items():
        headings = ((f"{error_unit(name).heading} RMS", 0), ("p95", 1), *(() if math.isnan(error.steady_state) else (("steady state", 2),)))
        for heading, k in headings:
            columns.append(flagged(heading, lambda s, name=name, k=k: error_unit(name).factor * s.errors[name][k], k != 1))  # type: ignore
    if first.reached is not None:
        columns.append(Column("reached", lambda s: f"{100 * (s.reached or 0.0):.0f} %", usual=True))
    return [
        *columns,
        Column("settled", lambda s: f"{s.settled}/{s.episodes}", usual=True),
        Column("after [s]", lambda s: number(s.settling_time)),
        *(flagged(METRICS[name].heading, lambda s, name=name: s.metrics[name], METRICS[name].usual) for name in first.metrics),  # type: ignore
        Column("violations", lambda s: str(s.bound_violations)),
        flagged("return", lambda s: s.mean_return, digits=4),
        Column("diverged", lambda s: f"{s.diverged}/{s.episodes}"),
        Column("time [ms]", lambda s: number(1e3 * s.action_time.median), usual=True),
        Column("p99 [ms]", lambda s: number(1e3 * s.action_time.percentile_99)),
    ]


def summary_table(label: str, summaries: Mapping[str, Summary], every: bool = False, models: Mapping[str, str] | None = None) -> str:
    """Table with a row per summary: errors, settled, chatter, time of an action; or every number. models: a last column by name, the
    policies' use of a model at run time, see `entrants.model_in_the_loop`."""
    columns = [column for column in columns_of(next(iter(summaries.values()))) if every or column.usual]
    rows = [
        (name, *(column.cell(summary) for column in columns), *([] if models is None else [models[name]]))
        for name, summary in summaries.items()
    ]
    table = markdown_table((label, *(column.header for column in columns), *([] if models is None else [MODEL])), rows)
    return f"{table}\n\n{LEGEND}" if any(summary.flagged for summary in summaries.values()) else table


def error_text(standing: Standing) -> str:
    """Root mean squares of the task's first error in words, see ERRORS_LEGEND."""
    factor, key = error_unit(standing.error).factor, f"{standing.error}_rms"
    value, low, high, mean, tail = (number(factor * value) for value in (*standing.mean(key), *Tails.of(standing.values(key))))
    return f"{value} ({low}-{high}) / {mean} / {tail} / {100.0 * standing.bad:.0f} %"


def error_table(found: Standings) -> str:
    """Table of the task's first error by policy (rows) and condition (columns), "-" where a policy did not play."""
    policies, conditions = ([*dict.fromkeys(key[i] for key in found)] for i in (0, 1))
    rows = []
    for policy in policies:
        members = next(len(standing.scores) for (name, _), standing in found.items() if name == policy)
        cells = (error_text(found[policy, condition]) if (policy, condition) in found else "-" for condition in conditions)
        rows.append((with_seeds(policy, members if members > 1 else None), *cells))
    header = f"{error_unit(next(iter(found.values())).error).heading} RMS"
    return f"{markdown_table((header, *conditions), rows)}\n\n{ERRORS_LEGEND}"


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table that reads well as it is and as Markdown."""
    cells = [tuple(header), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in cells]
    return "\n".join([lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]])


def records(found: Standings) -> list[dict[str, Any]]:
    """Errors, metrics and time of an action of every policy under every condition, SI units, with their intervals, for CSV."""
    rows = []
    for (policy, condition), standing in found.items():
        row: dict[str, Any] = {
            "policy": policy,
            "condition": condition,
            "members": len(standing.scores),
            "episodes": len(standing.episodes),
        }
        for key in standing.episodes[0].numbers:
            mean = standing.mean(key)
            row |= {key: mean.value, f"{key}_low": mean.low, f"{key}_high": mean.high}
        rows.append({**row, "bad": standing.bad})
    return rows


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a CSV file: a row per record, a column per key that any of them has. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)
    print(f"written: {path}")
