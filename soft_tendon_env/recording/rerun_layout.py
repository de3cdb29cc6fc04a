"""Rerun blueprint: the layout with which the viewer opens a recording, the arms large, below them
plots of what is compared."""

import math
from dataclasses import dataclass, field

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from soft_tendon_env.drawing.palette import Style
from soft_tendon_env.drawing.shapes import camera, view_box
from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

RECENT, AHEAD = (
    10.0,
    1.5,
)  # times [s] that plots of a running simulation show, before now and as room for legends
ASPECT = 3.3  # width of the view of the arms over its height
SHOWN = {
    "mm": 20.0,
    "deg": 10.0,
}  # errors up to which plots open, of an arm of 1 m: an arm that is lost hides no other
LEGEND, NO_LEGEND = rrb.PlotLegend(rrb.Corner2D.RightTop), rrb.PlotLegend(visible=False)


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
    series: dict[str, list[str]] = field(
        default_factory=dict
    )  # names of the numbers that there are of it, by kind


def part(name: str) -> str:
    """A name as part of an entity's path."""
    return rr.escape_entity_path_part(name)


def line_styles(arms: dict[str, DrawnArm]) -> dict[str, rr.SeriesLines]:
    """Names of the lines of every entity that is plotted, and the arm's colour where a plot has
    lines of several arms."""
    styles, alone = dict[str, rr.SeriesLines](), len(arms) == 1
    for name, arm in arms.items():
        colors = None if alone else [arm.style.colour]
        for kind, series in arm.series.items():
            if kind in ("tension", "action"):
                styles[f"{kind}/{part(name)}"] = rr.SeriesLines(names=series)
                continue
            for scalar in series:
                entity = (
                    f"plot/{part(scalar)}/{part(name)}"
                    if kind == "error"
                    else f"{kind}/{part(name)}/{part(scalar)}"
                )
                label = name if kind == "error" else scalar if alone else f"{name} {scalar}"
                styles[entity] = rr.SeriesLines(names=[label], colors=colors)
    return styles


def layout(arms: dict[str, DrawnArm], trail: float, *, live: bool) -> rrb.Blueprint:
    """The blueprint, the arms above their plots: `trail` [s] behind the tips; `live` plots follow
    the time."""
    now = rrb.TimeRangeBoundary.cursor_relative
    axis = (
        rrb.TimeAxis(view_range=rr.TimeRange(start=now(seconds=-RECENT), end=now(seconds=AHEAD)))
        if live
        else None
    )
    tabs = rrb.Tabs(*_tensions(arms, axis), *_others(arms, axis), active_tab=0)
    body = rrb.Vertical(
        _scenery(arms, trail), rrb.Horizontal(*_errors(arms, axis), tabs), row_shares=[3, 2]
    )
    state = rrb.components.PlayState.Following if live else None
    return rrb.Blueprint(
        body,
        rrb.TimePanel(state="collapsed", timeline="sim_time", play_state=state),
        collapse_panels=True,
    )


def _scenery(arms: dict[str, DrawnArm], trail: float) -> rrb.Spatial3DView:
    """The arms in space, from where `render` sees one, on a floor below all of them."""
    drawn = [*arms.values()]
    position, target, up = camera(drawn[0].model, np.array([arm.place for arm in drawn]), ASPECT)
    lower, upper, vertical, upright = view_box(drawn[0].model.scene)
    height = (
        min(arm.place @ up for arm in drawn)
        + (lower if upright else upper)[vertical] * up[vertical]
    )
    recent = rrb.VisibleTimeRange(
        "sim_time",
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-trail),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        origin="/world",
        name="arm" if len(arms) == 1 else "arms",
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=up),
        line_grid=rrb.LineGrid3D(
            plane=rr.components.Plane3D(up, height),
            spacing=0.25 * drawn[0].model.length,
            stroke_width=0.5,
        ),
        overrides={
            f"world/{part(name)}/{line}": rrb.VisibleTimeRanges([recent])
            for name in arms
            for line in ("trail", "target_trail")
        },
    )


def _errors(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> list[rrb.View | rrb.Container]:
    """A plot per error, in its unit, with a line per arm."""
    legend, found, length = (
        LEGEND if len(arms) > 1 else NO_LEGEND,
        list[rrb.View | rrb.Container](),
        next(iter(arms.values())).model.length,
    )
    for name in _names(arms, "error"):
        unit = error_unit(name)
        most = (
            SHOWN[unit.symbol] * (length if unit.symbol == "mm" else 1.0)
            if unit.symbol in SHOWN
            else None
        )
        title = f"{unit.heading}, up to {most:.3g}" if most else unit.heading
        found.append(
            _plot(f"/plot/{part(name)}", title, axis, legend, (0.0, most) if most else None)
        )
    return found


def _tensions(
    arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None
) -> list[rrb.View | rrb.Container]:
    """Tensions and actions, a plot per arm: one that shakes hides no other."""
    limits = np.array(
        [tendon.tension_limits for arm in arms.values() for tendon in arm.model.scene.tendons]
    )
    kinds = {
        "tension": ("tensions [N]", (float(limits.min()), float(limits.max()))),
        "action": ("actions", (-1.0, 1.0)),
    }
    legend, columns, found = (
        LEGEND if len(arms) == 1 else NO_LEGEND,
        math.ceil(math.sqrt(len(arms))),
        list[rrb.View | rrb.Container](),
    )
    for kind, (title, span) in kinds.items():
        if _names(arms, kind):
            plots = [_plot(f"/{kind}/{part(arm)}", arm, axis, legend, span) for arm in arms]
            found.append(rrb.Grid(*plots, name=title, grid_columns=columns))
    return found


def _others(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> list[rrb.View | rrb.Container]:
    """Rewards, what else is counted, the titles of episodes, the scene."""
    views: list[rrb.View] = []
    for kind in ("reward", "other"):
        shown = [
            f"/{kind}/{part(arm)}/{part(name)}"
            for arm, known in arms.items()
            for name in known.series.get(kind, [])
        ]
        if shown:
            legend = LEGEND if len(shown) > 1 else NO_LEGEND
            views.append(
                rrb.TimeSeriesView(contents=shown, name=kind, axis_x=axis, plot_legend=legend)
            )
    scenes = [rrb.TextDocumentView(origin=f"/scene/{part(next(iter(arms)))}", name="scene")]
    return [*views, rrb.TextLogView(origin="/episodes", name="episodes"), *scenes]


def _plot(
    origin: str,
    name: str,
    axis: rrb.TimeAxis | None,
    legend: rrb.PlotLegend,
    values: tuple[float, float] | None = None,
) -> rrb.View:
    """A plot of the numbers at an origin; `values`: the least and the greatest that it opens with,
    None: all."""
    vertical = None if values is None else rrb.ScalarAxis(range=values)
    return rrb.TimeSeriesView(
        origin=origin, name=name, axis_x=axis, axis_y=vertical, plot_legend=legend
    )


def _names(arms: dict[str, DrawnArm], kind: str) -> list[str]:
    """Names of all numbers of a kind, each once."""
    return [*dict.fromkeys(name for arm in arms.values() for name in arm.series.get(kind, []))]
