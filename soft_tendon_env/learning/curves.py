"""Learning curves over the seeds of one training, out of evaluations.csv of every run: as a picture
and as a table.

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
    """Learning curves of one configuration: rows of evaluations.csv of every seed (seeds, steps),
    those of steps that all seeds have."""

    name: str
    task: str
    rows: list[list[dict[str, float]]]

    def values(self, key: str) -> Array:
        """Numbers of a column (seeds, steps)."""
        return np.array([[row[key] for row in rows] for rows in self.rows])


def read_curves(folder: Path, seeds: Iterable[Path]) -> Curves:
    """Curves of a folder's runs, one per seed, as far as all have come. Raises ValueError where
    nothing can be shown."""
    runs, task = list[dict[float, dict[str, float]]](), ""
    for run in seeds:
        try:
            found = (
                read_run(run)["task"],
                {row["steps"]: row for row in read_numbers(run / "evaluations.csv")},
            )
        except (ValueError, OSError) as error:
            print(f"left out: {describe(error)}")
            continue
        if runs and found[0] != task:
            raise ValueError(f"{folder} has runs of several tasks: {task}, {found[0]}")
        task = found[0]
        runs.append(found[1])
    steps = sorted(set.intersection(*map(set, runs))) if runs else []
    if not steps:
        raise ValueError(f"{folder} has no step at which all seeds were evaluated")
    return Curves(folder.name, task, [[run[step] for step in steps] for run in runs])


def draw_curves(all_curves: list[Curves], key: str, path: Path) -> None:
    """Draw an error of one task over the steps, a line with its band per configuration."""
    unit, drawn = error_unit(key.removesuffix(RMS)), styles(curves.name for curves in all_curves)
    figure, axes = plt.subplots(figsize=(6.0, 4.5), constrained_layout=True)
    for curves in all_curves:
        steps, values, colour = (
            curves.values("steps")[0],
            unit.factor * curves.values(key),
            drawn[curves.name].rgb,
        )
        axes.plot(
            steps,
            interquartile_mean(values),
            color=colour,
            label=with_seeds(curves.name, len(values)),
        )
        axes.fill_between(steps, *bootstrap_interval(values), color=colour, alpha=0.2, linewidth=0)
    set_log_scale(axes, axes.yaxis)
    axes.set(
        xlabel="steps",
        ylabel=f"{unit.heading} RMS",
        title=f"{all_curves[0].task}: interquartile mean over seeds, 95 % interval",
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path)


def curve_table(all_curves: list[Curves], key: str) -> str:
    """Table of one task: a row per configuration, its error at the last step that all seeds
    have."""
    unit, rows = error_unit(key.removesuffix(RMS)), []
    for curves in all_curves:
        last = [of_seed[-1] for of_seed in curves.rows]
        minutes, values = (
            number(float(np.mean([row["seconds"] for row in last])) / 60.0),
            [unit.factor * row[key] for row in last],
        )
        middle, low, high, mean, tail = (
            number(float(value))
            for value in (interquartile_mean(values), *bootstrap_interval(values), *tails(values))
        )
        flag = f" {FLAG}" if any(row["diverged"] for row in last) else ""
        rows.append(
            (
                curves.name,
                str(len(last)),
                f"{last[0]['steps']:.0f}",
                minutes,
                f"{middle} [{low}, {high}] / {mean} / {tail}{flag}",
            )
        )
    table = markdown_table(
        ("configuration", "seeds", "steps", "time per run [min]", f"{unit.heading} RMS"), rows
    )
    return "\n\n".join(
        [
            table,
            f"Interquartile mean [95 % interval] / mean / p{HIGH} over seeds.",
            *([LEGEND] if FLAG in table else []),
        ]
    )


def show_curves(folders: Sequence[Path]) -> bool:
    """Print and draw the curves of every configuration's folder of runs, beside it; False where
    there are none."""
    found = dict[str, list[Curves]]()
    for folder in folders:
        try:
            curves = read_curves(folder, seed_folders(folder).values())
            found.setdefault(curves.task, []).append(curves)
        except (ValueError, OSError) as error:
            print(f"not shown: {error}")
    for task, of_task in found.items():
        key = next(key for key in of_task[0].rows[0][0] if key.endswith(RMS))
        draw_curves(of_task, key, folders[0].parent / f"learning_curves_{task}.png")
        print(f"\n## {task}\n\n{curve_table(of_task, key)}")
    return bool(found)
