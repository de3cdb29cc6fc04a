"""Tendon friction: Coulomb friction of tendons in their channels by the capstan equation, with hysteresis.

The tension falls along a tendon that is pulled in, and grows along one that is let out, with the angle phi(s) by which the path has turned,

    T(s) = T(0) exp(-mu z phi(s)),    z_dot = (v / x) (1 - z sign v),

v = -dL/dt being the rate at which the tendon is pulled in, and z its direction of sliding: 1 pulled in, -1 let out, in between where it
sticks and strains the contact by up to about x, the presliding displacement (the capstan equation with Dahl's friction model: P. R. Dahl,
A solid friction model, 1968; T. N. Do et al., Hysteresis modeling and position control of tendon-sheath mechanism, Mechatronics 24, 2014).
One direction holds for the whole tendon: fronts of sliding that move along it after a reversal are left out.

At rest z stays what it is, so that the arm rests anywhere within a band; an arm that has always been at rest has z = 0, no friction. The
tensions of the strain law have none either: what friction takes away bends coordinates that tensions alone leave at zero, and a strain
with passive fields follows it better. The contact's stiffness, that of z before it slides, enters the implicit step.
"""

import math
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lanes import (
    LANES,
    lane,
    lane_sum,
    largest,
    load,
    prefix_sum,
    smallest,
    spread,
    sqrt,
    store,
    with_lane,
)
from soft_tendon_env.mechanics.algebra.lie import cross, dot, minus, plus, times
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6
from soft_tendon_env.mechanics.effects import follows_command, loses_tension
from soft_tendon_env.mechanics.terms.tendons import chord, chord_rate, unit_tangent
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Positive

BEFORE = 0.5 - math.sqrt(3.0) / 6.0  # of an interval, what lies before its first Gauss point and after its second
STEEPEST = 100.0  # mu phi along the stress-free arm
CUT_ACROSS, CUT_INSIDE = ((part**2 / (3.0 * (1.0 - part))) for part in (2.0 * BEFORE, 1.0 - 2.0 * BEFORE))
"""Shortening of the chord of a part of a curve against the part, as a share of that of the chord of both parts: of third order."""


@register_effect("tendon_friction")
class TendonFriction(Effect):
    """`[effects.tendon_friction]`. `coefficient` mu [-]; `presliding` x [m], 0.1 mm by default."""

    is_actuation: ClassVar[bool] = True

    coefficient: Annotated[float, Field(ge=0, le=10)]
    presliding: Positive = 1e-4

    def parameters(self, rod: Discretisation) -> "FrictionParameters":
        i = int(np.argmax(rod.tendon_turn))
        if self.coefficient * rod.tendon_turn[i] > STEEPEST:
            text = f"is {self.coefficient:g}: tendon {i} turns by {rod.tendon_turn[i]:.3g} rad, for which it should be at most"
            problem = f"{text} {STEEPEST / rod.tendon_turn[i]:.3g}, or the tension let out grows by more than exp({STEEPEST:g})"
            raise ConfigurationError([Problem(("effects", "tendon_friction", "coefficient"), problem)])
        return FrictionParameters(self.coefficient, self.presliding, rod.step)

    def state(self, rod: Discretisation) -> Array:
        return np.zeros(2 * rod.tendon_length.size)  # z, and the last v, which tells how z would go on

    def potential_energy(self, arm: Configured) -> float:
        return 0.0


class FrictionParameters(NamedTuple):
    """The contact."""

    coefficient: float  # [-]
    presliding: float  # [m]
    step: float  # [s], the longest of the integrator


@kernel(inline=True)
def exponential(x):
    """exp(x) of a pack, to 2e-8 of itself, times |x| where that is above 1: a Pade approximant of x / 2^n, squared n times."""
    size, squarings, scale = max(largest(x), -smallest(x)), 4, 1.0 / 16.0
    while size * scale > 1.0 / 16.0:
        squarings, scale = squarings + 1, 0.5 * scale
    x = scale * x
    even, odd = 1.0 + (1.0 / 12.0) * (x * x), 0.5 * x
    root = (even + odd) / (even - odd)
    for _ in range(squarings):
        root = root * root
    return root


@kernel(inline=True)
def one_later(pack, before):
    """The lanes of a pack moved by one towards the tip, after the last of the pack before."""
    moved = spread(lane(before, LANES - 1))
    for i in range(LANES - 1):
        moved = with_lane(moved, i + 1, lane(pack, i))
    return moved


@kernel(inline=True)
def all_later(vector, before):
    """`one_later` of three components."""
    return one_later(vector[0], before[0]), one_later(vector[1], before[1]), one_later(vector[2], before[2])


@kernel(inline=True)
def turn(t_from, t_to, rate_from, rate_to, distance):
    """How a path's tangent turns over a distance: within the section, and with it."""
    return plus(minus(t_to, t_from), times(0.5 * distance, plus(rate_from, rate_to)))


@kernel(inline=True)
def length_of(x):
    """|x|."""
    return sqrt(dot(x, x))


@kernel(inline=True)
def within(z):
    """z, which extrapolation in time may have left beyond its ends."""
    return min(max(z, -1.0), 1.0)


@loses_tension(FrictionParameters)
@kernel
def capstan(friction, actuation):
    """exp(-mu z phi) of every tendon at the points, and the stiffness of what sticks."""
    tendons, blocks = actuation.tension.size, 2 * actuation.packs
    for i in range(tendons):
        z = within(actuation.state[i])
        slip = -friction.coefficient * z
        angle, zero = spread(0.0), spread(0.0)
        t_before, rate_before, width_before, there_before = (zero, zero, zero), (zero, zero, zero), zero, zero
        for pack in range(actuation.first[i], actuation.last[i]):
            first = i * blocks + 2 * pack
            t0, t1 = load3(actuation.tangent, first * 4 * LANES), load3(actuation.tangent, (first + 1) * 4 * LANES)
            rate0 = cross(load6(actuation.strain, 2 * pack * 6 * LANES)[0], t0)
            rate1 = cross(load6(actuation.strain, (2 * pack + 1) * 6 * LANES)[0], t1)
            width = 2.0 * load(actuation.weight, 2 * pack * LANES)
            there0 = load(actuation.geometry, (first * 5 + 4) * LANES)
            there1 = load(actuation.geometry, ((first + 1) * 5 + 4) * LANES)
            last_t, last_rate = all_later(t1, t_before), all_later(rate1, rate_before)
            last_there = one_later(there1, there_before)
            between = BEFORE * (width + one_later(width, width_before))
            turn_inside = times(there1, turn(t0, t1, rate0, rate1, (1.0 - 2.0 * BEFORE) * width))
            turn_across = times(last_there, turn(last_t, t0, last_rate, rate0, between))
            inside, across = length_of(turn_inside), length_of(turn_across)
            cut = inside + across - length_of(plus(turn_inside, turn_across))  # by the chord of both
            inside, across = inside + CUT_INSIDE * cut, across + CUT_ACROSS * cut
            begun = (BEFORE / (1.0 - 2.0 * BEFORE)) * inside  # at the tendon's start the path turns as evenly as behind it
            across = across + (1.0 - last_there) * begun
            so_far = angle + prefix_sum(there0 * (across + inside))
            store(actuation.share, first * LANES, load(actuation.share, first * LANES) * exponential(slip * (so_far - there0 * inside)))
            store(actuation.share, (first + 1) * LANES, load(actuation.share, (first + 1) * LANES) * exponential(slip * so_far))
            angle = spread(lane(so_far, LANES - 1))
            t_before, rate_before, width_before, there_before = t1, rate1, width, there1
        speed = abs(actuation.state[tendons + i])
        turned = friction.coefficient * lane(angle, 0)
        grip = turned * mean_slope(turned * z) * actuation.tension[i] * relaxed(friction, speed, friction.step)
        actuation.stiffness[i] += grip
        actuation.creep[i] += grip * speed * z


@kernel
def mean_slope(a):
    """Mean of u exp(-a u) over u from 0 to 1: how the mean tension falls with mu z phi = a."""
    return (1.0 - (1.0 + a) * math.exp(-a)) / (a * a) if abs(a) > 0.01 else 0.5 - a / 3.0 + a * a / 8.0


@kernel
def relaxed(friction, speed, step):
    """(1 - exp(-y)) / (y x) with y = speed step / x [1/m]: the part by which z goes to its new direction, per way of the tendon."""
    y = speed * step / friction.presliding
    return (-math.expm1(-y) / y if y > 1e-8 else 1.0) / friction.presliding


@kernel
def pull_in_rate(actuation, i):
    """v of a tendon [m/s]."""
    total, blocks = spread(0.0), 2 * actuation.packs
    for block in range(2 * actuation.first[i], 2 * actuation.last[i]):
        at, strain = (i * blocks + block) * 5 * LANES, load6(actuation.strain, block * 6 * LANES)
        t = unit_tangent(chord(actuation.geometry, at, strain[0], strain[1]))[0]
        along = dot(chord_rate(actuation.geometry, at, load6(actuation.rate, block * 6 * LANES)), t)
        total = total + load(actuation.weight, block * LANES) * load(actuation.geometry, at + 4 * LANES) * along
    return -lane_sum(total)


@follows_command(FrictionParameters)
@kernel
def slide(friction, step, actuation):
    """z after a step, exactly where v holds, and v.

    z_dot = (v - |v| z) / x with |v| as it was: a tendon that reverses passes through all directions, where the exact z of the new rate
    would jump from one end to the other, and the arm with it.
    """
    tendons = actuation.tension.size
    for i in range(tendons):
        rate, z, speed = pull_in_rate(actuation, i), within(actuation.state[i]), abs(actuation.state[tendons + i])
        if step < math.inf:
            actuation.state[i] = within(z + relaxed(friction, speed, step) * step * (rate - speed * z))
        actuation.state[tendons + i] = rate
