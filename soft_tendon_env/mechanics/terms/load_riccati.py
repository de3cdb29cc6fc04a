"""Riccati recursion, 6x6, from tip to base and back: the wrenches by which dead loads answer to displacements of the rod.

In the base frame the nodes' displacements X (twists) add up, X_i+1 = X_i + gamma_i with gamma_i = growth_i + Lambda_i p_i: growth is what
an interval would do alone, Lambda its compliance and p the change of the wrench on its end,

    p_i = B_i+1 (X_i + X_i+1) / 2 + sum over the nodes n > i of K_n X_n,

where total_i is the wrench of all loads from node i to the tip, B X = ad_X^T total, and K_n X the change of the moment of node n's force
about the base as the node moves. With the ansatz that the sum, and B_i+1 X_i+1 / 2, is -(S X_i+1 + s), the recursion for S factorises this
system once; s belongs to a column. S is symmetric for forces: a dead moment, which has no potential, makes it unsymmetric from the
tip on, by the antisymmetric -moment~ / 2.

The Hessian of the rod's energy is positive definite if those of the intervals and all matrices 1 + K^T S K, K K^T = Lambda, are.
"""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import ad_apply, cross, dot, plus, times, twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_motion, interval_operators, load_pose, running_sum
from soft_tendon_env.mechanics.workspace import MATRIX, ROW

NO_COMPLIANCE = 1e-15  # part of a diagonal entry of Lambda that may be left by rounding


@kernel(inline=True)
def node_force(mass, loads, part, pack, i):
    """Dead force on node i of a pack (x, y, z) [N], in the base frame, as numbers."""
    force = times(part * mass[pack * LANES + i], loads.acceleration)
    if (pack + 1) * LANES == mass.size and i == LANES - 1:
        force = plus(force, times(part, loads.force))
    return force


@kernel(inline=True)
def _vector_at(field, at):
    return field[at], field[at + LANES], field[at + 2 * LANES]


@kernel(inline=True)
def _position(pose, pack, i):
    return _vector_at(pose, (pack * 12 + 9) * LANES + i)


@kernel(inline=True)
def _write_vector(x, out, at):
    out[at], out[at + LANES], out[at + 2 * LANES] = x


@kernel
def total_loads(mass, loads, part, pose, memory):
    """Wrenches in the base frame of `part` of all loads from every node to the tip; after poses()."""
    moment, force = times(part, loads.moment), (0.0, 0.0, 0.0)
    for pack in range(mass.size // LANES - 1, -1, -1):
        for i in range(LANES - 1, -1, -1):
            f = node_force(mass, loads, part, pack, i)
            moment, force = plus(moment, cross(_position(pose, pack, i), f)), plus(force, f)
            _write_vector(moment, memory.total, pack * 6 * LANES + i)
            _write_vector(force, memory.total, (pack * 6 + 3) * LANES + i)


@kernel
def motion_of_nodes(rod, work):
    """Twists in the base frame of the nodes and their derivative at xi_ddot = 0, from work.xi_dot; see sweep()."""
    memory = work.under_loads
    work.carry[:12] = 0.0
    for pack in range(rod.packs):
        at, node_at = 2 * pack * 6 * LANES, pack * 6 * LANES
        h, xi_1, xi_2 = load(rod.length, pack * LANES), load6(work.xi, at), load6(work.xi, at + 6 * LANES)
        R, r = load_pose(work.start, pack * 12 * LANES)
        operators = interval_operators(h, 0.5 * h, KAPPA * h * h, xi_1, xi_2, R, r)
        rate_1, rate_2 = load6(work.xi_dot, at), load6(work.xi_dot, at + 6 * LANES)
        growth, change = interval_motion(h, xi_1, xi_2, rate_1, rate_2, R, r, operators)
        eta = running_sum(work.carry, 0, growth)
        start = twist_sum(eta, twist_scaled(-1.0, growth))
        change = twist_sum(change, ad_apply(start, growth))
        eta_dot = running_sum(work.carry, 1, change)
        store6(memory.eta, node_at, eta)
        store6(memory.eta_dot, node_at, eta_dot)
        store6(memory.start, node_at, start)
        store6(memory.start_dot, node_at, twist_sum(eta_dot, twist_scaled(-1.0, change)))


@kernel
def total_load_rates(mass, loads, pose, memory):
    """First and second derivative of the total loads along the motion, of which only moments change; after motion_of_nodes()."""
    once, twice = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for pack in range(mass.size // LANES - 1, -1, -1):
        for i in range(LANES - 1, -1, -1):
            f, r, at = node_force(mass, loads, 1.0, pack, i), _position(pose, pack, i), pack * 6 * LANES + i
            k, k_dot = _vector_at(memory.eta, at), _vector_at(memory.eta_dot, at)
            r_dot = plus(_vector_at(memory.eta, at + 3 * LANES), cross(k, r))
            r_ddot = plus(_vector_at(memory.eta_dot, at + 3 * LANES), plus(cross(k_dot, r), cross(k, r_dot)))
            once, twice = plus(once, cross(r_dot, f)), plus(twice, cross(r_ddot, f))
            _write_vector(once, memory.total_dot, at)
            _write_vector(twice, memory.total_ddot, at)


@kernel(inline=True)
def _place(node):
    """Index at which the six components of a node begin in a field over nodes."""
    return node // LANES * 6 * LANES + node % LANES


@kernel(inline=True)
def _product(a, b, out):
    """Product out = a b of matrices of 6 padded rows."""
    for i in range(6):
        left, right = spread(0.0), spread(0.0)
        for k in range(6):
            s = a[i * ROW + k]
            left = left + s * load(b, k * ROW)
            right = right + s * load(b, k * ROW + LANES)
        store(out, i * ROW, left)
        store(out, i * ROW + LANES, right)


@kernel(inline=True)
def _root(Lambda, K):
    """Cholesky factor K, lower triangular with K K^T = Lambda, which may be semidefinite."""
    for i in range(6):
        for j in range(i + 1):
            total = Lambda[i * ROW + j]
            for k in range(j):
                total -= K[i * ROW + k] * K[j * ROW + k]
            if i > j:
                K[i * ROW + j] = total * K[j * ROW + 7]
            else:
                found = total > NO_COMPLIANCE * Lambda[i * ROW + i]
                K[i * ROW + i] = math.sqrt(total) if found else 0.0
                K[i * ROW + 7] = 1.0 / K[i * ROW + i] if found else 0.0
    for i in range(6):
        K[i * ROW + 7] = 0.0


@kernel(inline=True)
def _eliminate(rows):
    """Gauss-Jordan without pivoting on 6 rows of 2 ROW numbers: the right half becomes that times the left half's inverse. Least pivot."""
    least = 1e300
    for k in range(6):
        own = k * 2 * ROW
        pivot = rows[own + k]
        if not pivot >= least:
            least = pivot
        inverse = 1.0 / pivot
        first, second = inverse * load(rows, own), inverse * load(rows, own + LANES)
        third, fourth = inverse * load(rows, own + 2 * LANES), inverse * load(rows, own + 3 * LANES)
        for i in range(6):
            if i != k:
                at = i * 2 * ROW
                s = rows[at + k]
                store(rows, at, load(rows, at) - s * first)
                store(rows, at + LANES, load(rows, at + LANES) - s * second)
                store(rows, at + 2 * LANES, load(rows, at + 2 * LANES) - s * third)
                store(rows, at + 3 * LANES, load(rows, at + 3 * LANES) - s * fourth)
        store(rows, own, first)
        store(rows, own + LANES, second)
        store(rows, own + 2 * LANES, third)
        store(rows, own + 3 * LANES, fourth)
    return least


@kernel(inline=True)
def _write_skew(x, s, out, at):
    """Writes s x~ into 3 x 3 of a matrix of padded rows."""
    out[at + 1], out[at + 2], out[at + ROW + 2] = -s * x[2], s * x[1], -s * x[0]
    out[at + ROW], out[at + 2 * ROW], out[at + 2 * ROW + 1] = s * x[2], -s * x[1], s * x[0]


@kernel(inline=True)
def _add_node(r, f, out):
    """Adds the second variation of the work of a dead force f at r, Q = (r.f 1 - (r f^T + f r^T)/2, f~/2; -f~/2, 0)."""
    work, turn, side = dot(r, f), times(0.5, f), 3 * ROW
    for i in range(3):
        out[i * ROW + i] += work
        for j in range(3):
            out[i * ROW + j] -= 0.5 * (r[i] * f[j] + f[i] * r[j])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3  # f~ has f_i at (k, j) and -f_i at (j, k)
        out[k * ROW + 3 + j] += turn[i]
        out[j * ROW + 3 + k] -= turn[i]
        out[side + k * ROW + j] -= turn[i]
        out[side + j * ROW + k] += turn[i]


@kernel
def factorise_riccati(mass, loads, part, pose, memory):
    """Riccati recursion for S: E, E S, Pi and N of every interval, with p = Pi X - E (S growth + s), X' = N X + ..; the least pivot."""
    S, K, SK, B, rows = memory.S, memory.K, memory.SK, memory.B, memory.rows
    least, packs = 1e300, mass.size // LANES
    S[:] = 0.0
    _add_node(_position(pose, packs - 1, LANES - 1), node_force(mass, loads, part, packs - 1, LANES - 1), S)
    for i in range(3):  # S -= moment~ / 2
        j, k = (i + 1) % 3, (i + 2) % 3
        S[j * ROW + k] += 0.5 * part * loads.moment[i]
        S[k * ROW + j] -= 0.5 * part * loads.moment[i]
    for node in range(packs * LANES - 1, -1, -1):
        E, ES, Pi, N, Lambda = memory.E[node], memory.ES[node], memory.Pi[node], memory.N[node], memory.Lambda[node]
        _root(Lambda, K)
        _product(S, K, SK)
        for i in range(6):
            for m in range(0, ROW, LANES):
                row = spread(0.0)
                for k in range(6):
                    row = row + K[k * ROW + i] * load(SK, k * ROW + m)
                store(rows, i * 2 * ROW + m, row)
            rows[i * 2 * ROW + i] += 1.0
            for k in range(6):
                rows[i * 2 * ROW + ROW + k] = K[k * ROW + i]
        pivot = _eliminate(rows)
        if not pivot >= least:
            least = pivot
        for i in range(6):
            for m in range(0, ROW, LANES):
                row = spread(0.0)
                for k in range(6):
                    row = row - SK[i * ROW + k] * load(rows, k * 2 * ROW + ROW + m)
                store(E, i * ROW + m, row)
            E[i * ROW + i] += 1.0
        _product(E, S, ES)
        B[:] = 0.0
        force = _vector_at(memory.total, _place(node) + 3 * LANES)
        _write_skew(_vector_at(memory.total, _place(node)), 0.5, B, 0)
        _write_skew(force, 0.5, B, 3)
        _write_skew(force, 0.5, B, 3 * ROW)
        _product(E, B, Pi)
        for k in range(0, MATRIX, LANES):
            store(Pi, k, load(Pi, k) - load(ES, k))
        _product(Lambda, Pi, N)
        for i in range(6):
            N[i * ROW + i] += 1.0
        _product(B, N, S)
        for k in range(0, MATRIX, LANES):
            store(S, k, load(S, k) - load(Pi, k))
        if node > 0:
            pack, i = (node - 1) // LANES, (node - 1) % LANES
            _add_node(_position(pose, pack, i), node_force(mass, loads, part, pack, i), S)
    return least


@kernel(inline=True)
def _load_column(field, at, stride):
    k = load(field, at), load(field, at + stride), load(field, at + 2 * stride)
    return k, (load(field, at + 3 * stride), load(field, at + 4 * stride), load(field, at + 5 * stride))


@kernel
def solve_riccati(packs, memory, width, stride):
    """Wrenches p that answer to the growth of columns 0..width-1 (whole packs) of `stride`; overwrites the growth."""
    sums, growth, answer, nodes = memory.sums, memory.growth, memory.answer, packs * LANES
    for m in range(0, width, LANES):
        sums[:] = 0.0
        for node in range(nodes - 1, -1, -1):
            at, ES, E, Lambda = node * 6 * stride + m, memory.ES[node], memory.E[node], memory.Lambda[node]
            for i in range(6):
                e = spread(0.0)
                for k in range(6):
                    e = e + ES[i * ROW + k] * load(growth, at + k * stride) + E[i * ROW + k] * load(sums, k * LANES)
                store(answer, at + i * stride, e)
            for i in range(6):
                y = load(growth, at + i * stride)
                for k in range(6):
                    y = y - Lambda[i * ROW + k] * load(answer, at + k * stride)
                store(growth, at + i * stride, y)
            y, total_at = _load_column(growth, at, stride), _place(node)
            moment, force = times(0.5, _vector_at(memory.total, total_at)), times(0.5, _vector_at(memory.total, total_at + 3 * LANES))
            turned = plus(cross(moment, y[0]), cross(force, y[1])), cross(force, y[0])
            store6(sums, 0, twist_sum(_load_column(answer, at, stride), turned))
        sums[:] = 0.0
        for node in range(nodes):
            at, Pi, N = node * 6 * stride + m, memory.Pi[node], memory.N[node]
            for i in range(6):
                p, ahead = -load(answer, at + i * stride), load(growth, at + i * stride)
                for k in range(6):
                    X = load(sums, k * LANES)
                    p = p + Pi[i * ROW + k] * X
                    ahead = ahead + N[i * ROW + k] * X
                store(answer, at + i * stride, p)
                store(growth, at + i * stride, ahead)
            store6(sums, 0, _load_column(growth, at, stride))
