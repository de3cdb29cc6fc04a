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

STATIONS, TRAIL = (
    25,
    3.0,
)  # about how many points a backbone is drawn with, and for how long [s] tips leave a line behind
TARGET_COLOR, MOUNT_COLOR, SOLID_COLOR = (255, 255, 255), (110, 112, 120), (186, 164, 128)
TRANSPARENCY = 80  # alpha of the body, of 255: the tendons inside are to be seen

AXES = np.stack([np.zeros((3, 3)), np.diag([0.12, 0.08, 0.04])], axis=1)
"""Lines (3, 2, 3) of a target's frame, as shares of the rod's length, the longest along its x:
white, since tips and arms have colours."""

TENDON_WIDTH, TRAIL_WIDTH, TARGET_WIDTH, TARGET_SIZE = -1.0, -1.25, -0.75, -4.0
"""Radii of lines and points in pixels: Rerun takes negative ones so."""


class RerunStream:
    """A recording of Rerun, and the arms in it; `RerunFile` and `RerunViewer` say where it goes."""

    live = False

    def __init__(self, name: str, where: str) -> None:
        """`name`: of the recording, in the viewer, which keeps one layout per name; `where` it
        goes, for messages."""
        self._where, self._arms = where, dict[str, DrawnArm]()
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
        """Complete the recording. Nothing can be written afterwards."""
        if self._recording is not None:
            self._recording.disconnect()
            self._recording = None

    def add_arm(self, arm: str, model: Model, place: Iterable[float] | None = None) -> None:
        """Name an arm, to be drawn at a `place` (3,) [m], by default beside those before it;
        positions are recorded as if at the origin.

        Raises ValueError if there is one of this name.
        """
        if arm in self._arms:
            raise ValueError(f"arm {arm!r} is in {self._where} already")
        where = np.array(
            [*(shapes.side_by_side(model, len(self._arms)) if place is None else place)],
            dtype=float,
        )
        style = palette.style(arm, [other.style for other in self._arms.values()])
        new = DrawnArm(model, style, where, shapes.drawing_stations(model, STATIONS))
        straight = model.grid.unpacked(model.arm.rod.reference_strain)
        shapes.backbones(
            model, straight[None], new.station
        )  # compiles, if need be, before an episode waits for it
        self._arms[arm] = new
        self._send_scenery(arm, new)

    def align(self) -> None:
        """Let the next episodes of all arms begin at the same time, that of the arm which is
        furthest."""
        latest = max(((arm.time, arm.step) for arm in self._arms.values()), default=(0, 0))
        for arm in self._arms.values():
            arm.time, arm.step = latest

    def write(self, rollout: Rollout, arm: str = "arm", *, continues: bool = False) -> None:
        """Append an episode of an arm or, if it `continues`, the next stretch of the arm's last
        episode.

        Raises ValueError if the arm has another scene, or the recording is closed.
        """
        if arm not in self._arms:
            self.add_arm(arm, rollout.model)
        known = self._arms[arm]
        if rollout.model is not known.model and rollout.model.scene != known.model.scene:
            raise ValueError(
                f"arm {arm!r} has another scene, {known.model.scene.name!r}: give this one a name"
                " of its own"
            )
        if not rollout.samples:
            return
        if not continues or known.episode < 0:
            known.episode, known.tip, known.target, known.shown = known.episode + 1, None, None, 0
            self._send(
                f"episodes/{part(arm)}",
                _times(known, 1, rollout.period),
                rr.TextLog.columns(text=[rollout.title or "episode"]),
            )
        times, root = _times(known, rollout.samples, rollout.period), f"world/{part(arm)}"
        self._send_arm(root, known, rollout, times)
        self._send_target(root, known, rollout, times)
        self._send_solids(root, known, rollout, times)
        self._send(
            f"{root}/name",
            times,
            rr.Points3D.columns(labels=[f"{arm}\n{rollout.title}".rstrip()] * rollout.samples),
        )
        self._send_numbers(arm, known, rollout, times)
        known.step += rollout.samples
        known.shown += rollout.samples
        known.time += rollout.samples * round(1e9 * rollout.period)

    def _open_recording(self) -> rr.RecordingStream:
        if self._recording is None:
            raise ValueError(f"{self._where} is closed")
        return self._recording

    def _send(
        self, entity: str, times: list[rr.TimeColumn], *columns: Iterable[rr.ComponentColumn]
    ) -> None:
        self._open_recording().send_columns(
            entity, times, [column for several in columns for column in several], strict=True
        )

    def _send_static(self, entity: str, what: rr.AsComponents) -> None:
        self._open_recording().log(entity, what, static=True, strict=True)

    def _send_scenery(self, arm: str, new: DrawnArm) -> None:
        """Log what never changes."""
        scene, length, solid = (
            new.model.scene,
            rod_length(new.model.scene),
            rr.components.FillMode.Solid,
        )
        *_, vertical, upright = shapes.view_box(scene)
        depth, radius = shapes.mount_size(scene)
        along_x = rr.Quaternion(xyzw=[0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])
        behind, label = [-depth / 2, 0.0, 0.0], shapes.label_place(new.model)
        radii, _ = rod_radius(scene, 0.5 * (new.station[1:] + new.station[:-1]))
        colors = (*new.style.colour, TRANSPARENCY)
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
            "/backbone": rr.LineStrips3D.from_fields(
                radii=0.5 * TENDON_WIDTH, colors=new.style.colour
            ),
            "/tendons": rr.LineStrips3D.from_fields(radii=TENDON_WIDTH),
            "/trail": rr.LineStrips3D.from_fields(radii=TRAIL_WIDTH, colors=new.style.colour),
            "/tip": rr.TransformAxes3D(0.05 * length),
            "/target_backbone": rr.LineStrips3D.from_fields(
                radii=TARGET_WIDTH, colors=TARGET_COLOR
            ),
            "/target_trail": rr.LineStrips3D.from_fields(radii=TARGET_WIDTH, colors=TARGET_COLOR),
        }
        self._send_static(
            "world",
            getattr(
                rr.ViewCoordinates, f"RIGHT_HAND_{'XYZ'[vertical]}_{'UP' if upright else 'DOWN'}"
            ),
        )
        if (discs := disc_rows(scene)).size:
            parts["/discs"] = rr.Cylinders3D.from_fields(
                lengths=discs[:, 3], radii=discs[:, 2], fill_mode=solid, colors=colors
            )
        for name, what in parts.items():
            self._send_static(f"world/{part(arm)}{name}", what)
        self._send_static(
            f"scene/{part(arm)}", rr.TextDocument(json.dumps(scene_to_dict(scene), indent=2))
        )

    def _send_arm(
        self, root: str, known: DrawnArm, rollout: Rollout, times: list[rr.TimeColumn]
    ) -> None:
        base = shapes.base_poses(rollout.model, _moments(known, rollout), rollout.scene)
        if (base != np.eye(4)).any():
            self._send(f"{root}/mount", times, _poses(base))
        frames = shapes.backbones(rollout.model, rollout.strain, known.station, base)
        position = frames[..., :3, 3]
        centers, quaternions = shapes.cylinders(position)
        pieces = rr.Cylinders3D.columns(
            centers=centers.reshape(-1, 3), quaternions=quaternions.reshape(-1, 4)
        )
        self._send(
            f"{root}/body", times, pieces.partition([known.station.size - 1] * rollout.samples)
        )
        self._send(f"{root}/backbone", times, _lines(position))
        if (discs := disc_rows(rollout.model.scene)).size:
            poses = shapes.backbones(rollout.model, rollout.strain, discs[:, 0], base)
            turned = shapes.rotation_from_z(poses[..., :3, 0])
            plates = rr.Cylinders3D.columns(
                centers=poses[..., :3, 3].reshape(-1, 3), quaternions=turned.reshape(-1, 4)
            )
            self._send(f"{root}/discs", times, plates.partition([len(discs)] * rollout.samples))
        curves = shapes.tendon_curves(rollout.model, frames, known.station)
        strips = rr.LineStrips3D.columns(
            strips=_strips(curves),
            colors=shapes.tension_colors(rollout.model, rollout.tension)
            .reshape(-1, 3)
            .astype(np.uint8),
        )
        self._send(f"{root}/tendons", times, strips.partition([len(curves)] * rollout.samples))
        self._send(f"{root}/tip", times, _poses(rollout.tip_pose))
        self._send(f"{root}/trail", times, _lines(_steps(rollout.tip_pose, known.tip)))
        known.tip = rollout.tip_pose[-1:, :3, 3]

    def _send_target(
        self, root: str, known: DrawnArm, rollout: Rollout, times: list[rr.TimeColumn]
    ) -> None:
        if rollout.target_pose is not None:
            if known.episode == 0 and known.target is None:
                self._send_static(
                    f"{root}/target",
                    rr.Points3D([[0.0, 0.0, 0.0]], radii=TARGET_SIZE, colors=TARGET_COLOR),
                )
                axes = rr.LineStrips3D(
                    [*(rod_length(rollout.model.scene) * AXES)],
                    radii=TARGET_WIDTH,
                    colors=TARGET_COLOR,
                )
                self._send_static(f"{root}/target/axes", axes)
            self._send(f"{root}/target", times, _poses(rollout.target_pose))
            self._send(
                f"{root}/target_trail", times, _lines(_steps(rollout.target_pose, known.target))
            )
            known.target = rollout.target_pose[-1:, :3, 3]
        if rollout.target_backbone is not None and rollout.target_backbone.shape[1]:
            self._send(f"{root}/target_backbone", times, _lines(rollout.target_backbone))

    def _send_solids(
        self, root: str, known: DrawnArm, rollout: Rollout, times: list[rr.TimeColumn]
    ) -> None:
        """The obstacles where others than before are to be seen, and how they move: their surfaces
        are where they are at time 0."""
        effects = (rollout.scene or rollout.model.scene).effects
        obstacles, moments = shapes.obstacles_of(effects), _moments(known, rollout)
        if not obstacles:
            return
        if known.effects != effects:
            known.effects = effects
            first = _times(known, 1, rollout.period)
            for number, obstacle in enumerate(obstacles):
                corners = shapes.surface(obstacle, 0.0, shapes.view_box(rollout.model.scene)[:2])
                self._send(
                    f"{root}/solids/{number}",
                    first,
                    _seen_through(corners) if obstacle.is_endless else _mesh(corners),
                )
        for number, obstacle in enumerate(obstacles):
            if obstacle.moves:
                poses = np.array([obstacle.pose(time) for time in moments.tolist()])
                self._send(
                    f"{root}/solids/{number}",
                    times,
                    _poses(poses @ np.linalg.inv(obstacle.pose(0.0))),
                )

    def _send_numbers(
        self, arm: str, known: DrawnArm, rollout: Rollout, times: list[rr.TimeColumn]
    ) -> None:
        rows = {"tension": rollout.tension}
        if rollout.action is not None and rollout.action.shape[1]:
            rows["action"] = rollout.action
        for kind, values in rows.items():
            columns = rr.Scalars.columns(scalars=values.ravel())
            self._send(
                f"{kind}/{part(arm)}", times, columns.partition([values.shape[1]] * rollout.samples)
            )
        for name, values in rollout.scalars.items():
            self._send(
                f"{_kind(name)}/{part(arm)}/{part(name)}", times, rr.Scalars.columns(scalars=values)
            )
            if _kind(name) == "error":
                self._send(
                    f"plot/{part(name)}/{part(arm)}",
                    times,
                    rr.Scalars.columns(scalars=error_unit(name).factor * values),
                )
        series = {
            kind: [f"{kind} {i}" for i in range(values.shape[1])] for kind, values in rows.items()
        }
        for name in rollout.scalars:
            series.setdefault(_kind(name), []).append(name)
        if any(
            name not in known.series.get(kind, [])
            for kind, names in series.items()
            for name in names
        ):
            for kind, names in series.items():
                known.series[kind] = [*dict.fromkeys([*known.series.get(kind, []), *names])]
            if all(
                each.series for each in self._arms.values()
            ):  # a layout takes space: not one for each arm that appears
                self._lay_out()

    def _lay_out(self) -> None:
        """Send the names and colours of all lines in plots, and what the viewer is to show of all
        arms."""
        for entity, style in line_styles(self._arms).items():
            self._send_static(entity, style)
        self._open_recording().send_blueprint(layout(self._arms, TRAIL, live=self.live))


def _kind(scalar: str) -> str:
    """The group of plots that a scalar belongs to."""
    return (
        "reward"
        if scalar.startswith("reward")
        else "error"
        if scalar.endswith("error")
        else "other"
    )


def _times(arm: DrawnArm, samples: int, period: float) -> list[rr.TimeColumn]:
    """Places of the arm's next samples on the timelines."""
    passed = np.arange(samples)
    return [
        rr.TimeColumn(
            "sim_time", duration=(arm.time + passed * round(1e9 * period)).astype("timedelta64[ns]")
        ),
        rr.TimeColumn("step", sequence=arm.step + passed),
        rr.TimeColumn("episode", sequence=np.full(samples, arm.episode)),
    ]


def _steps(pose: Array, before: Array | None) -> Array:
    """Lines (samples, 2, 3) from where poses (samples, 4, 4) were a sample before; the view shows
    those of the last seconds together."""
    position = pose[:, :3, 3]
    return np.stack(
        [np.concatenate([position[:1] if before is None else before, position[:-1]]), position],
        axis=1,
    )


def _lines(points: Array) -> rr.ComponentColumnList:
    """A line through points (samples, m, 3) per sample."""
    return rr.LineStrips3D.columns(strips=points.astype(np.float32))


def _poses(pose: Array) -> rr.ComponentColumnList:
    return rr.Transform3D.columns(translation=pose[:, :3, 3], mat3x3=pose[:, :3, :3])


def _mesh(corners: Array) -> list[rr.ComponentColumn]:
    """Quadrilaterals (n, 4, 3) as a mesh, at one time."""
    first = 4 * np.arange(len(corners))[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    shaded = np.repeat(normals(corners), 4, axis=0)
    vertices = rr.Mesh3D.columns(
        vertex_positions=corners.reshape(-1, 3), vertex_normals=shaded
    ).partition([4 * len(corners)])
    faces = rr.Mesh3D.columns(triangle_indices=triangles).partition([len(triangles)])
    return [*vertices, *faces, *rr.Mesh3D.columns(albedo_factor=[SOLID_COLOR])]


def _seen_through(corners: Array) -> list[rr.ComponentColumn]:
    """Quadrilaterals (n, 4, 3) as lines, at one time."""
    lines = rr.LineStrips3D.columns(strips=corners.astype(np.float32)).partition([len(corners)])
    return [*lines, *rr.LineStrips3D.columns(radii=[0.5 * TENDON_WIDTH], colors=[SOLID_COLOR])]


def _moments(known: DrawnArm, rollout: Rollout) -> Array:
    """Times (samples,) [s] of a rollout's samples since its episode began."""
    return np.asarray((known.shown + np.arange(rollout.samples)) * rollout.period)


def _strips(curves: list[Array]) -> pyarrow.Array:
    """Curves (samples, m_i, 3) sample by sample. Made in Arrow: from lists of arrays Rerun takes
    ten times as long."""
    kind = rr.components.LineStrip3DBatch([]).as_arrow_array().type
    points = pyarrow.array(np.concatenate(curves, axis=1, dtype=np.float32).ravel())
    lengths = np.tile([curve.shape[1] for curve in curves], len(curves[0]))
    vectors = pyarrow.FixedSizeListArray.from_arrays(points, type=kind.value_type)
    return pyarrow.ListArray.from_arrays(
        np.cumsum([0, *lengths], dtype=np.int32), vectors, type=kind
    )
