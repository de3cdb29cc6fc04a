"""Rerun blueprint: the layout with which the viewer opens a recording, the arms large, beside them plots of what is compared.

Plots of errors end at FAR of the rod's length or ASKEW, so that an arm that fails hides no other.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from soft_tendon_env.drawing.geometry import camera
from soft_tendon_env.drawing.palette import RGB, Style, hues, shades
from soft_tendon_env.drawing.renderer import view_box
from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

WIDE = 3
"""Number of arms from which on they stand in a row above the plots, else beside them."""

ROOM = 1.16
"""Time axes are longer than the recording by this factor: legends stand beside the curves."""

RECENT, AHEAD = 10.0, 1.5
"""Times [s] that plots of a running simulation show, before now and as room for legends."""

FAR, ASKEW = 20.0, 10.0
"""Greatest errors of plots: [mm] per metre of the rod, [deg]."""

TOTAL = "reward"
"""The scalar that the terms of rewards add up to."""

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
    series: dict[str, list[str]] = field(default_factory=dict)  # names of the numbers that there are of it, by kind

    @property
    def color(self) -> RGB:
        return self.style.colour


class LineStyle(NamedTuple):
    """Names and colours of the lines of one entity."""

    names: list[str]
    colors: list[RGB]


def part(name: str) -> str:
    """A name as part of an entity's path."""
    return rr.escape_entity_path_part(name)


def line_styles(arms: dict[str, DrawnArm]) -> dict[str, LineStyle]:
    """Names and colours of the lines of every entity that is plotted: each arm has one colour, and a lone arm's tendons have one each."""
    styles = {}
    for name, arm in arms.items():
        for kind, series in arm.series.items():
            tones = shades(arm.color, len(series))
            if kind in ("tension", "action"):
                styles[f"{kind}/{part(name)}"] = LineStyle(series, hues(len(series)) if len(arms) == 1 else tones)
            elif kind == "error":
                styles |= {f"plot/{part(scalar)}/{part(name)}": LineStyle([name], [arm.color]) for scalar in series}
            else:
                for scalar, tone in zip(series, tones, strict=True):
                    label = scalar if len(arms) == 1 else f"{name} {scalar}"
                    style = LineStyle([name], [arm.color]) if scalar == TOTAL else LineStyle([label], [tone])
                    styles[f"{kind}/{part(name)}/{part(scalar)}"] = style
    return styles


def layout(arms: dict[str, DrawnArm], trail: float, *, live: bool, complete: bool) -> rrb.Blueprint:
    """The blueprint: `trail` [s] behind the tips; `live` plots follow the time, others of a `complete` recording leave room for legends."""
    axis = _time_axis(arms, live, complete)
    errors, tensions, others = _errors(arms, axis), _tensions(arms, axis, live), _others(arms, axis)
    wide = len(arms) >= WIDE
    view = _scenery(arms, trail, aspect=3.3 if wide else 1.1)
    if wide:
        body: rrb.Container = rrb.Vertical(view, rrb.Horizontal(*errors, _tabs(*tensions, *others)), row_shares=[3, 2])
    else:
        plots = [*errors, _tabs(*tensions), _tabs(*others)]
        body = rrb.Horizontal(view, rrb.Vertical(*plots), column_shares=[3, 2])
    state = rrb.components.PlayState.Following if live else None
    return rrb.Blueprint(body, rrb.TimePanel(state="collapsed", timeline="sim_time", play_state=state), collapse_panels=True)


def _scenery(arms: dict[str, DrawnArm], trail: float, aspect: float) -> rrb.Spatial3DView:
    """The arms in space, from where `render` sees one, on a floor below all of them."""
    drawn = [*arms.values()]
    eye = camera([arm.model for arm in drawn], np.array([arm.place for arm in drawn]), aspect)
    lower, upper, vertical, upright = view_box(drawn[0].model.scene)
    height = min(arm.place @ eye.up for arm in drawn) + (lower if upright else upper)[vertical] * eye.up[vertical]
    recent = rrb.VisibleTimeRange(
        "sim_time", start=rrb.TimeRangeBoundary.cursor_relative(seconds=-trail), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.Spatial3DView(
        origin="/world",
        name="arm" if len(arms) == 1 else "arms",
        eye_controls=rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=eye.up),
        line_grid=rrb.LineGrid3D(plane=rr.components.Plane3D(eye.up, height), spacing=0.25 * drawn[0].model.length, stroke_width=0.5),
        overrides={f"world/{part(name)}/{line}": rrb.VisibleTimeRanges([recent]) for name in arms for line in ("trail", "target_trail")},
    )


def _errors(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> list[rrb.View | rrb.Container]:
    """A plot per error, in its unit, with a line per arm."""
    legend, length = LEGEND if len(arms) > 1 else NO_LEGEND, max(arm.model.length for arm in arms.values())
    most = {"mm": FAR * length, "deg": ASKEW}
    found: list[rrb.View | rrb.Container] = []
    for name in _names(arms, "error"):
        unit = error_unit(name)
        shown = (0.0, most[unit.symbol]) if unit.symbol in most else None
        title = f"{unit.titled}, up to {shown[1]:.3g}" if shown else unit.titled
        found.append(_plot(f"/plot/{part(name)}", title, axis, legend, shown))
    return found


def _tensions(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None, live: bool) -> list[rrb.View | rrb.Container]:
    """Tensions and actions, a plot per arm: one that shakes hides no other."""
    limits = np.array([tendon.tension_limits for arm in arms.values() for tendon in arm.model.scene.tendons])
    kinds = {"tension": ("tensions [N]", (float(limits.min()), float(limits.max()))), "action": ("actions", (-1.0, 1.0))}
    alone, found = len(arms) == 1, list[rrb.View | rrb.Container]()
    for kind, (title, span) in kinds.items():
        if _names(arms, kind):
            shown = (axis, LEGEND) if alone else (axis if live else None, NO_LEGEND)
            plots = [_plot(f"/{kind}/{part(arm)}", title if alone else arm, *shown, None if alone else span) for arm in arms]
            found.append(plots[0] if alone else rrb.Grid(*plots, name=title, grid_columns=math.ceil(math.sqrt(len(arms)))))
    return found


def _others(arms: dict[str, DrawnArm], axis: rrb.TimeAxis | None) -> list[rrb.View | rrb.Container]:
    """Rewards, what else is counted, the titles of episodes, the scene."""

    def entities(kind: str, wanted: Callable[[str], bool]) -> list[str]:
        return [f"/{kind}/{part(arm)}/{part(name)}" for arm, known in arms.items() for name in known.series.get(kind, []) if wanted(name)]

    plots = {
        "reward": entities("reward", lambda name: name == TOTAL),
        "reward terms": entities("reward", lambda name: name != TOTAL),
        "other": entities("other", lambda name: True),
    }
    views = [
        rrb.TimeSeriesView(contents=shown, name=name, axis_x=axis, plot_legend=LEGEND if len(shown) > 1 else NO_LEGEND)
        for name, shown in plots.items()
        if shown
    ]
    scenes = [rrb.TextDocumentView(origin=f"/scene/{part(next(iter(arms)))}", name="scene")]
    return [*views, rrb.TextLogView(origin="/episodes", name="episodes"), *scenes]


def _plot(origin: str, name: str, axis: rrb.TimeAxis | None, legend: rrb.PlotLegend, values: tuple[float, float] | None = None) -> rrb.View:
    """A plot of the numbers at an origin; `values`: the least and the greatest that it opens with, None: all."""
    vertical = None if values is None else rrb.ScalarAxis(range=values)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=axis, axis_y=vertical, plot_legend=legend)


def _tabs(*views: rrb.View | rrb.Container) -> rrb.View | rrb.Container:
    return views[0] if len(views) == 1 else rrb.Tabs(*views, active_tab=0)


def _names(arms: dict[str, DrawnArm], kind: str) -> list[str]:
    """Names of all numbers of a kind, each once."""
    return [*dict.fromkeys(name for arm in arms.values() for name in arm.series.get(kind, []))]


def _time_axis(arms: dict[str, DrawnArm], live: bool, complete: bool) -> rrb.TimeAxis | None:
    """Time axis of the plots; None: as long as the recording."""
    if live:
        now = rrb.TimeRangeBoundary.cursor_relative
        return rrb.TimeAxis(view_range=rr.TimeRange(start=now(seconds=-RECENT), end=now(seconds=AHEAD)))
    if not complete:
        return None
    from_start, end = rrb.TimeRangeBoundary.absolute, max(arm.time for arm in arms.values()) / 1e9
    return rrb.TimeAxis(view_range=rr.TimeRange(start=from_start(seconds=0.0), end=from_start(seconds=ROOM * end)))
