"""Learning curves over the seeds of one training, out of evaluations.csv of every run: as CSV, as a picture and as a table.

Numbers are interquartile means over seeds with 95 % intervals, see summaries.py, at the steps at which all seeds were evaluated.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.entrants import read_run, seed_folders
from soft_tendon_env.evaluation.pictures import set_log_scale
from soft_tendon_env.evaluation.summaries import HIGH, Tails, bootstrap_interval, interquartile_mean
from soft_tendon_env.evaluation.tables import FLAG, LEGEND, markdown_table, number, with_seeds, write_csv
from soft_tendon_env.tools.files import read_numbers
from soft_tendon_env.tools.messages import describe

RMS = "_rms"
Row = dict[str, float]


class Curves(NamedTuple):
    """Learning curves of one configuration: rows of evaluations.csv by step and the evaluation of the best agent, for every seed."""

    name: str
    task: str
    runs: list[dict[float, Row]]
    best: list[Row]
    steps: list[float]  # that all seeds have
    errors: list[str]  # columns: RMS of the first two errors


def read_curves(folder: Path, seeds: list[int] | None = None) -> Curves:
    """Curves of a folder's runs, or of some seeds, as far as they have come. Raises ValueError, OSError where nothing can be shown."""
    runs, best, tasks = [], [], set()
    for seed, run in seed_folders(folder).items():
        if seeds is None or seed in seeds:
            try:
                rows = read_numbers(run / "evaluations.csv", ("steps", "seconds", "diverged"))
                best.append(read_run(run / "best")["evaluated"])
            except (ValueError, OSError) as error:
                print(f"left out: {describe(error)}")
                continue
            runs.append({row["steps"]: row for row in rows})
            tasks.add(read_run(run)["task"])
    if len(tasks) != 1:
        text = f"has runs of several tasks: {', '.join(sorted(tasks))}" if tasks else "has no run that was evaluated"
        raise ValueError(f"{folder} {text}")
    steps = sorted(set.intersection(*map(set, runs)))
    if not steps:
        raise ValueError(f"{folder.name}: no step at which all seeds were evaluated")
    if max(map(max, runs)) > steps[-1]:
        print(f"{folder.name}: shown up to step {steps[-1]:.0f}, where the first seed ends")
    return Curves(folder.name, tasks.pop(), runs, best, steps, [key for key in runs[0][steps[0]] if key.endswith(RMS)][:2])


def _numbers(curves: Curves, key: str) -> tuple[Any, Any]:
    """Interquartile means (steps,) over seeds of a column, and their intervals."""
    values = np.array([[run[step][key] for step in curves.steps] for run in curves.runs])
    return interquartile_mean(values), bootstrap_interval(values)


def draw_curves(all_curves: list[Curves], path: Path) -> None:
    """Draw the curves of one task: a panel per error, a line with its band per configuration."""
    keys, drawn = all_curves[0].errors, styles(curves.name for curves in all_curves)
    figure, all_axes = plt.subplots(1, len(keys), figsize=(1.0 + 5.0 * len(keys), 4.5), constrained_layout=True, squeeze=False)
    for axes, key in zip(all_axes[0], keys, strict=True):
        unit = error_unit(key.removesuffix(RMS))
        for curves in all_curves:
            (means, bounds), colour = _numbers(curves, key), drawn[curves.name].rgb
            axes.plot(curves.steps, unit.factor * means, color=colour, label=with_seeds(curves.name, len(curves.runs)))
            axes.fill_between(curves.steps, *(unit.factor * bound for bound in bounds), color=colour, alpha=0.2, linewidth=0)
        set_log_scale(axes, axes.yaxis)
        axes.set(xlabel="steps", ylabel=f"{unit.heading} RMS")
        axes.grid(alpha=0.3, which="both")
    all_axes[0, 0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"{all_curves[0].task}: interquartile mean over seeds, 95 % interval")
    figure.savefig(path, dpi=130)
    plt.close(figure)
    print(f"written: {path}")


def curve_table(all_curves: list[Curves]) -> str:
    """Table of one task: a row per configuration, its first error at the last step that all seeds have, and at each seed's best."""
    key = all_curves[0].errors[0]
    unit, rows = error_unit(key.removesuffix(RMS)), []
    for curves in all_curves:
        last = [run[curves.steps[-1]] for run in curves.runs]
        minutes = number(float(np.mean([row["seconds"] for row in last])) / 60.0)
        found = (_spread(evaluated, key, unit.factor) for evaluated in (last, curves.best))
        rows.append((curves.name, str(len(last)), f"{curves.steps[-1]:.0f}", minutes, *found))
    errors = (f"{unit.heading} RMS, {which}" for which in ("last", "best"))
    table = markdown_table(("configuration", "seeds", "steps", "time per run [min]", *errors), rows)
    legends = [f"Interquartile mean [95 % interval] / mean / p{HIGH} over seeds.", *([LEGEND] if FLAG in table else [])]
    return "\n\n".join([table, *legends])


def _spread(rows: list[Row], key: str, scale: float) -> str:
    """Text of a number of one evaluation per seed, "interquartile mean [low, high] / mean / p90", marked where episodes diverged."""
    values = [np.nan if row[key] is None else scale * row[key] for row in rows]
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
        columns: dict[str, Any] = {"steps": curves.steps, "seeds": [len(curves.runs)] * len(curves.steps)}
        for key in curves.errors:
            means, (low, high) = _numbers(curves, key)
            columns |= {key: means, f"{key}_low": low, f"{key}_high": high}
        write_csv(out / name / "learning_curve.csv", [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)])
        found.setdefault(curves.task, []).append(curves)
    for task, of_task in found.items():
        draw_curves(of_task, out / f"learning_curves_{task}.png")
        print(f"\n## {task}\n\n{curve_table(of_task)}")
    return {task: curve_table(of_task) for task, of_task in found.items()}
