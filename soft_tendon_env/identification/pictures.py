"""Pictures of an estimate's page, as SVG: markers, correlations."""

import io
import itertools

import numpy as np
from matplotlib.figure import Figure

from soft_tendon_env.identification.identify import Estimate

FIT, HELD_OUT = "#2e6f95", "#d1495b"
MOST_LABELS = 24
"""Parameters up to which their names are written along a picture."""


def draw_shapes(found: Estimate) -> str:
    """Measured and simulated markers in the scene's frame, in three views."""
    figure = Figure(figsize=(11.0, 4.2), constrained_layout=True)
    views = figure.subplots(1, 3)
    for readings, colour in ((found.fitted, FIT), (found.held_out, HELD_OUT)):
        if not readings.recordings:
            continue
        measured, simulated = 1e3 * readings.measured, 1e3 * readings.positions(found.fit.x)
        for axes, (i, j) in zip(views, itertools.combinations(range(3), 2), strict=True):
            lines = np.stack([measured, simulated], axis=2).reshape(-1, 2, 3)
            axes.plot(lines[:, :, i].T, lines[:, :, j].T, color=colour, linewidth=0.7)
            axes.plot(measured[..., i].ravel(), measured[..., j].ravel(), ".", color=colour, markersize=4)
            axes.plot(simulated[..., i].ravel(), simulated[..., j].ravel(), "x", color=colour, markersize=4)
            axes.set(xlabel=f"{'xyz'[i]} [mm]", ylabel=f"{'xyz'[j]} [mm]", aspect="equal")
    figure.suptitle("blue: fit, red: held out")
    return _svg(figure)


def draw_correlation(found: Estimate) -> str:
    """Correlation matrix of the parameters."""
    names, size = [own.name for own in found.parameters], len(found.parameters)
    width = 3.5 + 0.3 * size
    figure = Figure(figsize=(width, 0.75 * width), constrained_layout=True)
    axes = figure.subplots()
    image = axes.imshow(found.intervals.correlation, vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    if size <= MOST_LABELS:
        axes.set_yticks(range(size), names, fontsize=7)
        axes.set_xticks(range(size), names, fontsize=7, rotation=90)
    figure.colorbar(image)
    return _svg(figure)


def _svg(figure: Figure) -> str:
    """SVG of a figure, to stand in HTML."""
    text = io.StringIO()
    figure.savefig(text, format="svg")
    return text.getvalue().partition("<svg")[1] + text.getvalue().partition("<svg")[2]
