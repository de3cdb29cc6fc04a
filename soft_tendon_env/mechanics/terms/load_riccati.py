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

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import ad_apply, cross, dot, plus, times, twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_motion, interval_operators, load_pose, running_sum

ROW = 8  # numbers of a row of 6, padded to whole packs
MATRIX = 6 * ROW
NO_COMPLIANCE = 1e-15  # part of a diagonal entry of Lambda that may be left by rounding


@kernel(inline=True)
def node_force(mass, loads, part, pack, i):
    """The dead force on node i of a pack (x, y, z) [N], in the base frame, as numbers."""
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
def total_loads(mass, loads, part, pose, places, memory):
    """The wrench in the base frame of `part` of all loads from every node to the tip; after poses()."""
    moment, force = times(part, loads.moment), (0.0, 0.0, 0.0)
    for pack in range(mass.size // LANES - 1, -1, -1):
        for i in range(LANES - 1, -1, -1):
            f = node_force(mass, loads, part, pack, i)
            moment, force = plus(moment, cross(_position(pose, pack, i), f)), plus(force, f)
            _write_vector(moment, memory, places.total + pack * 6 * LANES + i)
            _write_vector(force, memory, places.total + (pack * 6 + 3) * LANES + i)


@kernel
def motion_of_nodes(rod, places, work):
    """Twists in the base frame of the nodes and their derivative at xi_ddot = 0, from work.xi_dot; see sweep()."""
    memory = work.memory
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
        store6(memory, places.eta + node_at, eta)
        store6(memory, places.eta_dot + node_at, eta_dot)
        store6(memory, places.start + node_at, start)
        store6(memory, places.start_dot + node_at, twist_sum(eta_dot, twist_scaled(-1.0, change)))


@kernel
def total_load_rates(mass, loads, pose, places, memory):
    """First and second derivative of the total loads along the motion, of which only moments change; after motion_of_nodes()."""
    once, twice = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for pack in range(mass.size // LANES - 1, -1, -1):
        for i in range(LANES - 1, -1, -1):
            f, r, at = node_force(mass, loads, 1.0, pack, i), _position(pose, pack, i), pack * 6 * LANES + i
            k, k_dot = _vector_at(memory, places.eta + at), _vector_at(memory, places.eta_dot + at)
            r_dot = plus(_vector_at(memory, places.eta + at + 3 * LANES), cross(k, r))
            r_ddot = plus(_vector_at(memory, places.eta_dot + at + 3 * LANES), plus(cross(k_dot, r), cross(k, r_dot)))
            once, twice = plus(once, cross(r_dot, f)), plus(twice, cross(r_ddot, f))
            _write_vector(once, memory, places.total_dot + at)
            _write_vector(twice, memory, places.total_ddot + at)


@kernel(inline=True)
def _place(node):
    """Where the six components of a node begin in a field over nodes."""
    return node // LANES * 6 * LANES + node % LANES


@kernel(inline=True)
def _product(memory, a, b, out):
    """out = a b of matrices of 6 padded rows, by where they begin."""
    for i in range(6):
        left, right = spread(0.0), spread(0.0)
        for k in range(6):
            s = memory[a + i * ROW + k]
            left = left + s * load(memory, b + k * ROW)
            right = right + s * load(memory, b + k * ROW + LANES)
        store(memory, out + i * ROW, left)
        store(memory, out + i * ROW + LANES, right)


@kernel(inline=True)
def _root(memory, Lambda, K):
    """K lower triangular with K K^T = Lambda, semidefinite; both by where they begin."""
    for i in range(6):
        for j in range(i + 1):
            total = memory[Lambda + i * ROW + j]
            for k in range(j):
                total -= memory[K + i * ROW + k] * memory[K + j * ROW + k]
            if i > j:
                memory[K + i * ROW + j] = total * memory[K + j * ROW + 7]
            else:
                found = total > NO_COMPLIANCE * memory[Lambda + i * ROW + i]
                memory[K + i * ROW + i] = math.sqrt(total) if found else 0.0
                memory[K + i * ROW + 7] = 1.0 / memory[K + i * ROW + i] if found else 0.0
    for i in range(6):
        memory[K + i * ROW + 7] = 0.0


@kernel(inline=True)
def _eliminate(memory, rows):
    """Gauss-Jordan without pivoting on 6 rows of 2 ROW numbers: the right half becomes that times the left half's inverse. Least pivot."""
    least = 1e300
    for k in range(6):
        own = rows + k * 2 * ROW
        pivot = memory[own + k]
        if not pivot >= least:
            least = pivot
        inverse = 1.0 / pivot
        first, second = inverse * load(memory, own), inverse * load(memory, own + LANES)
        third, fourth = inverse * load(memory, own + 2 * LANES), inverse * load(memory, own + 3 * LANES)
        for i in range(6):
            if i != k:
                at = rows + i * 2 * ROW
                s = memory[at + k]
                store(memory, at, load(memory, at) - s * first)
                store(memory, at + LANES, load(memory, at + LANES) - s * second)
                store(memory, at + 2 * LANES, load(memory, at + 2 * LANES) - s * third)
                store(memory, at + 3 * LANES, load(memory, at + 3 * LANES) - s * fourth)
        store(memory, own, first)
        store(memory, own + LANES, second)
        store(memory, own + 2 * LANES, third)
        store(memory, own + 3 * LANES, fourth)
    return least


@kernel(inline=True)
def _write_skew(x, s, out, at):
    """s x~ into 3 x 3 of a matrix of padded rows."""
    out[at + 1], out[at + 2], out[at + ROW + 2] = -s * x[2], s * x[1], -s * x[0]
    out[at + ROW], out[at + 2 * ROW], out[at + 2 * ROW + 1] = s * x[2], -s * x[1], s * x[0]


@kernel(inline=True)
def _add_node(r, f, out, at):
    """Adds the second variation of the work of a dead force f at r, Q = (r.f 1 - (r f^T + f r^T)/2, f~/2; -f~/2, 0)."""
    work, turn, side = dot(r, f), times(0.5, f), 3 * ROW
    for i in range(3):
        out[at + i * ROW + i] += work
        for j in range(3):
            out[at + i * ROW + j] -= 0.5 * (r[i] * f[j] + f[i] * r[j])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3  # f~ has f_i at (k, j) and -f_i at (j, k)
        out[at + k * ROW + 3 + j] += turn[i]
        out[at + j * ROW + 3 + k] -= turn[i]
        out[at + side + k * ROW + j] -= turn[i]
        out[at + side + j * ROW + k] += turn[i]


@kernel
def factorise_riccati(mass, loads, part, pose, places, memory):
    """The recursion for S: E, E S, Pi and N of every interval, with p = Pi X - E (S growth + s), X' = N X + ..; the least pivot."""
    S, K, rows = places.S, places.K, places.rows
    SK, B, least, packs = rows + 96, rows + 96 + MATRIX, 1e300, mass.size // LANES
    memory[S : S + MATRIX] = 0.0
    _add_node(_position(pose, packs - 1, LANES - 1), node_force(mass, loads, part, packs - 1, LANES - 1), memory, S)
    for i in range(3):  # S -= moment~ / 2
        j, k = (i + 1) % 3, (i + 2) % 3
        memory[S + j * ROW + k] += 0.5 * part * loads.moment[i]
        memory[S + k * ROW + j] -= 0.5 * part * loads.moment[i]
    for node in range(packs * LANES - 1, -1, -1):
        at, total = node * MATRIX, places.total + _place(node)
        E, ES, Pi, N, Lambda = places.E + at, places.ES + at, places.Pi + at, places.N + at, places.Lambda + at
        _root(memory, Lambda, K)
        _product(memory, S, K, SK)
        for i in range(6):
            for m in range(0, ROW, LANES):
                row = spread(0.0)
                for k in range(6):
                    row = row + memory[K + k * ROW + i] * load(memory, SK + k * ROW + m)
                store(memory, rows + i * 2 * ROW + m, row)
            memory[rows + i * 2 * ROW + i] += 1.0
            for k in range(6):
                memory[rows + i * 2 * ROW + ROW + k] = memory[K + k * ROW + i]
        pivot = _eliminate(memory, rows)
        if not pivot >= least:
            least = pivot
        for i in range(6):
            for m in range(0, ROW, LANES):
                row = spread(0.0)
                for k in range(6):
                    row = row - memory[SK + i * ROW + k] * load(memory, rows + k * 2 * ROW + ROW + m)
                store(memory, E + i * ROW + m, row)
            memory[E + i * ROW + i] += 1.0
        _product(memory, E, S, ES)
        memory[B : B + MATRIX] = 0.0
        force = _vector_at(memory, total + 3 * LANES)
        _write_skew(_vector_at(memory, total), 0.5, memory, B)
        _write_skew(force, 0.5, memory, B + 3)
        _write_skew(force, 0.5, memory, B + 3 * ROW)
        _product(memory, E, B, Pi)
        for k in range(0, MATRIX, LANES):
            store(memory, Pi + k, load(memory, Pi + k) - load(memory, ES + k))
        _product(memory, Lambda, Pi, N)
        for i in range(6):
            memory[N + i * ROW + i] += 1.0
        _product(memory, B, N, S)
        for k in range(0, MATRIX, LANES):
            store(memory, S + k, load(memory, S + k) - load(memory, Pi + k))
        if node > 0:
            pack, i = (node - 1) // LANES, (node - 1) % LANES
            _add_node(_position(pose, pack, i), node_force(mass, loads, part, pack, i), memory, S)
    return least


@kernel(inline=True)
def _load_column(field, at, stride):
    k = load(field, at), load(field, at + stride), load(field, at + 2 * stride)
    return k, (load(field, at + 3 * stride), load(field, at + 4 * stride), load(field, at + 5 * stride))


@kernel
def solve_riccati(packs, places, memory, width, stride):
    """The wrenches p that answer to the growth of columns 0..width-1 (whole packs) of `stride`; overwrites the growth."""
    sums, nodes = places.sums, packs * LANES
    for m in range(0, width, LANES):
        for i in range(6):
            store(memory, sums + i * LANES, spread(0.0))
        for node in range(nodes - 1, -1, -1):
            at, growth, answer = node * MATRIX, places.growth + node * 6 * stride + m, places.answer + node * 6 * stride + m
            for i in range(6):
                e, ES, E = spread(0.0), places.ES + at + i * ROW, places.E + at + i * ROW
                for k in range(6):
                    e = e + memory[ES + k] * load(memory, growth + k * stride) + memory[E + k] * load(memory, sums + k * LANES)
                store(memory, answer + i * stride, e)
            for i in range(6):
                y, Lambda = load(memory, growth + i * stride), places.Lambda + at + i * ROW
                for k in range(6):
                    y = y - memory[Lambda + k] * load(memory, answer + k * stride)
                store(memory, growth + i * stride, y)
            y, total = _load_column(memory, growth, stride), places.total + _place(node)
            moment, force = times(0.5, _vector_at(memory, total)), times(0.5, _vector_at(memory, total + 3 * LANES))
            turned = plus(cross(moment, y[0]), cross(force, y[1])), cross(force, y[0])
            store6(memory, sums, twist_sum(_load_column(memory, answer, stride), turned))
        for i in range(6):
            store(memory, sums + i * LANES, spread(0.0))
        for node in range(nodes):
            at, growth, answer = node * MATRIX, places.growth + node * 6 * stride + m, places.answer + node * 6 * stride + m
            for i in range(6):
                p, ahead = -load(memory, answer + i * stride), load(memory, growth + i * stride)
                Pi, N = places.Pi + at + i * ROW, places.N + at + i * ROW
                for k in range(6):
                    X = load(memory, sums + k * LANES)
                    p = p + memory[Pi + k] * X
                    ahead = ahead + memory[N + k] * X
                store(memory, answer + i * stride, p)
                store(memory, growth + i * stride, ahead)
            store6(memory, sums, _load_column(memory, growth, stride))
