"""Rollouts written to a Rerun file (.rrd). The only file that imports Rerun.

One file is one recording, in which several arms run side by side and the episodes of each arm follow one another:

- timelines: `sim_time` [s] and `step` go on from episode to episode, `episode` counts them; an arm's first sample is at 0, 0, 0;
- `world/ARM/...`, in metres: `backbone`, `body`, `tendons`, `tip`, `trail`, `target`, `target_backbone`;
- `tension/ARM` [N] and `action/ARM`: a row of numbers per sample; `error/ARM/NAME`, `reward/ARM/NAME`, `other/ARM/NAME`: one number;
- `episodes/ARM`: the title of each episode where it begins; `scene/ARM`: the scene as JSON.

A recording per episode would start each of them at 0. But the rows of a vector environment do not end together, and arms that are to be
compared belong in one view.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np
from gymnasium.error import DependencyNotInstalled

from soft_tendon_env.model import Model
from soft_tendon_env.recording.geometry import body, tension_colors, upwards
from soft_tendon_env.recording.rollout import Rollout
from soft_tendon_env.scene import Array, rod_length, rod_radius, scene_to_dict
from soft_tendon_env.shapes import backbones, drawing_stations, tendon_curves

try:
    import pyarrow
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError as error:
    raise DependencyNotInstalled('Rerun is not installed, run `pip install "soft_tendon_env[recording]"`') from error

ARM_COLORS = (235, 205, 175), (120, 175, 255), (255, 130, 170), (150, 225, 150), (200, 150, 255), (255, 170, 90)
TARGET_COLOR = (80, 220, 120)
TRANSPARENCY = 70
"""Alpha of the body, of 255: the tendons inside are to be seen."""
TENDON_THICKNESS = 0.07
"""Radius of drawn tendons as a share of the rod's, at its thinnest."""


@dataclass
class _Arm:
    """An arm of the file, and where its next sample goes."""

    model: Model
    place: Array  # (3,) [m]
    station: Array  # (m,) [m]
    step: int = 0
    time: int = 0  # [ns]
    episode: int = -1
    tip: Array | None = None  # (1, 3) [m] of the sample before
    series: set[str] = field(default_factory=set)  # kinds of numbers that there are of it


class RerunFile:
    """A Rerun file that opens as a 3-D view beside plots. Also a context manager.

    `stations`: about how many points a backbone is drawn with. `trail` [s]: how long the tip leaves a line behind.
    Whatever `write` has returned from stays readable if the process is killed, unless in the very moment of another write; `close` adds the
    index that `rerun rrd verify` asks for.
    It and `write` raise OSError if the file cannot be written, because a disk is full for instance.
    """

    def __init__(self, path: str | Path, *, stations: int = 25, trail: float = 3.0) -> None:
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_bytes(b"")  # Rerun itself would only warn
        self._stations, self._trail = stations, trail
        self._arms: dict[str, _Arm] = {}
        self._recording: rr.RecordingStream | None = rr.RecordingStream(self.path.stem)  # the viewer keeps one layout per name
        self._write(self._recording.save, self.path)
        self._recording.send_recording_name(self.path.stem)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Complete the file. Nothing can be written afterwards."""
        if self._recording is not None:
            self._recording.disconnect()
            self._recording = None

    def add_arm(self, arm: str, model: Model, place: Iterable[float] = (0.0, 0.0, 0.0)) -> None:
        """Name an arm, to draw it at another `place` (3,) [m]; positions are recorded as if it stood at the origin.

        Raises ValueError if there is one of this name.
        """
        if arm in self._arms:
            raise ValueError(f"arm {arm!r} is in {self.path} already")
        new = _Arm(model, np.array([*place], dtype=float), drawing_stations(model, self._stations))
        backbones(model, model.arm.rod.reference_strain[None], new.station)  # compiles, if need be, before an episode waits for it
        self._arms[arm] = new
        self._style(arm, new)

    def align(self) -> None:
        """Let the next episodes of all arms begin at the same time, that of the arm which is furthest."""
        latest = max(((arm.time, arm.step) for arm in self._arms.values()), default=(0, 0))
        for arm in self._arms.values():
            arm.time, arm.step = latest

    def write(self, rollout: Rollout, arm: str = "arm", *, continues: bool = False) -> None:
        """Append an episode of an arm or, if it `continues`, the next stretch of the arm's last episode; on disk when this returns.

        Raises ValueError if the arm has another scene, or the file is closed, and OSError if it cannot be written.
        """
        if arm not in self._arms:
            self.add_arm(arm, rollout.model)
        known = self._arms[arm]
        if rollout.model is not known.model and rollout.model.scene != known.model.scene:
            raise ValueError(f"arm {arm!r} has another scene, {known.model.scene.name!r}: give this one a name of its own")
        if not rollout.samples:
            return
        if not continues or known.episode < 0:
            known.episode, known.tip = known.episode + 1, None
            self._send(f"episodes/{_part(arm)}", _times(known, 1, rollout.period), rr.TextLog.columns(text=[rollout.title or "episode"]))
        times = _times(known, rollout.samples, rollout.period)
        self._send_arm(f"world/{_part(arm)}", known, rollout, times)
        self._send_target(f"world/{_part(arm)}", rollout, times)
        self._send_numbers(arm, known, rollout, times)
        known.step += rollout.samples
        known.time += rollout.samples * _nanoseconds(rollout.period)
        self._write(self._open_recording().flush)

    def _write(self, action: Callable[..., None], *arguments: Path) -> None:
        """Raises OSError."""
        try:
            action(*arguments)
        except RuntimeError as error:  # what Rerun makes of it
            raise OSError(f"{self.path} cannot be written, what was recorded ends before this: {error}") from error

    def _open_recording(self) -> rr.RecordingStream:
        if self._recording is None:
            raise ValueError(f"{self.path} is closed")
        return self._recording

    def _send(self, entity: str, times: list[rr.TimeColumn], *columns: Iterable[rr.ComponentColumn]) -> None:
        self._open_recording().send_columns(entity, times, [column for several in columns for column in several], strict=True)

    def _send_static(self, entity: str, *parts: rr.AsComponents) -> None:
        for part in parts:
            self._open_recording().log(entity, part, static=True, strict=True)

    def _style(self, arm: str, known: _Arm) -> None:
        """Log what never changes."""
        scene, root = known.model.scene, f"world/{_part(arm)}"
        up, color = upwards(known.model), ARM_COLORS[(len(self._arms) - 1) % len(ARM_COLORS)]
        axis = int(np.argmax(np.abs(up)))
        thin = TENDON_THICKNESS * float(rod_radius(scene, known.station)[0].min())
        self._send_static("world", getattr(rr.ViewCoordinates, f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"))
        self._send_static(root, rr.Transform3D(translation=known.place))
        pieces = body(known.model, known.station, np.zeros((1, known.station.size, 3)))
        shape = rr.Cylinders3D.from_fields(lengths=pieces.length, radii=pieces.radius, fill_mode=rr.components.FillMode.Solid)
        self._send_static(f"{root}/body", shape, rr.Cylinders3D.from_fields(colors=(*color, TRANSPARENCY)))
        self._send_static(f"{root}/backbone", rr.LineStrips3D.from_fields(radii=2 * thin, colors=color))
        self._send_static(f"{root}/trail", rr.LineStrips3D.from_fields(radii=thin, colors=color))
        self._send_static(f"{root}/tendons", rr.LineStrips3D.from_fields(radii=thin))
        self._send_static(f"{root}/target_backbone", rr.LineStrips3D.from_fields(radii=2 * thin, colors=TARGET_COLOR))
        self._send_static(f"{root}/tip", rr.TransformAxes3D(0.05 * rod_length(scene)))
        self._send_static(f"{root}/target", rr.TransformAxes3D(0.1 * rod_length(scene)))
        self._send_static(f"scene/{_part(arm)}", rr.TextDocument(json.dumps(scene_to_dict(scene), indent=2)))

    def _send_arm(self, root: str, known: _Arm, rollout: Rollout, times: list[rr.TimeColumn]) -> None:
        frames = backbones(rollout.model, rollout.strain, known.station)
        position = frames[..., :3, 3]
        pieces = body(rollout.model, known.station, position)
        cylinders = rr.Cylinders3D.columns(centers=pieces.center.reshape(-1, 3), quaternions=pieces.quaternion.reshape(-1, 4))
        self._send(f"{root}/body", times, cylinders.partition([known.station.size - 1] * rollout.samples))
        self._send(f"{root}/backbone", times, _lines(position))
        curves = tendon_curves(rollout.model, frames, known.station)
        strips = rr.LineStrips3D.columns(strips=_strips(curves), colors=tension_colors(rollout.model, rollout.tension).ravel())
        self._send(f"{root}/tendons", times, strips.partition([len(curves)] * rollout.samples))
        self._send(f"{root}/tip", times, _poses(rollout.tip_pose))
        tip = rollout.tip_pose[:, :3, 3]
        before = np.concatenate([tip[:1] if known.tip is None else known.tip, tip[:-1]])
        self._send(f"{root}/trail", times, _lines(np.stack([before, tip], axis=1)))  # the view shows those of the last seconds together
        known.tip = tip[-1:]

    def _send_target(self, root: str, rollout: Rollout, times: list[rr.TimeColumn]) -> None:
        if rollout.target_pose is not None:
            self._send(f"{root}/target", times, _poses(rollout.target_pose))
        if rollout.target_backbone is not None and rollout.target_backbone.shape[1]:
            self._send(f"{root}/target_backbone", times, _lines(rollout.target_backbone))

    def _send_numbers(self, arm: str, known: _Arm, rollout: Rollout, times: list[rr.TimeColumn]) -> None:
        rows = {"tension": rollout.tension}
        if rollout.action is not None and rollout.action.shape[1]:
            rows["action"] = rollout.action
        kinds = {*rows, *(_kind(name) for name in rollout.scalars)}
        for kind, values in rows.items():
            if kind not in known.series:
                self._send_static(f"{kind}/{_part(arm)}", rr.SeriesLines(names=[f"{kind} {i}" for i in range(values.shape[1])]))
            columns = rr.Scalars.columns(scalars=values.ravel())
            self._send(f"{kind}/{_part(arm)}", times, columns.partition([values.shape[1]] * rollout.samples))
        for name, values in rollout.scalars.items():
            self._send(f"{_kind(name)}/{_part(arm)}/{_part(name)}", times, rr.Scalars.columns(scalars=values))
        if not kinds <= known.series:
            known.series |= kinds
            self._open_recording().send_blueprint(_blueprint(self._arms, self._trail))


def _blueprint(arms: dict[str, _Arm], trail: float) -> rrb.Blueprint:
    """The 3-D view beside the plots of those numbers that there are; with tabs where one plot would hold too much."""
    kinds = set().union(*(arm.series for arm in arms.values()))
    recent = rrb.VisibleTimeRange(
        "sim_time", start=rrb.TimeRangeBoundary.cursor_relative(seconds=-trail), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    scenery = rrb.Spatial3DView(
        origin="/world",
        name="arm" if len(arms) == 1 else "arms",
        eye_controls=_eye(list(arms.values())),
        overrides={f"world/{_part(arm)}/trail": rrb.VisibleTimeRanges([recent]) for arm in arms},
    )
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)

    def per_arm(kind: str, unit: str = "") -> list[rrb.View]:
        named = {arm: f"{kind}{unit}" if len(arms) == 1 else f"{kind} of {arm}{unit}" for arm in arms}
        return [rrb.TimeSeriesView(origin=f"/{kind}/{_part(arm)}", name=name, plot_legend=legend) for arm, name in named.items()]

    def together(kind: str, name: str) -> list[rrb.View]:
        return [rrb.TimeSeriesView(origin=f"/{kind}", name=name, plot_legend=legend)] if kind in kinds else []

    first = _part(next(iter(arms)))
    texts = [rrb.TextLogView(origin="/episodes", name="episodes"), rrb.TextDocumentView(origin=f"/scene/{first}", name="scene")]
    plots = [
        per_arm("tension", " [N]") + (per_arm("action") if "action" in kinds else []),
        together("error", "errors") + together("other", "other"),
        together("reward", "rewards") + texts,
    ]
    columns = [views[0] if len(views) == 1 else rrb.Tabs(*views, active_tab=0) for views in plots if views]
    return rrb.Blueprint(
        rrb.Horizontal(scenery, rrb.Vertical(*columns), column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline="sim_time"),
        collapse_panels=True,
    )


def _eye(arms: list[_Arm]) -> rrb.EyeControls3D:
    """From the side and a little above, far enough to see every arm whole."""
    places, reach = np.array([arm.place for arm in arms]), max(rod_length(arm.model.scene) for arm in arms)
    up = upwards(arms[0].model)
    side = np.eye(3)[1 if abs(up[1]) < 0.5 else 2]
    target = places.mean(axis=0) + [0.4 * reach, 0.0, 0.0]
    distance = 1.2 * reach + np.ptp(places, axis=0).max()
    return rrb.EyeControls3D(position=target + distance * (0.5 * np.cross(side, up) - side + 0.4 * up), look_target=target, eye_up=up)


def _kind(scalar: str) -> str:
    """The plot that a scalar belongs to."""
    return "reward" if scalar.startswith("reward") else "error" if scalar.endswith("error") else "other"


def _part(name: str) -> str:
    return rr.escape_entity_path_part(name)


def _nanoseconds(period: float) -> int:
    return round(1e9 * period)


def _times(arm: _Arm, samples: int, period: float) -> list[rr.TimeColumn]:
    """Where the arm's next samples lie on the timelines."""
    passed = np.arange(samples)
    return [
        rr.TimeColumn("sim_time", duration=(arm.time + passed * _nanoseconds(period)).astype("timedelta64[ns]")),
        rr.TimeColumn("step", sequence=arm.step + passed),
        rr.TimeColumn("episode", sequence=np.full(samples, arm.episode)),
    ]


def _lines(points: Array) -> rr.ComponentColumnList:
    """A line through points (samples, m, 3) per sample."""
    return rr.LineStrips3D.columns(strips=points.astype(np.float32))


def _poses(pose: Array) -> rr.ComponentColumnList:
    return rr.Transform3D.columns(translation=pose[:, :3, 3], mat3x3=pose[:, :3, :3])


def _strips(curves: list[Array]) -> pyarrow.Array:
    """Curves (samples, m_i, 3) sample by sample. Made in Arrow: from lists of arrays Rerun takes ten times as long."""
    kind = rr.components.LineStrip3DBatch([]).as_arrow_array().type
    points = pyarrow.array(np.concatenate(curves, axis=1, dtype=np.float32).ravel())
    lengths = np.tile([curve.shape[1] for curve in curves], len(curves[0]))
    vectors = pyarrow.FixedSizeListArray.from_arrays(points, type=kind.value_type)
    return pyarrow.ListArray.from_arrays(np.cumsum([0, *lengths], dtype=np.int32), vectors, type=kind)
