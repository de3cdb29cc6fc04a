"""Disturbances: wrenches at points of the rod or distributed over parts of it, as functions of time: pushes, pulses, vibrations.

The place of a section is a cubic through the nodes nearest to it, none beyond the end of a tendon. A load at a point is shared among them
with its weights there, and a distributed one with their integrals, by virtual work: force and moment are exact, the error is of fourth
order in the distance of the nodes. What falls to the base does no work.
"""

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, register_effect
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
CONSTANT, PULSE, SINE = 0.0, 1.0, 2.0


class Constant(Configuration):
    """1 always. The arm rests under it."""

    type: Literal["constant"] = "constant"


class Pulse(Configuration):
    """1 for a time, before and after it 0. Integrator steps end where it begins and ends."""

    type: Literal["pulse"] = "pulse"
    start: Positive = Field(description="begin [s], after 0")
    duration: Positive = Field(description="duration [s]")


class Sine(Configuration):
    """sin(2 pi frequency t + phase). The arm rests under its value at time 0."""

    type: Literal["sine"] = "sine"
    frequency: Annotated[Frequency, Field(gt=0)] = Field(description="frequency [Hz]")
    phase: Number = Field(0.0, description="phase [deg]")


def signal_numbers(signal: Constant | Pulse | Sine) -> Triple:
    """A signal as `signal_at` reads it: kind and parameters."""
    if isinstance(signal, Pulse):
        return PULSE, signal.start, signal.start + signal.duration
    return (SINE, 2.0 * np.pi * signal.frequency, np.deg2rad(signal.phase)) if isinstance(signal, Sine) else (CONSTANT, 0.0, 0.0)


class Load(Configuration):
    """One load, either at a point or distributed evenly along a part of the rod."""

    force: Triple = Field((0.0, 0.0, 0.0), description="force [N], or of distributed loads force per length [N/m]")
    moment: Triple = Field((0.0, 0.0, 0.0), description="moment [N m], or moment per length [N m/m]")
    at: NotNegative | None = Field(None, description="arc length of the point [m]")
    along: tuple[NotNegative, NotNegative] | None = Field(None, description="arc lengths between which it is distributed [m]")
    frame: Literal["world", "body"] = Field("world", description="frame of its components; body: the section, x along the rod")
    signal: Annotated[Constant | Pulse | Sine, Field(discriminator="type")] = Field(Constant(), description="factor as a function of time")

    @model_validator(mode="after")
    def _has_a_place(self) -> Self:
        if (self.at is None) == (self.along is None):
            raise ValueError("should be at a point (`at`, an arc length [m]) or distributed (`along`, from and to [m])")
        if self.along is not None and not self.along[0] < self.along[1]:
            raise ValueError(f"has along = {list(self.along)}: it should end after it begins")
        return self


@register_effect("disturbance")
class Disturbance(Effect):
    """`[effects.disturbance]` with `[[effects.disturbance.loads]]`. Equilibria and resets are those under the loads at time 0."""

    loads: tuple[Load, ...] = Field(min_length=1, description="the loads")

    def parameters(self, rod: Discretisation) -> "DisturbanceParameters":
        for i, own in enumerate(self.loads):
            end = (own.along or (0.0, own.at or 0.0))[1]
            if end > rod.length * (1.0 + SAME):
                key = ("effects", "disturbance", "loads", i, "at" if own.along is None else "along")
                raise ConfigurationError([Problem(key, f"ends at {end:g} m: the rod has {rod.length:g} m")])
        rows = [[*signal_numbers(own.signal), float(own.frame == "body"), *own.moment, *own.force] for own in self.loads]
        return DisturbanceParameters(np.array(rows), np.array([node_field(weights(rod, own)[:, None]) for own in self.loads]))

    def potential_energy(self, arm: Configured) -> float:
        if any(own.signal.type != "constant" or own.frame == "body" or any(own.moment) for own in self.loads):
            raise ValueError("a disturbance that changes in time, follows the rod or has a moment has no potential energy")
        return -sum(float(weights(arm.rod, own) @ (arm.pose[:, :3, 3] @ np.array(own.force))) for own in self.loads)


def weights(rod: Discretisation, own: Load) -> Array:
    """Weights (nodes,) with which values at the nodes, 0 at the base, add up to that at the point of a load, or to their integral [m] over
    its part of the rod: exact for functions that are cubic between the borders, where there are four nodes."""
    start, end = own.along or (own.at or 0.0, own.at or 0.0)
    places, found, same = np.append(0.0, rod.node), np.zeros(rod.node.size + 1), SAME * rod.length
    for border, next_border in zip(rod.borders[:-1], rod.borders[1:], strict=True):
        inside = np.flatnonzero((places > border - same) & (places < next_border + same))
        piece = inside[np.append(True, np.diff(places[inside]) > same)]  # without the empty intervals at the tip
        stencil = min(4, piece.size)
        for i, (here, there) in enumerate(zip(places[piece[:-1]], places[piece[1:]], strict=True)):
            a, b = (float(np.clip(place, here, there) - here) / (there - here) for place in (start, end))
            own_nodes = piece[(first := min(max(i + 1 - stencil // 2, 0), piece.size - stencil)) : first + stencil]
            powers = np.arange(1, stencil + 1)
            values = ((places[own_nodes] - here) / (there - here)) ** (powers[:, None] - 1)
            if own.along is not None:
                found[own_nodes] += (there - here) * np.linalg.solve(values, (b**powers - a**powers) / powers)
            elif here <= start < there or (there > rod.length - same and start >= there):
                found[own_nodes] = np.linalg.solve(values, a ** (powers - 1.0))
    return found[1:]


class DisturbanceParameters(Struct):
    """The loads, and their weights at the nodes."""

    loads: Array  # loads x 10: signal (3), frame, moment, force
    weight: Array  # loads x nodes


@kernel
def signal_at(row, time):
    """The signal of a load, from the first three numbers of its row, at a time [s]."""
    if row[0] == PULSE:
        return 1.0 if row[1] <= time + EDGE and time + EDGE < row[2] else 0.0
    if row[0] == SINE:
        return math.sin(row[1] * time + row[2])
    return 1.0


@adds_wrench(DisturbanceParameters)
@kernel
def disturbance_wrench(disturbance, nodes):
    """All loads at the nodes' time."""
    for i in range(disturbance.loads.shape[0]):
        row, weight = disturbance.loads[i], disturbance.weight[i]
        factor = signal_at(row, nodes.time)
        moment, force = (row[4], row[5], row[6]), (row[7], row[8], row[9])
        for pack in range(nodes.packs if factor != 0.0 else 0):
            at, share = pack * 6 * LANES, factor * load(weight, pack * LANES)
            here = times(share, moment), times(share, force)
            if row[3] == 0.0:
                R, _ = load_pose(nodes.pose, pack * 12 * LANES)
                here = rotate_back(R, here[0]), rotate_back(R, here[1])
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
