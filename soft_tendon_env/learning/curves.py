"""Learning curves over the seeds of one training, as a picture and as a table.

They come out of evaluations.csv of every run.

Numbers are interquartile means over seeds with 95 % intervals, see summaries.py, at the steps at
which all seeds were evaluated.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.entrants import read_run, seed_folders
from soft_tendon_env.evaluation.pictures import save_figure, set_log_scale
from soft_tendon_env.evaluation.summaries import HIGH, bootstrap_interval, interquartile_mean, tails
from soft_tendon_env.evaluation.tables import FLAG, LEGEND, markdown_table, number, with_seeds
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.tables import read_numbers
from soft_tendon_env.tools.types import Array

RMS = "_rms"


class Curves(NamedTuple):
    """Learning curves of one configuration."""

    name: str
    task: str
    # of evaluations.csv of every seed (seeds, steps), those of steps that all seeds have
    rows: list[list[dict[str, float]]]

    def values(self, key: str) -> Array:
        """Numbers of a column (seeds, steps)."""
        columns = [[row[key] for row in rows] for rows in self.rows]
        return np.array(columns)


def read_curves(folder: Path, seeds: Iterable[Path]) -> Curves:
    """Curves of a folder's runs, one per seed, as far as all have come.

    Raises:
        ValueError: nothing can be shown.
    """
    runs: list[dict[float, dict[str, float]]] = []
    task = ""
    for run in seeds:
        try:
            task_of_run = read_run(run)["task"]
            rows = read_numbers(run / "evaluations.csv")
        except (ValueError, OSError) as error:
            print(f"left out: {describe(error)}")
            continue
        if runs and task_of_run != task:
            raise ValueError(f"{folder} has runs of several tasks: {task}, {task_of_run}")
        task = task_of_run
        by_steps = {row["steps"]: row for row in rows}
        runs.append(by_steps)
    if runs:
        common_steps = set.intersection(*map(set, runs))
        steps = sorted(common_steps)
    else:
        steps = []
    if not steps:
        raise ValueError(f"{folder} has no step at which all seeds were evaluated")
    common = [[run[step] for step in steps] for run in runs]
    return Curves(folder.name, task, common)


def draw_curves(all_curves: list[Curves], key: str, path: Path) -> None:
    """Draw an error of one task over the steps, a line with its band per configuration."""
    unit = error_unit(key.removesuffix(RMS))
    style = styles(curves.name for curves in all_curves)
    figure, axes = plt.subplots(figsize=(6.0, 4.5), constrained_layout=True)
    for curves in all_curves:
        steps = curves.values("steps")[0]
        values = unit.factor * curves.values(key)
        middle = interquartile_mean(values)
        low, high = bootstrap_interval(values)
        colour = style[curves.name].rgb
        label = with_seeds(curves.name, len(values))
        axes.plot(steps, middle, color=colour, label=label)
        axes.fill_between(steps, low, high, color=colour, alpha=0.2, linewidth=0)
    set_log_scale(axes, axes.yaxis)
    task = all_curves[0].task
    axes.set(
        xlabel="steps",
        ylabel=f"{unit.heading} RMS",
        title=f"{task}: interquartile mean over seeds, 95 % interval",
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path)


def curve_table(all_curves: list[Curves], key: str) -> str:
    """Table of one task: a row per configuration, its error at the last step of all seeds."""
    unit = error_unit(key.removesuffix(RMS))
    columns = ("configuration", "seeds", "steps", "time per run [min]", f"{unit.heading} RMS")
    rows = [_table_row(curves, key, unit.factor) for curves in all_curves]
    table = markdown_table(columns, rows)
    parts = [table, f"Interquartile mean [95 % interval] / mean / p{HIGH} over seeds."]
    if FLAG in table:
        parts.append(LEGEND)
    return "\n\n".join(parts)


def _table_row(curves: Curves, key: str, factor: float) -> tuple[str, ...]:
    """Row of one configuration; factor: of the unit in which the error is shown."""
    last = [rows[-1] for rows in curves.rows]
    steps = last[0]["steps"]
    seconds = [row["seconds"] for row in last]
    minutes = float(np.mean(seconds)) / 60.0
    values = [factor * row[key] for row in last]
    middle = number(float(interquartile_mean(values)))
    interval = bootstrap_interval(values)
    low, high = [number(float(bound)) for bound in interval]
    mean_and_tail = tails(values)
    mean, tail = [number(float(value)) for value in mean_and_tail]
    diverged = any(row["diverged"] for row in last)
    if diverged:
        flag = f" {FLAG}"
    else:
        flag = ""
    return (
        curves.name,
        str(len(last)),
        f"{steps:.0f}",
        number(minutes),
        f"{middle} [{low}, {high}] / {mean} / {tail}{flag}",
    )


def show_curves(folders: Sequence[Path]) -> bool:
    """Print and draw the curves of every configuration's folder of runs, beside it.

    Returns:
        False where there are none.
    """
    by_task: dict[str, list[Curves]] = {}
    for folder in folders:
        try:
            curves = read_curves(folder, seed_folders(folder).values())
        except (ValueError, OSError) as error:
            print(f"not shown: {error}")
            continue
        by_task.setdefault(curves.task, []).append(curves)
    for task, of_task in by_task.items():
        columns = of_task[0].rows[0][0]
        errors = (name for name in columns if name.endswith(RMS))
        key = next(errors)
        picture = folders[0].parent / f"learning_curves_{task}.png"
        draw_curves(of_task, key, picture)
        table = curve_table(of_task, key)
        print(f"\n## {task}\n\n{table}")
    return bool(by_task)
