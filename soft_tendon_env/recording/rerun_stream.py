"""Rollouts logged to Rerun: which entities there are, and how an arm is drawn.

In one recording several arms run side by side, and the episodes of each arm follow one another:

- timelines: `sim_time` [s] and `step` go on from episode to episode, `episode` counts them; an
arm's first sample is at 0, 0, 0;
- `world/ARM/...`, in metres: `backbone`, `body`, `mount`, `tendons`, `tip`, `trail`, `target`,
  `target_trail`, `target_backbone`, `solids/NUMBER` of the effects, and the arm's `name` with the
  title of its episode;
- `tension/ARM` [N] and `action/ARM`: a row of numbers per sample; `error/ARM/NAME`,
  `reward/ARM/NAME`, `other/ARM/NAME`: one number, in SI units;
- `plot/NAME/ARM`: for the plots, an error in millimetres, in degrees, or in its own unit;
- `episodes/ARM`: the title of each episode where it begins; `scene/ARM`: the scene as JSON.
"""

import itertools
import json
from collections.abc import Iterable
from typing import Any, Self

import numpy as np
from gymnasium.error import DependencyNotInstalled

from soft_tendon_env.drawing import palette, shapes
from soft_tendon_env.drawing.renderer import normals
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.model.model import Model
from soft_tendon_env.recording.rollout import Rollout
from soft_tendon_env.scene.scene import disc_rows, rod_length, rod_radius, scene_to_dict
from soft_tendon_env.tools.types import Array

try:
    import pyarrow
    import rerun as rr

    from soft_tendon_env.recording.rerun_layout import DrawnArm, layout, line_styles, part
except ImportError as error:
    raise DependencyNotInstalled(
        'Rerun is not installed, run `pip install "soft_tendon_env[recording]"`'
    ) from error

STATIONS = 25  # about how many points a backbone is drawn with
TRAIL = 3.0  # [s] for which tips leave a line behind

# red, green and blue, 0 to 255
TARGET_COLOR = (255, 255, 255)
MOUNT_COLOR = (110, 112, 120)
SOLID_COLOR = (186, 164, 128)
TRANSPARENCY = 80  # alpha of the body, of 255: the tendons inside are to be seen
TIP_AXES = 0.05  # length of the axes of the tip, in lengths of the rod

AXES = np.stack([np.zeros((3, 3)), np.diag([0.12, 0.08, 0.04])], axis=1)
"""Lines (3, 2, 3) of a target's frame, as shares of the rod's length, the longest along its x:
white, since tips and arms have colours."""

# radii of lines and points in pixels: Rerun takes negative ones so
TENDON_WIDTH = -1.0
TRAIL_WIDTH = -1.25
TARGET_WIDTH = -0.75
TARGET_SIZE = -4.0
THIN_WIDTH = 0.5 * TENDON_WIDTH  # of backbones and of what is seen through


class RerunStream:
    """A recording of Rerun, and the arms in it; `RerunFile` and `RerunViewer` say where it goes."""

    live = False

    def __init__(self, name: str, where: str) -> None:
        """Opens a recording of a name.

        `name`: in the viewer, which keeps one layout per name; `where` it goes, for messages.
        """
        self._where = where
        self._arms = dict[str, DrawnArm]()
        self._recording: rr.RecordingStream | None = rr.RecordingStream(name)
        self._recording.send_recording_name(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> Any:
        """Raises TypeError."""
        text = "copy an environment without RecordRollout and without render_mode='human'"
        raise TypeError(f"what is written to {self._where} cannot be copied: {text}")

    def close(self) -> None:
        """Complete the recording.

        Nothing can be written afterwards.
        """
        if self._recording is not None:
            self._recording.disconnect()
            self._recording = None

    def add_arm(
        self,
        arm: str,
        model: Model,
        place: Iterable[float] | None = None,
    ) -> None:
        """Names an arm, to be drawn at a `place` (3,) [m], by default beside those before it.

        Positions are recorded as if at the origin.

        Raises ValueError if there is one of this name.
        """
        if arm in self._arms:
            raise ValueError(f"arm {arm!r} is in {self._where} already")
        if place is None:
            place = shapes.side_by_side(model, len(self._arms))
        position = np.array(list(place), dtype=float)
        styles = [other.style for other in self._arms.values()]
        style = palette.style(arm, styles)
        stations = shapes.drawing_stations(model, STATIONS)
        new = DrawnArm(model, style, position, stations)
        straight = model.grid.unpacked(model.arm.rod.reference_strain)
        # compiles, if need be, before an episode waits for it
        shapes.backbones(model, straight[None], new.station)
        self._arms[arm] = new
        self._send_scenery(arm, new)

    def align(self) -> None:
        """Lets the next episodes of all arms begin at the same time.

        It is that of the arm which is furthest.
        """
        moments = ((arm.time, arm.step) for arm in self._arms.values())
        latest = max(moments, default=(0, 0))
        for arm in self._arms.values():
            arm.time, arm.step = latest

    def write(
        self,
        rollout: Rollout,
        arm: str = "arm",
        *,
        continues: bool = False,
    ) -> None:
        """Appends an episode of an arm.

        If it `continues`, it is the next stretch of the arm's last episode.

        Raises ValueError if the arm has another scene, or the recording is closed.
        """
        if arm not in self._arms:
            self.add_arm(arm, rollout.model)
        known = self._arms[arm]
        is_other = rollout.model is not known.model
        if is_other and rollout.model.scene != known.model.scene:
            raise ValueError(
                f"arm {arm!r} has another scene, {known.model.scene.name!r}: give this one a name"
                " of its own"
            )
        if not rollout.samples:
            return
        # an episode begins: nothing of the one before is joined with it
        if not continues or known.episode < 0:
            known.episode += 1
            known.tip = None
            known.target = None
            known.shown = 0
            begin = _times(known, 1, rollout.period)
            title = rr.TextLog.columns(text=[rollout.title or "episode"])
            self._send(f"episodes/{part(arm)}", begin, title)
        times = _times(known, rollout.samples, rollout.period)
        root = f"world/{part(arm)}"
        self._send_arm(root, known, rollout, times)
        self._send_target(root, known, rollout, times)
        self._send_solids(root, known, rollout, times)
        label = f"{arm}\n{rollout.title}".rstrip()
        self._send(
            f"{root}/name",
            times,
            rr.Points3D.columns(labels=[label] * rollout.samples),
        )
        self._send_numbers(arm, known, rollout, times)
        # where the next stretch goes on
        known.step += rollout.samples
        known.shown += rollout.samples
        known.time += rollout.samples * _nanoseconds(rollout.period)

    def _open_recording(self) -> rr.RecordingStream:
        if self._recording is None:
            raise ValueError(f"{self._where} is closed")
        return self._recording

    def _send(
        self, entity: str, times: list[rr.TimeColumn], *columns: Iterable[rr.ComponentColumn]
    ) -> None:
        every = list(itertools.chain(*columns))
        self._open_recording().send_columns(entity, times, every, strict=True)

    def _send_static(self, entity: str, what: rr.AsComponents) -> None:
        self._open_recording().log(entity, what, static=True, strict=True)

    def _send_scenery(self, arm: str, new: DrawnArm) -> None:
        """Log what never changes."""
        scene = new.model.scene
        length = rod_length(scene)
        solid = rr.components.FillMode.Solid
        *_, vertical, upright = shapes.view_box(scene)
        depth, radius = shapes.mount_size(scene)
        quarter_turn = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]
        along_x = rr.Quaternion(xyzw=quarter_turn)
        behind = [-depth / 2, 0.0, 0.0]
        label = shapes.label_place(new.model)
        start = new.station[:-1]
        end = new.station[1:]
        middle = 0.5 * (end + start)
        radii, _ = rod_radius(scene, middle)
        colors = (*new.style.colour, TRANSPARENCY)
        # what moves is sent with the samples; here is how it looks
        parts: dict[str, rr.AsComponents] = {
            "": rr.Transform3D(translation=new.place),
            "/name": rr.Points3D.from_fields(
                positions=[label], radii=0.0, colors=new.style.colour, show_labels=True
            ),
            "/body": rr.Cylinders3D.from_fields(
                lengths=np.diff(new.station), radii=radii, fill_mode=solid, colors=colors
            ),
            "/mount": rr.Cylinders3D(
                lengths=depth,
                radii=radius,
                centers=behind,
                quaternions=along_x,
                fill_mode=solid,
                colors=MOUNT_COLOR,
            ),
            "/backbone": rr.LineStrips3D.from_fields(radii=THIN_WIDTH, colors=new.style.colour),
            "/tendons": rr.LineStrips3D.from_fields(radii=TENDON_WIDTH),
            "/trail": rr.LineStrips3D.from_fields(radii=TRAIL_WIDTH, colors=new.style.colour),
            "/tip": rr.TransformAxes3D(TIP_AXES * length),
            "/target_backbone": rr.LineStrips3D.from_fields(
                radii=TARGET_WIDTH, colors=TARGET_COLOR
            ),
            "/target_trail": rr.LineStrips3D.from_fields(radii=TARGET_WIDTH, colors=TARGET_COLOR),
        }
        if upright:
            up = "UP"
        else:
            up = "DOWN"
        coordinates = f"RIGHT_HAND_{'XYZ'[vertical]}_{up}"
        axes = getattr(rr.ViewCoordinates, coordinates)
        self._send_static("world", axes)
        discs = disc_rows(scene)
        if discs.size:
            parts["/discs"] = rr.Cylinders3D.from_fields(
                lengths=discs[:, 3], radii=discs[:, 2], fill_mode=solid, colors=colors
            )
        for name, what in parts.items():
            self._send_static(f"world/{part(arm)}{name}", what)
        text = json.dumps(scene_to_dict(scene), indent=2)
        entity = f"scene/{part(arm)}"
        self._send_static(entity, rr.TextDocument(text))

    def _send_arm(
        self,
        root: str,
        known: DrawnArm,
        rollout: Rollout,
        times: list[rr.TimeColumn],
    ) -> None:
        model = rollout.model
        moments = _moments(known, rollout)
        base = shapes.base_poses(model, moments, rollout.scene)
        if (base != np.eye(4)).any():
            self._send(f"{root}/mount", times, _poses(base))
        # the rod, as cylinders between its stations
        frames = shapes.backbones(model, rollout.strain, known.station, base)
        position = shapes.positions(frames)
        centers, quaternions = shapes.cylinders(position)
        columns = _cylinders(centers, quaternions)
        self._send(f"{root}/body", times, columns)
        self._send(f"{root}/backbone", times, _lines(position))
        discs = disc_rows(model.scene)
        if discs.size:
            poses = shapes.backbones(
                model,
                rollout.strain,
                discs[:, 0],
                base,
            )
            turned = shapes.rotation_from_z(poses[..., :3, 0])
            plates = _cylinders(shapes.positions(poses), turned)
            self._send(f"{root}/discs", times, plates)
        # tendons, each in the colour of its tension
        curves = shapes.tendon_curves(model, frames, known.station)
        colors = shapes.tension_colors(model, rollout.tension)
        strips = rr.LineStrips3D.columns(
            strips=_strips(curves), colors=colors.reshape(-1, 3).astype(np.uint8)
        )
        per_sample = [len(curves)] * rollout.samples
        columns = strips.partition(per_sample)
        self._send(f"{root}/tendons", times, columns)
        self._send(f"{root}/tip", times, _poses(rollout.tip_pose))
        # the tip, and the way that it came
        tip = shapes.positions(rollout.tip_pose)
        self._send(
            f"{root}/trail",
            times,
            _lines(_steps(tip, known.tip)),
        )
        known.tip = tip[-1:]

    def _send_target(
        self,
        root: str,
        known: DrawnArm,
        rollout: Rollout,
        times: list[rr.TimeColumn],
    ) -> None:
        if rollout.target_pose is not None:
            if known.episode == 0 and known.target is None:
                length = rod_length(rollout.model.scene)
                self._send_target_frame(f"{root}/target", length)
            poses = _poses(rollout.target_pose)
            self._send(f"{root}/target", times, poses)
            target = shapes.positions(rollout.target_pose)
            self._send(
                f"{root}/target_trail",
                times,
                _lines(_steps(target, known.target)),
            )
            known.target = target[-1:]
        if rollout.target_backbone is not None and rollout.target_backbone.shape[1]:
            lines = _lines(rollout.target_backbone)
            self._send(f"{root}/target_backbone", times, lines)

    def _send_target_frame(self, entity: str, length: float) -> None:
        """Log how a target's pose looks, on an arm of this length [m]."""
        origin = [[0.0, 0.0, 0.0]]
        point = rr.Points3D(origin, radii=TARGET_SIZE, colors=TARGET_COLOR)
        self._send_static(entity, point)
        lines = list(length * AXES)
        axes = rr.LineStrips3D(lines, radii=TARGET_WIDTH, colors=TARGET_COLOR)
        self._send_static(f"{entity}/axes", axes)

    def _send_solids(
        self,
        root: str,
        known: DrawnArm,
        rollout: Rollout,
        times: list[rr.TimeColumn],
    ) -> None:
        """Sends the obstacles where others than before are to be seen, and how they move.

        Their surfaces are where they are at time 0.
        """
        effects = (rollout.scene or rollout.model.scene).effects
        obstacles = shapes.obstacles_of(effects)
        if not obstacles:
            return
        lower, upper, _, _ = shapes.view_box(rollout.model.scene)
        if known.effects != effects:
            known.effects = effects
            first = _times(known, 1, rollout.period)
            for number, obstacle in enumerate(obstacles):
                corners = shapes.surface(obstacle, 0.0, (lower, upper))
                if obstacle.is_endless:
                    look = _seen_through(corners)
                else:
                    look = _mesh(corners)
                self._send(f"{root}/solids/{number}", first, look)
        # surfaces are sent where they are at time 0, and then how they have moved since
        moments = _moments(known, rollout).tolist()
        for number, obstacle in enumerate(obstacles):
            if obstacle.moves:
                obstacle_poses = [obstacle.pose(time) for time in moments]
                poses = np.array(obstacle_poses)
                to_first = np.linalg.inv(obstacle.pose(0.0))
                from_first = poses @ to_first
                self._send(
                    f"{root}/solids/{number}",
                    times,
                    _poses(from_first),
                )

    def _send_numbers(
        self,
        arm: str,
        known: DrawnArm,
        rollout: Rollout,
        times: list[rr.TimeColumn],
    ) -> None:
        rows = {"tension": rollout.tension}
        if rollout.action is not None and rollout.action.shape[1]:
            rows["action"] = rollout.action
        for kind, values in rows.items():
            columns = rr.Scalars.columns(scalars=values.ravel())
            per_sample = [values.shape[1]] * rollout.samples
            self._send(
                f"{kind}/{part(arm)}",
                times,
                columns.partition(per_sample),
            )
        # plots have errors in the units in which people read them
        for name, values in rollout.scalars.items():
            numbers = rr.Scalars.columns(scalars=values)
            self._send(
                f"{_kind(name)}/{part(arm)}/{part(name)}",
                times,
                numbers,
            )
            if _kind(name) == "error":
                shown = error_unit(name).factor * values
                plotted = rr.Scalars.columns(scalars=shown)
                self._send(
                    f"plot/{part(name)}/{part(arm)}",
                    times,
                    plotted,
                )
        series = dict[str, list[str]]()
        for kind, values in rows.items():
            series_count = values.shape[1]
            series[kind] = [f"{kind} {number}" for number in range(series_count)]
        for name in rollout.scalars:
            series.setdefault(_kind(name), []).append(name)
        # a layout takes space: not one for each arm that appears
        is_new = known.add_series(series)
        if is_new and all(each.series for each in self._arms.values()):
            self._lay_out()

    def _lay_out(self) -> None:
        """Sends the names and colours of all lines in plots, and the layout of the viewer."""
        for entity, style in line_styles(self._arms).items():
            self._send_static(entity, style)
        blueprint = layout(self._arms, TRAIL, live=self.live)
        self._open_recording().send_blueprint(blueprint)


def _kind(scalar: str) -> str:
    """The group of plots that a scalar belongs to."""
    if scalar.startswith("reward"):
        return "reward"
    if scalar.endswith("error"):
        return "error"
    return "other"


def _nanoseconds(seconds: float) -> int:
    """A time [s] in the unit of Rerun's timelines."""
    return round(1e9 * seconds)


def _times(
    arm: DrawnArm,
    samples: int,
    period: float,
) -> list[rr.TimeColumn]:
    """Places of the arm's next samples on the timelines."""
    passed = np.arange(samples)
    time = arm.time + passed * _nanoseconds(period)
    episode = np.full(samples, arm.episode)
    return [
        rr.TimeColumn("sim_time", duration=time.astype("timedelta64[ns]")),
        rr.TimeColumn("step", sequence=arm.step + passed),
        rr.TimeColumn("episode", sequence=episode),
    ]


def _steps(position: Array, before: Array | None) -> Array:
    """Lines (samples, 2, 3) from where positions (samples, 3) were a sample before.

    The view shows those of the last seconds together. before (1, 3): the last of the samples
    before, None: there are none.
    """
    if before is None:
        first = position[:1]
    else:
        first = before
    starts = [first, position[:-1]]
    start = np.concatenate(starts)
    return np.stack([start, position], axis=1)


def _lines(points: Array) -> rr.ComponentColumnList:
    """A line through points (samples, m, 3) per sample."""
    return rr.LineStrips3D.columns(strips=points.astype(np.float32))


def _poses(pose: Array) -> rr.ComponentColumnList:
    """A transform per pose (samples, 4, 4)."""
    rotation = pose[:, :3, :3]
    translation = shapes.positions(pose)
    return rr.Transform3D.columns(translation=translation, mat3x3=rotation)


def _cylinders(centers: Array, quaternions: Array) -> rr.ComponentColumnList:
    """Cylinders at centres (samples, m, 3), turned by quaternions (samples, m, 4), per sample."""
    samples, count, _ = centers.shape
    columns = rr.Cylinders3D.columns(
        centers=centers.reshape(-1, 3), quaternions=quaternions.reshape(-1, 4)
    )
    return columns.partition([count] * samples)


def _mesh(corners: Array) -> list[rr.ComponentColumn]:
    """Quadrilaterals (n, 4, 3) as a mesh, at one time."""
    numbers = np.arange(len(corners))
    corner_places = numbers[:, None]
    first = 4 * corner_places  # number of a quadrilateral's first corner
    lower = first + [0, 1, 2]
    upper = first + [0, 2, 3]
    halves = [lower, upper]
    triangles = np.concatenate(halves)
    directions = np.repeat(normals(corners), 4, axis=0)
    vertices_in_rows = corners.reshape(-1, 3)
    vertices = rr.Mesh3D.columns(vertex_positions=vertices_in_rows, vertex_normals=directions)
    faces = rr.Mesh3D.columns(triangle_indices=triangles)
    return [
        *vertices.partition([4 * len(corners)]),
        *faces.partition([len(triangles)]),
        *rr.Mesh3D.columns(albedo_factor=[SOLID_COLOR]),
    ]


def _seen_through(corners: Array) -> list[rr.ComponentColumn]:
    """Quadrilaterals (n, 4, 3) as lines, at one time."""
    strips = corners.astype(np.float32)
    lines = rr.LineStrips3D.columns(strips=strips)
    look = rr.LineStrips3D.columns(radii=[THIN_WIDTH], colors=[SOLID_COLOR])
    strip_lengths = [len(corners)]
    return [*lines.partition(strip_lengths), *look]


def _moments(known: DrawnArm, rollout: Rollout) -> Array:
    """Times (samples,) [s] of a rollout's samples since its episode began."""
    numbers_of_samples = np.arange(rollout.samples)
    numbers = known.shown + numbers_of_samples
    return np.asarray(numbers * rollout.period)


def _strips(curves: list[Array]) -> pyarrow.Array:
    """Curves (samples, m_i, 3) sample by sample.

    Made in Arrow: from lists of arrays Rerun takes ten times as long.
    """
    kind = rr.components.LineStrip3DBatch([]).as_arrow_array().type
    samples = len(curves[0])
    points = np.concatenate(curves, axis=1, dtype=np.float32)
    points_per_curve = [curve.shape[1] for curve in curves]
    counts = np.tile(points_per_curve, samples)
    borders = [0, *counts]
    ends = np.cumsum(borders, dtype=np.int32)
    numbers = pyarrow.array(points.ravel())
    vectors = pyarrow.FixedSizeListArray.from_arrays(numbers, type=kind.value_type)
    return pyarrow.ListArray.from_arrays(ends, vectors, type=kind)
