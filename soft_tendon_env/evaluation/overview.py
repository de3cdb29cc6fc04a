"""Overview picture of policies on the same episode.

It has shapes of one arm on its way, paths of all tips, errors over time, and numbers.

It is read on a phone at a third of its size: large letters, few parts, one above the other.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from soft_tendon_env.drawing import shapes
from soft_tendon_env.drawing.palette import Style, styles
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation.metrics import BAD, SETTLED
from soft_tendon_env.evaluation.pictures import save_figure
from soft_tendon_env.recording.rollout import Rollout
from soft_tendon_env.tools.types import Array

SIZE = (8.3, 12.4)  # width and height [in]
HEIGHTS = (4.6, 3.6, 3.2)  # of arm and paths, of errors, of numbers: shares of their sum
WIDTHS = (0.8, 1.2)  # of the arm and of the paths: shares of their sum
HEADLINE = 24  # [pt]
LETTERS = 17  # [pt], also of the numbers
GREY = "0.35"  # colour of text and lines that belong to no policy
TARGET = "0.82"  # colour of the target's path

SHAPES = 9  # backbones that are drawn of the arm
STATIONS = 60  # points on a backbone
ELEVATION = 30.0  # [deg] of the camera above the floor, from where a circle across the arm is round
ROD_WIDTH = 7.0  # [pt]
FAINTEST = 0.2  # opacity of the first backbone; the last is opaque

TARGET_WIDTH = 13.0  # [pt], wider than all paths, which lie on it
WIDEST = 6.0  # [pt], path of the first policy; the others lie on it, ever thinner
THINNEST = 2.0  # [pt], path of the last policy
LOST_WIDTH = 0.8  # [pt], path of a policy that is far off, which would cover the others
ROOM = 0.25  # around the target's path on each side, in its widths
ROOM_OF_ARM = 0.06  # around the arm on each side, in its widths and heights

MARKS = 5  # markers on a line of the errors
MARKER_SIZE = 10  # [pt]
HEADING_ROWS = 2.2  # height of the headings of numbers, in rows
MARKER_PLACE = 0.02  # of a policy's marker beside its numbers, as a share of the width
NAME_EDGE = 0.05  # left edge of the policies' names, as a share of the width
FIRST_NUMBER = 0.56  # right edge of the first column of numbers, as a share of the width


class Overview(NamedTuple):
    """Content of the picture.

    Attributes:
        headline: above all.
        rollouts: episodes of the policies by name, all with the same target poses.
        bent: name of the policy whose arm is drawn.
        error: scalar of the rollouts that is drawn over time, see `error_unit`.
        numbers: cells of the policies' rows by heading; headings may have several lines.
    """

    headline: str
    rollouts: Mapping[str, Rollout]
    bent: str
    error: str
    numbers: Mapping[str, Mapping[str, str]]


def draw_overview(overview: Overview, path: Path) -> None:
    """Draw shapes, paths, errors and numbers into one picture.

    Raises ValueError for rollouts without target poses, OSError.
    """
    figure = plt.figure(figsize=SIZE, layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=HEIGHTS, width_ratios=WIDTHS)
    figure.suptitle(overview.headline, fontsize=HEADLINE, fontweight="bold")
    looks = styles(overview.numbers)
    arm = figure.add_subplot(grid[0, 0])
    draw_arm(arm, overview, looks)
    paths = figure.add_subplot(grid[0, 1])
    draw_paths(paths, overview, looks)
    errors = figure.add_subplot(grid[1, :])
    draw_errors_over_time(errors, overview, looks)
    table = figure.add_subplot(grid[2, :])
    draw_numbers(table, overview.numbers, looks)
    save_figure(figure, path)


def draw_arm(
    axes: Axes,
    overview: Overview,
    looks: Mapping[str, Style],
) -> None:
    """Draws backbones of one arm and its target's path.

    The camera of frames sees them, from higher up.
    """
    rollout = overview.rollouts[overview.bent]
    _, _, vertical, upright = shapes.view_box(rollout.model.scene)
    camera = shapes.viewpoint(vertical, upright, ELEVATION)
    across = camera[:2].T  # (3, 2), from the world to the picture
    backbones = backbones_on_the_way(rollout) @ across
    target = target_path(rollout) @ across
    axes.plot(*target.T, color=TARGET, linewidth=0.5 * TARGET_WIDTH)
    # the later a shape, the less of it shows through
    opacities = np.linspace(FAINTEST, 1.0, len(backbones))
    for backbone, opacity in zip(backbones, opacities, strict=True):
        axes.plot(
            *backbone.T,
            color=looks[overview.bent].rgb,
            alpha=opacity,
            linewidth=ROD_WIDTH,
            solid_capstyle="round",
        )
    points = np.concatenate([target, *backbones])
    show_around(axes, points, ROOM_OF_ARM)
    title = f"arm: {overview.bent}"
    axes.set_title(title, fontsize=LETTERS, color=GREY)


def backbones_on_the_way(rollout: Rollout) -> Array:
    """Backbones (SHAPES, points, 3) [m] of the arm at equal distances in time.

    Those of the first and of the last sample are among them.
    """
    last = rollout.samples - 1
    even = np.linspace(0, last, SHAPES)
    samples = even.round().astype(int)
    stations = shapes.drawing_stations(rollout.model, STATIONS)
    times = samples * rollout.period
    base = shapes.base_poses(rollout.model, times, rollout.scene)
    strain = rollout.strain[samples]
    poses = shapes.backbones(rollout.model, strain, stations, base)
    return shapes.positions(poses)


def target_path(rollout: Rollout) -> Array:
    """Positions (samples, 3) [m] of a rollout's target.

    Raises ValueError where it has no poses.
    """
    if rollout.target_pose is None:
        raise ValueError("rollouts should have target_pose, as those of TipPose have")
    return shapes.positions(rollout.target_pose)


def draw_paths(
    axes: Axes,
    overview: Overview,
    looks: Mapping[str, Style],
) -> None:
    """Draws the paths of all tips and of their target.

    They are seen along the straight arm from its tip.
    """
    first = next(iter(overview.rollouts.values()))
    across = first.model.scene.base.pose[:3, 1:3]  # (3, 2), from the world to the picture
    target = target_path(first) @ across
    axes.plot(
        *target.T,
        color=TARGET,
        linewidth=TARGET_WIDTH,
        label="target",
    )
    # a path that leaves the surroundings of the target is cut off
    show_around(axes, target, ROOM)
    for name, width in line_widths(overview).items():
        rollout = overview.rollouts[name]
        path = shapes.positions(rollout.tip_pose)
        tip = path @ across
        axes.plot(
            *tip.T,
            color=looks[name].rgb,
            linewidth=width,
            label=name,
        )
    axes.set_title("paths of the tips (grey: target)", fontsize=LETTERS, color=GREY)


def line_widths(overview: Overview) -> dict[str, float]:
    """Widths [pt] of lines by policy, from wide to thin in the order of drawing.

    Each can so be seen on those below it.
    """
    count = len(overview.rollouts)
    even = np.linspace(WIDEST, THINNEST, count)
    widths = even.tolist()
    by_policy = dict(zip(overview.rollouts, widths, strict=True))
    for name, rollout in overview.rollouts.items():
        errors = rollout.scalars[overview.error]
        error = np.median(errors)  # the way to the target does not count
        bad = BAD * rollout.model.length
        if not error <= bad:
            by_policy[name] = LOST_WIDTH
    return by_policy


def show_around(
    axes: Axes,
    points: Array,
    room: float,
) -> None:
    """Set limits around points (m, 2), with one scale for both axes, which are not drawn."""
    lower = points.min(axis=0)
    upper = points.max(axis=0)
    margin = room * (upper - lower)
    left, bottom = lower - margin
    right, top = upper + margin
    axes.set(xlim=(left, right), ylim=(bottom, top))
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_errors_over_time(
    axes: Axes,
    overview: Overview,
    looks: Mapping[str, Style],
) -> None:
    """Draw an error of every policy over time, and the bound below which an episode has settled."""
    unit = error_unit(overview.error)
    for name, width in line_widths(overview).items():
        rollout = overview.rollouts[name]
        axes.plot(
            rollout.period * np.arange(rollout.samples),
            unit.factor * rollout.scalars[overview.error],
            color=looks[name].rgb,
            linewidth=max(width, THINNEST),
            marker=looks[name].marker,
            markersize=MARKER_SIZE,
            markeredgecolor="white",
            markevery=max(rollout.samples // MARKS, 1),
            label=name,
        )
    length = overview.rollouts[overview.bent].model.length
    bound = unit.factor * SETTLED * length
    axes.axhline(bound, color=GREY, linewidth=1.5, linestyle="--")
    # errors of the policies differ by factors
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("time [s]", fontsize=LETTERS)
    axes.set_title(
        f"{unit.label} [{unit.symbol}] (dashed: settled)",
        fontsize=LETTERS,
        color=GREY,
    )
    axes.tick_params(labelsize=LETTERS)
    axes.grid(axis="y", alpha=0.3)
    axes.margins(x=0.01)


def draw_numbers(
    axes: Axes,
    numbers: Mapping[str, Mapping[str, str]],
    looks: Mapping[str, Style],
) -> None:
    """Draw a table of cells by policy and heading, with the policies' colours and markers."""
    axes.set_axis_off()
    lowest = len(numbers) - 0.5
    heights = (lowest, -HEADING_ROWS)
    axes.set(xlim=(0.0, 1.0), ylim=heights)  # the first row is on top
    first = next(iter(numbers.values()))
    headings = list(first)
    right_edges = np.linspace(FIRST_NUMBER, 1.0, len(headings))
    above = -0.6  # of the first row, in rows
    for heading, edge in zip(headings, right_edges, strict=True):
        axes.text(edge, above, heading, fontsize=LETTERS, color=GREY, ha="right", va="bottom")
    for row, (name, cells) in enumerate(numbers.items()):
        look = looks[name]
        axes.plot(
            MARKER_PLACE,
            row,
            look.marker,
            color=look.rgb,
            markersize=1.4 * MARKER_SIZE,
        )
        axes.text(NAME_EDGE, row, name, fontsize=LETTERS, va="center")
        for heading, edge in zip(headings, right_edges, strict=True):
            axes.text(edge, row, cells[heading], fontsize=LETTERS, ha="right", va="center")
