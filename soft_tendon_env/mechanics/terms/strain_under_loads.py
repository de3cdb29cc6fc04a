"""Statics-based strain with dead loads inside (35): Newton with the exact Hessian, columns, bias and stiffness (paper III-B).

The strain minimises U = int 1/2 (xi - xi*) . Sigma (xi - xi*) dX + sum tau_i (length of tendon i) - int xi . Phi_p q_p dX - (work of the
dead loads) over the strains at the points, the poses being the Magnus product of interval exponentials. So

    e + C^1/2 (sum tau s - Phi_p q_p) - W^T total = 0    (scaled as in statics_based, W and total in load_riccati)

at every point. The Hessian is that of statics_based, local, plus what the loads add inside an interval (its two points make one
symmetric matrix R) and from interval to interval (load_riccati). Columns Phi = H^-1 [Phi_a Phi_p] reach over the whole rod. The equation
of motion keeps its form, with K - F = G q for K less the force F of these loads.

Loads make U non-convex: of several strains at the same coordinates the one is taken that is reached as coordinates and loads grow together
from nothing, or along a motion; where the Hessian loses its positive pivots the arm buckles, and there is no strain.
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, largest, load, spread, store, with_lane
from soft_tendon_env.mechanics.algebra.lie import (
    ad_apply,
    coad_apply,
    coefficients,
    dot,
    matrix_scaled,
    matrix_sum,
    plus,
    times,
    twist_scaled,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import copy, row_stride
from soft_tendon_env.mechanics.algebra.packed_ldl import SIX, entry, ldl_factorise, ldl_solve, ldl_solve_six
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, scaled, scaled_stiffness, squared_norm, store3, store6, zero6
from soft_tendon_env.mechanics.terms.dynamics import cross_gram, damping_matrix, point_rows
from soft_tendon_env.mechanics.terms.interval_derivatives import (
    dexp_curvature,
    times_zanna,
    transposed_dexp,
    transposed_dexp_jet,
    wrench_at_start,
    zanna_times,
    zanna_transposed,
)
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_operators, load_pose, magnus, poses, zanna
from soft_tendon_env.mechanics.terms.load_riccati import (
    MATRIX,
    ROW,
    factorise_riccati,
    motion_of_nodes,
    solve_riccati,
    total_load_rates,
    total_loads,
)
from soft_tendon_env.mechanics.terms.parametrisation import Parametrisation, parametrises
from soft_tendon_env.mechanics.terms.statics_based import (
    CONTRACTION,
    FIRM_PARTS,
    LEAST_PART,
    MAX_NEWTON,
    SMALLEST_PART,
    SOFT,
    actuation_wrench,
    add_at,
    all_pull,
    chords_stay,
    passive_wrench,
    strain_tension,
    turning_wrench,
    weighted_wrenches,
)
from soft_tendon_env.mechanics.terms.tendons import pull, wrench_column
from soft_tendon_env.mechanics.terms.transmission import transmitted
from soft_tendon_env.mechanics.types import Loaded

SHARPER = 1e-3
"""Of the tolerance, what is asked of the last correction: the factors are of the iterate before it, and columns are as far off as that."""
ROUND_OFF = 1e-12  # relative size of corrections that rounding leaves


@kernel(inline=True)
def _row(A, i):
    """Row i of a 3x3 matrix."""
    return A[3 * i], A[3 * i + 1], A[3 * i + 2]


@kernel(inline=True)
def _product3(x, y):
    return x[0] * y[0], x[1] * y[1], x[2] * y[2]


@kernel(inline=True)
def _write_columns(c, W, free, out, at):
    """W of a point as rows of the interval's at out[at:]: (free strain, six of the base frame), times C^1/2."""
    (A, C), zero = W, spread(0.0)
    still = zero, zero, zero
    columns_A = (A[0], A[3], A[6]), (A[1], A[4], A[7]), (A[2], A[5], A[8])
    columns_C = (C[0], C[3], C[6]), (C[1], C[4], C[7]), (C[2], C[5], C[8])
    store6(out, at, (times(c[0][0], columns_A[0]), times(c[0][0], columns_C[0])))
    store6(out, at + 6 * LANES, (times(c[0][1], columns_A[1]), times(c[0][1], columns_C[1])))
    store6(out, at + 12 * LANES, (times(c[0][2], columns_A[2]), times(c[0][2], columns_C[2])))
    if len(free) > 3:
        store6(out, at + 18 * LANES, (still, times(c[1][0], columns_A[0])))
    if len(free) > 4:
        store6(out, at + 24 * LANES, (still, times(c[1][1], columns_A[1])))
        store6(out, at + 30 * LANES, (still, times(c[1][2], columns_A[2])))


@kernel(inline=True)
def _write_point(h, c, weight, D, z, free, out, at):
    """The diagonal block of a point: 1 + C^1/2 h C^1/2 - weight C^1/2 (C, A; A, 0) C^1/2 for the dual matrix D = (A, C)."""
    h, (A, C), (k, p), n = scaled_stiffness(h, c), D, c, z * len(free)
    x, y, v = times(-weight * k[0], k), times(-weight * k[1], k), times(-weight * k[2], k)
    store(out, at + entry(n, n), h[0] + x[0] * C[0])
    store(out, at + entry(n + 1, n), h[1] + y[0] * C[3])
    store(out, at + entry(n + 1, n + 1), h[2] + y[1] * C[4])
    store3(out, at + entry(n + 2, n), (h[3] + v[0] * C[6], h[4] + v[1] * C[7], h[5] + v[2] * C[8]))
    if len(free) > 3:
        store3(out, at + entry(n + 3, n), plus((h[6], h[7], h[8]), _product3(times(-weight * p[0], k), _row(A, 0))))
        store(out, at + entry(n + 3, n + 3), h[9])
    if len(free) > 4:
        store3(out, at + entry(n + 4, n), plus((h[10], h[11], h[12]), _product3(times(-weight * p[1], k), _row(A, 1))))
        store(out, at + entry(n + 4, n + 3), h[13])
        store(out, at + entry(n + 4, n + 4), h[14])
        store3(out, at + entry(n + 5, n), plus((h[15], h[16], h[17]), _product3(times(-weight * p[2], k), _row(A, 2))))
        store3(out, at + entry(n + 5, n + 3), (h[18], h[19], h[20]))


@kernel(inline=True)
def _write_coupling(c_1, c_2, D, free, out, at):
    """The block between the points, C_2^1/2 (C, A; A, 0) C_1^1/2."""
    (A, C), (k, p), n = D, c_1, len(free)
    _write_coupling_row(times(c_2[0][0], k), times(c_2[0][0], p), _row(C, 0), _row(A, 0), free, out, at + entry(n, 0))
    _write_coupling_row(times(c_2[0][1], k), times(c_2[0][1], p), _row(C, 1), _row(A, 1), free, out, at + entry(n + 1, 0))
    _write_coupling_row(times(c_2[0][2], k), times(c_2[0][2], p), _row(C, 2), _row(A, 2), free, out, at + entry(n + 2, 0))
    zero = spread(0.0)
    none = zero, zero, zero
    if len(free) > 3:
        _write_coupling_row(times(c_2[1][0], k), none, _row(A, 0), none, free, out, at + entry(n + 3, 0))
    if len(free) > 4:
        _write_coupling_row(times(c_2[1][1], k), none, _row(A, 1), none, free, out, at + entry(n + 4, 0))
        _write_coupling_row(times(c_2[1][2], k), none, _row(A, 2), none, free, out, at + entry(n + 5, 0))


@kernel(inline=True)
def _write_coupling_row(k, p, angular, linear, free, out, at):
    store3(out, at, _product3(k, angular))
    if len(free) > 3:
        store(out, at + 3 * LANES, p[0] * linear[0])
    if len(free) > 4:
        store(out, at + 4 * LANES, p[1] * linear[1])
        store(out, at + 5 * LANES, p[2] * linear[2])


@kernel(inline=True)
def _skew(x):
    zero = 0.0 * x[0]
    return zero, -x[2], x[1], x[2], zero, -x[0], -x[1], x[0], zero


@kernel(inline=True)
def _write_rows(x, z, free, out, at):
    """The free components of a twist-shaped x at point z as unknowns of the interval, from out[at] on."""
    own = at + z * len(free) * LANES
    store3(out, own, x[0])
    if len(free) > 3:
        store(out, own + 3 * LANES, x[1][0])
    if len(free) > 4:
        store(out, own + 4 * LANES, x[1][1])
        store(out, own + 5 * LANES, x[1][2])


@kernel(inline=True)
def _read_rows(field, at, z, free):
    """What _write_rows wrote."""
    own, zero = at + z * len(free) * LANES, spread(0.0)
    if len(free) > 4:
        return load6(field, own)
    if len(free) > 3:
        return load3(field, own), (load(field, own + 3 * LANES), zero, zero)
    return load3(field, own), (zero, zero, zero)


@kernel
def assemble_hessian(rod, tendons, law, places, q, work):
    """W and R of all intervals, and the residual of the balance as `pressed`; after poses() and total_loads()."""
    memory, free, blocks = work.memory, rod.free, 2 * rod.packs
    for pack in range(rod.packs):
        at, W_at, R_at = 2 * pack * 6 * LANES, places.W + pack * 72 * LANES, places.R + pack * 78 * LANES
        h, weight = load(rod.length, pack * LANES), load(rod.weight, 2 * pack * LANES)
        mu = (2.0 * KAPPA) * h
        xi_1, xi_2 = load6(work.xi, at), load6(work.xi, at + 6 * LANES)
        c_1, c_2 = load6(rod.root_compliance, at), load6(rod.root_compliance, at + 6 * LANES)
        R, r = load_pose(work.start, pack * 12 * LANES)
        W_1, W_2, A, C, Omega, c = interval_operators(h, spread(1.0), mu, xi_1, xi_2, R, r)
        _write_columns(c_1, W_1, free, memory, W_at)
        _write_columns(c_2, W_2, free, memory, W_at + len(free) * 6 * LANES)
        psi = wrench_at_start(R, r, load6(memory, places.total + pack * 6 * LANES))
        t, D = transposed_dexp(Omega, c, psi), dexp_curvature(Omega, c, psi)
        DZ_1, DZ_2 = times_zanna(D, -mu, xi_2), times_zanna(D, mu, xi_1)
        h_1, pull_1 = pull(rod, tendons, 2 * pack, xi_1, work.tau, work.tangent)
        h_2, pull_2 = pull(rod, tendons, 2 * pack + 1, xi_2, work.tau, work.tangent)
        _write_point(h_1, c_1, weight, zanna_times(-mu, xi_2, DZ_1), 0, free, memory, R_at)
        _write_point(h_2, c_2, weight, zanna_times(mu, xi_1, DZ_2), 1, free, memory, R_at)
        between = zanna_times(mu, xi_1, DZ_1)
        coupling = (
            matrix_sum(matrix_scaled(-weight, between[0]), matrix_scaled(-mu, _skew(t[1]))),
            matrix_sum(matrix_scaled(-weight, between[1]), matrix_scaled(-mu, _skew(t[0]))),
        )
        _write_coupling(c_1, c_2, coupling, free, memory, R_at)
        force_1 = twist_sum(zanna_transposed(-mu, xi_2, t), twist_scaled(-1.0, pull_1))
        force_2 = twist_sum(zanna_transposed(mu, xi_1, t), twist_scaled(-1.0, pull_2))
        force_1 = twist_sum(force_1, passive_wrench(law, blocks, 2 * pack, q))
        force_2 = twist_sum(force_2, passive_wrench(law, blocks, 2 * pack + 1, q))
        e_at, x_at = places.e + at, places.pressed + pack * 12 * LANES
        _write_rows(twist_sum(scaled(c_1, force_1), twist_scaled(-1.0, load6(memory, e_at))), 0, free, memory, x_at)
        _write_rows(twist_sum(scaled(c_2, force_2), twist_scaled(-1.0, load6(memory, e_at + 6 * LANES))), 1, free, memory, x_at)


@kernel
def factorise_intervals(weight, free, places, memory):
    """R factorised, A = R^-1 W^T and Lambda = weight W A of all intervals; the least pivot, and the pack that has it."""
    m, least, softest = 2 * len(free), 1e300, 0
    for pack in range(weight.size // (2 * LANES)):
        R_at, W_at, A_at = places.R + pack * 78 * LANES, places.W + pack * 72 * LANES, places.A + pack * 72 * LANES
        pivot = ldl_factorise(memory, R_at, m)
        if not pivot >= least:
            least, softest = pivot, pack
        for k in range(6):
            for i in range(m):
                store(memory, A_at + (k * 12 + i) * LANES, load(memory, W_at + (i * 6 + k) * LANES))
        ldl_solve_six(memory, R_at, m, memory, A_at, 12 * LANES)
        w = load(weight, 2 * pack * LANES)
        for k in range(6):
            for j in range(k + 1):
                total = spread(0.0)
                for i in range(m):
                    total = total + load(memory, W_at + (i * 6 + j) * LANES) * load(memory, A_at + (k * 12 + i) * LANES)
                total = w * total
                for own in range(LANES):
                    at = places.Lambda + (pack * LANES + own) * MATRIX
                    memory[at + j * ROW + k] = lane(total, own)
                    memory[at + k * ROW + j] = lane(total, own)
    return least, softest


@kernel(inline=True)
def _write_growth(weight, free, places, memory, x_at, pack, column, stride):
    """weight W x of a solution of the intervals that begins at x_at, into a column of the growth."""
    w, W_at = load(weight, 2 * pack * LANES), places.W + pack * 72 * LANES
    for k in range(6):
        total = spread(0.0)
        for i in range(2 * len(free)):
            total = total + load(memory, W_at + (i * 6 + k) * LANES) * load(memory, x_at + i * LANES)
        total = w * total
        for own in range(LANES):
            memory[places.growth + ((pack * LANES + own) * 6 + k) * stride + column] = lane(total, own)


@kernel(inline=True)
def _gather(memory, at, step):
    """The numbers of a pack's nodes, `step` apart."""
    found = spread(memory[at])
    for own in range(1, LANES):
        found = with_lane(found, own, memory[at + own * step])
    return found


@kernel(inline=True)
def _answer_of(free, places, memory, pack, column, stride):
    """A p of a column at the two points of the intervals of a pack."""
    at, step, A_at = places.answer + (pack * LANES * 6) * stride + column, 6 * stride, places.A + pack * 72 * LANES
    p_0, p_1, p_2 = _gather(memory, at, step), _gather(memory, at + stride, step), _gather(memory, at + 2 * stride, step)
    at += 3 * stride
    p_3, p_4, p_5 = _gather(memory, at, step), _gather(memory, at + stride, step), _gather(memory, at + 2 * stride, step)
    for i in range(2 * len(free)):
        own = A_at + i * LANES
        total = load(memory, own) * p_0 + load(memory, own + 12 * LANES) * p_1 + load(memory, own + 24 * LANES) * p_2
        total = total + load(memory, own + 36 * LANES) * p_3 + load(memory, own + 48 * LANES) * p_4
        store(memory, places.six + i * LANES, total + load(memory, own + 60 * LANES) * p_5)
    return _read_rows(memory, places.six, 0, free), _read_rows(memory, places.six, 1, free)


@kernel
def solve_hessian(weight, free, places, memory):
    """Solve H x = pressed in place, for one field."""
    packs, m = weight.size // (2 * LANES), 2 * len(free)
    memory[places.growth : places.growth + packs * LANES * 6 * LANES] = 0.0
    for pack in range(packs):
        x_at = places.pressed + pack * 12 * LANES
        ldl_solve(memory, places.R + pack * 78 * LANES, m, memory, x_at)
        _write_growth(weight, free, places, memory, x_at, pack, 0, LANES)
    solve_riccati(packs, places, memory, LANES, LANES)
    for pack in range(packs):
        x_at = places.pressed + pack * 12 * LANES
        first, second = _answer_of(free, places, memory, pack, 0, LANES)
        _write_rows(twist_sum(_read_rows(memory, x_at, 0, free), first), 0, free, memory, x_at)
        _write_rows(twist_sum(_read_rows(memory, x_at, 1, free), second), 1, free, memory, x_at)


@kernel
def factorise_hessian(rod, tendons, strain, q, part, work):
    """Residual and Hessian at work.xi, factorised; -1, the block of an interval that gives way, or 2 packs where the arm buckles."""
    places, loads, memory = strain.places, strain.loads, work.memory
    poses(rod, work)
    total_loads(rod.node_mass, loads, part, work.pose, places, memory)
    assemble_hessian(rod, tendons, strain.law, places, q, work)
    least, pack = factorise_intervals(rod.weight, rod.free, places, memory)
    if not least > 0.0:
        return 2 * pack
    response = factorise_riccati(rod.node_mass, loads, part, work.pose, places, memory)
    if not response > 0.0:
        return 2 * rod.packs
    memory[places.softest] = min(least, response)
    return -1


@kernel
def apply_correction(rod, places, xi, memory):
    """Add the solution in `pressed` to the scaled strain; the largest squared corrections and squared strains of a point."""
    size, norm = 0.0, 0.0
    for pack in range(rod.packs):
        for z in range(2):
            at = (2 * pack + z) * 6 * LANES
            step = _read_rows(memory, places.pressed + pack * 12 * LANES, z, rod.free)
            e = twist_sum(load6(memory, places.e + at), step)
            store6(memory, places.e + at, e)
            store6(xi, at, twist_sum(load6(rod.reference_strain, at), scaled(load6(rod.root_compliance, at), e)))
            found = largest(squared_norm(step))
            if not found <= size:
                size = found
            norm = max(norm, largest(squared_norm(e)))
    return size, norm


@kernel
def rounding(rod, loads, part, tau):
    """Scaled strain that rounding leaves in the balance of tensions and loads."""
    force, moment = 0.0, 0.0
    for tension in tau:
        force += abs(tension)
    for i in range(3):
        force += part * (abs(loads.force[i]) + rod.mass[0] * abs(loads.acceleration[i]))
        moment += part * abs(loads.moment[i])
    length, bend, stretch = 0.0, 0.0, 0.0
    for i in range(rod.length.size):
        length += rod.length[i]
    for block in range(2 * rod.packs):
        c = load6(rod.root_compliance, block * 6 * LANES)
        bend, stretch = max(bend, largest(c[0][1])), max(stretch, largest(c[1][0]))
    return 1e-15 * (force * stretch + (moment + force * length) * bend)


@kernel
def solve_strain_under_loads(rod, tendons, strain, q, part, tolerance, work):
    """Newton for the strain under `part` of the loads, from the guess in work.xi; leaves xi, tangents and factors, see solve_strain().

    It stays on the branch that it began on: see CONTRACTION. Returns -1, or the block that stopped it, see factorise_hessian().
    """
    places, memory, xi = strain.places, work.memory, work.xi
    for block in range(2 * rod.packs):
        at = block * 6 * LANES
        strained = twist_sum(load6(xi, at), twist_scaled(-1.0, load6(rod.reference_strain, at)))
        store6(memory, places.e + at, scaled(load6(rod.root_stiffness, at), strained))
    tolerance = max(SHARPER * tolerance, ROUND_OFF)
    resolution, last = rounding(rod, strain.loads, part, work.tau), 0.0
    for iteration in range(MAX_NEWTON):
        failed = factorise_hessian(rod, tendons, strain, q, part, work)
        if failed >= 0:
            return failed
        solve_hessian(rod.weight, rod.free, places, memory)
        size, norm = apply_correction(rod, places, xi, memory)
        excess = size - tolerance * tolerance * norm - resolution * resolution
        if excess <= 0.0:
            return -1
        if not size < 1e300 or (iteration > 0 and not size - tolerance * tolerance * norm <= CONTRACTION * CONTRACTION * last):
            break
        last = size
    return 2 * rod.packs


@kernel(counted=True)
def follow_loads(arm, q_from, part_from, q, tolerance, most, work):
    """The strain at q (n,) under all loads, continued from that at q_from under a part of them, in parts of at most `most` of the way.

    As solve_strain_along(); returns (-1, 1.0), or (the block that stopped it, the part of the way reached, whose strain is in work.xi),
    and the least pivot of the Hessian on the way.
    """
    rod, tendons, strain = arm.rod, arm.tendons, arm.strain
    reached, step, way, last_good, softest = 0.0, most, q - q_from, work.xi.copy(), 1e300
    while reached < 1.0:
        step = min(step, most, 1.0 - reached)
        ahead = reached + step if step < 1.0 - reached else 1.0
        part_q = q_from + ahead * way
        strain_tension(strain.law, part_q, work.tau)
        copy(last_good, work.xi)
        failed = solve_strain_under_loads(rod, tendons, strain, part_q, part_from + ahead * (1.0 - part_from), tolerance, work)
        if failed < 0 and (all_pull(work.tau) or chords_stay(rod, tendons, last_good, work.xi)):
            reached, step, last_good = ahead, 2.0 * step, work.xi.copy()
            softest = min(softest, work.memory[strain.places.softest])
        else:
            step *= 0.5
            if step < max(SMALLEST_PART * reached, LEAST_PART):
                copy(last_good, work.xi)
                return max(failed, 0), reached, softest
    return -1, 1.0, softest


@kernel
def coordinate_wrenches(rod, tendons, law, u, q, work):
    """The wrenches Phi_w of the coordinates into work.Phi, and the mismatch weight (Phi_a (u - tau) - Phi_p q_p)."""
    blocks = 2 * rod.packs
    for block in range(blocks):
        at, pack, weight = block * 6 * LANES, block // 2, load(rod.weight, block * LANES)
        mismatch = twist_scaled(-1.0, passive_wrench(law, blocks, block, q))
        for j in range(law.size):
            store6(work.Phi, (j * blocks + block) * 6 * LANES, zero6())
        for i in range(tendons.size):
            if tendons.first[i] <= pack < tendons.last[i]:
                column = actuation_wrench(tendons, blocks, block, i, work)
                mismatch = twist_sum(mismatch, twist_scaled(u[i] - work.tau[i], column))
                for m in range(law.row[i], law.row[i + 1]):
                    column_at = (law.coordinate[m] * blocks + block) * 6 * LANES
                    add_at(work.Phi, column_at, twist_scaled(law.mixing[m], column))
        for j in range(law.active, law.size):
            if law.first[j] <= pack < law.last[j]:
                column = load6(law.passive, ((j - law.active) * blocks + block) * 6 * LANES)
                store6(work.Phi, (j * blocks + block) * 6 * LANES, column)
        store6(work.mismatch, at, twist_scaled(weight, mismatch))


@kernel(inline=True)
def _press(root_compliance, free, field, at, pack, out, out_at):
    """C^1/2 times a wrench field of one pack as a right-hand side."""
    for z in range(2):
        c = load6(root_compliance, (2 * pack + z) * 6 * LANES)
        _write_rows(scaled(c, load6(field, at + z * 6 * LANES)), z, free, out, out_at)


@kernel(inline=True)
def _release(root_compliance, free, x, x_at, pack, field, at):
    """C^1/2 times a solution as a strain field of one pack."""
    for z in range(2):
        c = load6(root_compliance, (2 * pack + z) * 6 * LANES)
        store6(field, at + z * 6 * LANES, scaled(c, _read_rows(x, x_at, z, free)))


@kernel(inline=True)
def _solve_six_columns(rod, law, places, Phi, memory, pack, begin, end):
    """From wrenches in Phi to strains, in place, and the growth, of up to SIX columns of begin..end-1, those that load a pack."""
    at, of, stride = places.six, rod.root_compliance, row_stride(law.size)
    for j in range(begin, end):
        if law.first[j] <= pack < law.last[j]:
            _press(of, rod.free, Phi, (j * rod.packs + pack) * 12 * LANES, pack, memory, at)
            at += 12 * LANES
    ldl_solve_six(memory, places.R + pack * 78 * LANES, 2 * len(rod.free), memory, places.six, 12 * LANES)
    at = places.six
    for j in range(begin, end):
        if law.first[j] <= pack < law.last[j]:
            _write_growth(rod.weight, rod.free, places, memory, at, pack, j, stride)
            _release(of, rod.free, memory, at, pack, Phi, (j * rod.packs + pack) * 12 * LANES)
            at += 12 * LANES


@kernel
def columns_under_loads(rod, law, places, Phi, memory):
    """Columns H^-1 Phi_w from the wrenches Phi_w in Phi, in place, with all that follows from the loads."""
    n, packs, stride = law.size, rod.packs, row_stride(law.size)
    memory[places.growth : places.growth + packs * LANES * 6 * stride] = 0.0
    for pack in range(packs):
        begin, count = 0, 0
        for j in range(n):
            if law.first[j] <= pack < law.last[j]:
                count += 1
            if count == SIX or (j == n - 1 and count > 0):
                _solve_six_columns(rod, law, places, Phi, memory, pack, begin, j + 1)
                begin, count = j + 1, 0
    solve_riccati(packs, places, memory, stride, stride)
    for pack in range(packs):
        c_1, c_2 = load6(rod.root_compliance, 2 * pack * 6 * LANES), load6(rod.root_compliance, (2 * pack + 1) * 6 * LANES)
        for j in range(n):
            at = (j * packs + pack) * 12 * LANES
            phi_1, phi_2 = _answer_of(rod.free, places, memory, pack, j, stride)
            store6(Phi, at, twist_sum(load6(Phi, at), scaled(c_1, phi_1)))
            store6(Phi, at + 6 * LANES, twist_sum(load6(Phi, at + 6 * LANES), scaled(c_2, phi_2)))


@kernel
def combined_columns(Phi, q_dot, xi_dot):
    """xi_dot = Phi q_dot."""
    for m in range(0, xi_dot.size, LANES):
        total = spread(0.0)
        for j in range(q_dot.size):
            total = total + q_dot[j] * load(Phi, j * xi_dot.size + m)
        store(xi_dot, m, total)


@kernel(inline=True)
def load_accelerations(rod, places, work, pack):
    """Second derivatives along the motion of the loads' generalised forces on the two strains of the intervals, over the weight."""
    memory, at, node_at = work.memory, 2 * pack * 6 * LANES, pack * 6 * LANES
    h = load(rod.length, pack * LANES)
    mu = (2.0 * KAPPA) * h
    xi_1, xi_2 = load6(work.xi, at), load6(work.xi, at + 6 * LANES)
    rate_1, rate_2 = load6(work.xi_dot, at), load6(work.xi_dot, at + 6 * LANES)
    R, r = load_pose(work.start, pack * 12 * LANES)
    Omega = magnus(h, xi_1, xi_2)
    c = coefficients(dot(Omega[0], Omega[0]))
    Omega_dot = zanna(h, xi_1, xi_2, rate_1, rate_2)
    Omega_ddot = twist_scaled((2.0 * KAPPA) * (h * h), ad_apply(rate_1, rate_2))
    X, X_dot, still = load6(memory, places.start + node_at), load6(memory, places.start_dot + node_at), zero6()[0]
    total = load6(memory, places.total + node_at)
    total_dot = load3(memory, places.total_dot + node_at), still
    total_ddot = load3(memory, places.total_ddot + node_at), still
    # Ad_g^T total, with Ad_g' = ad_X Ad_g and ad_X^T = -ad*_X
    once = twist_sum(total_dot, twist_scaled(-1.0, coad_apply(X, total)))
    twice = twist_sum(coad_apply(X, twist_sum(once, total_dot)), coad_apply(X_dot, total))
    twice = twist_sum(total_ddot, twist_scaled(-1.0, twice))
    psi, psi_dot, psi_ddot = wrench_at_start(R, r, total), wrench_at_start(R, r, once), wrench_at_start(R, r, twice)
    t_dot, t_ddot = transposed_dexp_jet(Omega, Omega_dot, Omega_ddot, c, psi, psi_dot, psi_ddot)
    first = twist_sum(zanna_transposed(-mu, xi_2, t_ddot), twist_scaled(2.0 * mu, coad_apply(rate_2, t_dot)))
    return first, twist_sum(zanna_transposed(mu, xi_1, t_ddot), twist_scaled(-2.0 * mu, coad_apply(rate_1, t_dot)))


@kernel
def bias_under_loads(rod, tendons, strain, work):
    """xi_bias = -H^-1 d^2 grad U: the balance differentiated twice along the motion with xi_ddot = 0, of tendons and loads."""
    places, memory, blocks, free = strain.places, work.memory, 2 * rod.packs, rod.free
    motion_of_nodes(rod, places, work)
    total_load_rates(rod.node_mass, strain.loads, work.pose, places, memory)
    for pack in range(rod.packs):
        at, x_at = 2 * pack * 6 * LANES, places.pressed + pack * 12 * LANES
        first, second = load_accelerations(rod, places, work, pack)
        first = twist_sum(first, turning_wrench(tendons, blocks, 2 * pack, load6(work.xi_dot, at), work))
        second = twist_sum(second, turning_wrench(tendons, blocks, 2 * pack + 1, load6(work.xi_dot, at + 6 * LANES), work))
        _write_rows(scaled(load6(rod.root_compliance, at), first), 0, free, memory, x_at)
        _write_rows(scaled(load6(rod.root_compliance, at + 6 * LANES), second), 1, free, memory, x_at)
    solve_hessian(rod.weight, free, places, memory)
    for pack in range(rod.packs):
        _release(rod.root_compliance, free, memory, places.pressed + pack * 12 * LANES, pack, work.xi_bias, 2 * pack * 6 * LANES)


@kernel
def loaded_stage(arm, u, q, q_dot, tolerance, work):
    """Strain, columns, bias and mismatch of the strain with these loads inside (35), of which B u - K + F is made."""
    rod, tendons, strain, law = arm.rod, arm.tendons, arm.strain, arm.strain.law
    strain_tension(law, q, work.tau)
    strain_tension(law, q_dot, work.tau_dot)
    failed = solve_strain_under_loads(rod, tendons, strain, q, 1.0, tolerance, work)
    if failed >= 0:
        return failed
    coordinate_wrenches(rod, tendons, law, transmitted(arm, u, work), q, work)
    columns_under_loads(rod, law, strain.places, work.Phi, work.memory)
    combined_columns(work.Phi, q_dot, work.xi_dot)
    bias_under_loads(rod, tendons, strain, work)
    return -1


@kernel
def loaded_matrices(arm, work):
    """G = int Phi^T Phi_w dX and D, of the columns."""
    law = arm.strain.law
    weighted_wrenches(arm.rod, arm.tendons, law, work)
    cross_gram(work.Phi, work.Y, point_rows(arm.rod), law.first, law.last, work.G)
    damping_matrix(arm.rod, arm.strain, work)


@kernel
def loaded_from_guess(arm, q, tolerance, work):
    """The strain at q from the guess in work.xi, on its branch."""
    strain_tension(arm.strain.law, q, work.tau)
    return solve_strain_under_loads(arm.rod, arm.tendons, arm.strain, q, 1.0, tolerance, work)


@kernel(counted=True)
def loaded_from_rest(arm, q, tolerance, work):
    """The strain at q on the branch on which coordinates and loads grow together from the stress-free rod."""
    copy(arm.rod.reference_strain, work.xi)
    failed, reached, _ = follow_loads(arm, np.zeros(q.size), 0.0, q, tolerance, 1.0, work)
    return failed, reached


@kernel
def loaded_along(arm, q_from, q, tolerance, work):
    """The strain at q on the branch of that at q_from."""
    failed, reached, _ = follow_loads(arm, q_from, 1.0, q, tolerance, 1.0, work)
    return failed, reached


@kernel(counted=True)
def loaded_is_unique(arm, q, work):
    """Never known: loads make the energy non-convex."""
    return False


@kernel(counted=True)
def loaded_is_firm(arm, q, tolerance, work):
    """Whether coordinates and loads grow together to q in FIRM_PARTS parts or more with pivots of the Hessian that stay above SOFT."""
    copy(arm.rod.reference_strain, work.xi)
    failed, _, softest = follow_loads(arm, np.zeros(q.size), 0.0, q, tolerance, 1.0 / FIRM_PARTS, work)
    return failed < 0 and softest > SOFT


@kernel
def loaded_rate(arm, q_dot, work):
    """xi_dot = H^-1 Phi_w q_dot, from the tangents and factors that solve_strain_under_loads() left."""
    rod, tendons, law = arm.rod, arm.tendons, arm.strain.law
    blocks = 2 * rod.packs
    strain_tension(law, q_dot, work.tau_dot)
    for block in range(blocks):
        total = passive_wrench(law, blocks, block, q_dot)
        for i in range(tendons.size):
            if tendons.first[i] <= block // 2 < tendons.last[i]:
                geometry_at = (i * blocks + block) * 5 * LANES
                t = load3(work.tangent, (i * blocks + block) * 4 * LANES)
                pulled = -work.tau_dot[i] * load(tendons.geometry, geometry_at + 4 * LANES)
                total = twist_sum(total, twist_scaled(pulled, wrench_column(tendons.geometry, geometry_at, t)))
        store6(work.xi_dot, block * 6 * LANES, total)
    places, memory = arm.strain.places, work.memory
    for pack in range(rod.packs):
        _press(rod.root_compliance, rod.free, work.xi_dot, 2 * pack * 6 * LANES, pack, memory, places.pressed + pack * 12 * LANES)
    solve_hessian(rod.weight, rod.free, places, memory)
    for pack in range(rod.packs):
        _release(rod.root_compliance, rod.free, memory, places.pressed + pack * 12 * LANES, pack, work.xi_dot, 2 * pack * 6 * LANES)


parametrises(
    Loaded,
    Parametrisation(
        loaded_stage,
        loaded_matrices,
        loaded_from_guess,
        loaded_from_rest,
        loaded_along,
        loaded_is_unique,
        loaded_is_firm,
        loaded_rate,
    ),
)
