"""Contact of the arm with obstacles: its configuration, forces between samples of the arm and
obstacles, and the collision check.

By virtual work a force f on a sample is the force H00 f and the moment H10 h R_a e_x x f on the
node before it, and likewise on the one behind. With d = radius - signed distance of a sample's
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
from soft_tendon_env.effects.base import Configured, Discretisation, Effect, register_effect
from soft_tendon_env.effects.contact.obstacles import (
    AnyObstacle,
    body_at,
    distance,
    place_in,
    read_distances,
    triple,
)
from soft_tendon_env.effects.contact.samples import (
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
    cross,
    dot,
    minus,
    plus,
    rotate,
    rotate_back,
    times,
)
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import YES, adds_wrench, allow_turning, limits_step
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.types import Array, NotNegative, Triple

STICTION_SPEED = 1e-4  # [m/s] of slip, below which friction falls: what it holds creeps
FREE, WALL = (
    0.2,
    0.45,
    # depths in radii of the rod between which the wall stops what would go through: a wire between
    # samples is 0.5 deep
)
WALL_DISSIPATION = (
    1.0  # [s/m] the least c of the wall: what begins within an obstacle leaves it at 1 m/s at most
)
OVERRUN, THROUGH = (
    0.1,
    0.15,
    # of the radius: how much deeper a step in contact may lead, and from where on it is tried again
    # shorter
)
LANDED, MOST_LANDED, IDLE = 0.01, 8.0, 0.05
"""Share of the arm's kinetic energy that a sample is to store where a step ends in what it comes
upon; how many such shares all may store; and the speed of the arm, in its lengths per second, that
counts besides: at rest steps need not end where a contact begins."""
CUTS, SAME = (
    64,
    1e-3,
    # places at which the way of a sample is looked at, at most; and the share of the way that
    # counts as none
)
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@register_effect("contact")
class Contact(Effect):
    """`[effects.contact]` with `[[effects.contact.obstacles]]`: obstacles, fixed or moving, which
    the whole arm cannot enter.

    Obstacles are tables with a `type`, see the classes of obstacles.py. An impact at a speed v
    returns it times about 1 - 2/3 c v where c v is small, with c the `dissipation`.
    """

    is_contact: ClassVar[bool] = True

    obstacles: tuple[AnyObstacle, ...] = Field(min_length=1, description="what the arm may touch")
    friction: NotNegative = Field(0.0, description="coefficient of friction mu [-]")
    dissipation: NotNegative = Field(1.0, description="damping c [s/m] of the normal force")

    def parameters(self, rod: Discretisation) -> "ContactParameters":
        return ContactParameters(*make_samples(rod)[:2], self.rows())

    def rows(self) -> Array:
        """Rows of `ContactParameters.obstacles`."""
        return np.array(
            [obstacle.row(self.friction, self.dissipation) for obstacle in self.obstacles]
        )

    def sample_places(self, rod: Discretisation) -> Array:
        """Arc lengths (samples,) [m] at which contact is looked for."""
        return make_samples(rod)[2]

    def potential_energy(self, arm: Configured) -> float:
        """That of the normal forces: friction stores none."""
        if any(obstacle.moves for obstacle in self.obstacles):
            raise ValueError("contact with obstacles that move has no potential energy")
        pose = node_field(
            np.concatenate([arm.pose[:, :3, :3].reshape(-1, 9), arm.pose[:, :3, 3]], axis=1)
        )
        base, parameters = np.append(arm.base, np.zeros(12)), self.parameters(arm.rod)
        nodes, gap = (
            nodes_with(pose, np.zeros(pose.size // 2), base, 0.0),
            np.empty((len(self.obstacles), len(parameters.samples))),
        )
        return float(
            read_contacts(
                parameters, nodes, gap, np.empty((gap.shape[1], 3)), np.empty((*gap.shape, 3))
            )
        )

    def distances(self, positions: Array, time: float = 0.0) -> Array:
        """Signed distances (obstacles, m) [m] from the obstacles' surfaces to positions (m, 3) [m]
        at a time [s], negative inside."""
        out = np.empty((len(self.obstacles), len(positions)))
        read_distances(self.rows(), positions, time, out, np.empty((*out.shape, 3)))
        return out


class ContactParameters(Struct):
    """The numbers of samples and obstacles; intervals in order from base to tip, the empty ones at
    the end without samples."""

    intervals: (
        Array  # (nodes, 4): length h [m], first sample, one past the last, largest radius [m]
    )
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


@kernel(inline=True)
def size(x):
    """Euclidean norm."""
    return math.sqrt(dot(x, x))


@kernel(inline=True)
def reach_of(intervals, ends):
    """No point of an interval's samples is farther [m] from its end: the polygon of the curve's
    Bezier points holds it."""
    return (
        size(minus(ends.r_b, ends.r_a))
        + intervals[ends.interval, 0] / 3.0
        + intervals[ends.interval, 3]
    )


@kernel(inline=True)
def normal_law(body, sample, depth, approach):
    """Force [N] of a sample along the normal, its derivatives by depth and approach, and the energy
    [J] stored: the penalty, and a wall S x^3 / width that stops what would go through, each damped;
    x is 0 at FREE and 1 at WALL, less deep in what is thin."""
    k, e, smooth, c = (
        sample.stiffness,
        sample.smoothing,
        min(depth, sample.smoothing),
        body.dissipation,
    )
    thick = 0.5 * min(sample.radius, body.thickness)
    width, linear = (WALL - FREE) * sample.radius + thick, depth - smooth
    x = max(depth - FREE * sample.radius - thick, 0.0) / width
    scale, c_wall = sample.wall * x * x, max(c, WALL_DISSIPATION)
    penalty, wall = k * (0.5 * smooth * smooth / e + linear), scale * x / width
    energy = (
        k * (smooth * smooth * smooth / (6.0 * e) + 0.5 * depth * linear) + 0.25 * scale * x * x
    )
    factor, stop = max(1.0 + c * approach, 0.0), max(1.0 + c_wall * approach, 0.0)
    stiffness = k * smooth / e * factor + 3.0 * scale / (width * width) * stop
    damping = (c * penalty if factor > 0.0 else 0.0) + (c_wall * wall if stop > 0.0 else 0.0)
    return penalty * factor + wall * stop, stiffness, damping, energy


@kernel(inline=True)
def touch_of(body, sample, ends, nodes):
    """The contact of a sample between two nodes with an obstacle, without forces where they do not
    touch."""
    x = position_of(sample, ends)
    _, away, out = place_in(body, x)
    gap, normal = away - sample.radius, rotate(body.R, out)
    velocity, turning = motion_at(sample, ends, nodes)
    slip = minus(plus(velocity, cross(turning, times(-sample.radius, normal))), body.velocity)
    approach = -dot(slip, normal)
    slip = plus(slip, times(approach, normal))
    pressure, stiffness, damping, energy = normal_law(body, sample, max(-gap, 0.0), approach)
    drag = body.friction * pressure / math.sqrt(dot(slip, slip) + STICTION_SPEED * STICTION_SPEED)
    return Touch(
        x,
        gap,
        normal,
        minus(times(pressure, normal), times(drag, slip)),
        stiffness,
        damping,
        drag,
        energy,
    )


@kernel(inline=True)
def add_along(field, node, lever, share, n, k):
    """k w w^T, w = (lever x n, share n), added to the block of a node: of what resists motion along
    n."""
    moment, begin = cross(lever, n), (node // LANES) * 21 * LANES + node % LANES
    w = moment[0], moment[1], moment[2], share * n[0], share * n[1], share * n[2]
    for i in range(6):
        for j in range(i + 1):
            field[begin + (i * (i + 1) // 2 + j) * LANES] += k * w[i] * w[j]


@kernel(inline=True)
def add_to_node(nodes, node, R, weights, radius, touch):
    """The wrench of a sample's force on one node, with the derivatives as if the other node of the
    interval stood still.

    weights: share, reach [m], turn and part: the sample's surface moves by share dp + dtheta x
    (reach e_x - turn radius n) in the node's frame. Each node gets 1 / part times its block, with
    parts that add up to 1: no motion then meets less stiffness than there is.
    """
    share, reach, turn, part = weights
    n, force = rotate_back(R, touch.normal), rotate_back(R, touch.force)
    lever = minus((reach, 0.0, 0.0), times(turn * radius, n))
    moment, at_node = cross(lever, force), (node // LANES) * 6 * LANES + node % LANES
    for k in range(3):
        nodes.wrench[at_node + k * LANES] += moment[k]
        nodes.wrench[at_node + (3 + k) * LANES] += share * force[k]
    add_along(nodes.stiffness, node, lever, share, n, touch.stiffness / part)
    add_along(nodes.damping, node, lever, share, n, (touch.damping - touch.drag) / part)
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
            if place_in(body, ends.r_b)[1] < reach_of(intervals, ends):
                for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                    sample = sample_at(contact, m)
                    touch, t = touch_of(body, sample, ends, nodes), sample.t
                    if touch.gap < 0.0:
                        nodes.contact.touched[0] = YES
                        add_to_node(
                            nodes,
                            i,
                            ends.R_b,
                            (sample.h_b, sample.reach_b, t, t if i > 0 else 1.0),
                            sample.radius,
                            touch,
                        )
                        if i > 0 and t < 1.0:
                            add_to_node(
                                nodes,
                                i - 1,
                                ends.R_a,
                                (sample.h_a, sample.reach_a, 1.0 - t, 1.0 - t),
                                sample.radius,
                                touch,
                            )


@kernel
def read_contacts(contact, nodes, gap, position, force):
    """Position of every sample (samples, 3) [m]; for every obstacle its gap (obstacles, samples)
    [m] and its force (obstacles, samples, 3) [N] in the world frame. Returns the potential energy
    [J] of the normal forces."""
    energy = 0.0
    for j in range(gap.shape[0]):
        body = body_at(contact.obstacles, j, nodes.time)
        for i in range(contact.intervals.shape[0]):
            ends = ends_of(nodes, i)
            for m in range(int(contact.intervals[i, 1]), int(contact.intervals[i, 2])):
                touch = touch_of(body, sample_at(contact, m), ends, nodes)
                gap[j, m], energy = touch.gap, energy + touch.energy
                for k in range(3):
                    position[m, k], force[j, m, k] = touch.position[k], touch.force[k]
    return energy


@limits_step(ContactParameters)
@kernel
def limit_contact(contact, nodes, longest):
    """Steps are short beside the periods of obstacles that swing, and the next one ends where
    something is met. The last one was too long if a sample went through something, or if all that
    met something came to store more than a share of the arm's energy."""
    intervals, landed, fastest = contact.intervals, 0.0, 0.0
    for j in range(contact.obstacles.shape[0]):
        fastest = max(fastest, size(body_at(contact.obstacles, j, nodes.time).velocity))
        if size(triple(contact.obstacles, j, 25)) > 0.0:
            allow_turning(contact.obstacles[j, 4], longest)
    energy = landing_energy(nodes, intervals, fastest)
    for j in range(contact.obstacles.shape[0]):
        bodies = (
            body_at(contact.obstacles, j, nodes.before_step.time[0]),
            body_at(contact.obstacles, j, nodes.time),
        )
        for i in range(intervals.shape[0]):
            ends = ends_of(nodes.before_step, i), ends_of(nodes, i)
            if not is_far(bodies, ends, intervals, nodes, longest):
                for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                    landed += check_sample(
                        sample_at(contact, m), bodies, ends, nodes, energy, longest
                    )
    if landed > MOST_LANDED * energy:
        nodes.contact.tunnelled[0] = YES


@kernel
def landing_energy(nodes, intervals, fastest):
    """Energy [J] that a sample may store where a step ends in what it comes upon; obstacles move at
    most at a speed [m/s]."""
    energy, mass, length = 0.0, 0.0, 0.0
    for i in range(intervals.shape[0]):
        R, r = pose_of(nodes, i)
        _, v = motion_of(nodes, i, R, r)
        energy, mass, length = (
            energy + 0.5 * nodes.mass[i] * dot(v, v),
            mass + nodes.mass[i],
            length + intervals[i, 0],
        )
    return LANDED * (energy + 0.5 * mass * max(IDLE * length, fastest) ** 2)


@kernel(inline=True)
def is_far(bodies, ends, intervals, nodes, longest):
    """Whether no sample of an interval can have met an obstacle in the last step, nor does in the
    next one: the Hermite polynomials of tangents stay below 4/27, and the signed distance changes
    no faster than a point moves. Bodies and ends: before the step and now."""
    body, now, before = bodies[1], ends[1], ends[0]
    w, v = motion_of(nodes, now.interval, now.R_b, now.r_b)
    w_a, v_a = motion_of(nodes, now.interval - 1, now.R_a, now.r_a)
    speed = (
        max(size(v), size(v_a))
        + 4.0 / 27.0 * intervals[now.interval, 0] * (size(w) + size(w_a))
        + size(body.velocity)
    )
    place, away, _ = place_in(body, now.r_b)
    moved = size(minus(rotate_back(bodies[0].R, minus(before.r_b, bodies[0].r)), place))
    return away >= max(
        reach_of(intervals, before) + moved, reach_of(intervals, now) + speed * longest[0]
    )


@kernel(inline=True)
def check_sample(sample, bodies, ends, nodes, energy, longest):
    """`limit_contact` for a sample and an obstacle, straight ahead as seen by the obstacle; bodies
    and ends: before the step and now. The energy [J] that it has come to store in the step, if it
    met the obstacle there."""
    body, radius, flags = bodies[1], sample.radius, nodes.contact
    landing = min(
        sample.smoothing, (6.0 * sample.smoothing * energy / sample.stiffness) ** (1.0 / 3.0)
    )
    start, was, _ = place_in(bodies[0], position_of(sample, ends[0]))
    end, away, out = place_in(body, position_of(sample, ends[1]))
    velocity, _ = motion_at(sample, ends[1], nodes)
    gap, approach = away - radius, -dot(minus(velocity, body.velocity), rotate(body.R, out))
    if goes_through(body, start, end, min(was - radius, 0.0) + (1.0 - THROUGH) * radius):
        flags.tunnelled[0] = YES
    room = gap + landing if gap > 0.0 else OVERRUN * radius
    if gap < 0.0 or approach * longest[0] > room:
        flags.active[0] = YES
    if approach * longest[0] > room:
        longest[0] = room / approach
    return (
        normal_law(body, sample, -gap, 0.0)[3]
        if was > radius and gap < 0.0 and approach > 0.0
        else 0.0
    )


@kernel
def goes_through(body, start, end, allowed):
    """Whether the distance from a body falls below `allowed` [m] on the straight way between two
    points in its frame: it falls no faster than the way goes on."""
    way, s = minus(end, start), 0.0
    length = size(way)
    if distance(body, end)[0] < allowed:
        return True
    for _ in range(CUTS):
        room = distance(body, plus(start, times(s, way)))[0] - allowed
        if room > length * (1.0 - s):
            return False
        if room < SAME * length:
            return True
        s += room / length
    return True
