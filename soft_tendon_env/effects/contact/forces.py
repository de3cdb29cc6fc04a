"""Forces of contact on a sample: normal force by a smooth penalty with damping, and Coulomb friction with sticking.

With d = radius - signed distance of the sample's middle, k = stiffness ds and a smoothing depth e, N = p(d) max(0, 1 + c d_dot),
p = k d^2 / 2 e up to d = e, k (d - e / 2) beyond: Hunt and Crossley (1975), here of a force that begins smoothly. It never pulls, and what
it takes out of the motion, p c d_dot^2, is never negative.

A bristle of displacement s per sample and obstacle is kept in the obstacle's frame and in its tangent plane: f = -g min(1, mu N / |g|),
g = k_t (s + T v) at the slip velocity v of the surface, and s_dot = v as long as |k_t s| < mu N, brought back to that limit where it is
not: return mapping (Simo and Hughes, Computational Inelasticity, 1998, ch. 1; Cundall and Strack 1979). So a load below mu N is held
without creep. k_t = 2/3 k is the ratio of Mindlin (1949) for a rubber, 2 (1 - nu) / (2 - nu) at nu = 1/2.
"""

import math
from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.distance import velocity_at
from soft_tendon_env.effects.contact.rows import DEPTH, DISSIPATION, FRICTION, RADIUS, SOLID, STIFFNESS, THICKNESS, WALL_SCALE
from soft_tendon_env.effects.contact.samples import motion_at
from soft_tendon_env.mechanics.algebra.lie import cross, dot, minus, plus, rotate, rotate_back, times
from soft_tendon_env.tools.types import Triple as Vector

FREE, WALL = 0.2, 0.45
"""Depths in radii of the rod between which the wall stops what would go through, see `walled`: a wire between two samples a radius apart is
half a radius deep in both."""
WALL_DISSIPATION = 1.0
"""The least c [s/m] of the wall: what begins within an obstacle leaves it at 1 m/s at most."""
TANGENTIAL = 2.0 / 3.0
"""Stiffness of a bristle over that of the sample."""
BRISTLE_TIME = 1e-3
"""T [s]: damping over stiffness of a bristle, and so how fast a slip counts as slip."""


class Touch(NamedTuple):
    """Contact of a sample with an obstacle; vectors in the world frame."""

    force: float  # N
    stiffness: float  # dN / dd
    damping: float  # dN / dd_dot
    normal: Vector  # out of the obstacle
    slip: Vector  # velocity of the rod's surface along the obstacle's


class Traction(NamedTuple):
    """A force on a sample in the world frame [N], and the stiffness [N/m] and damping [N s/m] of friction in the tangent plane."""

    force: Vector
    stiffness: float
    damping: float


@kernel(inline=True)
def pressed(samples, m, depth):
    """Penalty force p(d) of a sample, its derivative and its integral."""
    stiffness, smoothing = samples[m, STIFFNESS], samples[m, DEPTH]
    if depth < smoothing:
        slope = stiffness * depth / smoothing
        return 0.5 * slope * depth, slope, slope * depth * depth / 6.0
    beyond = depth - 0.5 * smoothing
    return stiffness * beyond, stiffness, 0.5 * stiffness * (beyond * beyond + smoothing * smoothing / 12.0)


@kernel(inline=True)
def walled(body, samples, m, depth):
    """Force of the wall that stops what would go through, its derivative and its integral.

    S x^3 / width, with x from 0 at FREE to 1 at WALL, deeper by half of the obstacle's thickness and by all of it. Without a stiffness of
    the ground's own, thickness counts up to the rod's radius.
    """
    thick = 0.5 * min(samples[m, SOLID], body.obstacles[body.j, THICKNESS])
    x, width = depth - FREE * samples[m, RADIUS] - thick, (WALL - FREE) * samples[m, RADIUS] + thick
    if not x > 0.0:  # nor is it for what is infinitely thick
        return 0.0, 0.0, 0.0
    x /= width
    energy = samples[m, WALL_SCALE] * x * x
    return energy * x / width, 3.0 * energy / (width * width), 0.25 * energy * x * x


@kernel(inline=True)
def damped(law, dissipation, approach):
    """The force p max(0, 1 + c d_dot) of a law, with its derivatives by depth and approach."""
    p, slope, _ = law
    factor = 1.0 + dissipation * approach
    return (p * factor, slope * factor, p * dissipation) if factor > 0.0 else (0.0, 0.0, 0.0)


@kernel(inline=True)
def normal_force(body, samples, m, depth, approach):
    """Normal force [N] of a sample so deep that comes so fast [m/s], and its derivatives by depth and approach."""
    own = damped(pressed(samples, m, depth), body.obstacles[body.j, DISSIPATION], approach)
    wall = damped(walled(body, samples, m, depth), max(body.obstacles[body.j, DISSIPATION], WALL_DISSIPATION), approach)
    return own[0] + wall[0], own[1] + wall[1], own[2] + wall[2]


@kernel(inline=True)
def stored_energy(body, samples, m, depth):
    """Energy [J] of the normal force without damping."""
    return pressed(samples, m, depth)[2] + walled(body, samples, m, depth)[2]


@kernel(inline=True)
def touch_of(body, samples, m, ends, nodes, x, depth, normal):
    """The contact of a sample at x that is so deep in an obstacle."""
    velocity, turning = motion_at(samples, m, ends, nodes)
    surface = times(-samples[m, RADIUS], normal)
    relative = minus(plus(velocity, cross(turning, surface)), velocity_at(body, plus(x, surface)))
    approach = -dot(relative, normal)
    slip = plus(relative, times(approach, normal))
    force, stiffness, damping = normal_force(body, samples, m, depth, approach)
    return Touch(force, stiffness, damping, normal, slip)


@kernel(inline=True)
def shortened(x, most):
    """A vector no longer than this."""
    size = math.sqrt(dot(x, x))
    return times(most / size, x) if size > most else x


@kernel(inline=True)
def bristle_of(state, at, body, normal):
    """A bristle's displacement in the world frame, in the tangent plane."""
    s = rotate(body.R, (state[at], state[at + 1], state[at + 2]))
    return minus(s, times(dot(s, normal), normal))


@kernel(inline=True)
def friction_of(touch, s, limit, stiffness):
    """Friction on a sample with its stiffness and damping: those of the bristle, or the secant of what slips."""
    g = times(stiffness, plus(shortened(s, limit / stiffness), times(BRISTLE_TIME, touch.slip)))
    size = math.sqrt(dot(g, g))
    if size <= limit:
        return Traction(times(-1.0, g), stiffness, BRISTLE_TIME * stiffness)
    return Traction(times(-limit / size, g), 0.0, BRISTLE_TIME * stiffness * limit / size)


@kernel(inline=True)
def traction_of(body, samples, m, touch, state, at):
    """Normal force and friction together; without internal states there is no friction."""
    force, stiffness, damping = times(touch.force, touch.normal), 0.0, 0.0
    if body.obstacles[body.j, FRICTION] > 0.0 and state.size > 0:
        s = bristle_of(state, at, body, touch.normal)
        friction = friction_of(touch, s, body.obstacles[body.j, FRICTION] * touch.force, TANGENTIAL * samples[m, STIFFNESS])
        force, stiffness, damping = plus(force, friction.force), friction.stiffness, friction.damping
    return Traction(force, stiffness, damping)


@kernel(inline=True)
def advanced_bristle(body, samples, m, touch, state, at, step):
    """Displacement of a bristle in the obstacle's frame after a step [s] of slip."""
    limit = body.obstacles[body.j, FRICTION] * touch.force / (TANGENTIAL * samples[m, STIFFNESS])
    s = bristle_of(state, at, body, touch.normal)
    return rotate_back(body.R, shortened(plus(shortened(s, limit), times(step, touch.slip)), limit))
