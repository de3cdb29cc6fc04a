"""Hessian of the rod's energy under dead loads: assembly, block elimination from tip to base, and solution for further right-hand sides.

In the base frame a strain a of interval i displaces all nodes beyond by the twist W_a (Appendix C), so that the loads do the work
F . v + sum r_n x f_n . k + moment . k, (k, v) = W_a, with F the sum of the dead forces f_n on the nodes beyond, at r_n. A strain b nearer
to the base turns all of that, and the work changes by k_b . y_a with

    y_a = v x F + Q k,    Q = sum (r_n f_n^T - r_n . f_n I).

So all blocks of the Hessian between two intervals are products of rank 3, and eliminating the intervals from the tip on only adds to Q:
their compliance lets the loads give way. A dead moment has no potential: it adds k x moment to y_a as equations have it (`rows`), and
nothing to y_a as unknowns have it (`columns`).
"""

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
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_operators, magnus, start_of
from soft_tendon_env.mechanics.terms.transposed_kinematics import transposed_dexp, wrench_at_start, zanna_transposed

SIZE = 12  # unknowns of an interval: the scaled strains e at its two points


@kernel(inline=True)
def place(node):
    """Index in a field over points, or of poses, at which the interval that ends at a node begins."""
    return (node // LANES * SIZE) * LANES + node % LANES


@kernel(inline=True)
def _vector(field, at):
    return field[at], field[at + LANES], field[at + 2 * LANES]


@kernel(inline=True)
def _twist(field, at):
    return _vector(field, at), _vector(field, at + 3 * LANES)


@kernel(inline=True)
def _work(wrench, twist):
    return dot(wrench[0], twist[0]) + dot(wrench[1], twist[1])


@kernel(inline=True)
def _unit(i, size):
    """The twist whose component i has this size, and all others are 0."""
    a, b, c = size * (i == 0), size * (i == 1), size * (i == 2)
    return (a, b, c), (size * (i == 3), size * (i == 4), size * (i == 5))


@kernel(inline=True)
def _node_load(rod, loads, part, node, work):
    """Position of a node and the dead force on it, in the base frame."""
    force = times(part * rod.node_mass[node], loads.acceleration)
    if node == rod.node_mass.size - 1:
        force = plus(force, times(part, loads.force))
    return _vector(work.pose, place(node) + 9 * LANES), force


@kernel
def load_stress(rod, loads, part, work, out):
    """Generalised force of `part` of the loads on the strains over their weight, out (points x 6); after poses()."""
    moment, force = times(part, loads.moment), (0.0, 0.0, 0.0)
    for node in range(rod.length.size - 1, -1, -1):
        position, own = _node_load(rod, loads, part, node, work)
        moment, force = plus(moment, cross(position, own)), plus(force, own)
        at, mu, (R, r) = place(node), 2.0 * KAPPA * rod.length[node], start_of(node, work)
        xi_1, xi_2 = _twist(work.xi, at), _twist(work.xi, at + 6 * LANES)
        Omega = magnus(rod.length[node], xi_1, xi_2)
        t = transposed_dexp(Omega, coefficients(dot(Omega[0], Omega[0])), wrench_at_start(R, r, (moment, force)))
        first, second = zanna_transposed(-mu, xi_2, t), zanna_transposed(mu, xi_1, t)
        for i in range(3):
            out[at + i * LANES], out[at + (3 + i) * LANES] = first[0][i], first[1][i]
            out[at + (6 + i) * LANES], out[at + (9 + i) * LANES] = second[0][i], second[1][i]


@kernel
def _assemble_interval(rod, node, wrench, work):
    """The block of the Hessian of an interval, over the weight, but for y; and W of its unknowns, over the weight."""
    memory, at, h = work.under_loads, place(node), rod.length[node]
    D, W, Z = memory.inverse[node], memory.W, memory.Z
    (R, r), xi_1, xi_2 = start_of(node, work), _twist(work.xi, at), _twist(work.xi, at + 6 * LANES)
    mu, psi = 2.0 * KAPPA * h, wrench_at_start(R, r, wrench)
    W_1, W_2, A, C, Omega, c = interval_operators(h, 1.0, mu, xi_1, xi_2, R, r)
    t = transposed_dexp(Omega, c, psi)
    for a in range(SIZE):
        e = _unit(a % 6, rod.root_compliance[at + a * LANES])
        zanna = twist_sum(e, ad_apply(twist_scaled(mu, xi_1), e) if a >= 6 else ad_apply(twist_scaled(-mu, xi_2), e))
        moved = operator_apply(W_2[0], W_2[1], e) if a >= 6 else operator_apply(W_1[0], W_1[1], e)
        for i in range(3):
            Z[a, i], Z[a, 3 + i], W[a, i], W[a, 3 + i] = zanna[0][i], zanna[1][i], moved[0][i], moved[1][i]
    for a in range(SIZE):
        zanna = (Z[a, 0], Z[a, 1], Z[a, 2]), (Z[a, 3], Z[a, 4], Z[a, 5])
        for i in range(6):
            memory.bent[i] = 0.5 * h * _work(psi, dexp_dot_apply(Omega, zanna, c, _unit(i, 1.0)))
        e_a = _unit(a % 6, mu * rod.root_compliance[at + a * LANES])
        for b in range(SIZE):
            i, j = max(a % 6, b % 6), min(a % 6, b % 6)
            if a // 6 == b // 6:
                D[b, a] = work.factor[((2 * (node // LANES) + a // 6) * 21 + i * (i + 1) // 2 + j) * LANES + node % LANES]
            else:
                turn = _work(t, ad_apply(e_a, _unit(b % 6, rod.root_compliance[at + b * LANES])))
                D[b, a] = turn if a > b else -turn
            for i in range(6):
                D[b, a] -= memory.bent[i] * Z[b, i]


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


@kernel
def factorise_hessian(rod, loads, part, work):
    """Eliminates the intervals from tip to base; the least pivot. After poses(), with the scaled section stiffness in work.factor."""
    memory, least = work.under_loads, 1e300
    Q, rows_Q, W = memory.Q, memory.rows_Q, memory.W
    moment, force = times(part, loads.moment), (0.0, 0.0, 0.0)
    Q[:], rows_Q[:] = 0.0, 0.0
    for i in range(3):  # rows_Q = -moment~
        j, k = (i + 1) % 3, (i + 2) % 3
        rows_Q[j, k], rows_Q[k, j] = moment[i], -moment[i]
    for node in range(rod.length.size - 1, -1, -1):
        position, own = _node_load(rod, loads, part, node, work)
        moment, force = plus(moment, cross(position, own)), plus(force, own)
        for i in range(3):
            for j in range(3):
                change = position[i] * own[j] - (dot(position, own) if i == j else 0.0)
                Q[i, j] += change
                rows_Q[i, j] += change
        _assemble_interval(rod, node, (moment, force), work)
        D, turn, columns, answer = memory.inverse[node], memory.turn[node], memory.columns[node], memory.answer[node]
        for a in range(SIZE):
            side = cross((W[a, 3], W[a, 4], W[a, 5]), force)
            for i in range(3):
                column, row = side[i], side[i]
                for j in range(3):
                    column += Q[i, j] * W[a, j]
                    row += rows_Q[i, j] * W[a, j]
                turn[a, i], columns[a, i], memory.rows[a, i] = W[a, i], 0.5 * rod.length[node] * column, row
        for a in range(SIZE):
            for b in range(SIZE):
                D[b, a] -= turn[b, 0] * columns[a, 0] + turn[b, 1] * columns[a, 1] + turn[b, 2] * columns[a, 2]
        pivot = _invert(D)
        if not pivot >= least:
            least = pivot
        for i in range(3):
            for a in range(SIZE):
                answer[a, i] = 0.0
                for b in range(SIZE):
                    answer[a, i] += D[a, b] * memory.rows[b, i]
            for j in range(3):
                for a in range(SIZE):
                    Q[j, i] += columns[a, j] * answer[a, i]
                    rows_Q[i, j] += columns[a, j] * answer[a, i]
    return least


@kernel
def solve_hessian(rod, memory, x, start):
    """Solves H x = b in place of b, a field over points from x[start] on."""
    nodes = rod.length.size
    p, q, r = 0.0, 0.0, 0.0
    for node in range(nodes - 1, -1, -1):
        at, D, turn, columns, y = start + place(node), memory.inverse[node], memory.turn[node], memory.columns[node], memory.y
        for a in range(SIZE):
            y[a] = x[at + a * LANES] + turn[a, 0] * p + turn[a, 1] * q + turn[a, 2] * r
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
            x[at + a * LANES] = own
            p, q, r = p + half * turn[a, 0] * own, q + half * turn[a, 1] * own, r + half * turn[a, 2] * own
