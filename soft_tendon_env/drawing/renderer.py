"""Rendered frames of an arm without a display: a shaded tube with its tendons and mount, the trail
of its tip, its target.

The floor is painted once; a frame restores it and paints over it what moves. Everything solid is
cut into small pieces and painted as one flat collection from far to near.
"""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from soft_tendon_env.drawing import shapes
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import (
    Scene,
    Segment,
    along_rod,
    disc_rows,
    rod_length,
    rod_radius,
    tendon_ends,
)
from soft_tendon_env.tools.types import Array

SECTIONS, AROUND = (
    40,
    32,
    # sections along the rod (more where it has many borders), and corners around each: eighths for
    # rectangles
)
CIRCLE = np.stack([np.cos(angle := 2.0 * np.pi / AROUND * np.arange(AROUND)), np.sin(angle)])

TUBE, MOUNT, TRAIL, OBSTACLE = np.array(
    [[0.62, 0.71, 0.82], [0.40, 0.42, 0.46], [0.42, 0.24, 0.66], [0.80, 0.72, 0.58]]
)
PAPER, FLOOR, TEXT, TARGET = (
    (1.0, 1.0, 1.0),
    (0.86, 0.87, 0.89),
    (0.30, 0.30, 0.33),
    (0.05, 0.58, 0.30),
)
POSE_AXES = np.array([[0.84, 0.15, 0.16], [0.17, 0.63, 0.17], [0.12, 0.35, 0.80]])  # x, y, z
GRID, AXES = (
    0.25,
    0.09,
)  # distance between lines on the floor, and length of a target's axes, in lengths of the rod
ROOM = (
    0.9,
    0.84,
    # shares of a frame's width and height that the box around the arm fills at most; the title is
    # above
)
SEAM, FADED = (
    0.5,
    0.7,
    # width [pt] of edges that close gaps, and how far the colour of a tendon on the far side goes
    # over into the tube's
)


class Picture(NamedTuple):
    """Content of one frame; None: not shown."""

    strain: Array  # (points, 6) as of `Model.strain`
    tension: Array  # (n_a,) [N]
    trail: Array  # (k, 3) past tip positions [m], oldest first
    target_pose: Array | None  # (4, 4)
    target_backbone: Array | None  # (stations, 3) [m]
    title: str
    time: float = 0.0  # [s] since the episode began, for what moves by itself
    scene: Scene | None = (
        None  # of the arm, where its numbers are not those of the renderer's model
    )


class Pieces(NamedTuple):
    """Quadrilaterals to be painted from far to near; a line is one without area, visible by its
    edge."""

    corners: Array  # (n, 4, 3) [m]
    colour: Array  # (n, 3) of area and edge
    width: Array  # (n,) of the edge [pt]
    depth: Array  # (n,) [m] along the view, greater is farther away


class ArmRenderer:
    """Draws frames of one arm in parallel projection. It has a figure of its own, so that every
    thread or process can have a renderer."""

    def __init__(self, model: Model, width: int = 640, height: int = 480) -> None:
        """Frames of width x height pixels. Raises gymnasium's DependencyNotInstalled if matplotlib
        is missing."""
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ImportError as error:
            raise DependencyNotInstalled(
                'pictures need matplotlib: pip install "soft_tendon_env[pictures]"'
            ) from error
        scene = model.scene
        self._model, self._arc_length = model, shapes.drawing_stations(model, SECTIONS + 1)
        self._radius, _ = rod_radius(scene, self._arc_length)
        self._outline = along_rod(scene, self._arc_length, outline).T.reshape(-1, *CIRCLE.shape)
        self._discs = disc_rows(scene)
        ends = [tendon_ends(scene, tendon) for tendon in scene.tendons]
        self._inside = [
            (self._arc_length >= start) & (self._arc_length <= end) for start, end in ends
        ]
        self._box, self.turn = (
            shapes.view_box(scene)[:2],
            shapes.viewpoint(*shapes.view_box(scene)[2:]),
        )

        dpi = 100.0 * min(width / 640, height / 480)
        figure = Figure(
            figsize=((width + 0.1) / dpi, (height + 0.1) / dpi), dpi=dpi, facecolor=PAPER
        )  # 0.1: pixels are rounded down
        self._canvas = FigureCanvasAgg(figure)
        self.artists = moving_artists(figure, paint_floor(figure, scene, self.turn))
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def frame(self, picture: Picture) -> NDArray[np.uint8]:
        """The picture (height, width, 3), red, green, blue."""
        base = shapes.base_poses(self._model, np.array([picture.time]), picture.scene)
        backbone = shapes.backbones(self._model, picture.strain[None], self._arc_length, base)
        discs = shapes.backbones(self._model, picture.strain[None], self._discs[:, 0], base)[0]
        pieces = [
            *self._arm(backbone[0], base[0], discs),
            *self._tendons(backbone, picture.tension),
            *trail(picture.trail, self.turn),
        ]
        obstacles = shapes.obstacles_of((picture.scene or self._model.scene).effects)
        pieces += [
            solid(shapes.surface(obstacle, picture.time, self._box), OBSTACLE, self.turn)
            for obstacle in obstacles
        ]
        self._show(pieces, picture)
        self._canvas.restore_region(self._background)
        for artist in self.artists:
            artist.draw(self._canvas.get_renderer())
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _show(self, pieces: list[Pieces], picture: Picture) -> None:
        """Let the artists take over what a frame shows."""
        areas, target, pose, place, title = self.artists
        corners, colour, width, depth = (
            np.concatenate(values) for values in zip(*pieces, strict=True)
        )
        order, across = np.argsort(-depth, kind="stable"), self.turn[:2].T
        areas.set_verts(corners[order] @ across)
        areas.set_facecolor(colour[order])
        areas.set_linewidth(width[order])
        target.set_data(
            *(
                np.empty((0, 2))
                if picture.target_backbone is None
                else picture.target_backbone @ across
            ).T
        )
        poses = np.empty((0, 4, 4)) if picture.target_pose is None else picture.target_pose[None]
        place.set_data(*(poses[:, :3, 3] @ across).T)
        size = AXES * self._model.length
        ends = [
            np.stack([frame[:3, 3], frame[:3, 3] + size * frame[:3, k]]) @ across
            for frame in poses
            for k in range(3)
        ]
        pose.set_segments([*ends, *ends])
        title.set_text(picture.title)

    def _arm(self, backbone: Array, base: Array, discs: Array) -> list[Pieces]:
        """Mount, rod and spacer discs, closed by rings without radius; backbone (m, 4, 4), base (4,
        4), poses of discs (d, 4, 4)."""
        rod = tube(
            np.concatenate([backbone, backbone[-1:]]),
            np.append(self._outline, np.zeros((1, *CIRCLE.shape)), axis=0),
        )
        depth, radius = shapes.mount_size(self._model.scene)
        mount = cylinder(base, -depth, 0.0, radius)
        sizes = self._discs[:, 2:].tolist()
        spacers = [
            cylinder(pose, -0.5 * thick, 0.5 * thick, wide)
            for pose, (wide, thick) in zip(discs, sizes, strict=True)
        ]
        return [
            solid(mount, MOUNT, self.turn),
            solid(rod, TUBE, self.turn),
            *(solid(disc, TUBE, self.turn) for disc in spacers),
        ]

    def _tendons(self, backbone: Array, tension: Array) -> list[Pieces]:
        """Lines coloured by tension (n_a,), all on the near surface of the tube; those of the far
        side are faded."""
        towards, colours = self.turn[2], shapes.tension_colors(self._model, tension) / 255.0
        axis, reach = (
            -backbone[0, :, :3, 3] @ towards,
            np.gradient(self._arc_length),
        )  # by which neighbours differ in depth
        far_side = axis - 1.5 * self._radius - reach
        near_side = far_side - 0.1 * self._radius - reach
        curves, lines = shapes.tendon_curves(self._model, backbone, self._arc_length), []
        for (curve,), inside, colour in zip(curves, self._inside, colours, strict=True):
            behind = middle(-curve @ towards - axis[inside]) > 0.0
            shade = np.where(behind[:, None], (1.0 - FADED) * colour + FADED * 0.9 * TUBE, colour)
            depth = np.where(behind, middle(far_side[inside]), middle(near_side[inside]))
            lines.append(line(curve, shade, 1.7, depth))
        return lines


def moving_artists(figure: Any, axes: Any) -> list[Any]:
    """The artists that change from frame to frame: areas, the target's backbone, its axes, its
    place, the title."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.lines import Line2D

    shared: dict[str, Any] = {"animated": True, "clip_on": False, "transform": axes.transData}
    artists: list[Any] = [
        PolyCollection([], edgecolors="face", joinstyle="round", **shared),
        Line2D([], [], color=TARGET, alpha=0.55, linewidth=4.0, solid_capstyle="round", **shared),
        LineCollection(
            [],
            colors=[PAPER] * 3 + [*POSE_AXES],
            linewidths=[3.6] * 3 + [2.0] * 3,
            capstyle="round",
            **shared,
        ),
        Line2D(
            [],
            [],
            marker="o",
            markersize=5.5,
            color=TARGET,
            markeredgecolor=PAPER,
            markeredgewidth=0.9,
            **shared,
        ),
    ]
    for artist in artists:
        figure.add_artist(artist)
    title = figure.text(
        0.5,
        0.955,
        "",
        ha="center",
        va="center",
        fontsize=10,
        color=TEXT,
        animated=True,
        parse_math=False,
    )
    return [*artists, title]


def outline(segment: Segment, places: Array) -> Array:
    """Corners y, z [m] around the sections at arc lengths (m,) [m] of a segment: (2 * AROUND,
    m)."""
    half = 0.5 * segment.shape.hull(places, segment.length)[:2]
    return (half[:, None] * segment.shape.outline(CIRCLE)[..., None]).reshape(CIRCLE.size, -1)


def cylinder(pose: Array, start: float, end: float, radius: float) -> Array:
    """Quadrilaterals (3 * AROUND, 4, 3) of a cylinder with its ends, about the x axis of a pose (4,
    4) from start to end [m]."""
    ends = np.tile(np.eye(4), (4, 1, 1))
    ends[:, 0, 3] = start, start, end, end
    return tube(pose @ ends, radius * np.array([0.0, 1.0, 1.0, 0.0])[:, None, None] * CIRCLE)


def tube(poses: Array, outline: Array) -> Array:
    """Quadrilaterals ((m - 1) * AROUND, 4, 3), seen counterclockwise from outside, on outlines (m,
    2, AROUND) [m] at poses (m, 4, 4)."""
    rings = poses[:, None, :3, 3] + (poses[:, :3, 1:3] @ outline).swapaxes(1, 2)
    turned = np.roll(rings, -1, axis=1)
    return np.stack([rings[:-1], turned[:-1], turned[1:], rings[1:]], axis=2).reshape(-1, 4, 3)


def normals(corners: Array) -> Array:
    """Outward normals (n, 3) of the quadrilaterals of a tube, zero for those without area."""
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]


def solid(corners: Array, colour: Array, turn: Array) -> Pieces:
    """The visible quadrilaterals of a closed surface, lit from above left; turn: see
    `viewpoint`."""
    normal = normals(corners)
    visible = normal @ turn[2] > 0.0
    normal, seen = normal[visible], corners[visible]
    diffuse = np.clip(normal @ (np.array([-0.45, 0.65, 0.62]) @ turn), 0.0, None)[:, None]
    glossy = (
        np.clip(normal @ (np.array([-0.25, 0.36, 0.90]) @ turn), 0.0, None)[:, None] ** 24
    )  # half way between light and viewer
    shade = np.clip(colour * (0.60 + 0.46 * diffuse) + 0.20 * glossy, 0.0, 1.0)
    return Pieces(seen, shade, np.full(len(seen), SEAM), -seen.mean(axis=1) @ turn[2])


def line(points: Array, colour: Array, width: float, depth: Array) -> Pieces:
    """A line through points (m, 3) whose parts have colours (m - 1, 3) and depths (m - 1,) [m]."""
    corners = np.stack([points[:-1], points[:-1], points[1:], points[1:]], axis=1)
    return Pieces(corners, colour, np.full(len(corners), width), depth)


def trail(points: Array, turn: Array) -> list[Pieces]:
    """A line through past positions (k, 3) [m] that pales with age."""
    if len(points) < 2:
        return []
    age = np.linspace(0.75, 0.0, len(points) - 1)[:, None]
    return [
        line(points, age * np.array(PAPER) + (1.0 - age) * TRAIL, 1.2, middle(-points @ turn[2]))
    ]


def middle(values: Array) -> Array:
    """Mean of each value and the next."""
    return np.asarray(0.5 * (values[:-1] + values[1:]))


def paint_floor(figure: Any, scene: Scene, turn: Array) -> Any:
    """Flat axes in which the box around the arm fills the figure, with lines on its floor;
    coordinates are those of the camera [m]."""
    from matplotlib.collections import LineCollection

    lower, upper, vertical, upright = shapes.view_box(scene)
    corners = shapes.corners_of_box(lower, upper) @ turn[:2].T
    size, middle = figure.bbox.size, 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    half = 0.5 * np.max(np.ptp(corners, axis=0) / (ROOM * size)) * size
    middle[1] += 0.3 * (1.0 - ROOM[1]) * half[1]
    (left, low), (right, high) = middle - half, middle + half
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(left, right), ylim=(low, high))
    axes.set_axis_off()
    (a, b), spacing, lines = [k for k in range(3) if k != vertical], GRID * rod_length(scene), []
    for along, across in ((a, b), (b, a)):
        for place in np.arange(np.ceil(lower[across] / spacing), upper[across] / spacing) * spacing:
            ends = np.full((2, 3), (lower if upright else upper)[vertical])
            ends[:, across], ends[:, along] = place, (lower[along], upper[along])
            lines.append(ends @ turn[:2].T)
    axes.add_collection(LineCollection(lines, colors=[FLOOR], linewidths=0.8))
    return axes
