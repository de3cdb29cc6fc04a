"""Contact of the arm with obstacles: configuration, forces, and the collision check.

Forces act between samples of the arm and obstacles.

By virtual work a force f on a sample is the force H00 f and the moment H10 h R_a e_x x f on the
node before it, and likewise on the one behind; where the section is flat, with the lever arm of its
nearest point too (outline.py). With d = radius - signed distance of a sample's
middle, k = stiffness ds and a smoothing depth e, N = p(d) max(0, 1 + c d_dot), p = k d^2 / 2 e up
to d = e, k (d - e / 2) beyond: Hunt and Crossley (1975), here of a force that begins smoothly.

Friction opposes the slip velocity v of the surfaces with mu N |v| / sqrt(|v|^2 + v_s^2), v_s =
STICTION_SPEED: what it holds creeps, with a share s of mu N at v_s s / sqrt(1 - s^2). The implicit
step gets the secant mu N / sqrt(|v|^2 + v_s^2) as damping.

Steps end where a contact begins; those that went through something, or too deep into it, are tried
again at half of their length.
"""

import math
from typing import ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Configured, Discretisation, Effect
from soft_tendon_env.effects.contact.obstacles import (
    AMPLITUDE,
    OMEGA,
    AnyObstacle,
    body_at,
    distance,
    in_frame_of,
    place_in,
    read_distances,
)
from soft_tendon_env.effects.contact.outline import ROUND, nearest
from soft_tendon_env.effects.contact.samples import (
    axes_of,
    ends_of,
    make_samples,
    motion_at,
    motion_of,
    nodes_with,
    pose_of,
    position_of,
    sample_at,
)
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import (
    columns_of,
    cross,
    dot,
    minus,
    plus,
    rotate_back,
    times,
)
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import YES, adds_wrench, allow_turning, limits_step
from soft_tendon_env.mechanics.terms.kinematics import matrix_pose, triple
from soft_tendon_env.mechanics.terms.transposed_kinematics import add_at, index_of_node
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.registry import register
from soft_tendon_env.tools.types import Array, NotNegative, Triple

STICTION_SPEED = 1e-4  # [m/s] of slip, below which friction falls: what it holds creeps
# depths in radii of the rod between which the wall stops what would go through: a wire between
# samples is 0.5 deep
FREE = 0.2
WALL = 0.45
# [s/m] the least c of the wall: what begins within an obstacle leaves it at 1 m/s at most
WALL_DISSIPATION = 1.0
OVERRUN = 0.1  # of the radius: how much deeper a step in contact may lead
THROUGH = 0.15  # of the radius: from where on a step is tried again shorter
# share of the arm's kinetic energy that a sample is to store where a step ends in what it comes
# upon
LANDED = 0.01
MOST_LANDED = 8.0  # such shares that all samples may store
# [1/s] lengths per second, the speed of the arm that counts besides: at rest steps need not end
# where a contact begins
IDLE = 0.05
CUTS = 64  # places at which the way of a sample is looked at, at most
SAME = 1e-3  # of the way, what counts as none
MOST_HERMITE = 4.0 / 27.0  # the largest value of the Hermite polynomials of tangents
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@register("effect", "contact")
class Contact(Effect):
    """`[effects.contact]`: contact of the whole arm with obstacles, fixed or moving.

    They are the tables `[[effects.contact.obstacles]]`, and the arm cannot enter them.

    Obstacles are tables with a `type`, see the classes of obstacles.py. An impact at a speed v
    returns it times about 1 - 2/3 c v where c v is small, with c the `dissipation`.
    """

    is_contact: ClassVar[bool] = True

    obstacles: tuple[AnyObstacle, ...] = Field(min_length=1, description="what the arm may touch")
    friction: NotNegative = Field(0.0, description="coefficient of friction mu [-]")
    dissipation: NotNegative = Field(1.0, description="damping c [s/m] of the normal force")

    def parameters(self, rod: Discretisation) -> "ContactParameters":
        intervals, samples, _ = make_samples(rod)
        return ContactParameters(intervals, samples, self.rows())

    def rows(self) -> Array:
        """Rows of `ContactParameters.obstacles`."""
        return np.array(
            [obstacle.row(self.friction, self.dissipation) for obstacle in self.obstacles]
        )

    def sample_places(self, rod: Discretisation) -> Array:
        """Arc lengths (samples,) [m] at which contact is looked for."""
        _, _, places = make_samples(rod)
        return places

    def potential_energy(self, arm: Configured) -> float:
        """That of the normal forces: friction stores none."""
        if any(obstacle.moves for obstacle in self.obstacles):
            raise ValueError("contact with obstacles that move has no potential energy")
        rotations = arm.pose[:, :3, :3].reshape(-1, 9)
        positions = arm.pose[:, :3, 3]
        pose_rows = np.concatenate([rotations, positions], axis=1)
        pose = node_field(pose_rows)
        # a twist has 6 numbers where a pose has 12
        twists_at_rest = np.zeros(pose.size // 2)
        base_at_rest = np.zeros(12)
        base = np.append(arm.base, base_at_rest)
        nodes = nodes_with(pose, twists_at_rest, base, 0.0)
        parameters = self.parameters(arm.rod)
        # what is read besides the energy
        count = len(parameters.samples)
        obstacle_count = len(self.obstacles)
        gap = np.empty((obstacle_count, count))
        position = np.empty((count, 3))
        force = np.empty((obstacle_count, count, 3))
        energy = read_contacts(parameters, nodes, gap, position, force)
        return float(energy)

    def gaps(self, rod: Discretisation, poses: Array, time: float = 0.0) -> Array:
        """Gaps (obstacles, samples) [m] between the surfaces of obstacles and of samples.

        They are negative where the surfaces overlap.

        Args:
            rod: The discretised rod.
            poses: Poses (samples, 4, 4) of the samples.
            time: Time [s], at which obstacles that move are looked at.
        """
        parameters = self.parameters(rod)
        out = np.empty((len(self.obstacles), len(poses)))
        read_gaps(parameters, np.ascontiguousarray(poses), time, out)
        return out

    def distances(self, positions: Array, time: float = 0.0) -> Array:
        """Signed distances (obstacles, m) [m] from the obstacles' surfaces, negative inside.

        They are those of positions (m, 3) [m] at a time [s].
        """
        out = np.empty((len(self.obstacles), len(positions)))
        nearest = np.empty((*out.shape, 3))
        read_distances(self.rows(), positions, time, out, nearest)
        return out


class ContactParameters(Struct):
    """Numbers of samples and obstacles, as kernels read them.

    Intervals are in order from base to tip, the empty ones at the end without samples.
    """

    # (nodes, 4): length h [m], first sample, one past the last, largest radius [m]
    intervals: Array
    samples: Array  # (samples, 9): see Sample
    obstacles: Array  # (obstacles, 28): see Obstacle.row


class Touch(NamedTuple):
    """Contact of a sample with an obstacle; vectors in the world frame."""

    position: Triple  # [m] of the sample's middle
    gap: float  # [m] between the surfaces, negative where they overlap
    normal: Triple  # out of the obstacle
    force: Triple  # [N] on the sample
    stiffness: float  # [N/m] along the normal
    damping: float  # [N s/m] along the normal
    drag: float  # [N s/m] of friction, across the normal
    energy: float  # [J] that the normal force has stored
    place: Triple  # [m] of the point about which the surface is a ball, in the section's frame
    ball: float  # [m] radius of that
    moves: tuple[float, float]  # [m/rad] by which that point moves where the section turns


@kernel(inline=True)
def size(x):
    """Euclidean norm."""
    return math.sqrt(dot(x, x))


@kernel(inline=True)
def reach_of(intervals, ends):
    """Distance [m] from its end that no point of an interval's samples exceeds.

    The polygon of the curve's Bezier points holds it.
    """
    chord = size(minus(ends.r_b, ends.r_a))
    length = intervals[ends.interval, 0]
    radius = intervals[ends.interval, 3]
    return chord + length / 3.0 + radius


@kernel(inline=True)
def normal_law(body, sample, depth, approach):
    """Force [N] of a sample along the normal, its derivatives, and the energy [J] stored.

    The derivatives are by depth and approach. The force is the penalty, and a wall S x^3 / width
    that stops what would go through, each damped; x is 0 at FREE and 1 at WALL, less deep in what
    is thin.
    """
    k = sample.stiffness
    e = sample.smoothing
    # penalty p = k d^2 / 2 e up to d = e, k (d - e / 2) beyond, and its energy
    smooth = min(depth, e)
    linear = depth - smooth
    squared = smooth * smooth
    penalty = k * (0.5 * squared / e + linear)
    energy_of_smooth = squared * smooth / (6.0 * e)
    energy_of_linear = 0.5 * depth * linear
    penalty_energy = k * (energy_of_smooth + energy_of_linear)
    # wall S x^3 / width, with energy S x^4 / 4
    thick = 0.5 * min(sample.radius, body.thickness)
    free = FREE * sample.radius
    width = (WALL - FREE) * sample.radius + thick
    x = max(depth - free - thick, 0.0) / width
    scale = sample.wall * x * x
    wall = scale * x / width
    energy = penalty_energy + 0.25 * scale * x * x
    # each times max(0, 1 + c d_dot)
    c = body.dissipation
    c_wall = max(c, WALL_DISSIPATION)
    factor = max(1.0 + c * approach, 0.0)
    stop = max(1.0 + c_wall * approach, 0.0)
    force = penalty * factor + wall * stop
    # derivatives by d and by d_dot
    penalty_stiffness = k * smooth / e
    wall_stiffness = 3.0 * scale / (width * width)
    stiffness = penalty_stiffness * factor + wall_stiffness * stop
    penalty_damping = c * penalty if factor > 0.0 else 0.0
    wall_damping = c_wall * wall if stop > 0.0 else 0.0
    return force, stiffness, penalty_damping + wall_damping, energy


@kernel(inline=True)
def touch_of(body, sample, ends, nodes):
    """Contact of a sample between two nodes with an obstacle.

    It has no forces where they do not touch.
    """
    position = position_of(sample, ends)
    y_axis, z_axis = axes_of(sample, ends)
    point = nearest(body, sample, position, y_axis, z_axis)
    normal = point.normal
    ball = ball_of(sample)
    # relative velocity of the surfaces, along the normal and across
    velocity, turning = motion_at(sample, ends, nodes)
    lever = plus(point.offset, times(-ball, normal))
    surface = plus(velocity, cross(turning, lever))
    relative = minus(surface, body.velocity)
    approach = -dot(relative, normal)
    slip = plus(relative, times(approach, normal))
    # pressure and friction
    depth = max(-point.gap, 0.0)
    pressure, stiffness, damping, energy = normal_law(body, sample, depth, approach)
    squared_speed = dot(slip, slip) + STICTION_SPEED * STICTION_SPEED
    speed = math.sqrt(squared_speed)
    drag = body.friction * pressure / speed
    force = minus(times(pressure, normal), times(drag, slip))
    return Touch(
        position,
        point.gap,
        normal,
        force,
        stiffness,
        damping,
        drag,
        energy,
        point.place,
        ball,
        point.moves,
    )


@kernel(inline=True)
def ball_of(sample):
    """Radius [m] of the ball about a sample's nearest point: a flat section has none."""
    return sample.radius if sample.shape == ROUND else 0.0


@kernel(inline=True)
def add_along(field, node, lever, share, n, k):
    """Adds k w w^T, w = (lever x n, share n), to the block of a node.

    It is that of what resists motion along n.
    """
    w = cross(lever, n) + times(share, n)
    add_square(field, node, w, k)


@kernel(inline=True)
def add_square(field, node, w, k):
    """Adds k w w^T to the block of a node, of a twist w (6 numbers) or of a rotation (3)."""
    begin = (node // LANES) * 21 * LANES + node % LANES
    for i in range(len(w)):
        for j in range(i + 1):
            entry = i * (i + 1) // 2 + j
            field[begin + entry * LANES] += k * w[i] * w[j]


@kernel(inline=True)
def add_to_node(nodes, node, R, weights, touch):
    """Adds the wrench of a sample's force on one node, with its derivatives.

    They are as if the other node of the interval stood still.

    weights: share, reach [m], turn and part: the sample's surface moves by share dp + dtheta x
    (reach e_x + turn (p - ball n)) in the node's frame, with the place p of the nearest point.
    Each node gets 1 / part times its block, with parts that add up to 1: no motion then meets less
    stiffness than there is.
    """
    share, reach, turn, part = weights
    n = rotate_back(R, touch.normal)
    force = rotate_back(R, touch.force)
    middle = plus((reach, 0.0, 0.0), times(turn, touch.place))
    lever = minus(middle, times(turn * touch.ball, n))
    wrench = (cross(lever, force), times(share, force))
    add_at(nodes.wrench, index_of_node(node), wrench)
    add_along(nodes.stiffness, node, lever, share, n, touch.stiffness / part)
    # a flat section that turns brings its nearest point, and with it the force, to another place
    pressure = dot(touch.force, touch.normal)
    for i in range(2):
        move = touch.moves[i]
        if move > 0.0 and pressure > 0.0:
            turned = times(turn, cross(AXES[1 + i], n))
            add_square(nodes.stiffness, node, turned, pressure * move / part)
    # friction resists motion along all axes, and so the normal one is counted less it
    along_normal = touch.damping - touch.drag
    add_along(nodes.damping, node, lever, share, n, along_normal / part)
    if touch.drag > 0.0:
        for axis in AXES:
            add_along(nodes.damping, node, lever, share, axis, touch.drag / part)


@adds_wrench(ContactParameters)
@kernel
def contact_wrench(contact, nodes):
    """Wrenches of all contacts, with their stiffness and damping."""
    intervals = contact.intervals
    for j in range(contact.obstacles.shape[0]):
        body = body_at(contact.obstacles, j, nodes.time)
        for i in range(intervals.shape[0]):
            ends = ends_of(nodes, i)
            _, away, _ = place_in(body, ends.r_b)
            if away < reach_of(intervals, ends):
                for m in samples_of(intervals, i):
                    sample = sample_at(contact, m)
                    touch = touch_of(body, sample, ends, nodes)
                    if touch.gap < 0.0:
                        nodes.contact.touched[0] = YES
                        add_to_nodes(nodes, sample, ends, touch)


@kernel(inline=True)
def samples_of(intervals, i):
    """Range of the samples of an interval."""
    return range(int(intervals[i, 1]), int(intervals[i, 2]))


@kernel(inline=True)
def add_to_nodes(nodes, sample, ends, touch):
    """Adds the wrenches of a sample's force on both nodes of its interval.

    The base takes what it gets.
    """
    i = ends.interval
    t = sample.t
    part = t if i > 0 else 1.0  # of the blocks
    add_to_node(nodes, i, ends.R_b, (sample.h_b, sample.reach_b, t, part), touch)
    if i > 0 and t < 1.0:
        rest = 1.0 - t
        weights = (sample.h_a, sample.reach_a, rest, rest)
        add_to_node(nodes, i - 1, ends.R_a, weights, touch)


@kernel
def read_contacts(contact, nodes, gap, position, force):
    """Writes the positions of samples, their gaps and their forces; returns an energy [J].

    Positions are (samples, 3) [m], gaps (obstacles, samples) [m], and forces (obstacles, samples,
    3) [N] in the world frame. The energy is the potential energy of the normal forces.
    """
    energy = 0.0
    for j in range(gap.shape[0]):
        body = body_at(contact.obstacles, j, nodes.time)
        for i in range(contact.intervals.shape[0]):
            ends = ends_of(nodes, i)
            for m in samples_of(contact.intervals, i):
                sample = sample_at(contact, m)
                touch = touch_of(body, sample, ends, nodes)
                energy += touch.energy
                gap[j, m] = touch.gap
                for k in range(3):
                    position[m, k] = touch.position[k]
                    force[j, m, k] = touch.force[k]
    return energy


@kernel
def read_gaps(contact, poses, time, out):
    """Gaps out (obstacles, samples) [m] of samples at poses (samples, 4, 4) at a time [s]."""
    for j in range(out.shape[0]):
        body = body_at(contact.obstacles, j, time)
        for m in range(out.shape[1]):
            sample = sample_at(contact, m)
            R, r = matrix_pose(poses, m)
            _, y_axis, z_axis = columns_of(R)
            point = nearest(body, sample, r, y_axis, z_axis)
            out[j, m] = point.gap


@limits_step(ContactParameters)
@kernel
def limit_contact(contact, nodes, longest):
    """Limits steps so that they end where something is met.

    They are short beside the periods of obstacles that swing. The last one was too long if a sample
    went through something, or if all that met something came to store more than a share of the
    arm's energy.
    """
    intervals = contact.intervals
    obstacles = contact.obstacles
    fastest = 0.0
    for j in range(obstacles.shape[0]):
        velocity = body_at(obstacles, j, nodes.time).velocity
        fastest = max(fastest, size(velocity))
        amplitude = triple(obstacles, j, AMPLITUDE)
        if size(amplitude) > 0.0:
            allow_turning(obstacles[j, OMEGA], longest)
    energy = landing_energy(nodes, intervals, fastest)
    landed = 0.0
    time_before = nodes.before_step.time[0]
    for j in range(obstacles.shape[0]):
        body_before = body_at(obstacles, j, time_before)
        body = body_at(obstacles, j, nodes.time)
        bodies = (body_before, body)
        for i in range(intervals.shape[0]):
            ends = (ends_of(nodes.before_step, i), ends_of(nodes, i))
            if not is_far(bodies, ends, intervals, nodes, longest):
                for m in samples_of(intervals, i):
                    sample = sample_at(contact, m)
                    landed += check_sample(sample, bodies, ends, nodes, energy, longest)
    if landed > MOST_LANDED * energy:
        nodes.contact.tunnelled[0] = YES


@kernel
def landing_energy(nodes, intervals, fastest):
    """Energy [J] that a sample may store where a step ends in what it comes upon.

    Obstacles move at most at a speed [m/s].
    """
    kinetic = 0.0
    mass = 0.0
    length = 0.0
    for i in range(intervals.shape[0]):
        R, r = pose_of(nodes, i)
        _, v = motion_of(nodes, i, R, r)
        node_mass = nodes.mass[i]
        kinetic += 0.5 * node_mass * dot(v, v)
        mass += node_mass
        length += intervals[i, 0]
    # the arm counts as moving at least so fast
    speed = max(IDLE * length, fastest)
    counted = 0.5 * mass * speed**2
    return LANDED * (kinetic + counted)


@kernel(inline=True)
def is_far(bodies, ends, intervals, nodes, longest):
    """Tells whether no sample of an interval meets an obstacle, in the last step or the next.

    The Hermite polynomials of tangents stay below 4/27, and the signed distance changes no faster
    than a point moves. Bodies and ends: before the step and now.
    """
    body_before, body = bodies
    before, now = ends
    # the most by which a sample moves in the next step, as seen by the obstacle
    w_a, v_a = motion_of(nodes, now.interval - 1, now.R_a, now.r_a)
    w_b, v_b = motion_of(nodes, now.interval, now.R_b, now.r_b)
    length = intervals[now.interval, 0]
    rates = size(w_b) + size(w_a)
    turning = MOST_HERMITE * length * rates
    fastest_end = max(size(v_b), size(v_a))
    speed = fastest_end + turning + size(body.velocity)
    ahead = reach_of(intervals, now) + speed * longest[0]
    # and that by which the interval's end has moved in the last one
    place, away, _ = place_in(body, now.r_b)
    place_before = in_frame_of(body_before, before.r_b)
    moved = size(minus(place_before, place))
    behind = reach_of(intervals, before) + moved
    return away >= max(behind, ahead)


@kernel(inline=True)
def check_sample(sample, bodies, ends, nodes, energy, longest):
    """Checks a sample and an obstacle for `limit_contact`; returns an energy [J].

    The sample moves straight ahead as seen by the obstacle; bodies and ends: before the step and
    now. The energy is what it has come to store in the step, if it met the obstacle there.
    """
    body_before, body = bodies
    before, now = ends
    flags = nodes.contact
    axis_before = position_of(sample, before)
    axis = position_of(sample, now)
    y_before, z_before = axes_of(sample, before)
    y_axis, z_axis = axes_of(sample, now)
    point_before = nearest(body_before, sample, axis_before, y_before, z_before)
    point = nearest(body, sample, axis, y_axis, z_axis)
    gap = point.gap
    start = in_frame_of(body_before, axis_before)
    end, away, _ = place_in(body, axis)
    velocity, turning = motion_at(sample, now, nodes)
    surface = plus(velocity, cross(turning, point.offset))
    relative = minus(surface, body.velocity)
    approach = -dot(relative, point.normal)
    # in the last step: the axis comes no nearer than the surface may be deep
    thickness = away - gap
    deep = THROUGH * sample.radius
    allowed = min(point_before.gap, 0.0) + thickness - deep
    if away < allowed or goes_through(body, start, end, allowed):
        flags.tunnelled[0] = YES
    # in the next one: up to where the energy k d^3 / 6 e is stored
    smoothing = sample.smoothing
    cubed = 6.0 * smoothing * energy / sample.stiffness
    landing = min(smoothing, cubed ** (1.0 / 3.0))
    room = gap + landing if gap > 0.0 else OVERRUN * sample.radius
    is_met = approach * longest[0] > room
    if gap < 0.0 or is_met:
        flags.active[0] = YES
    if is_met:
        longest[0] = room / approach
    has_landed = point_before.gap > 0.0 and gap < 0.0 and approach > 0.0
    if not has_landed:
        return 0.0
    _, _, _, stored = normal_law(body, sample, -gap, 0.0)
    return stored


@kernel
def goes_through(body, start, end, allowed):
    """Tells whether the distance from a body falls below `allowed` [m] on the straight way.

    The way lies between two points in its frame, the latter of which is not looked at; the distance
    falls no faster than the way goes on.
    """
    way = minus(end, start)
    length = size(way)
    s = 0.0  # share of the way
    for _ in range(CUTS):
        point = plus(start, times(s, way))
        away, _ = distance(body, point)
        room = away - allowed
        if room > length * (1.0 - s):
            return False
        if room < SAME * length:
            return True
        s += room / length
    return True
