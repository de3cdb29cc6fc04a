"""Learning curves over the seeds of one training, out of evaluations.csv of every run: as CSV, as a picture and as a table.

Numbers are interquartile means over seeds with 95 % intervals, see summaries.py, at the steps at which all seeds were evaluated.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.entrants import read_run, seed_folders
from soft_tendon_env.evaluation.pictures import set_log_scale
from soft_tendon_env.evaluation.summaries import HIGH, Interval, Tails, bootstrap_interval, interquartile_mean
from soft_tendon_env.evaluation.tables import FLAG, LEGEND, markdown_table, number, with_seeds, write_csv
from soft_tendon_env.tools.files import read_numbers
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.types import Array

NEEDED = ("steps", "seconds", "diverged")
REACHED = "reached"
RMS = "_rms"
PANELS = 2  # of errors, from the task's first


class Curve(NamedTuple):
    """Learning curve of one run: rows of evaluations.csv by step, and the evaluation of its best agent."""

    task: str
    rows: dict[int, dict[str, float]]
    best: dict[str, float]


class Curves(NamedTuple):
    """Learning curves of one configuration: its runs by seed, the steps that all have, and every number's mean and interval at them."""

    name: str
    runs: dict[int, Curve]
    steps: list[int]
    means: dict[str, Array]
    intervals: dict[str, Interval]

    @property
    def task(self) -> str:
        return next(iter(self.runs.values())).task


def read_curve(run: Path) -> Curve:
    """Learning curve of a run. Raises ValueError where a file is damaged, FileNotFoundError where there is no evaluation yet."""
    path = run / "evaluations.csv"
    if not path.is_file() or not (run / "best" / "config.json").is_file():
        raise FileNotFoundError(f"{run} has no evaluations.csv or no best agent")
    rows = read_numbers(path, NEEDED)
    if not rows:
        raise ValueError(f"{path} has no evaluation")
    task, best = read_run(run).get("task"), read_run(run / "best").get("evaluated")
    if task not in IDS:
        raise ValueError(f"{run / 'config.json'} should name the task, {', '.join(IDS)}, not {task!r}")
    errors = [key for key in rows[0] if key.endswith(RMS)]
    if not errors:
        raise ValueError(f"{path} has no column of an error, NAME{RMS}")
    if not isinstance(best, dict) or not best.keys() >= {"diverged", *errors}:
        raise ValueError(f"{run / 'best' / 'config.json'} should have the evaluation of the best agent: diverged, {', '.join(errors)}")
    return Curve(task, {int(row["steps"]): row for row in rows}, {key: math.nan if value is None else value for key, value in best.items()})


def read_curves(folder: Path, seeds: list[int] | None = None) -> Curves:
    """Curves of a folder's runs, or of some seeds, as far as they have come. Raises ValueError, OSError where nothing can be shown."""
    runs = {}
    for seed, run in seed_folders(folder).items():
        if seeds is not None and seed not in seeds:
            continue
        try:
            runs[seed] = read_curve(run)
        except (ValueError, OSError) as error:
            print(f"left out: {describe(error)}")
    if not runs:
        raise FileNotFoundError(f"{folder} has no run that was evaluated")
    if len({curve.task for curve in runs.values()}) > 1:
        raise ValueError(f"{folder} has runs of several tasks: {', '.join(f'seed {seed}: {run.task}' for seed, run in runs.items())}")
    return combine_runs(folder.name, runs)


def combine_runs(name: str, runs: dict[int, Curve]) -> Curves:
    """Curves of the runs of a configuration. Raises ValueError where seeds have no step in common."""
    steps = sorted(set.intersection(*(set(run.rows) for run in runs.values())))
    if not steps:
        raise ValueError(f"{name}: no step at which all seeds were evaluated")
    late = [f"seed {seed} ({max(run.rows)})" for seed, run in runs.items() if max(run.rows) > steps[-1]]
    if late:
        print(f"{name}: shown up to step {steps[-1]}, where the first seed ends; further: {', '.join(late)}")
    values = {key: np.array([[run.rows[step][key] for step in steps] for run in runs.values()]) for key in number_columns(runs)}
    means = {key: np.asarray(interquartile_mean(of_runs)) for key, of_runs in values.items()}
    return Curves(name, runs, steps, means, {key: bootstrap_interval(of_runs) for key, of_runs in values.items()})


def number_columns(runs: dict[int, Curve]) -> list[str]:
    """Columns of evaluations.csv: the RMS of the first errors and, for goals, the share reached."""
    header = next(iter(next(iter(runs.values())).rows.values()))
    return [*[key for key in header if key.endswith(RMS)][:PANELS], *([REACHED] if REACHED in header else [])]


def unit_of(key: str) -> tuple[str, float]:
    """Label and scale of a number where people read it."""
    if key == REACHED:
        return "reached [%]", 100.0
    unit = error_unit(key.removesuffix(RMS))
    return f"{unit.heading} RMS", unit.factor


def write_curves(path: Path, curves: Curves) -> None:
    """Write a row per step, in SI units."""
    columns: dict[str, Any] = {"steps": curves.steps, "seeds": [len(curves.runs)] * len(curves.steps)}
    for key, means in curves.means.items():
        columns |= {key: means, f"{key}_low": curves.intervals[key].low, f"{key}_high": curves.intervals[key].high}
    write_csv(path, [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)])


def draw_curves(all_curves: list[Curves], path: Path) -> None:
    """Draw the curves of one task: a panel per number, a line with its band per configuration."""
    keys = list(dict.fromkeys(key for curves in all_curves for key in curves.means))
    drawn = styles(curves.name for curves in all_curves)
    figure, all_axes = plt.subplots(1, len(keys), figsize=(1.0 + 5.0 * len(keys), 4.5), constrained_layout=True, squeeze=False)
    for axes, key in zip(all_axes[0], keys, strict=True):
        label, scale = unit_of(key)
        for curves in all_curves:
            colour = drawn[curves.name].rgb
            axes.plot(curves.steps, scale * curves.means[key], color=colour, label=with_seeds(curves.name, len(curves.runs)))
            bounds = (scale * bound for bound in curves.intervals[key])
            axes.fill_between(curves.steps, *bounds, color=colour, alpha=0.2, linewidth=0)
        if key != REACHED:
            set_log_scale(axes, axes.yaxis)
        axes.set(xlabel="steps", ylabel=label)
        axes.grid(alpha=0.3, which="both")
    all_axes[0, 0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{all_curves[0].task}: interquartile mean over seeds, 95 % interval")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    print(f"written: {path}")


def curve_table(all_curves: list[Curves]) -> str:
    """Table of one task: a row per configuration, its first error at the last step that all seeds have, and at each seed's best."""
    key = next(iter(all_curves[0].means))
    label, scale = unit_of(key)
    header = ("configuration", "seeds", "steps", "time per run [min]", f"{label}, last", f"{label}, best")
    table = markdown_table(header, [curve_row(curves, key, scale) for curves in all_curves])
    legends = [f"Interquartile mean [95 % interval] / mean / p{HIGH} over seeds.", *([LEGEND] if FLAG in table else [])]
    return "\n\n".join([table, *legends])


def curve_row(curves: Curves, key: str, scale: float) -> tuple[str, ...]:
    """Row of a configuration; the time is the mean of its runs'."""
    last = [run.rows[curves.steps[-1]] for run in curves.runs.values()]
    best = [run.best for run in curves.runs.values()]
    minutes = number(float(np.mean([row["seconds"] for row in last])) / 60.0)
    return curves.name, str(len(last)), str(curves.steps[-1]), minutes, *(spread(rows, key, scale) for rows in (last, best))


def spread(rows: list[dict[str, float]], key: str, scale: float) -> str:
    """Text of a number of one evaluation per seed, "interquartile mean [low, high] / mean / p90", marked where episodes diverged."""
    values = [scale * row[key] for row in rows]
    low, high, mean, tail = (number(float(value)) for value in (*bootstrap_interval(values), *Tails.of(values)))
    flag = f" {FLAG}" if any(row["diverged"] for row in rows) else ""
    return f"{number(float(interquartile_mean(values)))} [{low}, {high}] / {mean} / {tail}{flag}"


def show_curves(out: Path, names: Sequence[str], seeds: list[int] | None) -> dict[str, str]:
    """Print, draw and write the curves of every configuration in a folder of runs; their tables by task.

    seeds: those to be shown; None: all that are there.
    """
    found: dict[str, list[Curves]] = {}
    for name in names:
        try:
            curves = read_curves(out / name, seeds)
        except (ValueError, OSError) as error:
            print(f"not shown: {error}")
            continue
        write_curves(out / name / "learning_curve.csv", curves)
        found.setdefault(curves.task, []).append(curves)
    for task, of_task in found.items():
        draw_curves(of_task, out / ("learning_curves.png" if len(found) == 1 else f"learning_curves_{task}.png"))
        print(f"\n## {task}\n\n{curve_table(of_task)}")
    return {task: curve_table(of_task) for task, of_task in found.items()}
