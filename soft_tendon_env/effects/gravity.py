"""Uniform gravity: the force rho A dX g on every slice of the rod, and m g on a tip mass."""
from soft_tendon_env.effects import Effect, register


@register("gravity")
class Gravity(Effect):
    """`[effects.gravity]`. `acceleration` (x, y, z) [m/s^2] in the world frame, in which the straight rod lies along x."""

    acceleration: tuple[float, float, float]
