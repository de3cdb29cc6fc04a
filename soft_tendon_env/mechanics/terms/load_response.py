"""How dead loads answer to displacements of the rod: linear-quadratic (Riccati) recursion from tip to base, 6x6, and back.

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

from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import (
    Ad_apply,
    ad_apply,
    cross,
    dexp_dot_apply,
    operator_apply,
    plus,
    twist_scaled,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_operators, load_pose, running_sum, zanna
from soft_tendon_env.tools.compilation import kernel

ROW = 8  # numbers of a row of 6, padded to whole packs
MATRIX = 6 * ROW
NO_COMPLIANCE = 1e-15  # part of a diagonal entry of Lambda that may be left by rounding


@kernel(inline=True)
def node_force(rod, strain, part, pack, i):
    """The dead force on node i of a pack (x, y, z) [N], in the base frame, as numbers."""
    m, force = part * rod.inertia[(pack * 6 + 3) * LANES + i], strain.acceleration
    x, y, z = m * force[0], m * force[1], m * force[2]
    if pack == rod.packs - 1 and i == LANES - 1:
        x, y, z = x + part * strain.force[0], y + part * strain.force[1], z + part * strain.force[2]
    return x, y, z


@kernel(inline=True)
def _vector_at(field, at):
    return field[at], field[at + LANES], field[at + 2 * LANES]


@kernel(inline=True)
def _position(work, pack, i):
    return _vector_at(work.pose, (pack * 12 + 9) * LANES + i)


@kernel(inline=True)
def _write_vector(x, out, at):
    out[at], out[at + LANES], out[at + 2 * LANES] = x


@kernel
def total_loads(rod, strain, part, work):
    """The wrench in the base frame of `part` of all loads from every node to the tip; after poses()."""
    total = work.inner.total
    moment = part * strain.moment[0], part * strain.moment[1], part * strain.moment[2]
    force = 0.0, 0.0, 0.0
    for pack in range(rod.packs - 1, -1, -1):
        for i in range(LANES - 1, -1, -1):
            f = node_force(rod, strain, part, pack, i)
            moment, force = plus(moment, cross(_position(work, pack, i), f)), plus(force, f)
            _write_vector(moment, total, pack * 6 * LANES + i)
            _write_vector(force, total, (pack * 6 + 3) * LANES + i)


@kernel
def motion_of_nodes(rod, work):
    """Twists in the base frame of the nodes and their derivative at xi_ddot = 0, from work.xi_dot; see sweep()."""
    inner = work.inner
    work.carry[:12] = 0.0
    for pack in range(rod.packs):
        at = 2 * pack * 6 * LANES
        h, xi_1, xi_2 = load(rod.length, pack * LANES), load6(work.xi, at), load6(work.xi, at + 6 * LANES)
        R, r = load_pose(work.start, pack * 12 * LANES)
        W_1, W_2, A, C, Omega, c = interval_operators(h, 0.5 * h, KAPPA * h * h, xi_1, xi_2, R, r)
        rate_1, rate_2 = load6(work.xi_dot, at), load6(work.xi_dot, at + 6 * LANES)
        growth = twist_sum(operator_apply(W_1[0], W_1[1], rate_1), operator_apply(W_2[0], W_2[1], rate_2))
        eta = running_sum(work.carry, 0, growth)
        Omega_dot = zanna(h, xi_1, xi_2, rate_1, rate_2)
        change = twist_sum(
            operator_apply(A, C, twist_scaled(2.0 * KAPPA * h * h, ad_apply(rate_1, rate_2))),
            Ad_apply(R, r, dexp_dot_apply(Omega, Omega_dot, c, Omega_dot)),
        )
        start = twist_sum(eta, twist_scaled(-1.0, growth))
        change = twist_sum(change, ad_apply(start, growth))
        eta_dot = running_sum(work.carry, 1, change)
        node_at = pack * 6 * LANES
        store6(inner.eta, node_at, eta)
        store6(inner.eta_dot, node_at, eta_dot)
        store6(inner.start, node_at, start)
        store6(inner.start_dot, node_at, twist_sum(eta_dot, twist_scaled(-1.0, change)))


@kernel
def total_load_rates(rod, strain, part, work):
    """First and second derivative of the total loads along the motion, of which only moments change; after motion_of_nodes()."""
    inner, once, twice = work.inner, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for pack in range(rod.packs - 1, -1, -1):
        for i in range(LANES - 1, -1, -1):
            f, r, at = node_force(rod, strain, part, pack, i), _position(work, pack, i), pack * 6 * LANES + i
            k, k_dot = _vector_at(inner.eta, at), _vector_at(inner.eta_dot, at)
            r_dot = plus(_vector_at(inner.eta, at + 3 * LANES), cross(k, r))
            r_ddot = plus(_vector_at(inner.eta_dot, at + 3 * LANES), plus(cross(k_dot, r), cross(k, r_dot)))
            once, twice = plus(once, cross(r_dot, f)), plus(twice, cross(r_ddot, f))
            _write_vector(once, inner.total_dot, at)
            _write_vector(twice, inner.total_ddot, at)


@kernel(inline=True)
def _place(node):
    """Where the six components of a node begin in a field over nodes."""
    return node // LANES * 6 * LANES + node % LANES


@kernel(inline=True)
def _product(a, a_at, b, b_at, out, out_at):
    """out = a b of matrices of 6 padded rows."""
    for i in range(6):
        left, right = spread(0.0), spread(0.0)
        for k in range(6):
            s = a[a_at + i * ROW + k]
            left = left + s * load(b, b_at + k * ROW)
            right = right + s * load(b, b_at + k * ROW + LANES)
        store(out, out_at + i * ROW, left)
        store(out, out_at + i * ROW + LANES, right)


@kernel(inline=True)
def _root(Lambda, at, K):
    """K lower triangular with K K^T = Lambda, semidefinite."""
    for i in range(6):
        for j in range(i + 1):
            total = Lambda[at + i * ROW + j]
            for k in range(j):
                total -= K[i * ROW + k] * K[j * ROW + k]
            if i > j:
                K[i * ROW + j] = total * K[j * ROW + 7]
            else:
                found = total > NO_COMPLIANCE * Lambda[at + i * ROW + i]
                K[i * ROW + i] = math.sqrt(total) if found else 0.0
                K[i * ROW + 7] = 1.0 / K[i * ROW + i] if found else 0.0
    for i in range(6):
        K[i * ROW + 7] = 0.0


@kernel(inline=True)
def _eliminate(rows):
    """Gauss-Jordan without pivoting on 6 rows of 2 ROW numbers: the right half becomes that times the left half's inverse. Least pivot."""
    least = 1e300
    for k in range(6):
        pivot = rows[k * 2 * ROW + k]
        if not pivot >= least:
            least = pivot
        for m in range(0, 2 * ROW, LANES):
            store(rows, k * 2 * ROW + m, (1.0 / pivot) * load(rows, k * 2 * ROW + m))
        for i in range(6):
            if i != k:
                s = rows[i * 2 * ROW + k]
                for m in range(0, 2 * ROW, LANES):
                    store(rows, i * 2 * ROW + m, load(rows, i * 2 * ROW + m) - s * load(rows, k * 2 * ROW + m))
    return least


@kernel(inline=True)
def _write_skew(x, s, out, at):
    """s x~ into 3 x 3 of a matrix of padded rows."""
    out[at + 1], out[at + 2], out[at + ROW + 2] = -s * x[2], s * x[1], -s * x[0]
    out[at + ROW], out[at + 2 * ROW], out[at + 2 * ROW + 1] = s * x[2], -s * x[1], s * x[0]


@kernel(inline=True)
def _add_node(r, f, S):
    """S += the second variation of the work of a dead force f at r, Q = (r.f 1 - (r f^T + f r^T)/2, f~/2; -f~/2, 0)."""
    work = r[0] * f[0] + r[1] * f[1] + r[2] * f[2]
    for i in range(3):
        S[i * ROW + i] += work
        for j in range(3):
            S[i * ROW + j] -= 0.5 * (r[i] * f[j] + f[i] * r[j])
    x, y, z = 0.5 * f[0], 0.5 * f[1], 0.5 * f[2]
    S[4], S[5], S[ROW + 5] = S[4] - z, S[5] + y, S[ROW + 5] - x
    S[ROW + 3], S[2 * ROW + 3], S[2 * ROW + 4] = S[ROW + 3] + z, S[2 * ROW + 3] - y, S[2 * ROW + 4] + x
    S[3 * ROW + 1], S[3 * ROW + 2], S[4 * ROW + 2] = S[3 * ROW + 1] + z, S[3 * ROW + 2] - y, S[4 * ROW + 2] + x
    S[4 * ROW], S[5 * ROW], S[5 * ROW + 1] = S[4 * ROW] - z, S[5 * ROW] + y, S[5 * ROW + 1] - x


@kernel
def factorise_response(rod, strain, part, work):
    """The recursion for S: E, E S, Pi and N of every interval, with p = Pi X - E (S growth + s), X' = N X + ..; the least pivot."""
    inner = work.inner
    S, K, rows, B = inner.S, inner.K, inner.rows, inner.rows[192:]
    S[:] = 0.0
    last, least = rod.packs * LANES - 1, 1e300
    _add_node(_position(work, rod.packs - 1, LANES - 1), node_force(rod, strain, part, rod.packs - 1, LANES - 1), S)
    moment = part * strain.moment[0], part * strain.moment[1], part * strain.moment[2]
    for i in range(3):  # S -= moment~ / 2
        j, k = (i + 1) % 3, (i + 2) % 3
        S[j * ROW + k] += 0.5 * moment[i]
        S[k * ROW + j] -= 0.5 * moment[i]
    for node in range(last, -1, -1):
        at, total_at = node * MATRIX, _place(node)
        _root(inner.Lambda, at, K)
        _product(S, 0, K, 0, rows, 96)
        for i in range(6):
            for m in range(0, ROW, LANES):
                total = spread(0.0)
                for k in range(i, 6):
                    total = total + K[k * ROW + i] * load(rows, 96 + k * ROW + m)
                store(rows, i * 2 * ROW + m, total)
            rows[i * 2 * ROW + i] += 1.0
            for k in range(ROW):
                rows[i * 2 * ROW + ROW + k] = K[k * ROW + i] if k < 6 else 0.0
        # the products S K are needed again, so they lie beyond the 96 numbers of the rows
        pivot = _eliminate(rows)
        if not pivot >= least:
            least = pivot
        for i in range(6):
            for m in range(0, ROW, LANES):
                total = spread(0.0)
                for k in range(6):
                    total = total - rows[96 + i * ROW + k] * load(rows, k * 2 * ROW + ROW + m)
                store(inner.E, at + i * ROW + m, total)
            inner.E[at + i * ROW + i] += 1.0
        _product(inner.E, at, S, 0, inner.ES, at)
        B[:MATRIX] = 0.0
        m, f = _vector_at(inner.total, total_at), _vector_at(inner.total, total_at + 3 * LANES)
        _write_skew(m, 0.5, B, 0)
        _write_skew(f, 0.5, B, 3)
        _write_skew(f, 0.5, B, 3 * ROW)
        _product(inner.E, at, B, 0, inner.Pi, at)
        for k in range(0, MATRIX, LANES):
            store(inner.Pi, at + k, load(inner.Pi, at + k) - load(inner.ES, at + k))
        _product(inner.Lambda, at, inner.Pi, at, inner.N, at)
        for i in range(6):
            inner.N[at + i * ROW + i] += 1.0
        _product(B, 0, inner.N, at, S, 0)
        for k in range(0, MATRIX, LANES):
            store(S, k, load(S, k) - load(inner.Pi, at + k))
        if node > 0:
            pack, i = (node - 1) // LANES, (node - 1) % LANES
            _add_node(_position(work, pack, i), node_force(rod, strain, part, pack, i), S)
    return least


@kernel
def solve_response(rod, work, width, stride):
    """The wrenches p that answer to inner.growth, into inner.answer, for columns 0..width-1 (whole packs) of `stride`."""
    inner = work.inner
    growth, answer, sums = inner.growth, inner.answer, inner.sums
    nodes = rod.packs * LANES
    for m in range(0, width, LANES):
        for i in range(6):
            store(sums, i * LANES, spread(0.0))
        for node in range(nodes - 1, -1, -1):
            at, column_at, total_at = node * MATRIX, node * 6 * stride + m, _place(node)
            for i in range(6):
                e = spread(0.0)
                for k in range(6):
                    e = e + inner.ES[at + i * ROW + k] * load(growth, column_at + k * stride)
                    e = e + inner.E[at + i * ROW + k] * load(sums, k * LANES)
                store(answer, column_at + i * stride, e)
            for i in range(6):
                y = load(growth, column_at + i * stride)
                for k in range(6):
                    y = y - inner.Lambda[at + i * ROW + k] * load(answer, column_at + k * stride)
                store(growth, column_at + i * stride, y)
            k0, k1, k2 = load(growth, column_at), load(growth, column_at + stride), load(growth, column_at + 2 * stride)
            v0 = load(growth, column_at + 3 * stride)
            v1, v2 = load(growth, column_at + 4 * stride), load(growth, column_at + 5 * stride)
            m_, f = _vector_at(inner.total, total_at), _vector_at(inner.total, total_at + 3 * LANES)
            m0, m1, m2, f0, f1, f2 = 0.5 * m_[0], 0.5 * m_[1], 0.5 * m_[2], 0.5 * f[0], 0.5 * f[1], 0.5 * f[2]
            store(sums, 0, load(answer, column_at) + m1 * k2 - m2 * k1 + f1 * v2 - f2 * v1)
            store(sums, LANES, load(answer, column_at + stride) + m2 * k0 - m0 * k2 + f2 * v0 - f0 * v2)
            store(sums, 2 * LANES, load(answer, column_at + 2 * stride) + m0 * k1 - m1 * k0 + f0 * v1 - f1 * v0)
            store(sums, 3 * LANES, load(answer, column_at + 3 * stride) + f1 * k2 - f2 * k1)
            store(sums, 4 * LANES, load(answer, column_at + 4 * stride) + f2 * k0 - f0 * k2)
            store(sums, 5 * LANES, load(answer, column_at + 5 * stride) + f0 * k1 - f1 * k0)
        for i in range(6):
            store(sums, i * LANES, spread(0.0))
        for node in range(nodes):
            at, column_at = node * MATRIX, node * 6 * stride + m
            for i in range(6):
                p, ahead = -load(answer, column_at + i * stride), load(growth, column_at + i * stride)
                for k in range(6):
                    X = load(sums, k * LANES)
                    p = p + inner.Pi[at + i * ROW + k] * X
                    ahead = ahead + inner.N[at + i * ROW + k] * X
                store(answer, column_at + i * stride, p)
                store(growth, column_at + i * stride, ahead)
            for i in range(6):
                store(sums, i * LANES, load(growth, column_at + i * stride))
