"""Loads: gravity, a wrench and a payload at the tip, disturbances, and a moving base.

Disturbances are wrenches at points of the rod that change in time.

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
    twist_of,
    write_twist,
)
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, store3
from soft_tendon_env.mechanics.effects import (
    Base,
    adds_wrench,
    allow_turning,
    limits_step,
    moves_base,
)
from soft_tendon_env.mechanics.terms.kinematics import load_pose, pose_of_base, tip_pose_of
from soft_tendon_env.mechanics.terms.transposed_kinematics import (
    add_at,
    add_to_block,
    index_of_node,
)
from soft_tendon_env.mechanics.types import IntVector, node_field
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.registry import register
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
PULSE = 1.0
SINE = 2.0
"""Kinds of signals, the first number of a load's row."""
ALWAYS = (0.0, 0.0, 0.0)
"""Numbers of a load without a signal."""


@register("effect", "gravity")
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
        R, _ = load_pose(nodes.pose, pack)
        down = rotate_back(R, gravity.acceleration)
        weight = times(load(nodes.mass, pack * LANES), down)
        force_at = (pack * 6 + 3) * LANES
        others = load3(nodes.wrench, force_at)
        store3(nodes.wrench, force_at, plus(others, weight))


@register("effect", "tip_load")
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
        follows = self.frame == "tip" and any(self.force)
        if any(self.moment) or follows:
            raise ValueError(
                "a tip load with a moment, or one that follows the tip, has no potential energy"
            )
        tip = arm.pose[-1, :3, 3]
        return -float(tip @ np.array(self.force))

    def dead_loads(self) -> DeadLoads | None:
        if self.frame == "tip" and self.acts:
            return None
        return DeadLoads(force=self.force, moment=self.moment)


class TipLoadParameters(Struct):
    """The wrench and its frame; the payload is part of the rod's inertia."""

    force: Triple
    moment: Triple
    follows_tip: bool


@adds_wrench(TipLoadParameters)
@kernel
def tip_load_wrench(tip_load, nodes):
    """The wrench in the tip frame, on the last node."""
    moment = tip_load.moment
    force = tip_load.force
    if not tip_load.follows_tip:
        R, _ = tip_pose_of(nodes.pose)
        moment = rotate_back(R, moment)
        force = rotate_back(R, force)
    tip = nodes.packs * LANES - 1
    add_at(nodes.wrench, index_of_node(tip), (moment, force))


class Pulse(Configuration):
    """Factor 1 for a time, before and after it 0.

    Integrator steps end where it begins and ends.
    """

    type: Literal["pulse"] = "pulse"
    start: Positive = Field(description="begin [s], after 0")
    duration: Positive = Field(description="duration [s]")

    @property
    def numbers(self) -> Triple:
        return PULSE, self.start, self.start + self.duration


class Sine(Configuration):
    """Factor sin(2 pi frequency t + phase).

    The arm rests under its value at time 0.
    """

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


@register("effect", "disturbance")
class Disturbance(Effect):
    """`[effects.disturbance]`: loads at points of the rod, in `[[effects.disturbance.loads]]`.

    Equilibria and resets are those under the loads at time 0.
    """

    is_uniform: ClassVar[bool] = True

    loads: tuple[Load, ...] = Field(min_length=1, description="the loads")

    def parameters(self, rod: Discretisation) -> "DisturbanceParameters":
        rows = []
        furthest = rod.length * (1.0 + SAME)
        for i, push in enumerate(self.loads):
            if push.at > furthest:
                key = ("effects", "disturbance", "loads", i, "at")
                text = f"is {push.at:g} m: the rod has {rod.length:g} m"
                raise ConfigurationError([Problem(key, text)])
            signal = push.signal.numbers if push.signal else ALWAYS
            rows.append([*signal, *push.moment, *push.force])
        places = [push.at for push in self.loads]
        shares = weights(rod, places)
        packed = [node_field(share[:, None]) for share in shares]
        return DisturbanceParameters(np.array(rows), np.array(packed))


def weights(rod: Discretisation, arc_length: ArrayLike, most: int = 4) -> Array:
    """Weights (m, nodes) with which values at the nodes add up to those at arc lengths.

    Values are 0 at the base, arc lengths (m,) [m]. The weights are of the `most` nodes that are
    nearest: exact for functions that are cubic between the borders, or linear with 2.
    """
    places = np.append(0.0, rod.node)
    same = SAME * rod.length
    result = np.zeros((np.size(arc_length), places.size))
    for row, place in zip(result, np.ravel(arc_length), strict=True):
        piece = _nodes_of_piece(rod, places, place, same)
        piece_places = places[piece]
        last = piece_places[-1]
        # weights that are exact for powers of the distance from the place
        distance = np.abs(piece_places - place)
        order = np.argsort(distance, kind="stable")
        nearest = piece[order[:most]]
        unit = piece_places[1] - piece_places[0]
        away = (places[nearest] - min(place, last)) / unit
        powers = np.arange(nearest.size)
        vandermonde = away ** powers[:, None]
        row[nearest] = np.linalg.solve(vandermonde, powers == 0)
    return result[:, 1:]


def _nodes_of_piece(rod: Discretisation, places: Array, place: float, same: float) -> IntVector:
    """Nodes, of those at places (nodes + 1,) [m], of the smooth piece that holds a place [m].

    The empty intervals at the tip are left out. Places up to `same` [m] apart are one.
    """
    after = int(np.searchsorted(rod.borders, place + same, side="right"))
    border = min(after, rod.borders.size - 1)
    begin = rod.borders[border - 1] - same
    end = rod.borders[border] + same
    is_inside = (places > begin) & (places < end)
    inside = np.flatnonzero(is_inside)
    distances = np.diff(places[inside])
    is_new = np.append(True, distances > same)
    return inside[is_new]


class DisturbanceParameters(Struct):
    """The loads, and their weights at the nodes."""

    loads: Array  # loads x 9: signal (3), moment, force
    weight: Array  # loads x nodes


@kernel
def signal_at(row, time):
    """The signal of a load, from the first three numbers of its row, at a time [s]."""
    if row[0] == PULSE:
        begin = row[1]
        end = row[2]
        return 1.0 if begin <= time + EDGE < end else 0.0
    if row[0] == SINE:
        omega = row[1]
        phase = row[2]
        return math.sin(omega * time + phase)
    return 1.0


@adds_wrench(DisturbanceParameters)
@kernel
def disturbance_wrench(disturbance, nodes):
    """All loads at the nodes' time."""
    for i in range(disturbance.loads.shape[0]):
        row = disturbance.loads[i]
        weight = disturbance.weight[i]
        factor = signal_at(row, nodes.time)
        if factor == 0.0:
            continue
        moment, force = twist_of(row[3:])
        for pack in range(nodes.packs):
            share = factor * load(weight, pack * LANES)
            R, _ = load_pose(nodes.pose, pack)
            # in the frames of the nodes
            moment_there = rotate_back(R, times(share, moment))
            force_there = rotate_back(R, times(share, force))
            add_to_block(nodes.wrench, pack, (moment_there, force_there))


@limits_step(DisturbanceParameters)
@kernel
def limit_disturbance_step(disturbance, nodes, longest):
    """Limits steps so that they follow the signals.

    They last up to a fraction of the period of a sine, and to the next end of a pulse.
    """
    for i in range(disturbance.loads.shape[0]):
        row = disturbance.loads[i]
        kind = row[0]
        if kind == SINE:
            allow_turning(row[1], longest)
        if kind == PULSE:
            for edge in (row[1], row[2]):
                until = edge - nodes.time
                if edge > nodes.time + EDGE:
                    longest[0] = min(longest[0], until)


@register("effect", "moving_base")
class MovingBase(Effect):
    """`[effects.moving_base]`: motion of the base from its pose in the scene.

    It moves along the world's axes and about a fixed axis.

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
        length = math.hypot(*self.axis)
        return MovingBaseParameters(
            velocity=self.velocity,
            acceleration=self.acceleration,
            amplitude=self.amplitude,
            axis=tuple(part / length for part in self.axis),
            angular_velocity=self.angular_velocity,
            angular_amplitude=self.angular_amplitude,
            omega=2.0 * math.pi * self.frequency,
        )


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
    """Pose (R, r), spatial twist (w, r_dot - w x r) and its rate.

    The rate is (w_dot, r_ddot - w_dot x r - w x r_dot).
    """
    t = base.time
    omega = motion.omega
    sine = math.sin(omega * t)
    cosine = math.cos(omega * t)
    R_rest, r_rest = pose_of_base(base.pose)
    # theta, with its rates
    swing = motion.angular_amplitude
    angle = motion.angular_velocity * t + swing * sine
    rate = motion.angular_velocity + swing * omega * cosine
    rate_dot = -swing * omega * omega * sine
    w = times(rate, motion.axis)
    w_dot = times(rate_dot, motion.axis)
    turn_twist = (times(angle, motion.axis), (0.0, 0.0, 0.0))
    turn, _ = exp_se3(turn_twist, coefficients(angle * angle))
    R = matmul(turn, R_rest)
    # r, with its rates
    drift = times(t, motion.velocity)
    pushed = times(0.5 * t * t, motion.acceleration)
    smooth = plus(drift, pushed)
    r = plus(r_rest, plus(smooth, times(sine, motion.amplitude)))
    smooth_dot = plus(motion.velocity, times(t, motion.acceleration))
    swing_rate = omega * cosine
    r_dot = plus(smooth_dot, times(swing_rate, motion.amplitude))
    swing_rate_dot = omega * omega * sine
    r_ddot = minus(motion.acceleration, times(swing_rate_dot, motion.amplitude))
    # of the point of the base that is at the world's origin
    v = minus(r_dot, cross(w, r))
    turning = minus(r_ddot, cross(w_dot, r))
    v_dot = minus(turning, cross(w, r_dot))
    for i in range(9):
        base.pose[i] = R[i]
    for i in range(3):
        base.pose[9 + i] = r[i]
    write_twist((w, v), base.twist)
    write_twist((w_dot, v_dot), base.acceleration)


@limits_step(MovingBaseParameters)
@kernel
def limit_base_step(motion, nodes, longest):
    """Steps are short beside a period of the swing, and beside a turn."""
    allow_turning(motion.omega, longest)
    allow_turning(motion.angular_velocity, longest)
