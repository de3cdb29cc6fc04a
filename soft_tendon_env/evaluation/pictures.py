"""Pictures of evaluations: errors of policies by condition."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from soft_tendon_env.drawing.palette import styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.summaries import Standings


def draw_errors(panels: Mapping[str, Standings], path: Path) -> None:
    """Draw interquartile means of the first error with their intervals, by title of a panel, policy
    and condition. Raises OSError."""
    figure, all_axes = plt.subplots(
        len(panels),
        1,
        figsize=(12, 1.0 + 3.6 * len(panels)),
        constrained_layout=True,
        squeeze=False,
    )
    drawn = styles([*dict.fromkeys(policy for panel in panels.values() for policy, _ in panel)])
    for axes, (title, panel) in zip(all_axes[:, 0], panels.items(), strict=True):
        policies, conditions = ([*dict.fromkeys(key[i] for key in panel)] for i in (0, 1))
        unit = error_unit(next(iter(panel.values())).error)
        for index, policy in enumerate(policies):
            style, places = (
                drawn[policy],
                [k for k, condition in enumerate(conditions) if (policy, condition) in panel],
            )
            found = [panel[policy, conditions[k]] for k in places]
            value, low, high = (
                unit.factor
                * np.array([standing.mean(f"{standing.error}_rms") for standing in found]).T
            )
            x = np.array(places) + 0.7 * ((index + 0.5) / len(policies) - 0.5)
            axes.plot(
                x,
                value,
                style.marker,
                color=style.rgb,
                markersize=5,
                label="/".join(Path(policy).parts[-2:]),
            )
            axes.vlines(x, low, high, color=style.rgb, linewidth=1.5)
        for border in range(len(conditions) - 1):
            axes.axvline(border + 0.5, color="0.85", linewidth=0.8)
        set_log_scale(axes, axes.yaxis)
        axes.set_xticks(range(len(conditions)), conditions, rotation=20)
        axes.set(
            ylabel=f"{unit.heading} RMS,\ninterquartile mean of episodes",
            title=title,
            xlim=(-0.5, len(conditions) - 0.5),
        )
        axes.grid(axis="y", alpha=0.3)
        axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
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
