"""Pictures of the benchmark: the error of every policy under every condition, a panel per information regime."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soft_tendon_env.arena.page import condition_title
from soft_tendon_env.arena.standings import Standings
from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.pictures import save_figure, set_log_scale


def draw_arena(found: Standings, path: Path) -> None:
    """Draw interquartile means with their intervals. Raises OSError."""
    regimes = found.regimes()
    figure, panels = plt.subplots(len(regimes), 1, figsize=(12, 1.0 + 3.6 * len(regimes)), constrained_layout=True, squeeze=False)
    unit = error_unit(found.error)
    names = [entrant.label for entrant in found.protocol.entrants]
    drawn = styles(names)
    for axes, regime in zip(panels[:, 0], regimes, strict=True):
        conditions = [condition for condition in found.of if condition.regime == regime]
        there = [name for name in names if any(name in found.of[condition] for condition in conditions)]
        for index, name in enumerate(there):
            places = [place for place, condition in enumerate(conditions) if name in found.of[condition]]
            means = [found.of[conditions[place]][name].mean(found.key) for place in places]
            own, x = drawn[name], np.array(places) + 0.7 * ((index + 0.5) / len(there) - 0.5)
            value, low, high = unit.factor * np.array(means).T
            axes.plot(x, value, own.marker, color=own.rgb, markersize=5, label=name)
            axes.vlines(x, low, high, color=own.rgb, linewidth=1.5)
        for border in range(len(conditions) - 1):
            axes.axvline(border + 0.5, color="0.85", linewidth=0.8)
        set_log_scale(axes, axes.yaxis)
        axes.set_xticks(range(len(conditions)), [condition_title(condition, found) for condition in conditions])
        axes.set(ylabel=f"{unit.heading} RMS", title=f"information: {regime}", xlim=(-0.5, len(conditions) - 0.5))
        axes.grid(axis="y", alpha=0.3)
        axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save_figure(figure, path)
