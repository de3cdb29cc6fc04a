"""Hessian of the elastic energy under dead loads within the Magnus intervals: assembly and factorisation, a block R per interval.

The two points of an interval make one symmetric matrix R of up to 12 unknowns, their free strains one after the other. R is 1 + C^1/2 h
C^1/2 of the tendons at each point, as in statics_newton, less what the loads beyond the interval's end add (interval_derivatives); W maps
the unknowns to the displacement of the end. Between intervals see load_riccati.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import matrix_scaled, matrix_sum, plus, times, twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.packed_ldl import entry, ldl_factorise, ldl_solve_six
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, scaled, scaled_stiffness, store3, store6
from soft_tendon_env.mechanics.terms.interval_derivatives import (
    dexp_curvature,
    times_zanna,
    zanna_times,
)
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, interval_operators, load_pose
from soft_tendon_env.mechanics.terms.statics_newton import passive_wrench
from soft_tendon_env.mechanics.terms.tendons import pull
from soft_tendon_env.mechanics.terms.transposed_kinematics import transposed_dexp, wrench_at_start, zanna_transposed
from soft_tendon_env.mechanics.workspace import ROW


@kernel(inline=True)
def _row(A, i):
    """Row i of a 3x3 matrix."""
    return A[3 * i], A[3 * i + 1], A[3 * i + 2]


@kernel(inline=True)
def _product3(x, y):
    return x[0] * y[0], x[1] * y[1], x[2] * y[2]


@kernel(inline=True)
def _write_columns(c, W, z, free, out):
    """Writes W of point z as rows of the interval's: (free strain, six of the base frame), times C^1/2."""
    (A, C), zero, at = W, spread(0.0), z * len(free) * 6 * LANES
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
def _write_point(h, c, weight, D, z, free, out):
    """Writes the diagonal block of a point, 1 + C^1/2 h C^1/2 - weight C^1/2 (C, A; A, 0) C^1/2 for the dual matrix D = (A, C)."""
    h, (A, C), (k, p), n = scaled_stiffness(h, c), D, c, z * len(free)
    x, y, v = times(-weight * k[0], k), times(-weight * k[1], k), times(-weight * k[2], k)
    store(out, entry(n, n), h[0] + x[0] * C[0])
    store(out, entry(n + 1, n), h[1] + y[0] * C[3])
    store(out, entry(n + 1, n + 1), h[2] + y[1] * C[4])
    store3(out, entry(n + 2, n), (h[3] + v[0] * C[6], h[4] + v[1] * C[7], h[5] + v[2] * C[8]))
    if len(free) > 3:
        store3(out, entry(n + 3, n), plus((h[6], h[7], h[8]), _product3(times(-weight * p[0], k), _row(A, 0))))
        store(out, entry(n + 3, n + 3), h[9])
    if len(free) > 4:
        store3(out, entry(n + 4, n), plus((h[10], h[11], h[12]), _product3(times(-weight * p[1], k), _row(A, 1))))
        store(out, entry(n + 4, n + 3), h[13])
        store(out, entry(n + 4, n + 4), h[14])
        store3(out, entry(n + 5, n), plus((h[15], h[16], h[17]), _product3(times(-weight * p[2], k), _row(A, 2))))
        store3(out, entry(n + 5, n + 3), (h[18], h[19], h[20]))


@kernel(inline=True)
def _write_coupling(c_1, c_2, D, free, out):
    """Writes the block between the points, C_2^1/2 (C, A; A, 0) C_1^1/2."""
    (A, C), (k, p), n = D, c_1, len(free)
    _write_coupling_row(times(c_2[0][0], k), times(c_2[0][0], p), _row(C, 0), _row(A, 0), free, out, entry(n, 0))
    _write_coupling_row(times(c_2[0][1], k), times(c_2[0][1], p), _row(C, 1), _row(A, 1), free, out, entry(n + 1, 0))
    _write_coupling_row(times(c_2[0][2], k), times(c_2[0][2], p), _row(C, 2), _row(A, 2), free, out, entry(n + 2, 0))
    zero = spread(0.0)
    none = zero, zero, zero
    if len(free) > 3:
        _write_coupling_row(times(c_2[1][0], k), none, _row(A, 0), none, free, out, entry(n + 3, 0))
    if len(free) > 4:
        _write_coupling_row(times(c_2[1][1], k), none, _row(A, 1), none, free, out, entry(n + 4, 0))
        _write_coupling_row(times(c_2[1][2], k), none, _row(A, 2), none, free, out, entry(n + 5, 0))


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
def write_rows(x, z, free, out):
    """Writes the free components of a twist-shaped x at point z as unknowns of the interval."""
    own = z * len(free) * LANES
    store3(out, own, x[0])
    if len(free) > 3:
        store(out, own + 3 * LANES, x[1][0])
    if len(free) > 4:
        store(out, own + 4 * LANES, x[1][1])
        store(out, own + 5 * LANES, x[1][2])


@kernel(inline=True)
def read_rows(field, z, free):
    """Twist-shaped x at point z, of unknowns that write_rows() wrote; zero for rigid strains."""
    own, zero = z * len(free) * LANES, spread(0.0)
    if len(free) > 4:
        return load6(field, own)
    if len(free) > 3:
        return load3(field, own), (load(field, own + 3 * LANES), zero, zero)
    return load3(field, own), (zero, zero, zero)


@kernel
def assemble_hessian(rod, tendons, law, q, work):
    """Assembles W and R of all intervals, and the residual of the balance as their right-hand sides; after poses() and total_loads()."""
    memory, free, blocks = work.under_loads, rod.free, 2 * rod.packs
    for pack in range(rod.packs):
        at, W_out, R_out, rhs = 2 * pack * 6 * LANES, memory.W[pack], memory.R[pack], memory.rhs[pack]
        h, weight = load(rod.length, pack * LANES), load(rod.weight, 2 * pack * LANES)
        mu = (2.0 * KAPPA) * h
        xi_1, xi_2 = load6(work.xi, at), load6(work.xi, at + 6 * LANES)
        c_1, c_2 = load6(rod.root_compliance, at), load6(rod.root_compliance, at + 6 * LANES)
        R, r = load_pose(work.start, pack * 12 * LANES)
        W_1, W_2, A, C, Omega, c = interval_operators(h, spread(1.0), mu, xi_1, xi_2, R, r)
        _write_columns(c_1, W_1, 0, free, W_out)
        _write_columns(c_2, W_2, 1, free, W_out)
        psi = wrench_at_start(R, r, load6(memory.total, pack * 6 * LANES))
        t, D = transposed_dexp(Omega, c, psi), dexp_curvature(Omega, c, psi)
        DZ_1, DZ_2 = times_zanna(D, -mu, xi_2), times_zanna(D, mu, xi_1)
        h_1, pull_1 = pull(rod, tendons, 2 * pack, xi_1, work.tau, work.tangent)
        h_2, pull_2 = pull(rod, tendons, 2 * pack + 1, xi_2, work.tau, work.tangent)
        _write_point(h_1, c_1, weight, zanna_times(-mu, xi_2, DZ_1), 0, free, R_out)
        _write_point(h_2, c_2, weight, zanna_times(mu, xi_1, DZ_2), 1, free, R_out)
        between = zanna_times(mu, xi_1, DZ_1)
        coupling = (
            matrix_sum(matrix_scaled(-weight, between[0]), matrix_scaled(-mu, _skew(t[1]))),
            matrix_sum(matrix_scaled(-weight, between[1]), matrix_scaled(-mu, _skew(t[0]))),
        )
        _write_coupling(c_1, c_2, coupling, free, R_out)
        force_1 = twist_sum(zanna_transposed(-mu, xi_2, t), twist_scaled(-1.0, pull_1))
        force_2 = twist_sum(zanna_transposed(mu, xi_1, t), twist_scaled(-1.0, pull_2))
        force_1 = twist_sum(force_1, passive_wrench(law, blocks, 2 * pack, q))
        force_2 = twist_sum(force_2, passive_wrench(law, blocks, 2 * pack + 1, q))
        write_rows(twist_sum(scaled(c_1, force_1), twist_scaled(-1.0, load6(memory.e, at))), 0, free, rhs)
        write_rows(twist_sum(scaled(c_2, force_2), twist_scaled(-1.0, load6(memory.e, at + 6 * LANES))), 1, free, rhs)


@kernel
def factorise_intervals(weight, free, memory):
    """Factorises R of all intervals, with A = R^-1 W^T and Lambda = weight W A; the least pivot, and the pack that has it."""
    m, least, softest = 2 * len(free), 1e300, 0
    for pack in range(weight.size // (2 * LANES)):
        R, W, A, w = memory.R[pack], memory.W[pack], memory.A[pack], load(weight, 2 * pack * LANES)
        pivot = ldl_factorise(R, m)
        if not pivot >= least:
            least, softest = pivot, pack
        for k in range(6):
            for i in range(m):
                store(A[k], i * LANES, load(W, (i * 6 + k) * LANES))
        ldl_solve_six(R, m, A)
        for k in range(6):
            for j in range(k + 1):
                total = spread(0.0)
                for i in range(m):
                    total = total + load(W, (i * 6 + j) * LANES) * load(A[k], i * LANES)
                total = w * total
                for own in range(LANES):
                    Lambda = memory.Lambda[pack * LANES + own]
                    Lambda[j * ROW + k] = lane(total, own)
                    Lambda[k * ROW + j] = lane(total, own)
    return least, softest
