"""Loads: gravity, a wrench and a payload at the tip, disturbances (wrenches at points of the rod
that change in time), and a moving base.

A disturbance between nodes is shared among the nearest ones, none beyond the end of a tendon. By
virtual work and the weights of a cubic, force and moment are exact, and the error is of fourth
order in the distance of the nodes.
"""

import math
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import (
    Array,
    Configured,
    DeadLoads,
    Discretisation,
    Effect,
    register_effect,
)
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import (
    coefficients,
    cross,
    exp_se3,
    matmul,
    minus,
    plus,
    rotate_back,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store3, store6
from soft_tendon_env.mechanics.effects import (
    Base,
    adds_wrench,
    allow_turning,
    limits_step,
    moves_base,
)
from soft_tendon_env.mechanics.terms.kinematics import load_pose, pose_of_base, tip_pose_of
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import (
    Direction,
    Frequency,
    NotNegative,
    Number,
    Positive,
    Triple,
    Turning,
)

EDGE = 1e-9  # [s], up to which times of pulses and of the integrator count as the same
SAME = 1e-12  # of the rod's length, up to which two places are one
PULSE, SINE = 1.0, 2.0
ALWAYS = 0.0, 0.0, 0.0


@register_effect("gravity")
class Gravity(Effect):
    """`[effects.gravity]`: weight of the rod and its payload, in the world frame."""

    strengths: ClassVar[tuple[str, ...]] = ("acceleration",)
    is_uniform: ClassVar[bool] = True

    acceleration: Triple = Field(description="acceleration (x, y, z) [m/s^2]")

    def parameters(self, rod: Discretisation) -> "GravityParameters":
        return GravityParameters(self.acceleration)

    def potential_energy(self, arm: Configured) -> float:
        return -float(arm.mass @ (arm.pose[:, :3, 3] @ np.array(self.acceleration)))

    def dead_loads(self) -> DeadLoads:
        return DeadLoads(acceleration=self.acceleration)


class GravityParameters(Struct):
    """The acceleration [m/s^2] in the world frame."""

    acceleration: Triple


@adds_wrench(GravityParameters)
@kernel
def gravity_wrench(gravity, nodes):
    """The force m R^T g on every node."""
    for pack in range(nodes.packs):
        at, down = (
            (pack * 6 + 3) * LANES,
            rotate_back(load_pose(nodes.pose, pack)[0], gravity.acceleration),
        )
        store3(
            nodes.wrench,
            at,
            plus(load3(nodes.wrench, at), times(load(nodes.mass, pack * LANES), down)),
        )


@register_effect("tip_load")
class TipLoad(Effect):
    """`[effects.tip_load]`: a wrench at the tip, and a payload fixed to it."""

    strengths: ClassVar[tuple[str, ...]] = ("force", "moment", "mass")
    is_uniform: ClassVar[bool] = True

    force: Triple = Field((0.0, 0.0, 0.0), description="force (x, y, z) at the tip [N]")
    moment: Triple = Field((0.0, 0.0, 0.0), description="moment (x, y, z) at the tip [N m]")
    frame: Literal["world", "tip"] = Field(
        "world", description="frame of their components: a dead load, or one that follows the tip"
    )
    mass: NotNegative = Field(0.0, description="mass of a payload with its centre at the tip [kg]")
    inertia: tuple[NotNegative, NotNegative, NotNegative] = Field(
        (0.0, 0.0, 0.0), description="its moments about the tip's axes [kg m^2]"
    )

    @property
    def acts(self) -> bool:
        return any(self.force) or any(self.moment)

    def parameters(self, rod: Discretisation) -> "TipLoadParameters":
        return TipLoadParameters(self.force, self.moment, self.frame == "tip")

    @property
    def payload(self) -> Array:
        return np.array([*self.inertia, self.mass, self.mass, self.mass])

    def potential_energy(self, arm: Configured) -> float:
        if any(self.moment) or (self.frame == "tip" and any(self.force)):
            raise ValueError(
                "a tip load with a moment, or one that follows the tip, has no potential energy"
            )
        return -float(arm.pose[-1, :3, 3] @ np.array(self.force))

    def dead_loads(self) -> DeadLoads | None:
        return (
            None
            if self.frame == "tip" and self.acts
            else DeadLoads(force=self.force, moment=self.moment)
        )


class TipLoadParameters(Struct):
    """The wrench and its frame; the payload is part of the rod's inertia."""

    force: Triple
    moment: Triple
    follows_tip: bool


@adds_wrench(TipLoadParameters)
@kernel
def tip_load_wrench(tip_load, nodes):
    """The wrench in the tip frame, on the last node."""
    moment, force = tip_load.moment, tip_load.force
    if not tip_load.follows_tip:
        R, _ = tip_pose_of(nodes.pose)
        moment, force = rotate_back(R, moment), rotate_back(R, force)
    at = (nodes.packs - 1) * 6 * LANES + LANES - 1
    for i in range(3):
        nodes.wrench[at + i * LANES] += moment[i]
        nodes.wrench[at + (3 + i) * LANES] += force[i]


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
    signal: Annotated[Pulse | Sine, Field(discriminator="type")] | None = Field(
        None, description="factor over time, by default 1"
    )


@register_effect("disturbance")
class Disturbance(Effect):
    """`[effects.disturbance]` with `[[effects.disturbance.loads]]`. Equilibria and resets are those
    under the loads at time 0."""

    is_uniform: ClassVar[bool] = True

    loads: tuple[Load, ...] = Field(min_length=1, description="the loads")

    def parameters(self, rod: Discretisation) -> "DisturbanceParameters":
        for i, push in enumerate(self.loads):
            if push.at > rod.length * (1.0 + SAME):
                problem = Problem(
                    ("effects", "disturbance", "loads", i, "at"),
                    f"is {push.at:g} m: the rod has {rod.length:g} m",
                )
                raise ConfigurationError([problem])
        rows = [
            [*(push.signal.numbers if push.signal else ALWAYS), *push.moment, *push.force]
            for push in self.loads
        ]
        shares = weights(rod, [push.at for push in self.loads])
        return DisturbanceParameters(
            np.array(rows), np.array([node_field(share[:, None]) for share in shares])
        )


def weights(rod: Discretisation, arc_length: ArrayLike, most: int = 4) -> Array:
    """Weights (m, nodes) with which values at the nodes, 0 at the base, add up to those at arc
    lengths (m,) [m], of the `most` nodes that are nearest: exact for functions that are cubic
    between the borders, or linear with 2."""
    places, same = np.append(0.0, rod.node), SAME * rod.length
    found = np.zeros((np.size(arc_length), places.size))
    for row, at in zip(found, np.ravel(arc_length), strict=True):
        border = min(
            int(np.searchsorted(rod.borders, at + same, side="right")), rod.borders.size - 1
        )
        inside = np.flatnonzero(
            (places > rod.borders[border - 1] - same) & (places < rod.borders[border] + same)
        )
        piece = inside[
            np.append(True, np.diff(places[inside]) > same)
        ]  # without the empty intervals at the tip
        nearest = piece[np.argsort(np.abs(places[piece] - at), kind="stable")[:most]]
        away = (places[nearest] - min(at, places[piece[-1]])) / (
            places[piece[1]] - places[piece[0]]
        )
        powers = np.arange(nearest.size)
        row[nearest] = np.linalg.solve(away ** powers[:, None], powers == 0)
    return found[:, 1:]


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
            share = factor * load(weight, pack * LANES)
            R, _ = load_pose(nodes.pose, pack)
            here = (
                rotate_back(R, times(share, (row[3], row[4], row[5]))),
                rotate_back(R, times(share, (row[6], row[7], row[8]))),
            )
            store6(nodes.wrench, pack, twist_sum(load6(nodes.wrench, pack), here))


@limits_step(DisturbanceParameters)
@kernel
def limit_disturbance_step(disturbance, nodes, longest):
    """Steps follow the signals: up to a fraction of the period of a sine, and to the next end of a
    pulse."""
    for i in range(disturbance.loads.shape[0]):
        row = disturbance.loads[i]
        if row[0] == SINE:
            allow_turning(row[1], longest)
        for edge in (row[1], row[2]):
            if row[0] == PULSE and edge > nodes.time + EDGE:
                longest[0] = min(longest[0], edge - nodes.time)


@register_effect("moving_base")
class MovingBase(Effect):
    """`[effects.moving_base]`: motion of the base from its pose in the scene, along the world's
    axes and about a fixed axis.

    r(t) = r(0) + `velocity` t + `acceleration` t^2 / 2 + `amplitude` sin(2 pi f t) and R(t) =
    exp(theta `axis`) R(0), theta(t) = `angular_velocity` t + `angular_amplitude` sin(2 pi f t),
    with t the time of the simulation or of the episode. Base twist and acceleration enter the
    recursions (17)-(18) where they begin, from which inertia forces follow. Statics are those of
    the base at rest in its pose at t = 0.
    """

    velocity: Triple = Field(
        (0.0, 0.0, 0.0), description="velocity (x, y, z) at time 0 [m/s], world frame"
    )
    acceleration: Triple = Field(
        (0.0, 0.0, 0.0), description="constant acceleration (x, y, z) [m/s^2]"
    )
    amplitude: Triple = Field((0.0, 0.0, 0.0), description="amplitude (x, y, z) of the swing [m]")
    axis: Direction = Field(
        (0.0, 0.0, 1.0),
        description="axis about which it turns [-], world frame, of any length but zero",
    )
    angular_velocity: Turning = Field(0.0, description="constant angular velocity [rad/s]")
    angular_amplitude: Number = Field(0.0, description="amplitude of the turning swing [rad]")
    frequency: Frequency = Field(0.0, description="frequency f of both swings [Hz]")

    @model_validator(mode="after")
    def _swings(self) -> Self:
        if not self.frequency and (any(self.amplitude) or self.angular_amplitude):
            raise ValueError("frequency should be above 0 Hz where there is an amplitude")
        return self

    def parameters(self, rod: Discretisation) -> "MovingBaseParameters":
        x, y, z = (part / math.hypot(*self.axis) for part in self.axis)
        turning = (
            (x, y, z),
            self.angular_velocity,
            self.angular_amplitude,
            2.0 * math.pi * self.frequency,
        )
        return MovingBaseParameters(self.velocity, self.acceleration, self.amplitude, *turning)


class MovingBaseParameters(Struct):
    """The motion, with a unit axis and the angular frequency [rad/s]."""

    velocity: Triple
    acceleration: Triple
    amplitude: Triple
    axis: Triple
    angular_velocity: float
    angular_amplitude: float
    omega: float


@moves_base(MovingBaseParameters)
@kernel
def move(motion, base: Base):
    """Pose (R, r), spatial twist (w, r_dot - w x r) and its rate (w_dot, r_ddot - w_dot x r - w x
    r_dot)."""
    t, phase = base.time, motion.omega * base.time
    sine, cosine = math.sin(phase), math.cos(phase)
    angle = motion.angular_velocity * t + motion.angular_amplitude * sine
    rate = motion.angular_velocity + motion.angular_amplitude * motion.omega * cosine
    rate_dot = -motion.angular_amplitude * motion.omega * motion.omega * sine
    R_rest, r_rest = pose_of_base(base.pose)
    r = plus(
        plus(times(t, motion.velocity), times(0.5 * t * t, motion.acceleration)),
        times(sine, motion.amplitude),
    )
    r = plus(r_rest, r)
    r_dot = plus(
        plus(motion.velocity, times(t, motion.acceleration)),
        times(motion.omega * cosine, motion.amplitude),
    )
    r_ddot = minus(motion.acceleration, times(motion.omega * motion.omega * sine, motion.amplitude))
    w, w_dot = times(rate, motion.axis), times(rate_dot, motion.axis)
    v, v_dot = minus(r_dot, cross(w, r)), minus(minus(r_ddot, cross(w_dot, r)), cross(w, r_dot))
    R = matmul(
        exp_se3((times(angle, motion.axis), (0.0, 0.0, 0.0)), coefficients(angle * angle))[0],
        R_rest,
    )
    for i in range(9):
        base.pose[i] = R[i]
    for i in range(3):
        base.pose[9 + i] = r[i]
        base.twist[i], base.twist[3 + i] = w[i], v[i]
        base.acceleration[i], base.acceleration[3 + i] = w_dot[i], v_dot[i]


@limits_step(MovingBaseParameters)
@kernel
def limit_base_step(motion, nodes, longest):
    """Steps are short beside a period of the swing, and beside a turn."""
    allow_turning(motion.omega, longest)
    allow_turning(motion.angular_velocity, longest)
