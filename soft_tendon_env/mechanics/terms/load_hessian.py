"""Hessian of the rod's energy under dead loads: assembly, block elimination from tip to base, and solution for further right-hand sides.

A strain of an interval moves all nodes beyond by a twist W = (k, v), in the base frame (Appendix C), so that the loads do the work
F . v + (sum r_n x f_n + moment) . k, with F the sum of the dead forces f_n on the nodes beyond, at r_n. Strains nearer to the base turn all
of that, which changes the generalised force by -y times their k, where

    y = F x v + Q k,    Q = sum (r_n . f_n I - r_n f_n^T).

So the blocks of the Hessian between intervals have rank 3, turn times y, and eliminating intervals from the tip on only adds to Q: they
give way. A dead moment has no potential: it adds moment x k to the y of equations (`rows`), and nothing to that of unknowns (`columns`).
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import (
    ad_apply,
    coefficients,
    cross,
    dexp_dot_apply,
    dot,
    operator_apply,
    plus,
    times,
    twist_scaled,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import add_product
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_operators, magnus, pose_at, twist_at
from soft_tendon_env.mechanics.terms.transposed_kinematics import add_at, transposed_dexp, wrench_at_start, zanna_transposed

SIZE = 12  # unknowns of an interval: the scaled strains e at its two points


@kernel(inline=True)
def place(node):
    """Index in a field over points at which the unknowns of the interval begin that ends at a node, LANES apart."""
    return (node // LANES * SIZE) * LANES + node % LANES


@kernel(inline=True)
def _row(field, a):
    return (field[a, 0], field[a, 1], field[a, 2]), (field[a, 3], field[a, 4], field[a, 5])


@kernel(inline=True)
def _work(wrench, twist):
    return dot(wrench[0], twist[0]) + dot(wrench[1], twist[1])


@kernel(inline=True)
def _unit(a, size):
    """Strain of this size of the unknown a, as a twist."""
    i = a % 6
    return (size * (i == 0), size * (i == 1), size * (i == 2)), (size * (i == 3), size * (i == 4), size * (i == 5))


@kernel(inline=True)
def _strains(node, work):
    """Strains at the two points of the interval that ends at a node."""
    block, own = node // LANES * 2, node % LANES
    return twist_at(work.xi, block, own), twist_at(work.xi, block + 1, own)


@kernel(inline=True)
def _node_load(rod, strain, part, node, work):
    """Position of a node, and `part` of the dead force on it."""
    force = times(part * rod.node_mass[node], strain.acceleration)
    if node == rod.node_mass.size - 1:
        force = plus(force, times(part, strain.force))
    return pose_at(work.pose, node)[1], force


@kernel
def load_stress(rod, strain, part, work, out):
    """Generalised force of `part` of the loads on the strains over their weight, out (points x 6); after poses()."""
    moment, force = times(part, strain.moment), (0.0, 0.0, 0.0)
    out[:] = 0.0
    for node in range(rod.length.size - 1, -1, -1):
        position, own = _node_load(rod, strain, part, node, work)
        moment, force = plus(moment, cross(position, own)), plus(force, own)
        (R, r), (xi_1, xi_2), mu = pose_at(work.start, node), _strains(node, work), 2.0 * KAPPA * rod.length[node]
        Omega = magnus(rod.length[node], xi_1, xi_2)
        t = transposed_dexp(Omega, coefficients(dot(Omega[0], Omega[0])), wrench_at_start(R, r, (moment, force)))
        add_at(out, place(node), zanna_transposed(-mu, xi_2, t))
        add_at(out, place(node) + 6 * LANES, zanna_transposed(mu, xi_1, t))


@kernel
def _assemble_interval(rod, node, wrench, work, D, Z):
    """Hessian D (12, 12) of an interval over the weight, but for what y makes of it; its unknowns as derivatives of Omega, Z (12, 6), over
    the weight too. Returns the operator from these to W."""
    at, h, (R, r), (xi_1, xi_2) = place(node), rod.length[node], pose_at(work.start, node), _strains(node, work)
    mu, psi = 2.0 * KAPPA * h, wrench_at_start(R, r, wrench)
    _, _, A, C, Omega, c = interval_operators(h, 1.0, mu, xi_1, xi_2, R, r)
    t = transposed_dexp(Omega, c, psi)
    for a in range(SIZE):
        e = _unit(a, rod.root_compliance[at + a * LANES])
        x = twist_sum(e, ad_apply(twist_scaled(mu, xi_1), e) if a >= 6 else ad_apply(twist_scaled(-mu, xi_2), e))
        for i in range(3):
            Z[a, i], Z[a, 3 + i] = x[0][i], x[1][i]
    for a in range(SIZE):
        for b in range(SIZE):
            D[b, a] = -0.5 * h * _work(psi, dexp_dot_apply(Omega, _row(Z, a), c, _row(Z, b)))
            first, second = min(a, b), max(a, b)
            if first // 6 == second // 6:
                i, j = second % 6, first % 6
                entry = (2 * (node // LANES) + a // 6) * 21 + i * (i + 1) // 2 + j
                D[b, a] += work.factor[entry * LANES + node % LANES]
            else:  # Z_2 = 1 + mu ad_xi1 depends on the other strain
                e_1, e_2 = _unit(first, rod.root_compliance[at + first * LANES]), _unit(second, rod.root_compliance[at + second * LANES])
                D[b, a] -= mu * _work(t, ad_apply(e_1, e_2))
    return A, C


@kernel
def _invert(D):
    """Overwrites a matrix by its inverse, by elimination without pivoting; the least pivot, NaN if there is one."""
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
    """Eliminates the intervals from tip to base; the least pivot. After poses(), with the scaled section stiffness in work.factor."""
    memory, least, Z, rows = work.under_loads, 1e300, np.empty((SIZE, 6)), np.empty((SIZE, 3))
    Q, rows_Q = np.zeros((3, 3)), np.zeros((3, 3))
    moment, force = times(part, strain.moment), (0.0, 0.0, 0.0)
    for i in range(3):  # rows_Q = moment~
        j, k = (i + 1) % 3, (i + 2) % 3
        rows_Q[k, j], rows_Q[j, k] = moment[i], -moment[i]
    for node in range(rod.length.size - 1, -1, -1):
        position, own = _node_load(rod, strain, part, node, work)
        moment, force = plus(moment, cross(position, own)), plus(force, own)
        for i in range(3):
            for j in range(3):
                change = (dot(position, own) if i == j else 0.0) - position[i] * own[j]
                Q[i, j], rows_Q[i, j] = Q[i, j] + change, rows_Q[i, j] + change
        D, turn, columns, answer = memory.inverse[node], memory.turn[node], memory.columns[node], memory.answer[node]
        A, C = _assemble_interval(rod, node, (moment, force), work, D, Z)
        for a in range(SIZE):
            k, v = operator_apply(A, C, _row(Z, a))
            for i in range(3):
                turn[a, i], answer[a, i], side = k[i], 0.0, cross(force, v)[i]
                columns[a, i] = 0.5 * rod.length[node] * (side + Q[i, 0] * k[0] + Q[i, 1] * k[1] + Q[i, 2] * k[2])
                rows[a, i] = -(side + rows_Q[i, 0] * k[0] + rows_Q[i, 1] * k[1] + rows_Q[i, 2] * k[2])
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
    """Strains C^1/2 H^-1 C^1/2 of wrenches, in place of these, a field over points from x[start] on."""
    nodes, y, c = rod.length.size, np.empty(SIZE), rod.root_compliance
    p, q, r = 0.0, 0.0, 0.0
    for node in range(nodes - 1, -1, -1):
        at, D, turn, columns = start + place(node), memory.inverse[node], memory.turn[node], memory.columns[node]
        for a in range(SIZE):
            y[a] = c[at - start + a * LANES] * x[at + a * LANES] - turn[a, 0] * p - turn[a, 1] * q - turn[a, 2] * r
        for a in range(SIZE):
            own = 0.0
            for b in range(SIZE):
                own += D[a, b] * y[b]
            x[at + a * LANES] = own
            p, q, r = p + columns[a, 0] * own, q + columns[a, 1] * own, r + columns[a, 2] * own
    p, q, r = 0.0, 0.0, 0.0
    for node in range(nodes):
        at, half, turn, answer = start + place(node), 0.5 * rod.length[node], memory.turn[node], memory.answer[node]
        s, t, u = p, q, r
        for a in range(SIZE):
            own = x[at + a * LANES] + answer[a, 0] * s + answer[a, 1] * t + answer[a, 2] * u
            x[at + a * LANES] = c[at - start + a * LANES] * own
            p, q, r = p + half * turn[a, 0] * own, q + half * turn[a, 1] * own, r + half * turn[a, 2] * own
