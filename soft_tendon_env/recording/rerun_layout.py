"""Rerun blueprint: the layout with which the viewer opens a recording.

The arms are large, below them plots of what is compared.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from soft_tendon_env.drawing.palette import Style
from soft_tendon_env.drawing.shapes import camera, view_box
from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

RECENT = 10.0  # [s] before now that plots of a running simulation show
AHEAD = 1.5  # [s] after now, room for legends
ASPECT = 3.3  # width of the view of the arms over its height
GRID = 0.25  # distance between lines on the floor, in lengths of the rod
MOST_COLUMNS = 2
"""Plots of tensions side by side: their titles, the names of the arms, fit above them."""
SHOWN = {"mm": 20.0, "deg": 10.0}
"""Errors up to which plots open, of an arm of 1 m, by unit: an arm that is lost hides no other."""
LEGEND = rrb.PlotLegend(rrb.Corner2D.RightTop)
NO_LEGEND = rrb.PlotLegend(visible=False)

Views = list[rrb.View | rrb.Container]


@dataclass
class DrawnArm:
    """An arm of a recording: how it is drawn, and where its next sample goes."""

    model: Model
    style: Style
    place: Array  # (3,) [m]
    station: Array  # (m,) [m]
    step: int = 0
    time: int = 0  # [ns]
    shown: int = 0  # samples of its episode
    effects: Effects | None = None  # whose solids are to be seen
    episode: int = -1
    tip: Array | None = None  # (1, 3) [m] in the sample before
    target: Array | None = None  # (1, 3) [m], the target's position in the sample before
    # names of the numbers that there are of it, by kind
    series: dict[str, list[str]] = field(default_factory=dict)

    def add_series(self, series: dict[str, list[str]]) -> bool:
        """Add names of numbers by kind.

        Returns whether any is new.
        """
        is_new = False
        for kind, names in series.items():
            before = self.series.get(kind, [])
            in_order = [*before, *names]
            every = list(dict.fromkeys(in_order))
            if every != before:
                self.series[kind] = every
                is_new = True
        return is_new


def part(name: str) -> str:
    """A name as part of an entity's path."""
    return rr.escape_entity_path_part(name)


def line_styles(arms: dict[str, DrawnArm]) -> dict[str, rr.SeriesLines]:
    """Names of the lines of every entity that is plotted, and colours.

    The arm has its colour where a plot has lines of several arms.
    """
    styles = dict[str, rr.SeriesLines]()
    alone = len(arms) == 1
    for name, arm in arms.items():
        if alone:
            colors = None
        else:
            colors = [arm.style.colour]
        for kind, series in arm.series.items():
            if kind in ("tension", "action"):
                plot = f"{kind}/{part(name)}"
                styles[plot] = rr.SeriesLines(names=series)
                continue
            for scalar in series:
                if kind == "error":
                    entity = f"plot/{part(scalar)}/{part(name)}"
                    label = name
                else:
                    entity = f"{kind}/{part(name)}/{part(scalar)}"
                    if alone:
                        label = scalar
                    else:
                        label = f"{name} {scalar}"
                styles[entity] = rr.SeriesLines(names=[label], colors=colors)
    return styles


def layout(
    arms: dict[str, DrawnArm],
    trail: float,
    *,
    live: bool,
) -> rrb.Blueprint:
    """Blueprint with the arms above their plots.

    `trail` [s] behind the tips; `live` plots follow the time.
    """
    now = rrb.TimeRangeBoundary.cursor_relative
    axis = None
    state = None
    if live:
        begin = now(seconds=-RECENT)
        recent = rr.TimeRange(start=begin, end=now(seconds=AHEAD))
        axis = rrb.TimeAxis(view_range=recent)
        state = rrb.components.PlayState.Following
    tabs = rrb.Tabs(
        *_tensions(arms, axis),
        *_others(arms, axis),
        active_tab=0,
    )
    plots = rrb.Horizontal(*_errors(arms, axis), tabs)
    scenery = _scenery(arms, trail)
    body = rrb.Vertical(scenery, plots, row_shares=[3, 2])
    time = rrb.TimePanel(state="collapsed", timeline="sim_time", play_state=state)
    return rrb.Blueprint(body, time, collapse_panels=True)


def _scenery(arms: dict[str, DrawnArm], trail: float) -> rrb.Spatial3DView:
    """The arms in space, from where `render` sees one, on a floor below all of them."""
    first = next(iter(arms.values())).model
    every_place = [arm.place for arm in arms.values()]
    places = np.array(every_place)
    position, target, up = camera(first, places, ASPECT)
    lower, upper, vertical, upright = view_box(first.scene)
    # the floor lies below all arms, wherever they are drawn
    if upright:
        corner = lower
    else:
        corner = upper
    floor = corner[vertical] * up[vertical]
    heights = (place @ up for place in places)
    height = min(heights) + floor
    now = rrb.TimeRangeBoundary.cursor_relative
    begin = now(seconds=-trail)
    recent = rrb.VisibleTimeRange("sim_time", start=begin, end=now())
    # of tips and targets the view shows the last seconds, of all else the present
    trails = dict[Any, Any]()
    for name in arms:
        for line in ("trail", "target_trail"):
            entity = f"world/{part(name)}/{line}"
            trails[entity] = rrb.VisibleTimeRanges([recent])
    return rrb.Spatial3DView(
        origin="/world",
        name="arm" if len(arms) == 1 else "arms",
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=up),
        line_grid=rrb.LineGrid3D(
            plane=rr.components.Plane3D(up, height),
            spacing=GRID * first.length,
            stroke_width=0.5,
        ),
        overrides=trails,
    )


def _errors(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> Views:
    """A plot per error, in its unit, with a line per arm."""
    if len(arms) > 1:
        legend = LEGEND
    else:
        legend = NO_LEGEND
    length = next(iter(arms.values())).model.length
    plots = Views()
    for name in _names(arms, "error"):
        unit = error_unit(name)
        title = unit.heading
        span = None
        if unit.symbol in SHOWN:
            if unit.symbol == "mm":
                unit_length = length
            else:
                unit_length = 1.0
            most = SHOWN[unit.symbol] * unit_length
            title = f"{unit.heading}, up to {most:.3g}"
            span = (0.0, most)
        origin = f"/plot/{part(name)}"
        plots.append(_plot(origin, title, axis, legend, span))
    return plots


def _tensions(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> Views:
    """Tensions and actions, a plot per arm: one that shakes hides no other."""
    # one scale for all arms: who pulls more is seen to
    tendons = [tendon for arm in arms.values() for tendon in arm.model.scene.tendons]
    limits = np.array([tendon.tension_limits for tendon in tendons])
    kinds = {
        "tension": ("tensions [N]", (float(limits.min()), float(limits.max()))),
        "action": ("actions", (-1.0, 1.0)),
    }
    if len(arms) == 1:
        legend = LEGEND
    else:
        legend = NO_LEGEND
    columns = min(MOST_COLUMNS, len(arms))
    grids = Views()
    for kind, (title, span) in kinds.items():
        if _names(arms, kind):
            plots = [
                _plot(
                    f"/{kind}/{part(arm)}",
                    arm,
                    axis,
                    legend,
                    span,
                )
                for arm in arms
            ]
            grid = rrb.Grid(*plots, name=title, grid_columns=columns)
            grids.append(grid)
    return grids


def _others(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> Views:
    """Rewards, what else is counted, the titles of episodes, the scene."""
    views = Views()
    for kind in ("reward", "other"):
        shown = []
        for arm, known in arms.items():
            for name in known.series.get(kind, []):
                entity = f"/{kind}/{part(arm)}/{part(name)}"
                shown.append(entity)
        if shown:
            if len(shown) > 1:
                legend = LEGEND
            else:
                legend = NO_LEGEND
            view = rrb.TimeSeriesView(contents=shown, name=kind, axis_x=axis, plot_legend=legend)
            views.append(view)
    views.append(rrb.TextLogView(origin="/episodes", name="episodes"))
    first = next(iter(arms))
    origin = f"/scene/{part(first)}"
    views.append(rrb.TextDocumentView(origin=origin, name="scene"))
    return views


def _plot(
    origin: str,
    name: str,
    axis: rrb.TimeAxis | None,
    legend: rrb.PlotLegend,
    values: tuple[float, float] | None = None,
) -> rrb.View:
    """Plot of the numbers at an origin.

    `values`: the least and the greatest that it opens with, None: all.
    """
    if values is None:
        vertical = None
    else:
        vertical = rrb.ScalarAxis(range=values)
    return rrb.TimeSeriesView(
        origin=origin, name=name, axis_x=axis, axis_y=vertical, plot_legend=legend
    )


def _names(arms: dict[str, DrawnArm], kind: str) -> list[str]:
    """Names of all numbers of a kind, each once."""
    every = [name for arm in arms.values() for name in arm.series.get(kind, [])]
    return list(dict.fromkeys(every))
