"""Cheap linear map of a held period and its adjoint: linearly implicit Euler with the matrices of one evaluation, two columns extrapolated.

Changes (dq, dv) of coordinates and rates and du of the command go over a period h to

    v' = A^-1 (M dv - h G dq + h B du),    q' = dq + h v',    A = M + h D + h^2 G

in one step, which is extrapolated as the integrator's: T = 2 T(h/2)^2 - T(h). Its adjoint takes cotangents of (q', v') to those of
(dq, dv, du) by three solutions with two factors, and no matrix of T is formed. Left out is how M, D, G and B change along the motion.
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, product, row_stride, solve_factored, solve_positive_definite
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.implicit_euler import linear_matrices
from soft_tendon_env.mechanics.motion.stages import evaluate_force
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.types import Arm, FloatVector
from soft_tendon_env.mechanics.workspace import zeros_of


class MapMemory(Struct):
    """Factors of A for the two step sizes, and the cotangents that go back through a period."""

    whole: FloatVector  # n rows, see linear: A(h)
    half: FloatVector  # A(h / 2)
    q: FloatVector  # (n) cotangents of q' and v', then those of dq and dv
    v: FloatVector  # (n)
    kept_q: FloatVector  # (n)
    kept_v: FloatVector  # (n)
    solution: FloatVector  # (n)
    impulse: np.ndarray  # (2, n) what a force that acts in the first or in the second half of the period changes


def make_map_memory(arm: Arm) -> MapMemory:
    """Zeroed MapMemory for one arm."""
    n = arm.strain.size
    return MapMemory(
        **zeros_of(
            ((n * row_stride(n + 1),), "whole half"),
            ((n,), "q v kept_q kept_v solution"),
            ((2, n), "impulse"),
        )
    )


@kernel
def factorise_step(with_inertia, balance, h, system, unused):
    """Factors A = M + h D + h^2 G of a substep of length h into `system`; a status."""
    n = unused.size
    stride, share = row_stride(n + 1), 1.0 if with_inertia else 0.0
    for i in range(n):
        for j in range(n):
            mass = share * balance.mass[i, j]
            system[i * stride + j] = mass + h * (balance.damping[i, j] + h * balance.stiffness[i, j])
        system[i * stride + n] = 0.0
    return OK if solve_positive_definite(system, n, unused) else NOT_POSITIVE


@kernel
def linearise(arm, method, u, motion, h, scratch, memory):
    """The matrices of an evaluation at a motion under the command u that acts, and factors for a period h; a status."""
    copy(motion.xi, scratch.work.xi)
    status = evaluate_force(arm, method, u, motion.q, motion.q_dot, motion.state, motion.clock[0], scratch)
    if status != OK:
        return status
    linear_matrices(arm, scratch)
    status = factorise_step(method.with_inertia, scratch.first, h, memory.whole, memory.solution)
    if status != OK:
        return status
    return factorise_step(method.with_inertia, scratch.first, 0.5 * h, memory.half, memory.solution)


@kernel
def transposed_step(with_inertia, balance, h, system, q, v, y):
    """Cotangents (q, v) of a substep's end to those of its beginning, in place; leaves y = A^-1 (v + h q)."""
    n = y.size
    for i in range(n):
        y[i] = v[i] + h * q[i]
    solve_factored(system, n, y)
    for i in range(n):
        v[i] = product(balance.mass[i], y) if with_inertia else 0.0
        for j in range(n):
            q[j] -= h * y[i] * balance.stiffness[i, j]


@kernel
def transposed_map(with_inertia, balance, h, memory):
    """Cotangents memory.q, memory.v of a period's end to those of its beginning, and of the forces in its two halves, memory.impulse."""
    q, v, kept_q, kept_v, y = memory.q, memory.v, memory.kept_q, memory.kept_v, memory.solution
    first, second = memory.impulse[0], memory.impulse[1]
    copy(q, kept_q)
    copy(v, kept_v)
    for i in range(y.size):
        first[i] = 0.0
    transposed_step(with_inertia, balance, 0.5 * h, memory.half, q, v, y)
    for i in range(y.size):
        second[i] = h * y[i]
    transposed_step(with_inertia, balance, 0.5 * h, memory.half, q, v, y)
    for i in range(y.size):
        first[i] = h * y[i]
    transposed_step(with_inertia, balance, h, memory.whole, kept_q, kept_v, y)
    for i in range(y.size):
        first[i] -= 0.5 * h * y[i]
        second[i] -= 0.5 * h * y[i]
        q[i] = 2.0 * q[i] - kept_q[i]
        v[i] = 2.0 * v[i] - kept_v[i]
