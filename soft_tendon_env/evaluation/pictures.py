"""Pictures of evaluations: errors of policies by condition."""

import math
from collections.abc import Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from soft_tendon_env.drawing.palette import Style, styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.summaries import Standings

DOTS = 130  # pixels of an inch
WIDTH = 5.5  # [in], of a telephone's screen at twice its letters
ROW = 0.62  # [in], height of a condition
AROUND = 0.9  # [in], height of a panel's title and axis
LEGEND_COLUMNS = 2
LEGEND_LINE = 0.3  # [in]
SPREAD = 0.7  # part of a condition's height over which its policies are spread


def draw_errors(panels: Mapping[str, Standings], path: Path) -> None:
    """Draws interquartile means of the first error with their intervals.

    They are by title of a panel, policy and condition. The picture is narrow, so that a telephone
    shows it in letters that one reads. Raises OSError.
    """
    policies = (policy for panel in panels.values() for policy, _ in panel)
    looks = styles(dict.fromkeys(policies))
    heights = []
    for panel in panels.values():
        conditions = {condition for _, condition in panel}
        heights.append(ROW * len(conditions))
    full_rows = len(looks) / LEGEND_COLUMNS
    rows = math.ceil(full_rows)
    legend = LEGEND_LINE * rows
    figure, columns = plt.subplots(
        len(panels),
        1,
        figsize=(WIDTH, sum(heights) + AROUND * len(panels) + legend),
        height_ratios=heights,
        constrained_layout=True,
        squeeze=False,
    )
    rows_of_panels = columns[:, 0]
    for axes, (title, panel) in zip(rows_of_panels, panels.items(), strict=True):
        _draw_panel(axes, panel, looks)
        axes.set_title(title)
    handles = dict[str, Artist]()
    for axes in columns[:, 0]:
        lines, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, lines, strict=True))
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside upper center",
        ncols=LEGEND_COLUMNS,
        frameon=False,
    )
    save_figure(figure, path)


def _draw_panel(
    axes: Axes,
    panel: Standings,
    looks: Mapping[str, Style],
) -> None:
    """Draw means and intervals by policy, one below the other for each condition."""
    policy_names = (policy for policy, _ in panel)
    policies = list(dict.fromkeys(policy_names))
    condition_names = (condition for _, condition in panel)
    conditions = list(dict.fromkeys(condition_names))
    first = next(iter(panel.values()))
    unit = error_unit(first.error)
    # a point and its interval per policy and condition, where it was played
    for index, policy in enumerate(policies):
        look = looks[policy]
        places = []
        means = []
        for place, condition in enumerate(conditions):
            if (policy, condition) in panel:
                standing = panel[policy, condition]
                places.append(place)
                mean = standing.mean(f"{standing.error}_rms")
                means.append(mean)
        values = np.array(means)
        value, low, high = unit.factor * values.T
        share = (index + 0.5) / len(policies)
        aside = share - 0.5
        middles = np.array(places)
        y = middles + SPREAD * aside
        axes.plot(
            value,
            y,
            look.marker,
            color=look.rgb,
            markersize=5,
            label="/".join(Path(policy).parts[-2:]),
        )
        axes.hlines(y, low, high, color=look.rgb, linewidth=1.5)
    # lines between the conditions
    for border in range(len(conditions) - 1):
        axes.axhline(border + 0.5, color="0.85", linewidth=0.8)
    set_log_scale(axes, axes.xaxis)
    axes.set_yticks(range(len(conditions)), conditions)
    axes.set(
        xlabel=f"{unit.heading} RMS, interquartile mean",
        ylim=(len(conditions) - 0.5, -0.5),
    )
    axes.grid(axis="x", alpha=0.3)


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
    if axis is axes.xaxis:
        scale = "xscale"
    else:
        scale = "yscale"
    axes.set(**{scale: "log"})
    axes.margins(0.1)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
