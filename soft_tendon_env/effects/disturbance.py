"""Disturbances: wrenches at points of the rod or distributed over parts of it, as functions of time: pushes, pulses, vibrations.

A load at a point between two nodes is shared between them by virtual work: the rod is taken to have one strain from node to node, the
pose is g_a exp(t Omega), and the nodes get the wrenches that do the same work in every virtual motion of theirs (T is the tangent operator
of exp, Ad* acts on wrenches):

    w_b = Ad*_exp(Omega)^-1 Z,   w_a = W - Z,   Z = t T_Omega^-T T_(t Omega)^T W,   W = Ad*_exp(t Omega) w.

Force and moment are exact, and so is the work in every strain that is constant between the nodes; the error is of third order in the
distance of the nodes for bending under a force, of second order for stretch and for moments. A distributed load is integrated over its
part of the rod with cubics through the velocities at the nodes, to fourth order; they do not cross the end of a tendon.
"""

import math
from collections.abc import Iterable
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, random_vector, register_effect, size
from soft_tendon_env.effects.nodes import add_wrench, pose_before, pose_of
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import (
    coefficients,
    columns_of,
    cross,
    dexp_operator,
    dot,
    exp_se3,
    log_se3,
    minus,
    plus,
    rotate,
    rotate_back,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.effect_parameters import Matrix
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

    @property
    def numbers(self) -> Triple:
        """The signal as three numbers: kind and parameters."""
        return CONSTANT, 0.0, 0.0


class Pulse(Configuration):
    """1 from `start` [s], after 0, for `duration` [s], else 0. Integrator steps end where it begins and ends."""

    type: Literal["pulse"] = "pulse"
    start: Positive
    duration: Positive

    @property
    def numbers(self) -> Triple:
        return PULSE, self.start, self.start + self.duration


class Sine(Configuration):
    """sin(2 pi frequency t + phase), `frequency` [Hz] and `phase` [deg]. The arm rests under its value at time 0."""

    type: Literal["sine"] = "sine"
    frequency: Annotated[Frequency, Field(gt=0)]
    phase: Number = 0.0

    @property
    def numbers(self) -> Triple:
        return SINE, 2.0 * np.pi * self.frequency, np.deg2rad(self.phase)


class Load(Configuration):
    """One load.

    Either at a point, the arc length `at` [m], with `force` [N] and `moment` [N m]; or distributed evenly `along` (from, to) [m], with
    `force` [N/m] and `moment` [N m/m], each (x, y, z) in `frame`: "world", or "body" (of the section, x along the rod). `signal` is the
    function of time that multiplies both: `{ type = "constant" }`, `{ type = "pulse", start, duration }` [s], or
    `{ type = "sine", frequency, phase }` [Hz, deg].
    """

    force: Triple = (0.0, 0.0, 0.0)
    moment: Triple = (0.0, 0.0, 0.0)
    at: NotNegative | None = None
    along: tuple[NotNegative, NotNegative] | None = None
    frame: Literal["world", "body"] = "world"
    signal: Annotated[Constant | Pulse | Sine, Field(discriminator="type")] = Constant()

    @model_validator(mode="after")
    def _has_a_place(self) -> Self:
        if (self.at is None) == (self.along is None):
            raise ValueError("should be at a point (`at`, an arc length [m]) or distributed (`along`, from and to [m])")
        if self.along is not None and not self.along[0] < self.along[1]:
            raise ValueError(f"has along = {list(self.along)}: it should end after it begins")
        return self

    @property
    def place(self) -> tuple[float, float]:
        """Arc lengths [m] of its ends."""
        return self.along if self.along is not None else (self.at or 0.0, self.at or 0.0)

    @property
    def numbers(self) -> tuple[float, ...]:
        """Signal, frame, moment and force as the kernel reads them."""
        return *self.signal.numbers, float(self.frame == "body"), *self.moment, *self.force


@register_effect("disturbance")
class Disturbance(Effect):
    """`[effects.disturbance]`.

    `loads`: a table per load, `[[effects.disturbance.loads]]`, see `Load`. Equilibria and resets are those under the loads at time 0.
    """

    loads: tuple[Load, ...] = Field(min_length=1)

    def parameters(self, rod: Discretisation) -> "DisturbanceParameters":
        for i, own in enumerate(self.loads):
            if own.place[1] > rod.length * (1.0 + SAME):
                key = ("effects", "disturbance", "loads", i, "at" if own.along is None else "along")
                raise ConfigurationError([Problem(key, f"ends at {own.place[1]:g} m: the rod has {rod.length:g} m")])
        points = [own for own in self.loads if own.along is None]
        lines = [own for own in self.loads if own.along is not None]
        return DisturbanceParameters(
            point=_table((*own.numbers, *between_nodes(rod, own.place[0])) for own in points),
            line=_table(own.numbers for own in lines),
            weight=_table(node_field(shares(rod, *own.place)[:, None]) for own in lines),
        )

    def potential_energy(self, arm: Configured) -> float:
        energy = 0.0
        for own in self.loads:
            if own.signal.type != "constant" or own.frame == "body" or any(own.moment):
                raise ValueError("a disturbance that changes in time, follows the rod or has a moment has no potential energy")
            force = np.array(own.force)
            if own.along is not None:
                energy -= float(shares(arm.rod, *own.place) @ (arm.pose[:, :3, 3] @ force))
                continue
            node, share = between_nodes(arm.rod, own.place[0])
            before, after = (np.eye(4) if i < 0 else arm.pose[i] for i in (int(node) - 1, int(node)))
            _, _, _, r = section_between(_numbers(before), _numbers(after), share)
            energy -= float(force @ (before[:3, :3] @ np.array(r) + before[:3, 3]))
        return energy

    def varied(self, random: np.random.Generator) -> "Disturbance":
        def drawn(own: Load) -> Load:
            return own.model_copy(update={"force": random_vector(random, own.force), "moment": random_vector(random, own.moment)})

        return Disturbance(loads=tuple(drawn(own) for own in self.loads))

    def covers(self, other: "Disturbance") -> bool:
        def alike(own: Load, needed: Load) -> bool:
            here, there = ((load.place, load.along is None, load.frame, load.signal) for load in (own, needed))
            return here == there and size(own.force) >= size(needed.force) and size(own.moment) >= size(needed.moment)

        return len(self.loads) == len(other.loads) and all(map(alike, self.loads, other.loads))


def _table(rows: Iterable[Iterable[float]]) -> Matrix:
    """Rows as a matrix, also where there are none."""
    table = [list(row) for row in rows]
    return Matrix(np.array(table, dtype=np.float64).reshape(len(table), -1 if table else 0))


def _numbers(pose: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """A pose (4, 4) as (R, r) of plain numbers."""
    return tuple(pose[:3, :3].ravel().tolist()), tuple(pose[:3, 3].tolist())


def between_nodes(rod: Discretisation, arc_length: float) -> tuple[float, float]:
    """The first node at or after a place, and which part of the way there from the node before, or from the base, the place is."""
    node = int(np.searchsorted(rod.node, min(arc_length, rod.length * (1.0 - SAME))))
    start = rod.node[node - 1] if node else 0.0
    return float(node), float(min((arc_length - start) / (rod.node[node] - start), 1.0))


def shares(rod: Discretisation, start: float, end: float) -> Array:
    """Weights (nodes,) [m] with which values at the nodes, 0 at the base, add up to an integral from start to end: exact for functions
    that are cubic between the borders, where there are four nodes."""
    places, weights, same = np.append(0.0, rod.node), np.zeros(rod.node.size + 1), SAME * rod.length
    for border, next_border in zip(rod.borders[:-1], rod.borders[1:], strict=True):
        inside = np.flatnonzero((places > border - same) & (places < next_border + same))
        piece = inside[np.append(True, np.diff(places[inside]) > same)]  # without the empty intervals at the tip
        stencil = min(4, piece.size)
        for i, (here, there) in enumerate(zip(places[piece[:-1]], places[piece[1:]], strict=True)):
            a, b = (float(np.clip(place, here, there) - here) / (there - here) for place in (start, end))
            own = piece[(first := min(max(i + 1 - stencil // 2, 0), piece.size - stencil)) : first + stencil]
            powers = np.arange(1, stencil + 1)
            values = ((places[own] - here) / (there - here)) ** (powers[:, None] - 1)
            weights[own] += (there - here) * np.linalg.solve(values, (b**powers - a**powers) / powers)
    return weights[1:]


class DisturbanceParameters(NamedTuple):
    """The loads: those at points, and distributed ones with their weights at the nodes."""

    point: Matrix  # loads x 12: signal (3), frame, moment, force, and where: the node after it, and the part of the way there
    line: Matrix  # loads x 10: the same without where
    weight: Matrix  # loads x nodes [m]


@kernel
def signal_at(row, time):
    """The signal of a load, from the first three numbers of its row, at a time [s]."""
    if row[0] == PULSE:
        return 1.0 if row[1] <= time + EDGE and time + EDGE < row[2] else 0.0
    if row[0] == SINE:
        return math.sin(row[1] * time + row[2])
    return 1.0


@kernel
def section_between(before, after, share):
    """Omega, its coefficients, and R, r of the section at a share of the way between two poses (R, r), in the frame of the first."""
    R, r = before
    S, s = after
    turned = columns_of(rotate_back(R, (S[0], S[3], S[6])), rotate_back(R, (S[1], S[4], S[7])), rotate_back(R, (S[2], S[5], S[8])))
    Omega = log_se3(turned, rotate_back(R, minus(s, r)))
    part = times(share, Omega[0]), times(share, Omega[1])
    R_section, r_section = exp_se3(part, coefficients(dot(part[0], part[0])))
    return Omega, part, R_section, r_section


@kernel
def shared_wrench(Omega, part, share, wrench):
    """Z: what of a wrench W at the section, in the frame of the first node, goes to the second one; still in that frame."""
    A, C = dexp_operator(part, coefficients(dot(part[0], part[0])))
    moment, force = plus(rotate_back(A, wrench[0]), rotate_back(C, wrench[1])), rotate_back(A, wrench[1])
    c = coefficients(dot(Omega[0], Omega[0]))
    _, D = dexp_operator(Omega, c)
    force = solve_transposed(Omega[0], c, force)
    moment = solve_transposed(Omega[0], c, minus(moment, rotate_back(D, force)))
    return times(share, moment), times(share, force)


@kernel
def solve_transposed(k, c, x):
    """A^-T x, A the rotational block of T; as in log_se3."""
    u = cross(k, x)
    return plus(x, plus(times(0.5, u), times(-0.5 * c.a1 / c.a, cross(k, u))))


@kernel
def add_at_point(row, nodes):
    """A load at a point, on the nodes beside it."""
    size, node, share = signal_at(row, nodes.time), int(row[10]), row[11]
    if size == 0.0:
        return
    before, after = pose_before(nodes, node), pose_of(nodes, node)
    Omega, part, R, r = section_between(before, after, share)
    moment, force = (size * row[4], size * row[5], size * row[6]), (size * row[7], size * row[8], size * row[9])
    if row[3] != 0.0:
        moment, force = rotate(R, moment), rotate(R, force)
    else:
        moment, force = rotate_back(before[0], moment), rotate_back(before[0], force)
    moment = plus(moment, cross(r, force))
    later = shared_wrench(Omega, part, share, (moment, force))
    if node > 0:
        add_wrench(nodes, node - 1, minus(moment, later[0]), minus(force, later[1]))
    R_all, r_all = exp_se3(Omega, coefficients(dot(Omega[0], Omega[0])))
    add_wrench(nodes, node, rotate_back(R_all, minus(later[0], cross(r_all, later[1]))), rotate_back(R_all, later[1]))


@kernel
def add_along(row, weight, nodes):
    """A distributed load, on all nodes."""
    size = signal_at(row, nodes.time)
    if size == 0.0:
        return
    moment, force = (size * row[4], size * row[5], size * row[6]), (size * row[7], size * row[8], size * row[9])
    for pack in range(nodes.packs):
        at, share = pack * 6 * LANES, load(weight, pack * LANES)
        before = load6(nodes.wrench, at)
        if row[3] != 0.0:
            store6(nodes.wrench, at, twist_sum(before, (times(share, moment), times(share, force))))
        else:
            R, _ = load_pose(nodes.pose, pack * 12 * LANES)
            own = times(share, rotate_back(R, moment)), times(share, rotate_back(R, force))
            store6(nodes.wrench, at, twist_sum(before, own))


@adds_wrench(DisturbanceParameters)
@kernel
def disturbance_wrench(disturbance, nodes):
    """All loads at the nodes' time."""
    for i in range(disturbance.point.shape[0]):
        add_at_point(disturbance.point[i], nodes)
    for i in range(disturbance.line.shape[0]):
        add_along(disturbance.line[i], disturbance.weight[i], nodes)


@kernel
def limit_by_signal(row, time, longest):
    """Lower `longest` (1,) to a fraction of the period of a sine, and to the next end of a pulse."""
    if row[0] == SINE:
        allow_turning(row[1], longest)
    if row[0] == PULSE:
        for edge in (row[1], row[2]):
            if edge > time + EDGE:
                longest[0] = min(longest[0], edge - time)


@limits_step(DisturbanceParameters)
@kernel
def limit_step(disturbance, nodes, longest):
    """Steps follow the signals of all loads."""
    for i in range(disturbance.point.shape[0]):
        limit_by_signal(disturbance.point[i], nodes.time, longest)
    for i in range(disturbance.line.shape[0]):
        limit_by_signal(disturbance.line[i], nodes.time, longest)
