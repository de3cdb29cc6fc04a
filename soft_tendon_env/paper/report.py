"""Claims of the paper about its figures, beside what is measured here, and shared parts of the pictures."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import soft_tendon_env as ste
from soft_tendon_env.evaluation.tables import markdown_table

DESIRED, ACTUAL, OTHER = "#2a9d4e", "#1d4e9e", "#d1495b"
SNAPSHOTS = 6
REACH = (-0.4, 0.4)  # [m] sideways


class Claim(NamedTuple):
    figure: str
    paper: str  # what it says
    measured: str
    holds: bool


class Result(NamedTuple):
    """Claims and numbers of a reproduced figure."""

    claims: list[Claim]
    numbers: dict[str, Any]  # for JSON
    more: str = ""  # further tables


def claims_table(claims: Iterable[Claim]) -> str:
    """Table of claims, as text that is Markdown as well."""
    rows = [(*claim[:3], "yes" if claim.holds else "**NO, missed**") for claim in claims]
    return markdown_table(("figure", "the paper", "measured", "holds"), rows)


def snapshots(samples: int) -> np.ndarray:
    """Samples evenly spaced in time, the first and the last among them."""
    return np.linspace(0, samples - 1, SNAPSHOTS).astype(int)


def draw_arms(axes: Axes, model: ste.Model, shapes: Iterable[np.ndarray], colour: str) -> None:
    """Backbones at coordinates (n,), paler the earlier."""
    shapes = list(shapes)
    for opacity, q in zip(np.linspace(0.25, 1.0, len(shapes)), shapes, strict=True):
        axes.plot(*model.backbone(q)[:, :3, 3].T, color=colour, alpha=opacity, linewidth=3.0, solid_capstyle="round")


def draw_path(axes: Axes, points: np.ndarray, colour: str, label: str, style: str = "-") -> None:
    """A tip's path through points (m, 3) [m]."""
    axes.plot(*points.T, color=colour, linewidth=1.6, linestyle=style, label=label)


def box(axes: Any, title: str) -> None:
    """Equal scales, names, and a legend where something has a name, on axes with projection="3d"."""
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=title, xlim=(0.0, 1.0), ylim=REACH, zlim=REACH)
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.view_init(elev=25, azim=-60)
    axes.legend(frameon=False, loc="upper left", fontsize="small")


def draw_tensions(axes: Axes, time: np.ndarray, tension: np.ndarray, title: str) -> None:
    """Tensions (m, n_a) [N] against time [s]."""
    for index, (colour, values) in enumerate(zip(matplotlib.color_sequences["tab10"], tension.T, strict=True)):
        axes.plot(time, values, color=colour, linewidth=1.0, label=f"{index + 1}")
    axes.set(xlabel="time [s]", ylabel="tension [N]", title=title)
    axes.legend(frameon=False, ncols=5, fontsize="small", title="tendon", title_fontsize="small")
    axes.grid(alpha=0.3)


def save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
