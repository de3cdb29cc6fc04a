"""Rendered frames of an arm without a display.

They show a shaded tube with its tendons and mount, the trail of its tip, its target.

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

SECTIONS = 40  # along the rod, more where it has many borders
AROUND = 32  # corners around a section: eighths for rectangles
ANGLES = 2.0 * np.pi / AROUND * np.arange(AROUND)  # [rad]
CIRCLE = np.stack([np.cos(ANGLES), np.sin(ANGLES)])  # (2, AROUND)

# red, green and blue, 0 to 1
TUBE = np.array([0.62, 0.71, 0.82])
MOUNT = np.array([0.40, 0.42, 0.46])
TRAIL = np.array([0.42, 0.24, 0.66])
OBSTACLE = np.array([0.80, 0.72, 0.58])
PAPER = (1.0, 1.0, 1.0)
FLOOR = (0.86, 0.87, 0.89)
TEXT = (0.30, 0.30, 0.33)
TARGET = (0.05, 0.58, 0.30)
POSE_AXES = np.array([[0.84, 0.15, 0.16], [0.17, 0.63, 0.17], [0.12, 0.35, 0.80]])  # x, y, z

GRID = 0.25  # distance between lines on the floor, in lengths of the rod
AXES = 0.09  # length of a target's axes, in lengths of the rod
# share of a frame's width that the box around the arm fills at most, and of its height, as the
# title is above
ROOM = np.array([0.9, 0.84])
RAISED = 0.3  # share of the rest of the height by which the box moves down from the middle

TENDON = 1.7  # width of a tendon [pt]
THREAD = 1.2  # width of the tip's trail [pt]
SEAM = 0.5  # width of edges that close gaps [pt]
FADED = 0.7  # how far the colour of a tendon on the far side goes over into the tube's
DIMMED = 0.9  # lightness of the tube there
PALEST = 0.75  # how far the oldest part of a trail goes over into the paper's colour

# shaded as by Blinn and Phong: colours at the light, and what they have in shadow
LIGHT = np.array([-0.45, 0.65, 0.62])  # direction in the camera's frame: from above left
HALF_WAY = np.array([-0.25, 0.36, 0.90])  # between light and viewer
AMBIENT = 0.60
DIFFUSE = 0.46
GLOSSY = 0.20
SHININESS = 24  # exponent of the glossy part


class Picture(NamedTuple):
    """Content of one frame; None: not shown."""

    strain: Array  # (points, 6) as of `Model.strain`
    tension: Array  # (n_a,) [N]
    trail: Array  # (k, 3) past tip positions [m], oldest first
    target_pose: Array | None  # (4, 4)
    target_backbone: Array | None  # (stations, 3) [m]
    title: str
    time: float = 0.0  # [s] since the episode began, for what moves by itself
    has_axes: bool = True  # whether the target's orientation is to be reached too
    # of the arm, where its numbers are not those of the renderer's model
    scene: Scene | None = None


class Pieces(NamedTuple):
    """Quadrilaterals to be painted from far to near.

    A line is one without area, visible by its edge.
    """

    corners: Array  # (n, 4, 3) [m]
    colour: Array  # (n, 3) of area and edge
    width: Array  # (n,) of the edge [pt]
    depth: Array  # (n,) [m] along the view, greater is farther away


class ArmRenderer:
    """Draws frames of one arm in parallel projection.

    It has a figure of its own, so that every thread or process can have a renderer.
    """

    def __init__(
        self,
        model: Model,
        width: int = 640,
        height: int = 480,
    ) -> None:
        """Frames of width x height pixels.

        Raises gymnasium's DependencyNotInstalled if matplotlib is missing.
        """
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ImportError as error:
            raise DependencyNotInstalled(
                'pictures need matplotlib: pip install "soft_tendon_env[pictures]"'
            ) from error
        scene = model.scene
        self._model = model
        self._arc_length = shapes.drawing_stations(model, SECTIONS + 1)
        self._radius, _ = rod_radius(scene, self._arc_length)
        corners = along_rod(scene, self._arc_length, outline)
        self._outline = corners.T.reshape(-1, *CIRCLE.shape)
        self._discs = disc_rows(scene)
        self._inside = []  # of every tendon, which sections it passes
        for tendon in scene.tendons:
            start, end = tendon_ends(scene, tendon)
            is_after_start = self._arc_length >= start
            is_before_end = self._arc_length <= end
            self._inside.append(is_after_start & is_before_end)
        lower, upper, vertical, upright = shapes.view_box(scene)
        self._box = (lower, upper)
        self.turn = shapes.viewpoint(vertical, upright)

        # lines and letters grow with the frame
        scale = min(width / 640, height / 480)
        dpi = 100.0 * scale
        rest = 0.1  # pixels are rounded down
        inches_wide = (width + rest) / dpi
        inches_high = (height + rest) / dpi
        figure = Figure(figsize=(inches_wide, inches_high), dpi=dpi, facecolor=PAPER)
        self._canvas = FigureCanvasAgg(figure)
        axes = paint_floor(figure, scene, self.turn)
        self.artists = moving_artists(figure, axes)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def frame(self, picture: Picture) -> NDArray[np.uint8]:
        """The picture (height, width, 3), red, green, blue."""
        model = self._model
        scene = picture.scene or model.scene
        strain = picture.strain[None]
        base = shapes.base_poses(
            model,
            np.array([picture.time]),
            picture.scene,
        )
        backbone = shapes.backbones(model, strain, self._arc_length, base)
        discs = shapes.backbones(
            model,
            strain,
            self._discs[:, 0],
            base,
        )
        pieces = [
            *self._arm(
                backbone[0],
                base[0],
                discs[0],
            ),
            *self._tendons(backbone, picture.tension),
            *trail(picture.trail, self.turn),
        ]
        for obstacle in shapes.obstacles_of(scene.effects):
            corners = shapes.surface(obstacle, picture.time, self._box)
            pieces.append(solid(corners, OBSTACLE, self.turn))
        self._show(pieces, picture)
        # the floor is there, what moves is painted over it
        self._canvas.restore_region(self._background)
        for artist in self.artists:
            artist.draw(self._canvas.get_renderer())
        pixels = np.asarray(self._canvas.buffer_rgba())
        return pixels[..., :3].copy()

    def _show(self, pieces: list[Pieces], picture: Picture) -> None:
        """Let the artists take over what a frame shows."""
        areas, backbone, axes, place, title = self.artists
        across = self.turn[:2].T  # (3, 2), from the world to the picture
        corners = np.concatenate([part.corners for part in pieces])
        colour = np.concatenate([part.colour for part in pieces])
        width = np.concatenate([part.width for part in pieces])
        depth = np.concatenate([part.depth for part in pieces])
        # a painter's order: what is nearer covers what is farther
        from_afar = np.argsort(-depth, kind="stable")
        seen = corners[from_afar] @ across
        areas.set_verts(seen)
        areas.set_facecolor(colour[from_afar])
        areas.set_linewidth(width[from_afar])
        nothing = np.empty((0, 3))
        # the target: a curve, a point and three axes, as far as there are any
        curve = nothing
        if picture.target_backbone is not None:
            curve = picture.target_backbone
        x, y = (curve @ across).T
        backbone.set_data(x, y)
        positions = nothing
        segments = []
        if picture.target_pose is not None:
            position = picture.target_pose[:3, 3]
            positions = position[None]
            # a point has no axes
            if picture.has_axes:
                directions = picture.target_pose[:3, :3].T
            else:
                directions = nothing
            length = AXES * self._model.length
            for direction in directions:
                end = position + length * direction
                segment = np.stack([position, end])
                segments.append(segment @ across)
        x, y = (positions @ across).T
        place.set_data(x, y)
        axes.set_segments([*segments, *segments])  # each lies on a wider white line
        title.set_text(picture.title)

    def _arm(
        self,
        backbone: Array,
        base: Array,
        discs: Array,
    ) -> list[Pieces]:
        """Mount, rod and spacer discs, closed by rings without radius.

        backbone (m, 4, 4), base (4, 4), poses of discs (d, 4, 4).
        """
        # a ring without radius closes the tip
        tip = backbone[-1:]
        sections = np.concatenate([backbone, tip])
        shape = (1, *CIRCLE.shape)
        point = np.zeros(shape)
        outline = np.append(self._outline, point, axis=0)
        rod = tube(sections, outline)
        depth, radius = shapes.mount_size(self._model.scene)
        mount = cylinder(base, -depth, 0.0, radius)
        pieces = [
            solid(mount, MOUNT, self.turn),
            solid(rod, TUBE, self.turn),
        ]
        for pose, disc in zip(discs, self._discs, strict=True):
            _, _, wide, thick = disc
            half = 0.5 * thick
            corners = cylinder(pose, -half, half, wide)
            pieces.append(solid(corners, TUBE, self.turn))
        return pieces

    def _tendons(self, backbone: Array, tension: Array) -> list[Pieces]:
        """Lines coloured by tension (n_a,), all on the near surface of the tube.

        Those of the far side are faded.
        """
        towards = self.turn[2]
        colours_of_tensions = shapes.tension_colors(self._model, tension)
        colours = colours_of_tensions / 255.0
        axis = shapes.positions(backbone[0])
        axis_depth = -axis @ towards
        # painted after all sections around, whatever its tendons' own depth
        step = np.gradient(self._arc_length)  # by which neighbours differ in depth
        behind = axis_depth - 1.5 * self._radius
        far_side = behind - step
        before = far_side - 0.1 * self._radius
        near_side = before - step
        faded = FADED * DIMMED * TUBE
        curves = shapes.tendon_curves(self._model, backbone, self._arc_length)
        lines = []
        for samples, inside, colour in zip(curves, self._inside, colours, strict=True):
            curve = samples[0]
            depth = -curve @ towards
            behind_axis = depth - axis_depth[inside]
            is_behind = middle(behind_axis) > 0.0
            pale = (1.0 - FADED) * colour + faded
            rows_behind = is_behind[:, None]
            shade = np.where(rows_behind, pale, colour)
            far = middle(far_side[inside])
            near = middle(near_side[inside])
            painted = np.where(is_behind, far, near)
            tendon = line(curve, shade, TENDON, painted)
            lines.append(tendon)
        return lines


def moving_artists(figure: Any, axes: Any) -> list[Any]:
    """Artists that change from frame to frame.

    They are areas, the target's backbone, its axes, its place, the title.
    """
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.lines import Line2D

    shared: dict[str, Any] = {"animated": True, "clip_on": False, "transform": axes.transData}
    # areas, the target's backbone, its axes, its place: each is painted over those before it
    artists: list[Any] = [
        PolyCollection([], edgecolors="face", joinstyle="round", **shared),
        # dots with a rim: the arm that follows them stays to be seen
        Line2D(
            [],
            [],
            linestyle="none",
            marker="o",
            markersize=4.5,
            color=TARGET,
            markeredgecolor=PAPER,
            markeredgewidth=0.7,
            **shared,
        ),
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
    """Corners y, z [m] around the sections of a segment: (2 * AROUND, m).

    They are at arc lengths (m,) [m].
    """
    hull = segment.shape.hull(places, segment.length)
    height_and_width = hull[:2]
    half_sizes = 0.5 * height_and_width
    corners = segment.shape.outline(CIRCLE)
    half = half_sizes[:, None]
    scaled = half * corners[..., None]
    return scaled.reshape(CIRCLE.size, -1)


def cylinder(
    pose: Array,
    start: float,
    end: float,
    radius: float,
) -> Array:
    """Quadrilaterals (3 * AROUND, 4, 3) of a cylinder with its ends.

    It lies about the x axis of a pose (4, 4) from start to end [m].
    """
    rings = np.tile(np.eye(4), (4, 1, 1))
    rings[:, 0, 3] = (start, start, end, end)
    # the outer rings have no radius: they close its ends
    shares = np.array([0.0, 1.0, 1.0, 0.0])
    radii = radius * shares
    outlines = radii[:, None, None] * CIRCLE
    return tube(pose @ rings, outlines)


def tube(poses: Array, outline: Array) -> Array:
    """Quadrilaterals ((m - 1) * AROUND, 4, 3) of a tube, counterclockwise from outside.

    They lie on outlines (m, 2, AROUND) [m] at poses (m, 4, 4).
    """
    axes_across = poses[:, :3, 1:3]
    centre = poses[:, None, :3, 3]
    across = axes_across @ outline
    ring = centre + across.swapaxes(1, 2)
    turned = np.roll(ring, -1, axis=1)
    # corners of a quadrilateral: this ring and the next, here and one corner on
    around = [
        ring[:-1],
        turned[:-1],
        turned[1:],
        ring[1:],
    ]
    corners = np.stack(around, axis=2)
    return corners.reshape(-1, 4, 3)


def normals(corners: Array) -> Array:
    """Outward normals (n, 3) of the quadrilaterals of a tube, zero for those without area."""
    first, second, third, fourth = np.moveaxis(corners, 1, 0)
    # that of the two diagonals; a ring without radius leaves a triangle
    diagonal = third - first
    other_diagonal = fourth - second
    normal = np.cross(diagonal, other_diagonal)
    size = np.linalg.norm(normal, axis=1)
    smallest = 1e-300  # in place of zero, by which nothing can be divided
    divisor = np.maximum(size, smallest)
    return normal / divisor[:, None]


def solid(
    corners: Array,
    colour: Array,
    turn: Array,
) -> Pieces:
    """Visible quadrilaterals of a closed surface, lit from above left.

    turn: see `viewpoint`.
    """
    towards = turn[2]
    normal = normals(corners)
    is_visible = normal @ towards > 0.0
    normal = normal[is_visible]
    seen = corners[is_visible]
    light = LIGHT @ turn
    half_way = HALF_WAY @ turn
    # the model of Blinn and Phong
    diffuse = np.clip(normal @ light, 0.0, None)
    mirrored = np.clip(normal @ half_way, 0.0, None)
    glossy = mirrored[:, None] ** SHININESS
    in_rows = diffuse[:, None]
    lit = AMBIENT + DIFFUSE * in_rows
    bright = colour * lit + GLOSSY * glossy
    shade = np.clip(bright, 0.0, 1.0)
    centre = seen.mean(axis=1)
    depth = -centre @ towards
    width = np.full(len(seen), SEAM)
    return Pieces(seen, shade, width, depth)


def line(
    points: Array,
    colour: Array,
    width: float,
    depth: Array,
) -> Pieces:
    """A line through points (m, 3) whose parts have colours (m - 1, 3) and depths (m - 1,) [m]."""
    start = points[:-1]
    end = points[1:]
    ends = [start, start, end, end]
    corners = np.stack(ends, axis=1)
    return Pieces(
        corners,
        colour,
        np.full(len(corners), width),
        depth,
    )


def trail(points: Array, turn: Array) -> list[Pieces]:
    """A line through past positions (k, 3) [m] that pales with age."""
    if len(points) < 2:
        return []
    lines = len(points) - 1
    # share of the paper in the colour, from the oldest to the newest
    shades = np.linspace(PALEST, 0.0, lines)
    pale = shades[:, None]
    paper = np.array(PAPER)
    coloured = (1.0 - pale) * TRAIL
    colour = pale * paper + coloured
    towards = -points @ turn[2]
    depth = middle(towards)
    return [line(points, colour, THREAD, depth)]


def middle(values: Array) -> Array:
    """Mean of each value and the next."""
    pair_sums = values[:-1] + values[1:]
    return np.asarray(0.5 * pair_sums)


def paint_floor(
    figure: Any,
    scene: Scene,
    turn: Array,
) -> Any:
    """Flat axes in which the box around the arm fills the figure, with lines on its floor.

    Coordinates are those of the camera [m].
    """
    from matplotlib.collections import LineCollection

    lower, upper, vertical, upright = shapes.view_box(scene)
    across = turn[:2].T  # (3, 2), from the world to the picture
    corners = shapes.corners_of_box(lower, upper) @ across
    lowest = corners.min(axis=0)
    highest = corners.max(axis=0)
    # one scale for both axes: that of the narrower one
    pixels = figure.bbox.size
    filled_pixels = ROOM * pixels
    sizes = (highest - lowest) / filled_pixels
    per_pixel = np.max(sizes)  # [m]
    half = 0.5 * per_pixel * pixels
    centre = 0.5 * (lowest + highest)
    # the title has its room above the box
    space = 1.0 - ROOM[1]
    centre[1] += RAISED * space * half[1]
    left, low = centre - half
    right, high = centre + half
    axes = figure.add_axes(
        (0.0, 0.0, 1.0, 1.0),
        xlim=(left, right),
        ylim=(low, high),
    )
    axes.set_axis_off()
    # lines on the floor, along both of its axes
    first, second = [axis for axis in range(3) if axis != vertical]
    if upright:
        lowest_corner = lower
    else:
        lowest_corner = upper
    floor = lowest_corner[vertical]
    spacing = GRID * rod_length(scene)
    lines = []
    directions = ((first, second), (second, first))
    for along, aside in directions:
        # lines through multiples of the spacing in the world
        share = lower[aside] / spacing
        begin = np.ceil(share)
        end = upper[aside] / spacing
        for number in np.arange(begin, end):
            ends = np.full((2, 3), floor)
            ends[:, aside] = number * spacing
            ends[:, along] = (lower[along], upper[along])
            lines.append(ends @ across)
    collection = LineCollection(lines, colors=[FLOOR], linewidths=0.8)
    axes.add_collection(collection)
    return axes
