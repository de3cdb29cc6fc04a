"""Disturbances: wrenches at points of the rod as functions of time: pushes, pulses, vibrations.

The place of a section is a cubic through the nodes nearest to it, none beyond the end of a tendon. A load is shared among them with its
weights there, by virtual work: force and moment are exact, the error is of fourth order in the distance of the nodes.
"""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import rotate_back, times, twist_sum
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.effects import adds_wrench, allow_turning, limits_step
from soft_tendon_env.mechanics.terms.kinematics import load_pose
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import Frequency, NotNegative, Number, Positive, Triple

EDGE = 1e-9  # [s], up to which times of pulses and of the integrator count as the same
SAME = 1e-12  # of the rod's length, up to which two places are one
PULSE, SINE = 1.0, 2.0
ALWAYS = 0.0, 0.0, 0.0


class Pulse(Configuration):
    """1 for a time, before and after it 0. Integrator steps end where it begins and ends."""

    type: Literal["pulse"] = "pulse"
    start: Positive = Field(description="begin [s], after 0")
    duration: Positive = Field(description="duration [s]")

    @property
    def numbers(self) -> Triple:
        return PULSE, self.start, self.start + self.duration


class Sine(Configuration):
    """sin(2 pi frequency t + phase). The arm rests under its value at time 0."""

    type: Literal["sine"] = "sine"
    frequency: Annotated[Frequency, Field(gt=0)] = Field(description="frequency [Hz]")
    phase: Number = Field(0.0, description="phase [deg]")

    @property
    def numbers(self) -> Triple:
        return SINE, 2.0 * math.pi * self.frequency, math.radians(self.phase)


class Load(Configuration):
    """One load at a point, in the world frame."""

    at: NotNegative = Field(description="arc length of the point [m]")
    force: Triple = Field((0.0, 0.0, 0.0), description="force [N]")
    moment: Triple = Field((0.0, 0.0, 0.0), description="moment [N m]")
    signal: Annotated[Pulse | Sine, Field(discriminator="type")] | None = Field(None, description="factor over time, by default 1")


@register_effect("disturbance")
class Disturbance(Effect):
    """`[effects.disturbance]` with `[[effects.disturbance.loads]]`. Equilibria and resets are those under the loads at time 0."""

    loads: tuple[Load, ...] = Field(min_length=1, description="the loads")

    def parameters(self, rod: Discretisation) -> "DisturbanceParameters":
        for i, own in enumerate(self.loads):
            if own.at > rod.length * (1.0 + SAME):
                problem = Problem(("effects", "disturbance", "loads", i, "at"), f"is {own.at:g} m: the rod has {rod.length:g} m")
                raise ConfigurationError([problem])
        rows = [[*(own.signal.numbers if own.signal else ALWAYS), *own.moment, *own.force] for own in self.loads]
        return DisturbanceParameters(np.array(rows), np.array([node_field(weights(rod, own.at)[:, None]) for own in self.loads]))


def weights(rod: Discretisation, at: float) -> Array:
    """Weights (nodes,) with which values at the nodes, 0 at the base, add up to that at an arc length [m]: exact for functions that are
    cubic between the borders, where there are four nodes."""
    places, found, same = np.append(0.0, rod.node), np.zeros(rod.node.size + 1), SAME * rod.length
    border = min(int(np.searchsorted(rod.borders, at + same, side="right")), rod.borders.size - 1)
    inside = np.flatnonzero((places > rod.borders[border - 1] - same) & (places < rod.borders[border] + same))
    piece = inside[np.append(True, np.diff(places[inside]) > same)]  # without the empty intervals at the tip
    stencil, i = min(4, piece.size), int(np.clip(np.searchsorted(places[piece], at, side="right") - 1, 0, piece.size - 2))
    here, there = places[piece[i : i + 2]]
    own = piece[(first := min(max(i + 1 - stencil // 2, 0), piece.size - stencil)) : first + stencil]
    powers = np.arange(stencil)
    values = ((places[own] - here) / (there - here)) ** powers[:, None]
    found[own] = np.linalg.solve(values, min((at - here) / (there - here), 1.0) ** powers)
    return found[1:]


class DisturbanceParameters(Struct):
    """The loads, and their weights at the nodes."""

    loads: Array  # loads x 9: signal (3), moment, force
    weight: Array  # loads x nodes


@kernel
def signal_at(row, time):
    """The signal of a load, from the first three numbers of its row, at a time [s]."""
    if row[0] == PULSE:
        return 1.0 if row[1] <= time + EDGE and time + EDGE < row[2] else 0.0
    return math.sin(row[1] * time + row[2]) if row[0] == SINE else 1.0


@adds_wrench(DisturbanceParameters)
@kernel
def disturbance_wrench(disturbance, nodes):
    """All loads at the nodes' time."""
    for i in range(disturbance.loads.shape[0]):
        row, weight = disturbance.loads[i], disturbance.weight[i]
        factor = signal_at(row, nodes.time)
        for pack in range(nodes.packs if factor != 0.0 else 0):
            at, share = pack * 6 * LANES, factor * load(weight, pack * LANES)
            R, _ = load_pose(nodes.pose, pack * 12 * LANES)
            here = rotate_back(R, times(share, (row[3], row[4], row[5]))), rotate_back(R, times(share, (row[6], row[7], row[8])))
            store6(nodes.wrench, at, twist_sum(load6(nodes.wrench, at), here))


@limits_step(DisturbanceParameters)
@kernel
def limit_step(disturbance, nodes, longest):
    """Steps follow the signals: up to a fraction of the period of a sine, and to the next end of a pulse."""
    for i in range(disturbance.loads.shape[0]):
        row = disturbance.loads[i]
        if row[0] == SINE:
            allow_turning(row[1], longest)
        for edge in (row[1], row[2]):
            if row[0] == PULSE and edge > nodes.time + EDGE:
                longest[0] = min(longest[0], edge - nodes.time)
