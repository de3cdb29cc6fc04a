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

from soft_tendon_env.drawing.palette import Style, styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.summaries import Standings

DOTS = 130  # pixels of an inch
SPREAD = 0.7  # part of a condition's width over which its policies are spread


def draw_errors(panels: Mapping[str, Standings], path: Path) -> None:
    """Draws interquartile means of the first error with their intervals.

    They are by title of a panel, policy and condition. Raises OSError.
    """
    figure, columns = plt.subplots(
        len(panels),
        1,
        figsize=(12, 1.0 + 3.6 * len(panels)),
        constrained_layout=True,
        squeeze=False,
    )
    looks = styles(dict.fromkeys(policy for panel in panels.values() for policy, _ in panel))
    for axes, (title, panel) in zip(columns[:, 0], panels.items(), strict=True):
        _draw_panel(axes, panel, looks)
        axes.set_title(title)
    save_figure(figure, path)


def _draw_panel(
    axes: Axes,
    panel: Standings,
    looks: Mapping[str, Style],
) -> None:
    """Draw means and intervals by policy, side by side for each condition."""
    policies = list(dict.fromkeys(policy for policy, _ in panel))
    conditions = list(dict.fromkeys(condition for _, condition in panel))
    unit = error_unit(next(iter(panel.values())).error)
    # a point and its interval per policy and condition, where it was played
    for index, policy in enumerate(policies):
        look = looks[policy]
        places = []
        means = []
        for place, condition in enumerate(conditions):
            if (policy, condition) in panel:
                standing = panel[policy, condition]
                places.append(place)
                means.append(standing.mean(f"{standing.error}_rms"))
        value, low, high = unit.factor * np.array(means).T
        aside = (index + 0.5) / len(policies) - 0.5
        x = np.array(places) + SPREAD * aside
        axes.plot(
            x,
            value,
            look.marker,
            color=look.rgb,
            markersize=5,
            label="/".join(Path(policy).parts[-2:]),
        )
        axes.vlines(x, low, high, color=look.rgb, linewidth=1.5)
    # lines between the conditions
    for border in range(len(conditions) - 1):
        axes.axvline(border + 0.5, color="0.85", linewidth=0.8)
    set_log_scale(axes, axes.yaxis)
    axes.set_xticks(range(len(conditions)), conditions, rotation=20)
    axes.set(
        ylabel=f"{unit.heading} RMS,\ninterquartile mean of episodes",
        xlim=(-0.5, len(conditions) - 0.5),
    )
    axes.grid(axis="y", alpha=0.3)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture, print its path, and close the figure.

    Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DOTS)
    plt.close(figure)
    print(f"written: {path}")


def set_log_scale(axes: Axes, axis: Axis) -> None:
    """Make an axis logarithmic, with labels at 1, 2, 5, 10, ...

    and room around.
    """
    axes.set(**{"xscale" if axis is axes.xaxis else "yscale": "log"})
    axes.margins(0.1)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
