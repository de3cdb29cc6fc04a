"""Signed distance fields: pose and motion of an obstacle at a time, and distance from its surface with the gradient."""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.rows import KIND, triple
from soft_tendon_env.mechanics.algebra.lie import cross, dot, matmul, minus, plus, rodrigues, rotate, rotate_back, times
from soft_tendon_env.tools.types import Triple as Vector

PLANE, CAPSULE, CYLINDER, BOX = 0.0, 1.0, 2.0, 3.0
"""Kinds of signed distance; a sphere is a capsule without length."""
CUTS = 8
"""Most places at which the way of a sample is looked at."""

Rotation = tuple[float, float, float, float, float, float, float, float, float]


class Body(NamedTuple):
    """An obstacle as a rigid body at a time; vectors in the world frame."""

    obstacles: np.ndarray
    j: int  # its row among the obstacles
    R: Rotation
    r: Vector
    centre: Vector  # about which it turns
    velocity: Vector  # of the centre
    angular_velocity: Vector


@kernel
def rotation_by(angle):
    """Exponential of a rotation vector [rad]."""
    size = math.sqrt(dot(angle, angle))
    if size == 0.0:
        return 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    return rodrigues(math.sin(size) / size, 2.0 * (math.sin(0.5 * size) / size) ** 2, angle)


@kernel(refcount=True)
def body_at(obstacles, i, time):
    """The obstacle of a row, see `Obstacle.row`, at a time [s]."""
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
    return Body(obstacles, i, R, plus(centre, arm), centre, v, w)


@kernel(inline=True)
def in_frame(body, x):
    """A position [m] in the frame of a body."""
    return rotate_back(body.R, minus(x, body.r))


@kernel(inline=True)
def velocity_at(body, x):
    """Velocity of a body's material point at x [m/s]."""
    return plus(body.velocity, cross(body.angular_velocity, minus(x, body.centre)))


@kernel(inline=True)
def distance(body, x):
    """Signed distance [m] from a body's surface to x in its frame, negative inside, and its gradient: outwards, of length 1.

    Where a face, an axis or a middle has no single nearest point, that of one of them.
    """
    obstacles, j = body.obstacles, body.j
    if obstacles[j, KIND] == PLANE:
        return x[2], (0.0, 0.0, 1.0)
    if obstacles[j, KIND] == CAPSULE:
        away = x[0], x[1], x[2] - min(max(x[2], -obstacles[j, 2]), obstacles[j, 2])
        size = math.sqrt(dot(away, away))
        if size > 0.0:
            return size - obstacles[j, 1], times(1.0 / size, away)
        return -obstacles[j, 1], (1.0, 0.0, 0.0)
    if obstacles[j, KIND] == CYLINDER:
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


@kernel(refcount=True)
def read_distances(obstacles, positions, time, out):
    """Signed distance out (obstacles, m) of positions (m, 3) at a time."""
    for j in range(obstacles.shape[0]):
        body = body_at(obstacles, j, time)
        for m in range(positions.shape[0]):
            out[j, m] = distance(body, in_frame(body, triple(positions, m, 0)))[0]


@kernel
def goes_through(body, start, end, allowed):
    """Whether the distance from a body falls below `allowed` [m] on the straight way between two points in its frame.

    Obstacles are convex, and so is the signed distance along a line: it lies above its tangents. Where they cross is the next place to
    look at.
    """
    way = minus(end, start)
    a, out = distance(body, start)
    fall = dot(out, way)
    b, out = distance(body, end)
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
        c, out = distance(body, plus(start, times(s, way)))
        slope = dot(out, way)
        if slope < 0.0:
            first, a, fall = s, c, slope
        else:
            last, b, rise = s, c, slope
    return min(a, b) < allowed
