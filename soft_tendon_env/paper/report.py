"""Claims of the paper about its figures, beside what is measured here.

It also has shared parts of the pictures.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

import soft_tendon_env as ste
from soft_tendon_env.evaluation.tables import markdown_table

DESIRED = "#2a9d4e"  # colour of wanted shapes and paths
ACTUAL = "#1d4e9e"  # colour of those that came of it
SNAPSHOTS = 6  # shapes that are drawn of a motion
PALEST = 0.25  # opacity of the first of them; the last is opaque
REACH = (-0.4, 0.4)  # [m] sideways, in pictures


class Claim(NamedTuple):
    """Statement of the paper on a figure, and whether it holds."""

    figure: str
    paper: str  # what it says
    measured: str
    holds: bool


class Result(NamedTuple):
    """Claims and numbers of a reproduced figure."""

    claims: list[Claim]
    numbers: dict[str, Any]  # for JSON
    more: tuple[str, ...] = ()  # further tables

    @property
    def tables(self) -> str:
        """Table of claims, and the further ones."""
        table = claims_table(self.claims)
        parts = [table, *self.more]
        return "\n\n".join(parts)


def claims_table(claims: Iterable[Claim]) -> str:
    """Table of claims, as text that is Markdown as well."""
    rows = []
    for claim in claims:
        if claim.holds:
            verdict = "yes"
        else:
            verdict = "**NO, missed**"
        row = (claim.figure, claim.paper, claim.measured, verdict)
        rows.append(row)
    return markdown_table(("figure", "the paper", "measured", "holds"), rows)


def draw_arms(
    axes: Axes,
    model: ste.Model,
    motion: np.ndarray,
    colour: str,
) -> None:
    """Backbones at some of the coordinates (m, n) of a motion, paler the earlier."""
    last = len(motion) - 1
    even = np.linspace(0, last, SNAPSHOTS)
    samples = even.astype(int)
    opacities = np.linspace(PALEST, 1.0, SNAPSHOTS)
    for opacity, q in zip(opacities, motion[samples], strict=True):
        poses = model.backbone(q)
        backbone = poses[:, :3, 3]
        axes.plot(
            *backbone.T,
            color=colour,
            alpha=opacity,
            linewidth=3.0,
            solid_capstyle="round",
        )


def box(axes: Any, title: str, **paths: np.ndarray) -> None:
    """Draws equal scales, names, and paths (m, 3) [m] of a tip by their names.

    Axes have projection="3d".
    """
    curves = zip(paths.items(), (ACTUAL, DESIRED), strict=False)
    for (name, path), colour in curves:
        axes.plot(
            *path.T,
            color=colour,
            linewidth=1.6,
            linestyle="--" if name == "wanted" else "-",
            label=name,
        )
    axes.set(
        xlabel="x [m]",
        ylabel="y [m]",
        zlabel="z [m]",
        title=title,
        xlim=(0.0, 1.0),
        ylim=REACH,
        zlim=REACH,
    )
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.view_init(elev=25, azim=-60)
    axes.legend(frameon=False, loc="upper left", fontsize="small")


def draw_tensions(
    axes: Axes,
    time: np.ndarray,
    tension: np.ndarray,
    title: str,
) -> None:
    """Tensions (m, n_a) [N] against time [s]."""
    tendon_count = tension.shape[1]
    names = [f"{number + 1}" for number in range(tendon_count)]
    axes.plot(time, tension, linewidth=1.0, label=names)
    axes.legend(frameon=False, ncols=5, fontsize="small", title="tendon", title_fontsize="small")
    axes.set(xlabel="time [s]", ylabel="tension [N]", title=title)
    axes.grid(alpha=0.3)


def draw_errors(
    axes: Axes,
    errors: Mapping[str, tuple[np.ndarray, np.ndarray]],
    unit: str,
    title: str,
) -> None:
    """Errors (m,) against time (m,) [s] by their labels, on a logarithmic axis."""
    for label, (time, error) in errors.items():
        axes.semilogy(time, error, label=label)
    axes.set(xlabel="time [s]", ylabel=unit, title=title)
    axes.legend(frameon=False, fontsize="small")
    axes.grid(alpha=0.3)
