"""Pictures of evaluations: errors of episodes by model error, and of several policies, or settings, against their times."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from soft_tendon_env.accuracy.pareto import Point
from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import EpisodeScore
from soft_tendon_env.evaluation.summaries import Summary
from soft_tendon_env.policies.load import short_name


def draw_episodes(scores: Mapping[str, list[EpisodeScore]], title: str, path: Path) -> None:
    """Draw each episode's root mean square error, by model error; crosses are episodes that diverged. Raises OSError."""
    names = list(next(iter(scores.values()))[0].errors)
    figure, all_axes = plt.subplots(1, len(names), figsize=(1.0 + 4.5 * len(names), 4.5), constrained_layout=True, squeeze=False)
    for axes, name in zip(all_axes[0], names, strict=True):
        label, scale = error_unit(name).heading, error_unit(name).factor
        for place, of_error in enumerate(scores.values()):
            for marker, colour, diverged in ((".", "#2e6f95", False), ("x", "#d1495b", True)):
                values = [scale * score.errors[name].rms for score in of_error if (score.diverged is not None) == diverged]
                axes.plot([place] * len(values), values, marker, color=colour)
        set_log_scale(axes, axes.yaxis)
        axes.set_xticks(range(len(scores)), list(scores), rotation=40, ha="right")
        axes.set(ylabel=f"{label}, RMS of an episode")
        axes.grid(alpha=0.3, which="both")
    figure.suptitle(title)
    save_figure(figure, path)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture, print its path, and close the figure. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    print(f"written: {path}")


def set_log_scale(axes: Axes, axis: Axis) -> None:
    """Make an axis logarithmic, with labels at 1, 2, 5, 10, ... and room around."""
    axes.set(**{"xscale" if axis is axes.xaxis else "yscale": "log"})
    axes.margins(0.1)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def draw_comparison(summaries: Mapping[tuple[str, str], Summary], task: str, path: Path) -> None:
    """Draw errors by model error, and against time per action; hollow where episodes diverged, with a bar where there are several seeds.
    Raises OSError."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5), constrained_layout=True, width_ratios=(1.6, 1))
    policies, errors = (list(dict.fromkeys(key[i] for key in summaries)) for i in (0, 1))
    name = next(iter(next(iter(summaries.values())).errors))
    label, scale = error_unit(name).heading, error_unit(name).factor
    for policy, own in styles(policies).items():
        colour, of_policy = own.rgb, [summaries[policy, error] for error in errors]
        values = [scale * summary.errors[name].rms for summary in of_policy]
        left.plot(values, color=colour, alpha=0.4)
        for place, (summary, value) in enumerate(zip(of_policy, values, strict=True)):
            face = "none" if summary.flagged else colour
            left.plot(place, value, own.marker, color=colour, markerfacecolor=face, label=short_name(policy) if place == 0 else None)
            left.vlines(place, *interval_of(summary, name, scale), color=colour)
        time = 1e3 * of_policy[0].action_time.median
        right.plot(time, values[0], own.marker, color=colour, markerfacecolor="none" if of_policy[0].flagged else colour)
        right.vlines(time, *interval_of(of_policy[0], name, scale), color=colour)
    left.set_xticks(range(len(errors)), errors, rotation=40, ha="right")
    figure.legend(frameon=False, fontsize=8, loc="outside right center")
    left.set(ylabel=f"{label}, RMS", title=f"{task} by model error")
    right.set(xlabel="time per action [ms], median", ylabel=f"{label}, RMS", title=errors[0])
    for axes, axis in ((left, left.yaxis), (right, right.yaxis), (right, right.xaxis)):
        set_log_scale(axes, axis)
        axes.grid(alpha=0.3, which="both")
    save_figure(figure, path)


def interval_of(summary: Summary, name: str, scale: float) -> tuple[float, float]:
    """Bounds of an error's RMS; the number itself, twice, where there is one seed."""
    number = summary.errors[name].rms
    low, high = summary.intervals.get(f"{name}_rms", (number, number))
    return scale * float(low), scale * float(high)


def draw_front(title: str, costs: Sequence[tuple[Point, float]], tolerance: float | None, path: Path) -> None:
    """Draw a Pareto front of tip errors against measured CPU times: a line, dots by strain field, presets as crosses with their names, the
    tolerance [m] as a dashed line. Raises OSError."""
    figure, axes = plt.subplots(figsize=(8, 5), constrained_layout=True)
    shown = [(point, 1e3 * time, 1e3 * point.tip_error) for point, time in costs if np.isfinite(point.tip_error)]
    front = [own for own in shown if own[0].setting.strain]
    axes.plot([cpu for _, cpu, _ in front], [error for _, _, error in front], color="0.7", zorder=0)
    for name in dict.fromkeys(point.setting.name for point, _, _ in front):
        own = [(cpu, error) for point, cpu, error in front if point.setting.name == name]
        axes.plot(*zip(*own, strict=True), "o", label=name)
    for point, cpu, error in shown[len(front) :]:
        axes.plot(cpu, error, "x", color="black")
        axes.annotate(point.setting.name.strip("()"), (cpu, error), xytext=(5, 4), textcoords="offset points")
    if tolerance is not None:
        axes.axhline(1e3 * tolerance, color="0.4", linestyle="--", linewidth=1)
    for axis in (axes.xaxis, axes.yaxis):
        set_log_scale(axes, axis)
    axes.set(xlabel="CPU time [ms per simulated second]", ylabel="largest distance of the tip from full physics [mm]", title=title)
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=8)
    save_figure(figure, path)
