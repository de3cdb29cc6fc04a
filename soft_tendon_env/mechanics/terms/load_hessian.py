"""Hessian of the rod's energy under dead loads: assembly, block elimination from tip to base, and
solution for further right-hand sides.

A strain of an interval moves all nodes beyond by a twist W = (k, v), in the base frame (Appendix
C), so that the loads do the work F . v + (sum r_n x f_n + moment) . k, with F the sum of the dead
forces f_n on the nodes beyond, at r_n. Strains nearer to the base turn all of that, which changes
the generalised force by -y times their k, where

    y = F x v + Q k,    Q = sum (r_n . f_n I - r_n f_n^T).

So the blocks of the Hessian between intervals have rank 3, turn times y, and eliminating intervals
from the tip on only adds to Q: they give way. A dead moment has no potential: it adds moment x k to
the y of equations (`rows`), and nothing to that of unknowns (`columns`).
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import (
    coefficients,
    cross,
    dot,
    operator_apply,
    plus,
    scale_twist,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import add_product
from soft_tendon_env.mechanics.terms.kinematics import (
    KAPPA,
    interval_operators,
    magnus,
    pose_at,
    twist_at,
)
from soft_tendon_env.mechanics.terms.transposed_kinematics import (
    add_at,
    transposed_dexp,
    wrench_at_start,
    zanna_transposed,
)

SIZE = 12  # unknowns of an interval: the scaled strains e at its two points
DIFFERENCE = 1e-3  # [rad] of an interval's turn: errors of 1e-12 by truncation and by rounding
STENCIL = (-2.0, 1 / 12), (-1.0, -2 / 3), (1.0, 2 / 3), (2.0, -1 / 12)  # of the first derivative


@kernel(inline=True)
def place(node):
    """Index in a field over points at which the unknowns of the interval begin that ends at a node,
    LANES apart."""
    return (node // LANES * SIZE) * LANES + node % LANES


@kernel(inline=True)
def _strains(node, work):
    """Strains at the two points of the interval that ends at a node."""
    block, lane_index = node // LANES * 2, node % LANES
    return twist_at(work.xi, block, lane_index), twist_at(work.xi, block + 1, lane_index)


@kernel(inline=True)
def _node_load(rod, strain, part, node, work):
    """Position of a node, and `part` of the dead force on it."""
    force = times(part * rod.node_mass[node], strain.acceleration)
    if node == rod.node_mass.size - 1:
        force = plus(force, times(part, strain.force))
    return pose_at(work.pose, node)[1], force


@kernel
def _interval_stress(rod, node, xi_1, xi_2, wrench, work):
    """Generalised forces of a wrench beyond an interval, in the base frame, on the strains at its
    two points over their weight."""
    h, (R, r) = rod.length[node], pose_at(work.start, node)
    mu, Omega = 2.0 * KAPPA * h, magnus(h, xi_1, xi_2)
    t = transposed_dexp(Omega, coefficients(dot(Omega[0], Omega[0])), wrench_at_start(R, r, wrench))
    return zanna_transposed(-mu, xi_2, t), zanna_transposed(mu, xi_1, t)


@kernel
def load_stress(rod, strain, part, work, out):
    """Generalised force of `part` of the loads on the strains over their weight, out (points x 6);
    after poses()."""
    moment, force = times(part, strain.moment), (0.0, 0.0, 0.0)
    out[:] = 0.0
    for node in range(rod.length.size - 1, -1, -1):
        position, node_force = _node_load(rod, strain, part, node, work)
        moment, force = plus(moment, cross(position, node_force)), plus(force, node_force)
        xi_1, xi_2 = _strains(node, work)
        first, second = _interval_stress(rod, node, xi_1, xi_2, (moment, force), work)
        add_at(out, place(node), first)
        add_at(out, place(node) + 6 * LANES, second)


@kernel(inline=True)
def _unit(rod, node, a):
    """Strain of a point by the a-th unknown of an interval, as a twist."""
    i, c = a % 6, rod.root_compliance[place(node) + a * LANES]
    return (c * (i == 0), c * (i == 1), c * (i == 2)), (c * (i == 3), c * (i == 4), c * (i == 5))


@kernel
def _assemble_interval(rod, node, wrench, work, D):
    """Hessian D (12, 12) of an interval over the weight, but for what y makes of it: the section's,
    and differences of load stresses."""
    at, (xi_1, xi_2), block = place(node), _strains(node, work), 2 * (node // LANES)
    for a in range(SIZE):
        e, c, i = _unit(rod, node, a), rod.length[node] * rod.root_compliance[at + a * LANES], a % 6
        way = DIFFERENCE / c if c > 0.0 else 1.0
        for b in range(SIZE):
            j, D[b, a] = b % 6, 0.0
            if a // 6 == b // 6:
                entry = (block + a // 6) * 21 + max(i, j) * (max(i, j) + 1) // 2 + min(i, j)
                D[b, a] = work.factor[entry * LANES + node % LANES]
        for steps, share in STENCIL:
            moved = scale_twist(steps * way, e)
            first, second = (
                twist_sum(xi_1, moved) if a < 6 else xi_1,
                twist_sum(xi_2, moved) if a >= 6 else xi_2,
            )
            stress = _interval_stress(rod, node, first, second, wrench, work)
            for b in range(SIZE):
                D[b, a] -= (
                    rod.root_compliance[at + b * LANES]
                    * stress[b // 6][b % 6 // 3][b % 3]
                    * share
                    / way
                )


@kernel
def _invert(D):
    """Overwrites a matrix by its inverse, by elimination without pivoting; the least pivot, NaN if
    there is one."""
    least, n = 1e300, D.shape[0]
    for k in range(n):
        pivot = D[k, k]
        if not pivot >= least:
            least = pivot
        D[k, k] = 1.0
        for j in range(n):
            D[k, j] /= pivot
        for i in range(n):
            if i != k:
                share, D[i, k] = D[i, k], 0.0
                for j in range(n):
                    D[i, j] -= share * D[k, j]
    return least


@kernel(refcount=True)
def factorise_hessian(rod, strain, part, work):
    """Eliminates the intervals from tip to base; the least pivot. After poses(), with the scaled
    section stiffness in work.factor."""
    memory, least, rows = work.under_loads, 1e300, np.empty((SIZE, 3))
    Q, rows_Q = np.zeros((3, 3)), np.zeros((3, 3))
    moment, force = times(part, strain.moment), (0.0, 0.0, 0.0)
    for i in range(3):  # rows_Q = moment~
        j, k = (i + 1) % 3, (i + 2) % 3
        rows_Q[k, j], rows_Q[j, k] = moment[i], -moment[i]
    for node in range(rod.length.size - 1, -1, -1):
        position, node_force = _node_load(rod, strain, part, node, work)
        moment, force = plus(moment, cross(position, node_force)), plus(force, node_force)
        for i in range(3):
            for j in range(3):
                change = (dot(position, node_force) if i == j else 0.0) - position[i] * node_force[
                    j
                ]
                Q[i, j], rows_Q[i, j] = Q[i, j] + change, rows_Q[i, j] + change
        D, turn, columns, answer = (
            memory.inverse[node],
            memory.turn[node],
            memory.columns[node],
            memory.answer[node],
        )
        _assemble_interval(rod, node, (moment, force), work, D)
        (R, r), (xi_1, xi_2), h = pose_at(work.start, node), _strains(node, work), rod.length[node]
        W_1, W_2, _, _, _, _ = interval_operators(h, 1.0, 2.0 * KAPPA * h, xi_1, xi_2, R, r)
        for a in range(SIZE):
            A, C = W_1 if a < 6 else W_2
            k, v = operator_apply(A, C, _unit(rod, node, a))
            for i in range(3):
                turn[a, i], answer[a, i], side = k[i], 0.0, cross(force, v)[i]
                columns[a, i] = 0.5 * h * (side + Q[i, 0] * k[0] + Q[i, 1] * k[1] + Q[i, 2] * k[2])
                rows[a, i] = -(
                    side + rows_Q[i, 0] * k[0] + rows_Q[i, 1] * k[1] + rows_Q[i, 2] * k[2]
                )
        add_product(turn, columns.T, D)
        pivot = _invert(D)
        if not pivot >= least:
            least = pivot
        add_product(D, rows, answer)
        add_product(columns.T, answer, Q)
        add_product(answer.T, columns, rows_Q)
    return least


@kernel(refcount=True)
def solve_hessian(rod, memory, x, start):
    """Strains C^1/2 H^-1 C^1/2 of wrenches, in place of these, a field over points from x[start]
    on."""
    nodes, y, c = rod.length.size, np.empty(SIZE), rod.root_compliance
    p, q, r = 0.0, 0.0, 0.0
    for node in range(nodes - 1, -1, -1):
        at, D, turn, columns = (
            start + place(node),
            memory.inverse[node],
            memory.turn[node],
            memory.columns[node],
        )
        for a in range(SIZE):
            y[a] = (
                c[at - start + a * LANES] * x[at + a * LANES]
                - turn[a, 0] * p
                - turn[a, 1] * q
                - turn[a, 2] * r
            )
        for a in range(SIZE):
            strain = 0.0
            for b in range(SIZE):
                strain += D[a, b] * y[b]
            x[at + a * LANES] = strain
            p, q, r = (
                p + columns[a, 0] * strain,
                q + columns[a, 1] * strain,
                r + columns[a, 2] * strain,
            )
    p, q, r = 0.0, 0.0, 0.0
    for node in range(nodes):
        at, half, turn, answer = (
            start + place(node),
            0.5 * rod.length[node],
            memory.turn[node],
            memory.answer[node],
        )
        s, t, u = p, q, r
        for a in range(SIZE):
            strain = x[at + a * LANES] + answer[a, 0] * s + answer[a, 1] * t + answer[a, 2] * u
            x[at + a * LANES] = c[at - start + a * LANES] * strain
            p, q, r = (
                p + half * turn[a, 0] * strain,
                q + half * turn[a, 1] * strain,
                r + half * turn[a, 2] * strain,
            )
