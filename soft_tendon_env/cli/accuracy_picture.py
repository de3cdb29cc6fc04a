"""Picture of a Pareto front: tip error against measured CPU time."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soft_tendon_env.accuracy.pareto import Point
from soft_tendon_env.evaluation.pictures import set_log_scale


def draw_front(title: str, costs: Sequence[tuple[Point, float]], tolerance: float | None, path: Path) -> None:
    """The front as a line by strain field, presets as crosses with their names, the tolerance [m] as a dashed line."""
    figure, axes = plt.subplots(figsize=(8, 5), dpi=130, constrained_layout=True)
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
    figure.savefig(path)
    plt.close(figure)
