"""Contact with obstacles: smooth penalty with damping, Coulomb friction with sticking, on round samples along the whole arm.

Samples. Between neighbouring nodes the axis is the cubic Hermite curve through both, with tangents h R e_x for an interval of length h,
x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x. Samples lie evenly on it, each a ball of the rod's radius that stands for its
share ds of the length; the tip's stands for its round cap too. By virtual work a force f on a sample is the force H00 f and the moment
H10 h R_a e_x x f on the node before it, and likewise on the one behind: without friction contact has a potential of the nodes' poses.

Normal force. With d = radius - signed distance of the sample's middle, k = stiffness ds and a smoothing depth e,
N = p(d) max(0, 1 + c d_dot), p = k d^2 / 2 e up to d = e, k (d - e / 2) beyond: Hunt and Crossley (1975), here of a force that begins
smoothly. It never pulls, and what it takes out of the motion, p c d_dot^2, is never negative.

Friction. A bristle of displacement s per sample and obstacle, kept in the obstacle's frame and in its tangent plane:
f = -g min(1, mu N / |g|), g = k_t (s + T v) at the slip velocity v of the surface, and s_dot = v as long as |k_t s| < mu N, brought back to
that limit where it is not: return mapping (Simo and Hughes, Computational Inelasticity, 1998, ch. 1; Cundall and Strack 1979).
So a load below mu N is held without creep. k_t = 2/3 k is the ratio of Mindlin (1949) for a rubber, 2 (1 - nu) / (2 - nu) at nu = 1/2.
"""

import math
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import Field, field_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, Solid, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, dot, matmul, minus, plus, rodrigues, rotate, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import struct_at
from soft_tendon_env.mechanics.effects import (
    EffectTable,
    Matrix,
    Nodes,
    adds_wrench,
    advances_state,
    allow_turning,
    kinds_of,
    limits_step,
    parameters_at,
    sweeps_motion,
)
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.terms.kinematics import node_twists, poses
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_rate
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import LEAST, Frequency, Length, NotNegative, Number, Positive, Turning
from soft_tendon_env.tools.types import Triple as Vector

PLANE, CAPSULE, CYLINDER, BOX = 0.0, 1.0, 2.0, 3.0
"""Kinds of signed distance; a sphere is a capsule without length."""

TANGENTIAL = 2.0 / 3.0
"""Stiffness of a bristle over that of the sample."""
BRISTLE_TIME = 1e-3
"""T [s]: damping over stiffness of a bristle, and so how fast a slip counts as slip."""
MOST_SAMPLES = 10_000
"""Places along the arm at which contact is looked for."""
SMOOTHING = 0.01
"""Depth over which the stiffness grows to its full size, in radii of the rod."""
FREE, WALL = 0.2, 0.45
"""Depths in radii of the rod between which the wall stops what would go through, see `walled`: a wire between two samples a radius apart is
half a radius deep in both."""
WALL_SPEED, WALL_MASS = 30.0, 8.0
"""What the wall of a sample stops by itself within twice its width or so: this speed [m/s] of so many times the mass of its share."""
WALL_DISSIPATION = 1.0
"""The least c [s/m] of the wall: what begins within an obstacle leaves it at 1 m/s at most."""
OVERRUN, THROUGH = 0.1, 0.15
"""Of the radius: how much deeper a step in contact may lead, and what turns out to be so deep that it is tried again shorter."""
LANDED = 0.01
"""Of the kinetic energy of the arm, the most that a sample may store where a step ends in what it comes upon."""
IDLE = 0.05
"""Speed, in lengths of the arm per second, with which it counts as energy besides: at rest steps need not end where a contact begins."""
CUTS = 8
"""How often the way of a sample is looked at in detail."""


class Obstacle(Configuration):
    """A solid that may move: `position` at time 0 [m], constant `velocity` [m/s] and `angular_velocity` [rad/s] about `centre` (None: its
    position), which moves along, and a swing `amplitude` sin(2 pi `frequency` t + `phase`) of its place [m, Hz, degrees]; `friction`
    coefficient mu, None: that of the table."""

    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: tuple[Turning, Turning, Turning] = (0.0, 0.0, 0.0)
    centre: Vector | None = None
    amplitude: Vector = (0.0, 0.0, 0.0)
    frequency: Frequency = 0.0
    phase: Number = 0.0
    friction: NotNegative | None = None

    @property
    def kind(self) -> float:
        """Which signed distance it has."""
        raise NotImplementedError

    @property
    def dimensions(self) -> Vector:
        """Half sizes [m] as the signed distance reads them."""
        raise NotImplementedError

    @property
    def orientation(self) -> Array:
        """Rotation (3, 3) at time 0."""
        raise NotImplementedError

    @property
    def extent(self) -> float:
        """Radius [m] of a ball around its position that holds it."""
        return math.hypot(*self.dimensions)

    @property
    def thickness(self) -> float:
        """Half of what is least of its sizes [m]."""
        return min(self.dimensions)

    @property
    def moves(self) -> bool:
        """Whether its pose depends on time."""
        return any((*self.velocity, *self.angular_velocity, *self.amplitude))

    def solid(self, pose: Array) -> Solid:
        """What it looks like at a pose (4, 4)."""
        raise NotImplementedError

    def row(self, friction: float, dissipation: float) -> list[float]:
        """Its numbers, in the order in which `place_of` and `distance` read them."""
        centre = self.position if self.centre is None else self.centre
        swing = 2.0 * math.pi * self.frequency, math.radians(self.phase)
        own = friction if self.friction is None else self.friction
        return [
            self.kind, *self.dimensions, *self.position, *self.orientation.ravel().tolist(), *self.velocity, *self.angular_velocity,
            *centre, *self.amplitude, *swing, own, dissipation, self.extent, self.thickness,
        ]  # fmt: skip


def across(axis: Vector) -> Array:
    """The rotation (3, 3) with its z along an axis."""
    z = np.array(axis) / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


class Directed(Obstacle):
    """An obstacle with an axis, a vector of any length but zero."""

    axis: Vector = (0.0, 0.0, 1.0)

    @field_validator("axis")
    @classmethod
    def _is_a_direction(cls, axis: Vector) -> Vector:
        if max(map(abs, axis)) < LEAST:
            raise ValueError("should be a direction, not zero")
        return axis

    @property
    def orientation(self) -> Array:
        return across(self.axis)


class Plane(Directed):
    """Half-space below the plane through `position` with outward normal `axis`."""

    type: Literal["plane"] = "plane"

    @property
    def kind(self) -> float:
        return PLANE

    @property
    def dimensions(self) -> Vector:
        return 0.0, 0.0, 0.0

    @property
    def extent(self) -> float:
        return math.inf

    @property
    def thickness(self) -> float:
        return math.inf

    def solid(self, pose: Array) -> Solid:
        return Solid("plane", (), pose)


class Sphere(Obstacle):
    """Sphere of a `radius` [m] about `position`."""

    type: Literal["sphere"] = "sphere"
    radius: Length

    @property
    def kind(self) -> float:
        return CAPSULE

    @property
    def dimensions(self) -> Vector:
        return self.radius, 0.0, 0.0

    @property
    def thickness(self) -> float:
        return self.radius

    @property
    def orientation(self) -> Array:
        return np.eye(3)

    def solid(self, pose: Array) -> Solid:
        return Solid("sphere", (self.radius,), pose)


class Round(Directed):
    """Base of what is round about a line: of a `radius` and a `length` [m] along `axis`, about `position`."""

    radius: Length
    length: Length

    @property
    def dimensions(self) -> Vector:
        return self.radius, 0.5 * self.length, 0.0

    @property
    def thickness(self) -> float:
        return self.radius


class Capsule(Round):
    """Capsule about `position`: points up to `radius` [m] from a line of this `length` [m] along `axis`."""

    type: Literal["capsule"] = "capsule"

    @property
    def kind(self) -> float:
        return CAPSULE

    @property
    def extent(self) -> float:
        return self.radius + 0.5 * self.length

    def solid(self, pose: Array) -> Solid:
        return Solid("capsule", (self.radius, self.length), pose)


class Cylinder(Round):
    """Cylinder about `position` with flat ends, of a `radius` and a `length` [m] along `axis`."""

    type: Literal["cylinder"] = "cylinder"

    @property
    def kind(self) -> float:
        return CYLINDER

    @property
    def thickness(self) -> float:
        return min(self.radius, 0.5 * self.length)

    def solid(self, pose: Array) -> Solid:
        return Solid("cylinder", (self.radius, self.length), pose)


class Box(Obstacle):
    """Box about `position` with edges of `size` (x, y, z) [m], turned by `rotation` (x, y, z): angle [degrees] times axis."""

    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length]
    rotation: Vector = (0.0, 0.0, 0.0)

    @property
    def kind(self) -> float:
        return BOX

    @property
    def dimensions(self) -> Vector:
        x, y, z = self.size
        return 0.5 * x, 0.5 * y, 0.5 * z

    @property
    def orientation(self) -> Array:
        x, y, z = np.radians(self.rotation).tolist()
        return np.array(rotation_by((x, y, z))).reshape(3, 3)

    def solid(self, pose: Array) -> Solid:
        return Solid("box", self.size, pose)


AnyObstacle = Annotated[Plane | Sphere | Capsule | Cylinder | Box, Field(discriminator="type")]


@register_effect("contact")
class Contact(Effect):
    """`[effects.contact]` with `[[effects.contact.obstacles]]`: planes, spheres, capsules, cylinders and boxes, fixed or moving, which the
    whole arm cannot enter.

    `obstacles` are tables with a `type`, "plane", "sphere", "capsule", "cylinder" or "box", see Plane, Sphere, Capsule, Cylinder and Box;
    `friction` is the coefficient mu [-] of those that have none of their own. `stiffness` is force per length and depth [N/m^2]; none:
    E A / (2 r)^2, about that of the rod's material pressed flat, pi E / 4. `dissipation` is c [s/m] of the normal force: an impact at a
    speed v returns it times about 1 - 2/3 c v where c v is small. `spacing` is the largest distance [m] between neighbouring samples; none:
    the rod's radius there. What is thinner than that and meets the arm between samples sinks in a little.
    """

    is_encountered: ClassVar[bool] = True

    obstacles: tuple[AnyObstacle, ...] = Field(min_length=1)
    friction: NotNegative = 0.0
    stiffness: Positive | None = None
    dissipation: NotNegative = 1.0
    spacing: Positive | None = None

    def parameters(self, rod: Discretisation) -> "ContactParameters":
        intervals, samples = self._samples(rod)
        rows = [obstacle.row(self.friction, self.dissipation) for obstacle in self.obstacles]
        return ContactParameters(Matrix(intervals), Matrix(samples[:, :10]), Matrix(np.array(rows)))

    def sample_places(self, rod: Discretisation) -> Array:
        """Arc lengths (samples,) [m] at which contact is looked for."""
        return self._samples(rod)[1][:, 10]

    def state(self, rod: Discretisation) -> Array:
        if not any(obstacle.friction if obstacle.friction is not None else self.friction for obstacle in self.obstacles):
            return np.zeros(0)
        return np.zeros(3 * len(self.obstacles) * len(self._samples(rod)[1]))

    def bodies(self) -> tuple[tuple[str, bool], ...]:
        return tuple((f"obstacles[{i}], a {obstacle.type}", obstacle.moves) for i, obstacle in enumerate(self.obstacles))

    def state_of(self) -> str:
        return f"of {', '.join(obstacle.type for obstacle in self.obstacles)}"

    def potential_energy(self, arm: Configured) -> float:
        if self.state(arm.rod).size or any(obstacle.moves for obstacle in self.obstacles):
            raise ValueError("contact with friction or with obstacles that move has no potential energy")
        parameters = self.parameters(arm.rod)
        pose = np.concatenate([arm.pose[:, :3, :3].reshape(-1, 9), arm.pose[:, :3, 3]], axis=1)
        energy = np.zeros(1)
        contact_energy(parameters, nodes_at(node_field(pose)), energy)
        return float(energy[0])

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        found = []
        for obstacle in self.obstacles:
            pose = np.eye(4)
            place = place_of(np.array([obstacle.row(0.0, 0.0)]), 0, time)
            pose[:3, :3], pose[:3, 3] = np.array(place.R).reshape(3, 3), place.r
            found.append(obstacle.solid(pose))
        return tuple(found)

    def distances(self, positions: Array, time: float = 0.0) -> Array:
        """Signed distances (obstacles, m) [m] from the obstacles' surfaces to positions (m, 3) [m] at a time [s], negative inside."""
        obstacles = np.array([obstacle.row(0.0, 0.0) for obstacle in self.obstacles])
        out = np.empty((len(obstacles), len(positions)))
        read_distances(obstacles, positions, time, out)
        return out

    def _samples(self, rod: Discretisation) -> tuple[Array, Array]:
        """Rows of `ContactParameters.intervals`, and of `samples`: H00, h H10 [m], H01, h H11 [m], t, radius [m], stiffness k [N/m],
        smoothing e [m], scale of the wall's energy [J], most thickness [m] that counts for it, and arc length [m] besides."""
        least = rod.length / MOST_SAMPLES
        if self.spacing is not None and self.spacing < least:
            text = f"is {self.spacing:g}: it should be at least {least:g} m, for {MOST_SAMPLES} samples along the arm"
            raise ConfigurationError([Problem(("effects", "contact", "spacing"), text)])
        intervals: list[list[float]] = []
        samples: list[list[float]] = []
        for start, end in zip(np.concatenate([[0.0], rod.node[:-1]]), rod.node, strict=True):
            h, first = float(end - start), len(samples)
            if h > 0.0:
                apart = self.spacing or max(float(rod.radius(np.array([0.5 * (start + end)]))[0]), least)
                count = math.ceil(h / apart)
                t = np.arange(1, count + 1) / count
                place = start + t * h
                radius, stiffness = rod.radius(place), self._stiffness(rod, place)
                share = np.full(count, h / count)
                if end >= rod.length * (1.0 - 1e-12):
                    share[-1] = 0.5 * h / count + radius[-1]
                bases = (1 + 2 * t) * (1 - t) ** 2, h * t * (1 - t) ** 2, t**2 * (3 - 2 * t), h * t**2 * (t - 1)
                wall = WALL_MASS * WALL_SPEED**2 * rod.line_mass(place) * share
                solid = radius if self.stiffness is None else np.full(count, math.inf)
                samples += np.stack([*bases, t, radius, stiffness * share, SMOOTHING * radius, wall, solid, place], axis=1).tolist()
            largest = max((sample[5] for sample in samples[first:]), default=0.0)
            intervals.append([h, first, len(samples), largest])
        return np.array(intervals), np.array(samples)

    def _stiffness(self, rod: Discretisation, place: Array) -> Array:
        """Force per length and depth [N/m^2] at arc lengths (m,)."""
        if self.stiffness is not None:
            return np.full(place.size, self.stiffness)
        return rod.elasticity(place)[:, 3] / (2.0 * rod.radius(place)) ** 2


class ContactParameters(NamedTuple):
    """What the kernels read of samples and obstacles; intervals in order from base to tip, the empty ones at the end without samples."""

    intervals: Matrix  # (nodes, 4): length h [m], first sample, one past the last, largest radius [m]
    samples: Matrix  # (samples, 10): see Contact._samples
    obstacles: Matrix  # (obstacles, 34): see Obstacle.row


class Place(NamedTuple):
    """Pose of an obstacle, and its motion as a rigid body."""

    R: tuple[float, float, float, float, float, float, float, float, float]
    r: Vector
    centre: Vector
    velocity: Vector  # of the centre
    angular_velocity: Vector


class Ends(NamedTuple):
    """Poses of the two nodes of an interval."""

    R_a: tuple[float, float, float, float, float, float, float, float, float]
    r_a: Vector
    R_b: tuple[float, float, float, float, float, float, float, float, float]
    r_b: Vector


class Touch(NamedTuple):
    """Contact of a sample with an obstacle; vectors in the world frame."""

    force: float  # N
    stiffness: float  # dN / dd
    damping: float  # dN / dd_dot
    normal: Vector  # out of the obstacle
    slip: Vector  # velocity of the rod's surface along the obstacle's


@kernel
def rotation_by(angle):
    """exp of a rotation vector [rad]."""
    size = math.sqrt(dot(angle, angle))
    if size == 0.0:
        return 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    return rodrigues(math.sin(size) / size, 2.0 * (math.sin(0.5 * size) / size) ** 2, angle)


@kernel(inline=True)
def triple(rows, i, at):
    return rows[i, at], rows[i, at + 1], rows[i, at + 2]


@kernel
def place_of(obstacles, i, time):
    """Pose and motion of an obstacle at a time [s]."""
    position, v, w = triple(obstacles, i, 4), triple(obstacles, i, 16), triple(obstacles, i, 19)
    centre, amplitude = triple(obstacles, i, 22), triple(obstacles, i, 25)
    x, y, z = triple(obstacles, i, 7), triple(obstacles, i, 10), triple(obstacles, i, 13)
    R = x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]
    arm = minus(position, centre)
    if w[0] != 0.0 or w[1] != 0.0 or w[2] != 0.0:
        turn = rotation_by(times(time, w))
        R, arm = matmul(turn, R), rotate(turn, arm)
    centre = plus(centre, times(time, v))
    rate, phase = obstacles[i, 28], obstacles[i, 29]
    if rate != 0.0 or phase != 0.0:
        centre = plus(centre, times(math.sin(rate * time + phase), amplitude))
        v = plus(v, times(rate * math.cos(rate * time + phase), amplitude))
    return Place(R, plus(centre, arm), centre, v, w)


@kernel(inline=True)
def distance(obstacles, j, x):
    """Signed distance [m] from an obstacle's surface to x in its frame, negative inside, and its gradient: outwards, of length 1.

    Where a face, an axis or a middle has no single nearest point, that of one of them.
    """
    kind = obstacles[j, 0]
    if kind == PLANE:
        return x[2], (0.0, 0.0, 1.0)
    if kind == CAPSULE:
        away = x[0], x[1], x[2] - min(max(x[2], -obstacles[j, 2]), obstacles[j, 2])
        size = math.sqrt(dot(away, away))
        if size > 0.0:
            return size - obstacles[j, 1], times(1.0 / size, away)
        return -obstacles[j, 1], (1.0, 0.0, 0.0)
    if kind == CYLINDER:
        size = math.sqrt(x[0] * x[0] + x[1] * x[1])
        out_x, out_y = (x[0] / size, x[1] / size) if size > 0.0 else (1.0, 0.0)
        side, end, sign = size - obstacles[j, 1], abs(x[2]) - obstacles[j, 2], math.copysign(1.0, x[2])
        if side > 0.0 and end > 0.0:
            corner = math.sqrt(side * side + end * end)
            return corner, (out_x * side / corner, out_y * side / corner, sign * end / corner)
        if side > end:
            return side, (out_x, out_y, 0.0)
        return end, (0.0, 0.0, sign)
    a, b, c = abs(x[0]) - obstacles[j, 1], abs(x[1]) - obstacles[j, 2], abs(x[2]) - obstacles[j, 3]
    sign_a, sign_b, sign_c = math.copysign(1.0, x[0]), math.copysign(1.0, x[1]), math.copysign(1.0, x[2])
    if a > 0.0 or b > 0.0 or c > 0.0:
        out = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        size = math.sqrt(dot(out, out))
        return size, (sign_a * out[0] / size, sign_b * out[1] / size, sign_c * out[2] / size)
    if a >= b and a >= c:
        return a, (sign_a, 0.0, 0.0)
    if b >= c:
        return b, (0.0, sign_b, 0.0)
    return c, (0.0, 0.0, sign_c)


@kernel
def read_distances(obstacles, positions, time, out):
    """Signed distance out (obstacles, m) of positions (m, 3) at a time."""
    for j in range(obstacles.shape[0]):
        place = place_of(obstacles, j, time)
        for m in range(positions.shape[0]):
            out[j, m] = distance(obstacles, j, rotate_back(place.R, minus(triple(positions, m, 0), place.r)))[0]


@kernel(inline=True)
def pose_at(pose, node):
    """(R, r) of one node."""
    at = (node // LANES) * 12 * LANES + node % LANES
    R = (
        pose[at], pose[at + LANES], pose[at + 2 * LANES], pose[at + 3 * LANES], pose[at + 4 * LANES], pose[at + 5 * LANES],
        pose[at + 6 * LANES], pose[at + 7 * LANES], pose[at + 8 * LANES],
    )  # fmt: skip
    return R, (pose[at + 9 * LANES], pose[at + 10 * LANES], pose[at + 11 * LANES])


@kernel(inline=True)
def base_pose(base):
    """(R, r) of the base."""
    R = base[0], base[1], base[2], base[3], base[4], base[5], base[6], base[7], base[8]
    return R, (base[9], base[10], base[11])


@kernel(inline=True)
def ends_of(nodes, i):
    """Poses at both ends of an interval."""
    R_b, r_b = pose_at(nodes.pose, i)
    if i == 0:
        R_a, r_a = base_pose(nodes.base)
        return Ends(R_a, r_a, R_b, r_b)
    R_a, r_a = pose_at(nodes.pose, i - 1)
    return Ends(R_a, r_a, R_b, r_b)


@kernel(inline=True)
def tangent(R):
    """R e_x."""
    return R[0], R[3], R[6]


@kernel
def interval_balls(intervals, nodes, balls):
    """Balls (intervals, 4) around the samples of every interval with their radii: middle and radius [m]; how many intervals have any.

    No point of a curve through a and b is farther from their middle than half of its length, which is at most that of its Bezier polygon.
    """
    R_a, r_a = base_pose(nodes.base)
    for i in range(intervals.shape[0]):
        h = intervals[i, 0]
        if h == 0.0:
            return i
        R_b, r_b = pose_at(nodes.pose, i)
        inner = minus(minus(r_b, r_a), times(h / 3.0, plus(tangent(R_a), tangent(R_b))))
        for k in range(3):
            balls[i, k] = 0.5 * (r_a[k] + r_b[k])
        balls[i, 3] = h / 3.0 + 0.5 * math.sqrt(dot(inner, inner)) + intervals[i, 3]
        R_a, r_a = R_b, r_b
    return intervals.shape[0]


@kernel(inline=True)
def is_away(obstacles, j, place, balls, i):
    """Whether an obstacle touches nothing in a ball: told by that around the obstacle, or else by its signed distance."""
    x = minus(triple(balls, i, 0), place.r)
    reach = balls[i, 3] + obstacles[j, 32]
    return dot(x, x) >= reach * reach or distance(obstacles, j, rotate_back(place.R, x))[0] >= balls[i, 3]


@kernel(inline=True)
def sample_at(samples, m, ends):
    """Position of a sample's middle [m]."""
    a = plus(times(samples[m, 0], ends.r_a), times(samples[m, 1], tangent(ends.R_a)))
    return plus(a, plus(times(samples[m, 2], ends.r_b), times(samples[m, 3], tangent(ends.R_b))))


@kernel(inline=True)
def pressed(samples, m, depth):
    """p(d) of a sample, its derivative and its integral."""
    stiffness, smoothing = samples[m, 6], samples[m, 7]
    if depth < smoothing:
        slope = stiffness * depth / smoothing
        return 0.5 * slope * depth, slope, slope * depth * depth / 6.0
    beyond = depth - 0.5 * smoothing
    return stiffness * beyond, stiffness, 0.5 * stiffness * (beyond * beyond + smoothing * smoothing / 12.0)


@kernel(inline=True)
def walled(obstacles, j, samples, m, depth):
    """The same of the wall that stops what would go through: S x^3 / width, with x from 0 at FREE to 1 at WALL, deeper by half of the
    obstacle's thickness and by all of it. Without a stiffness of the ground's own, thickness counts up to the rod's radius."""
    thick = 0.5 * min(samples[m, 9], obstacles[j, 33])
    x, width = depth - FREE * samples[m, 5] - thick, (WALL - FREE) * samples[m, 5] + thick
    if not x > 0.0:  # nor is it for what is infinitely thick
        return 0.0, 0.0, 0.0
    x /= width
    energy = samples[m, 8] * x * x
    return energy * x / width, 3.0 * energy / (width * width), 0.25 * energy * x * x


@kernel(inline=True)
def damped(law, dissipation, approach):
    """The force p max(0, 1 + c d_dot) of a law, with its derivatives by depth and approach."""
    p, slope, _ = law
    factor = 1.0 + dissipation * approach
    return (p * factor, slope * factor, p * dissipation) if factor > 0.0 else (0.0, 0.0, 0.0)


@kernel(inline=True)
def motion_of(twist, R, node):
    """Angular and linear velocity of a node in the world frame."""
    at = (node // LANES) * 6 * LANES + node % LANES
    w = twist[at], twist[at + LANES], twist[at + 2 * LANES]
    return rotate(R, w), rotate(R, (twist[at + 3 * LANES], twist[at + 4 * LANES], twist[at + 5 * LANES]))


@kernel(inline=True)
def motion_before(nodes, ends, i):
    """The same of the node before an interval, or of the base."""
    if i > 0:
        return motion_of(nodes.twist, ends.R_a, i - 1)
    w = nodes.base[12], nodes.base[13], nodes.base[14]
    return w, plus((nodes.base[15], nodes.base[16], nodes.base[17]), cross(w, ends.r_a))


@kernel(inline=True)
def sample_motion(nodes, samples, m, ends, i):
    """Velocity of a sample's middle, and angular velocity, in the world frame."""
    w, v = motion_of(nodes.twist, ends.R_b, i)
    velocity = plus(times(samples[m, 2], v), times(samples[m, 3], cross(w, tangent(ends.R_b))))
    turning = times(samples[m, 4], w)
    w, v = motion_before(nodes, ends, i)
    velocity = plus(velocity, plus(times(samples[m, 0], v), times(samples[m, 1], cross(w, tangent(ends.R_a)))))
    turning = plus(turning, times(1.0 - samples[m, 4], w))
    return velocity, turning


@kernel(inline=True)
def touch_of(obstacles, j, place, samples, m, ends, nodes, i, x, depth, normal):
    """The contact of a sample at x that is so deep in an obstacle."""
    velocity, turning = sample_motion(nodes, samples, m, ends, i)
    surface = times(-samples[m, 5], normal)
    obstacle = plus(place.velocity, cross(place.angular_velocity, minus(plus(x, surface), place.centre)))
    relative = minus(plus(velocity, cross(turning, surface)), obstacle)
    approach = -dot(relative, normal)
    slip = plus(relative, times(approach, normal))
    own = damped(pressed(samples, m, depth), obstacles[j, 31], approach)
    wall = damped(walled(obstacles, j, samples, m, depth), max(obstacles[j, 31], WALL_DISSIPATION), approach)
    return Touch(own[0] + wall[0], own[1] + wall[1], own[2] + wall[2], normal, slip)


@kernel(inline=True)
def bristle_of(state, at, place, normal):
    """A bristle's displacement in the world frame, in the tangent plane."""
    s = rotate(place.R, (state[at], state[at + 1], state[at + 2]))
    return minus(s, times(dot(s, normal), normal))


@kernel(inline=True)
def shortened(x, most):
    """A vector no longer than this."""
    size = math.sqrt(dot(x, x))
    return times(most / size, x) if size > most else x


@kernel(inline=True)
def friction_of(touch, s, limit, stiffness):
    """Friction on a sample, and its stiffness and damping in the tangent plane: those of the bristle, or the secant of what slips."""
    g = times(stiffness, plus(shortened(s, limit / stiffness), times(BRISTLE_TIME, touch.slip)))
    size = math.sqrt(dot(g, g))
    if size <= limit:
        return times(-1.0, g), stiffness, BRISTLE_TIME * stiffness
    return times(-limit / size, g), 0.0, BRISTLE_TIME * stiffness * limit / size


@kernel(inline=True)
def add_wrench_at(nodes, node, lever, share, force):
    """The wrench of a force on the sample, in the node's frame."""
    at = (node // LANES) * 6 * LANES + node % LANES
    moment = cross(lever, force)
    for i in range(3):
        nodes.wrench[at + i * LANES] += moment[i]
        nodes.wrench[at + (3 + i) * LANES] += share * force[i]


@kernel(inline=True)
def add_block(field, node, lever, share, n, along, across):
    """B^T (along n n^T + across (I - n n^T)) B, B u = share u + theta x lever, added to the block of a node."""
    x, y, z = n
    more = along - across
    q_x = across + more * x * x, more * x * y, more * x * z
    q_y = q_x[1], across + more * y * y, more * y * z
    q_z = q_x[2], q_y[2], across + more * z * z
    a, b, c = cross(lever, q_x), cross(lever, q_y), cross(lever, q_z)  # columns of lever~ Q
    m_x, m_y, m_z = cross(lever, (a[0], b[0], c[0])), cross(lever, (a[1], b[1], c[1])), cross(lever, (a[2], b[2], c[2]))
    whole = share * share
    at = (node // LANES) * 21 * LANES + node % LANES
    field[at] += m_x[0]
    field[at + LANES] += m_y[0]
    field[at + 2 * LANES] += m_y[1]
    for i in range(3):
        field[at + (3 + i) * LANES] += m_z[i]
        field[at + (6 + i) * LANES] += share * a[i]
        field[at + (10 + i) * LANES] += share * b[i]
        field[at + (15 + i) * LANES] += share * c[i]
        field[at + (18 + i) * LANES] += whole * q_z[i]
    field[at + 9 * LANES] += whole * q_x[0]
    field[at + 13 * LANES] += whole * q_y[0]
    field[at + 14 * LANES] += whole * q_y[1]


@kernel(inline=True)
def add_to_node(nodes, node, R, share, reach, turn, radius, part, touch, force, stiffness, damping):
    """The wrench of a sample's force on one node, with the derivatives, each side of them as if the other stood still.

    A point of the surface moves by share dp + dtheta x lever in the node's frame. The blocks between both nodes of an interval are left
    out, so each gets 1 / part times its own, the parts of both adding up to one: no motion then meets less stiffness than there is.
    """
    n = rotate_back(R, touch.normal)
    lever = minus((reach, 0.0, 0.0), times(turn * radius, n))
    add_wrench_at(nodes, node, lever, share, rotate_back(R, force))
    add_block(nodes.stiffness, node, lever, share, n, touch.stiffness / part, stiffness / part)
    if touch.damping > 0.0 or damping > 0.0:
        add_block(nodes.damping, node, lever, share, n, touch.damping / part, damping / part)


@adds_wrench(ContactParameters)
@kernel(counted=True)
def contact_wrench(contact, nodes):
    """Wrenches of all contacts, with their stiffness and damping."""
    obstacles, samples, intervals = contact.obstacles, contact.samples, contact.intervals
    balls = np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    for j in range(obstacles.shape[0]):
        place = place_of(obstacles, j, nodes.time)
        for i in range(count):
            if is_away(obstacles, j, place, balls, i):
                continue
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                x = sample_at(samples, m, ends)
                away, out = distance(obstacles, j, rotate_back(place.R, minus(x, place.r)))
                depth = samples[m, 5] - away
                if depth <= 0.0:
                    continue
                touch = touch_of(obstacles, j, place, samples, m, ends, nodes, i, x, depth, rotate(place.R, out))
                force, stiffness, damping = times(touch.force, touch.normal), 0.0, 0.0
                if obstacles[j, 30] > 0.0 and nodes.state.size > 0:
                    s = bristle_of(nodes.state, 3 * (j * samples.shape[0] + m), place, touch.normal)
                    friction, stiffness, damping = friction_of(touch, s, obstacles[j, 30] * touch.force, TANGENTIAL * samples[m, 6])
                    force = plus(force, friction)
                if touch.stiffness > 0.0 or stiffness > 0.0:
                    nodes.touched[0] = 1.0
                t, radius = samples[m, 4], samples[m, 5]
                part = t if i > 0 else 1.0
                add_to_node(nodes, i, ends.R_b, samples[m, 2], samples[m, 3], t, radius, part, touch, force, stiffness, damping)
                if i > 0 and t < 1.0:
                    add_to_node(
                        nodes, i - 1, ends.R_a, samples[m, 0], samples[m, 1], 1.0 - t, radius, 1.0 - t, touch, force, stiffness, damping
                    )  # fmt: skip


@advances_state(ContactParameters)
@kernel(counted=True)
def contact_advance(contact, step, nodes, points):
    """Bristles follow the slip, up to the limit of friction; those of samples that touch nothing, and of an arm at rest, are slack."""
    obstacles, samples, intervals = contact.obstacles, contact.samples, contact.intervals
    if nodes.state.size == 0:
        return
    balls = np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    for j in range(obstacles.shape[0]):
        place = place_of(obstacles, j, nodes.time)
        for i in range(count):
            near = obstacles[j, 30] > 0.0 and math.isfinite(step) and not is_away(obstacles, j, place, balls, i)
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                at, s = 3 * (j * samples.shape[0] + m), (0.0, 0.0, 0.0)
                if near:
                    x = sample_at(samples, m, ends)
                    away, out = distance(obstacles, j, rotate_back(place.R, minus(x, place.r)))
                    depth = samples[m, 5] - away
                    if depth > 0.0:
                        touch = touch_of(obstacles, j, place, samples, m, ends, nodes, i, x, depth, rotate(place.R, out))
                        limit = obstacles[j, 30] * touch.force / (TANGENTIAL * samples[m, 6])
                        s = bristle_of(nodes.state, at, place, touch.normal)
                        s = rotate_back(place.R, shortened(plus(shortened(s, limit), times(step, touch.slip)), limit))
                nodes.state[at], nodes.state[at + 1], nodes.state[at + 2] = s


@kernel(counted=True)
def contact_energy(contact, nodes, energy):
    """Potential energy [J] of the normal forces without damping, added to energy (1,)."""
    obstacles, samples, intervals = contact.obstacles, contact.samples, contact.intervals
    balls = np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    for j in range(obstacles.shape[0]):
        place = place_of(obstacles, j, nodes.time)
        for i in range(count):
            if is_away(obstacles, j, place, balls, i):
                continue
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                away, _ = distance(obstacles, j, rotate_back(place.R, minus(sample_at(samples, m, ends), place.r)))
                if away < samples[m, 5]:
                    depth = samples[m, 5] - away
                    energy[0] += pressed(samples, m, depth)[2] + walled(obstacles, j, samples, m, depth)[2]


@limits_step(ContactParameters)
@kernel
def limit_step(contact, nodes, longest):
    """Steps are short beside the periods of obstacles that swing or turn."""
    obstacles = contact.obstacles
    for j in range(obstacles.shape[0]):
        w, amplitude = triple(obstacles, j, 19), triple(obstacles, j, 25)
        allow_turning(math.sqrt(dot(w, w)), longest)
        if dot(amplitude, amplitude) > 0.0:
            allow_turning(obstacles[j, 28], longest)


@kernel
def goes_through(obstacles, j, start, end, allowed):
    """Whether the distance from an obstacle falls below `allowed` [m] on the straight way between two points in its frame.

    Obstacles are convex, and so is the signed distance along a line: it lies above its tangents. Where they cross is the next place to
    look at.
    """
    way = minus(end, start)
    a, out = distance(obstacles, j, start)
    fall = dot(out, way)
    b, out = distance(obstacles, j, end)
    rise = dot(out, way)
    first, last = 0.0, 1.0
    for _ in range(CUTS):
        if min(a, b) < allowed:
            return True
        if fall >= 0.0 or rise <= 0.0:
            return False
        s = (b - a + fall * first - rise * last) / (fall - rise)
        if a + fall * (s - first) >= allowed:
            return False
        c, out = distance(obstacles, j, plus(start, times(s, way)))
        slope = dot(out, way)
        if slope < 0.0:
            first, a, fall = s, c, slope
        else:
            last, b, rise = s, c, slope
    return min(a, b) < allowed


@kernel
def speed_near(place, x, radius):
    """What no point of an obstacle in a ball about x exceeds in speed [m/s]."""
    v, w, lever = place.velocity, place.angular_velocity, minus(x, place.centre)
    return math.sqrt(dot(v, v)) + math.sqrt(dot(w, w)) * (math.sqrt(dot(lever, lever)) + radius)


@kernel
def speed_bound(nodes, intervals, i):
    """What no sample of an interval exceeds in speed [m/s]: the Hermite polynomials of tangents stay below 4/27."""
    ends = ends_of(nodes, i)
    w_b, v_b = motion_of(nodes.twist, ends.R_b, i)
    w_a, v_a = motion_before(nodes, ends, i)
    turning = math.sqrt(dot(w_a, w_a)) + math.sqrt(dot(w_b, w_b))
    return math.sqrt(max(dot(v_a, v_a), dot(v_b, v_b))) + 4.0 / 27.0 * intervals[i, 0] * turning


@kernel
def landing_energy(nodes, intervals, count):
    """Energy [J] that a sample may store where a step ends in what it comes upon: a share of the kinetic energy of the arm."""
    energy, mass, length = 0.0, 0.0, 0.0
    for i in range(count):
        R, _ = pose_at(nodes.pose, i)
        _, v = motion_of(nodes.twist, R, i)
        m = nodes.mass[i]
        energy, mass, length = energy + 0.5 * m * dot(v, v), mass + m, length + intervals[i, 0]
    idle = IDLE * length
    return LANDED * (energy + 0.5 * mass * idle * idle)


@kernel
def sweep_interval(contact, j, i, place_before, place, before, nodes, energy, longest, meeting):
    """The same for the samples of one interval and one obstacle, and an energy [J] that one may store."""
    obstacles, samples, intervals = contact.obstacles, contact.samples, contact.intervals
    ends, ends_before = ends_of(nodes, i), ends_of(before, i)
    for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
        radius, x = samples[m, 5], sample_at(samples, m, ends)
        start = rotate_back(place_before.R, minus(sample_at(samples, m, ends_before), place_before.r))
        end = rotate_back(place.R, minus(x, place.r))
        was = distance(obstacles, j, start)[0] - radius
        if goes_through(obstacles, j, start, end, min(was, 0.0) + (1.0 - THROUGH) * radius):
            meeting[0] = 1.0
            return
        away, out = distance(obstacles, j, end)
        gap, normal = away - radius, rotate(place.R, out)
        velocity, _ = sample_motion(nodes, samples, m, ends, i)
        surface = minus(x, times(away, normal))
        velocity = minus(velocity, plus(place.velocity, cross(place.angular_velocity, minus(surface, place.centre))))
        landing = min(samples[m, 7], (6.0 * samples[m, 7] * energy / samples[m, 6]) ** (1.0 / 3.0))
        approach, room = -dot(velocity, normal), (gap + landing if gap > 0.0 else OVERRUN * radius)
        if was > 0.0 and gap < -2.0 * landing and approach > 0.0:
            meeting[0] = 1.0
            return
        if gap < 0.0 or approach * longest[0] > room:
            meeting[1] = 1.0
            if approach * longest[0] > room:
                longest[0] = room / approach


@sweeps_motion(ContactParameters)
@kernel(counted=True)
def contact_sweep(contact, before, nodes, longest, meeting):
    """The next step ends where something is met; the last one was too long if a sample went through something on its way, or came to be
    so deep in it that it stores more than a share of the arm's energy. Samples go straight ahead, as seen by the obstacle."""
    obstacles, intervals = contact.obstacles, contact.intervals
    balls, balls_before = np.empty((intervals.shape[0], 4)), np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    interval_balls(intervals, before, balls_before)
    energy = landing_energy(nodes, intervals, count)
    for j in range(obstacles.shape[0]):
        place, place_before = place_of(obstacles, j, nodes.time), place_of(obstacles, j, before.time)
        for i in range(count):
            middle = rotate_back(place.R, minus(triple(balls, i, 0), place.r))
            way = minus(rotate_back(place_before.R, minus(triple(balls_before, i, 0), place_before.r)), middle)
            reach = max(balls[i, 3], balls_before[i, 3] + math.sqrt(dot(way, way)))
            speed = speed_bound(nodes, intervals, i) + speed_near(place, triple(balls, i, 0), balls[i, 3])
            if distance(obstacles, j, middle)[0] < max(reach, balls[i, 3] + speed * longest[0]):
                sweep_interval(contact, j, i, place_before, place, before, nodes, energy, longest, meeting)


@kernel(counted=True)
def read_contacts(contact, nodes, gap, position, force):
    """Of every sample its position (samples, 3) [m]; and for every obstacle its gap (obstacles, samples) [m] and its force
    (obstacles, samples, 3) [N] in the world frame."""
    obstacles, samples, intervals = contact.obstacles, contact.samples, contact.intervals
    for j in range(obstacles.shape[0]):
        place = place_of(obstacles, j, nodes.time)
        for i in range(intervals.shape[0]):
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                x = sample_at(samples, m, ends)
                away, out = distance(obstacles, j, rotate_back(place.R, minus(x, place.r)))
                gap[j, m] = away - samples[m, 5]
                total = 0.0, 0.0, 0.0
                if gap[j, m] < 0.0:
                    touch = touch_of(obstacles, j, place, samples, m, ends, nodes, i, x, -gap[j, m], rotate(place.R, out))
                    total = times(touch.force, touch.normal)
                    if obstacles[j, 30] > 0.0 and nodes.state.size > 0:
                        s = bristle_of(nodes.state, 3 * (j * samples.shape[0] + m), place, touch.normal)
                        total = plus(total, friction_of(touch, s, obstacles[j, 30] * touch.force, TANGENTIAL * samples[m, 6])[0])
                for k in range(3):
                    position[m, k], force[j, m, k] = x[k], total[k]


@kernel(counted=True)
def seen_nodes(pose, twist, base, state, time):
    """Nodes at poses and with twists in the kernels' layout, for what reads no more of them."""
    none = np.zeros(0)
    return Nodes(pose.size // (12 * LANES), time, state, none, none, pose, twist, base, none, none, none, none)


def nodes_at(pose: Array) -> Nodes:
    """Nodes at rest at poses, on a base at the origin, at time 0 and without internal states."""
    return seen_nodes(pose, np.zeros(pose.size // 2), np.concatenate([np.eye(3).ravel(), np.zeros(15)]), np.zeros(0), 0.0)


class ContactReading(NamedTuple):
    """Contact of every row of arms, by sections of the arm; vectors in the world frame."""

    force: np.ndarray  # (rows, sections, 3) [N] on the arm
    clearance: np.ndarray  # (rows, sections) [m] least between the surfaces of arm and obstacles, negative where they overlap
    load: np.ndarray  # (rows) [N] sum of the sizes of all contact forces


@kernel(counted=True)
def read_contact_rows(arm, rows, members, number, section, work, reading):
    """Contact of the rows named in `members` into `reading`; contact is the effect of that `number`, sample m lies in section[m]."""
    effects = arm.effects
    first, last = effects.first_value[number], effects.first_value[number + 1]
    begin, end = effects.first_state[number], effects.first_state[number + 1]
    for row in members:
        own = struct_at(arm, rows.arm, row)
        work.xi[:] = rows.xi[row]
        work.clock[0] = rows.clock[row, 0]
        strain_from_guess(own, rows.q[row], STEP_TOLERANCE, work)
        strain_rate(own, rows.q_dot[row], work)
        place_base(own, work)
        poses(own.rod, work)
        node_twists(own.rod, work)
        contact = parameters_at(ContactParameters, rows.effects[row][first:last])
        obstacles, samples = contact.obstacles.shape[0], contact.samples.shape[0]
        gap, position, force = np.empty((obstacles, samples)), np.empty((samples, 3)), np.empty((obstacles, samples, 3))
        nodes = seen_nodes(work.pose, work.eta, work.base, rows.state[row][begin:end], rows.clock[row, 0])
        read_contacts(contact, nodes, gap, position, force)
        reading.force[row] = 0.0
        reading.clearance[row] = math.inf
        reading.load[row] = 0.0
        for j in range(obstacles):
            for m in range(samples):
                part = section[m]
                reading.clearance[row, part] = min(reading.clearance[row, part], gap[j, m])
                x, y, z = triple(force[j], m, 0)
                reading.force[row, part, 0] += x
                reading.force[row, part, 1] += y
                reading.force[row, part, 2] += z
                reading.load[row] += math.sqrt(x * x + y * y + z * z)


def number_of_contact(effects: EffectTable) -> int | None:
    """Which of an arm's effects is contact; None: none is."""
    kinds = kinds_of(effects)
    return kinds.index(ContactParameters) if ContactParameters in kinds else None


def parameters_of(effects: EffectTable, number: int) -> ContactParameters:
    """The parameters of an arm's contact, which is the effect of that `number`."""
    own: ContactParameters = parameters_at(ContactParameters, effects.values[effects.first_value[number] : effects.first_value[number + 1]])
    return own


class ContactForces(NamedTuple):
    """Contact of an arm with its obstacles, in their order; vectors in the world frame, forces on the arm."""

    force: Array  # (obstacles, 3) [N]
    clearance: Array  # (obstacles,) [m] between surfaces, least along the arm; negative: the deepest penetration
    arc_length: Array  # (samples,) [m] of the samples along the arm
    position: Array  # (samples, 3) [m]
    sample_force: Array  # (obstacles, samples, 3) [N] on each sample
    gap: Array  # (obstacles, samples) [m] between the surfaces of sample and obstacle, negative where they overlap

    @property
    def penetration(self) -> Array:
        """Deepest penetration of each obstacle (obstacles,) [m], 0 without contact."""
        return np.maximum(-self.clearance, 0.0)


class HasContact(Protocol):
    """A model of a scene, see soft_tendon_env.Model."""

    @property
    def scene(self) -> Any: ...
    @property
    def arm(self) -> Any: ...
    @property
    def grid(self) -> Any: ...
    @property
    def discretisation(self) -> Discretisation: ...
    def check_names(self, names: tuple[str, ...]) -> None: ...


class Moving(Protocol):
    """A state of a simulation, see soft_tendon_env.State."""

    @property
    def time(self) -> float: ...
    @property
    def q(self) -> Array: ...
    @property
    def q_dot(self) -> Array: ...
    @property
    def strain(self) -> Array: ...
    @property
    def effects(self) -> Array: ...
    @property
    def names(self) -> tuple[str, ...]: ...


def contact_forces(model: HasContact, state: Moving) -> ContactForces:
    """Contact forces, clearance and penetration of an arm in a state: per obstacle and along the arm.

    The obstacles are those of the model's arm. Raises ValueError where it has no contact, or the state is of other effects.
    """
    work, arm = make_workspace(model.arm), model.arm
    number = number_of_contact(arm.effects)
    if number is None:
        raise ValueError("the model's scene has no table effects.contact")
    contact: Contact = model.scene.effects.contact
    parameters = parameters_of(arm.effects, number)
    if state.names:
        model.check_names(state.names)
    work.xi[:] = model.grid.packed(state.strain)
    work.state[:] = state.effects
    work.clock[0] = state.time
    evaluate_forces(arm, np.zeros(arm.tendons.size), state.q, state.q_dot, 1e-12, work)
    own = work.state[arm.effects.first_state[number] : arm.effects.first_state[number + 1]]
    obstacles, samples = len(parameters.obstacles), len(parameters.samples)
    gap, position, force = np.empty((obstacles, samples)), np.empty((samples, 3)), np.empty((obstacles, samples, 3))
    read_contacts(parameters, seen_nodes(work.pose, work.eta, work.base, own, state.time), gap, position, force)
    return ContactForces(force.sum(axis=1), gap.min(axis=1), contact.sample_places(model.discretisation), position, force, gap)
