"""Normal force of a sample in an obstacle: a smooth penalty with Hunt and Crossley's damping, and a wall against what would go through.

With d = radius - signed distance of the sample's middle, k = stiffness ds and a smoothing depth e, N = p(d) max(0, 1 + c d_dot),
p = k d^2 / 2 e up to d = e, k (d - e / 2) beyond: Hunt and Crossley (1975), here of a force that begins smoothly. It never pulls, and what
it takes out of the motion, p c d_dot^2, is never negative.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.rows import DEPTH, DISSIPATION, RADIUS, SOLID, STIFFNESS, THICKNESS, WALL_SCALE

SMOOTHING = 0.01
"""Depth over which the stiffness grows to its full size, in radii of the rod."""
FREE, WALL = 0.2, 0.45
"""Depths in radii of the rod between which the wall stops what would go through, see `walled`: a wire between two samples a radius apart is
half a radius deep in both."""
WALL_SPEED, WALL_MASS = 30.0, 8.0
"""Impact that the wall of a sample stops by itself within twice its width or so: this speed [m/s] of so many times the mass of its
share."""
WALL_DISSIPATION = 1.0
"""The least c [s/m] of the wall: what begins within an obstacle leaves it at 1 m/s at most."""


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
