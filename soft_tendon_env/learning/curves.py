"""Learning curves over the seeds of one training, out of evaluations.csv of every run: as a picture and as a table.

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
from soft_tendon_env.evaluation.tables import FLAG, LEGEND, markdown_table, number, with_seeds
from soft_tendon_env.tools.files import read_numbers
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.types import Array

RMS = "_rms"


class Curves(NamedTuple):
    """Learning curves of one configuration: rows of evaluations.csv of every seed (seeds, steps), those of steps that all seeds have."""

    name: str
    task: str
    rows: list[list[dict[str, float]]]
    best: list[dict[str, Any]]  # evaluations of the best agents

    def values(self, key: str) -> Array:
        """Numbers of a column (seeds, steps)."""
        return np.array([[row[key] for row in rows] for rows in self.rows])


def read_curves(folder: Path, seeds: list[int] | None = None) -> Curves:
    """Curves of a folder's runs, or of some seeds, as far as they have come. Raises ValueError, OSError where nothing can be shown."""
    runs, best, tasks = [], [], set()
    for seed, run in seed_folders(folder).items():
        if seeds is None or seed in seeds:
            try:
                found = read_run(run)["task"], read_run(run / "best")["evaluated"], read_numbers(run / "evaluations.csv")
            except (ValueError, OSError) as error:
                print(f"left out: {describe(error)}")
                continue
            tasks.add(found[0])
            best.append(found[1])
            runs.append({row["steps"]: row for row in found[2]})
    if len(tasks) != 1:
        text = f"has runs of several tasks: {', '.join(sorted(tasks))}" if tasks else "has no run that was evaluated"
        raise ValueError(f"{folder} {text}")
    steps = sorted(set.intersection(*map(set, runs)))
    if not steps:
        raise ValueError(f"{folder.name}: no step at which all seeds were evaluated")
    if max(map(max, runs)) > steps[-1]:
        print(f"{folder.name}: shown up to step {steps[-1]:.0f}, where the first seed ends")
    return Curves(folder.name, tasks.pop(), [[run[step] for step in steps] for run in runs], best)


def draw_curves(all_curves: list[Curves], key: str, path: Path) -> None:
    """Draw an error of one task over the steps, a line with its band per configuration."""
    unit, drawn = error_unit(key.removesuffix(RMS)), styles(curves.name for curves in all_curves)
    figure, axes = plt.subplots(figsize=(6.0, 4.5), constrained_layout=True)
    for curves in all_curves:
        steps, values, colour = curves.values("steps")[0], unit.factor * curves.values(key), drawn[curves.name].rgb
        axes.plot(steps, interquartile_mean(values), color=colour, label=with_seeds(curves.name, len(values)))
        axes.fill_between(steps, *bootstrap_interval(values), color=colour, alpha=0.2, linewidth=0)
    set_log_scale(axes, axes.yaxis)
    axes.set(xlabel="steps", ylabel=f"{unit.heading} RMS", title=f"{all_curves[0].task}: interquartile mean over seeds, 95 % interval")
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    print(f"written: {path}")


def curve_table(all_curves: list[Curves], key: str) -> str:
    """Table of one task: a row per configuration, an error at the last step that all seeds have, and at each seed's best."""
    unit, rows = error_unit(key.removesuffix(RMS)), []
    for curves in all_curves:
        last = [rows[-1] for rows in curves.rows]
        minutes = number(float(np.mean([row["seconds"] for row in last])) / 60.0)
        found = (_spread(evaluated, key, unit.factor) for evaluated in (last, curves.best))
        rows.append((curves.name, str(len(last)), f"{last[0]['steps']:.0f}", minutes, *found))
    errors = (f"{unit.heading} RMS, {which}" for which in ("last", "best"))
    table = markdown_table(("configuration", "seeds", "steps", "time per run [min]", *errors), rows)
    return "\n\n".join([table, f"Interquartile mean [95 % interval] / mean / p{HIGH} over seeds.", *([LEGEND] if FLAG in table else [])])


def _spread(rows: list[dict[str, Any]], key: str, scale: float) -> str:
    """Text of a number of one evaluation per seed, "interquartile mean [low, high] / mean / p90", marked where episodes diverged."""
    values = [np.nan if row[key] is None else scale * row[key] for row in rows]
    low, high, mean, tail = (number(float(value)) for value in (*bootstrap_interval(values), *Tails.of(values)))
    flag = f" {FLAG}" if any(row["diverged"] for row in rows) else ""
    return f"{number(float(interquartile_mean(values)))} [{low}, {high}] / {mean} / {tail}{flag}"


def show_curves(out: Path, names: Sequence[str], seeds: list[int] | None) -> dict[str, str]:
    """Print and draw the curves of every configuration in a folder of runs; their tables by task. seeds: those to be shown; None: all."""
    found, tables = dict[str, list[Curves]](), dict[str, str]()
    for name in names:
        try:
            curves = read_curves(out / name, seeds)
            found.setdefault(curves.task, []).append(curves)
        except (ValueError, OSError) as error:
            print(f"not shown: {error}")
    for task, of_task in found.items():
        key = next(key for key in of_task[0].rows[0][0] if key.endswith(RMS))
        draw_curves(of_task, key, out / f"learning_curves_{task}.png")
        tables[task] = curve_table(of_task, key)
        print(f"\n## {task}\n\n{tables[task]}")
    return tables
