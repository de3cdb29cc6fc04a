"""Nearest point of a flat section's outline to an obstacle: signed distance, normal and lever arm.

A round section is a ball about the axis, whose nearest point needs no search. A flat one, of half
widths a along y and b along z, has the point p = (0, y, z) at which the signed distance from the
obstacle is least. The gap is the least of

    distance(r + R p) + FLAT (y^2 / 2 a + z^2 / 2 b).

Without the second term the point would jump from edge to edge where a face lies flat on a plane.
With it the point moves across the face within a tilt of FLAT; it adds at most FLAT a / 2 to a gap.
Since the gap is a minimum, its derivative is that with p held (envelope theorem): a force along
the normal at p is the gradient of a potential.
"""

import math
from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.obstacles import place_in
from soft_tendon_env.mechanics.algebra.lie import dot, plus, rotate, times
from soft_tendon_env.tools.types import Triple

# shapes of a section's outline
ROUND = 0.0
ELLIPSE = 1.0
RECTANGLE = 2.0

FLAT = 0.01  # [rad] of tilt, within which a face that lies on a plane turns from edge to edge
ROUNDS = 2  # through y and z: on a plane they are independent of each other
MOST_TRIES = 12  # of a search along one axis: regula falsi gains about a digit with each
NEAR = 1e-3  # of the half width, over which the growth of a slope is taken
CLOSE = 1e-9  # slope, or angle [rad], that counts as none


class Nearest(NamedTuple):
    """Point of a section that is nearest to an obstacle."""

    gap: float  # [m] between the surfaces, negative where they overlap
    normal: Triple  # out of the obstacle, world frame
    place: Triple  # [m] of the point about which the surface is a ball, in the section's frame
    offset: Triple  # [m] from the axis to that point, world frame
    # [m/rad] by which the point moves along y and z where the section turns
    moves: tuple[float, float]


class Bracket(NamedTuple):
    """Interval in which a function changes its sign, for regula falsi (Illinois)."""

    low: float
    value_low: float
    high: float
    value_high: float
    last: float  # the end that was moved last: 1 the upper one, -1 the lower one, 0 none


@kernel(inline=True)
def root_of_chord(bracket):
    """Place at which the chord of a function between both ends is zero."""
    weighted = bracket.low * bracket.value_high - bracket.high * bracket.value_low
    return weighted / (bracket.value_high - bracket.value_low)


@kernel(inline=True)
def narrowed(bracket, place, value):
    """Bracket with an end at a place between, where the function has a value.

    Where the same end is moved twice, the value of the other one counts half: it would stay for
    ever.
    """
    if value * bracket.value_high > 0.0:
        value_low = bracket.value_low
        if bracket.last > 0.0:
            value_low = 0.5 * value_low
        return Bracket(bracket.low, value_low, place, value, 1.0)
    value_high = bracket.value_high
    if bracket.last < 0.0:
        value_high = 0.5 * value_high
    return Bracket(place, value, bracket.high, value_high, -1.0)


@kernel(inline=True)
def sloped_distance(body, x, direction, s, half):
    """Slope along a direction of what is least, at a place s [m] from x."""
    point = plus(x, times(s, direction))
    _, _, out = place_in(body, point)
    slope = dot(rotate(body.R, out), direction)
    return slope + FLAT * s / half


@kernel
def least_along(body, x, direction, half):
    """Place s [m] in [-half, half] along a direction where the sloped distance is least.

    Also its change [m/rad] with a turn, 0 at an end. Regula falsi (Illinois), as the slope grows
    with s.
    """
    low = -half
    slope_low = sloped_distance(body, x, direction, low, half)
    if slope_low >= 0.0:
        return low, 0.0
    high = half
    slope_high = sloped_distance(body, x, direction, high, half)
    if slope_high <= 0.0:
        return high, 0.0
    bracket = Bracket(low, slope_low, high, slope_high, 0.0)
    s = 0.0
    slope = 0.0
    for _ in range(MOST_TRIES):
        s = root_of_chord(bracket)
        slope = sloped_distance(body, x, direction, s, half)
        if abs(slope) < CLOSE:
            break
        bracket = narrowed(bracket, s, slope)
    step = NEAR * half
    growth = sloped_distance(body, x, direction, s + step, half) - slope
    return s, step / growth


@kernel
def nearest_of_rectangle(body, sample, r, y_axis, z_axis):
    """Place (y, z) [m] of the nearest point of a rectangle, and how it moves [m/rad].

    One axis comes after the other.
    """
    y = 0.0
    z = 0.0
    move_y = 0.0
    move_z = 0.0
    for _ in range(ROUNDS):
        beside_y = plus(r, times(y, y_axis))
        z, move_z = least_along(body, beside_y, z_axis, sample.half_z)
        beside_z = plus(r, times(z, z_axis))
        y, move_y = least_along(body, beside_z, y_axis, sample.half_y)
    return y, z, move_y, move_z


@kernel(inline=True)
def turned_back(body, sample, r, y_axis, z_axis, angle, share):
    """Angle [rad] from a point of an ellipse to the one that has the obstacle's normal there.

    It is a difference of eccentric angles, in (-pi, pi].
    """
    width_y = share * sample.half_y
    width_z = share * sample.half_z
    along_y = times(width_y * math.cos(angle), y_axis)
    along_z = times(width_z * math.sin(angle), z_axis)
    offset = plus(along_y, along_z)
    point = plus(r, offset)
    _, _, out = place_in(body, point)
    n = rotate(body.R, out)
    # the eccentric angle of the point that has this normal
    n_y = dot(n, y_axis)
    n_z = dot(n, z_axis)
    opposite_angle = math.atan2(-sample.half_z * n_z, -sample.half_y * n_y)
    turn = opposite_angle - angle
    # within (-pi, pi]
    sine = math.sin(turn)
    cosine = math.cos(turn)
    return math.atan2(sine, cosine)


@kernel
def nearest_of_ellipse(body, sample, r, y_axis, z_axis):
    """Place (y, z) [m] of the nearest point of an ellipse, and how it moves [m/rad].

    Regula falsi (Illinois) finds its eccentric angle, where both normals agree.
    """
    _, _, out = place_in(body, r)
    n = rotate(body.R, out)
    n_y = dot(n, y_axis)
    n_z = dot(n, z_axis)
    across = math.sqrt(n_y**2 + n_z**2)
    # where the rod meets something head on, no point of the outline is nearest
    share = across / math.sqrt(across * across + FLAT * FLAT)
    # the point whose normal is that at the axis: on a plane it is the nearest
    low = turned_back(body, sample, r, y_axis, z_axis, 0.0, 0.0)
    turn_low = turned_back(body, sample, r, y_axis, z_axis, low, share)
    angle = low
    if abs(turn_low) > CLOSE:
        high = low + turn_low
        turn_high = turned_back(body, sample, r, y_axis, z_axis, high, share)
        angle = high
        bracket = Bracket(low, turn_low, high, turn_high, 0.0)
        for _ in range(MOST_TRIES):
            has_no_change = bracket.value_low * bracket.value_high >= 0.0
            if abs(bracket.value_high) < CLOSE or has_no_change:
                break
            angle = root_of_chord(bracket)
            turn = turned_back(body, sample, r, y_axis, z_axis, angle, share)
            if abs(turn) < CLOSE:
                break
            bracket = narrowed(bracket, angle, turn)
    c = math.cos(angle)
    s = math.sin(angle)
    a = sample.half_y
    b = sample.half_z
    # radius of curvature of the outline there, along y and z
    height = math.sqrt((b * c) ** 2 + (a * s) ** 2)
    radius = height**3 / (a * b)
    normal_y = b * c / height
    normal_z = a * s / height
    move_y = radius * normal_z**2
    move_z = radius * normal_y**2
    return share * a * c, share * b * s, move_y, move_z


@kernel(inline=True)
def nearest(body, sample, r, y_axis, z_axis):
    """Point of a section with its middle at r that is nearest to an obstacle.

    The section's axes y and z are in the world frame.
    """
    y = 0.0
    z = 0.0
    move_y = 0.0
    move_z = 0.0
    ball = sample.radius  # of the surface about the point
    if sample.shape != ROUND:
        ball = 0.0
        if sample.shape == RECTANGLE:
            y, z, move_y, move_z = nearest_of_rectangle(body, sample, r, y_axis, z_axis)
        else:
            y, z, move_y, move_z = nearest_of_ellipse(body, sample, r, y_axis, z_axis)
    offset = plus(times(y, y_axis), times(z, z_axis))
    _, away, out = place_in(body, plus(r, offset))
    gap = away - ball
    if sample.shape == RECTANGLE:
        bent_y = y * y / sample.half_y
        bent_z = z * z / sample.half_z
        gap += 0.5 * FLAT * (bent_y + bent_z)
    normal = rotate(body.R, out)
    return Nearest(gap, normal, (0.0, y, z), offset, (move_y, move_z))
