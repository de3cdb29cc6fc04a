"""Strain parametrisations: from the coordinates to strains, their columns and their bias at every point.

`StaticsBased`: the implicit strain (30), Newton with the exact Jacobian (31)-(32), columns and bias (33). In scaled form, with
C = Sigma^-1 (0 for rigid strains) and e = Sigma^1/2 (xi - xi*), the strain solves  e + C^1/2 (sum tau s - Phi_p q_p) = 0. Its
Jacobian H is symmetric, and positive definite as long as every tendon pulls: e then minimises a convex energy.
"""

from soft_tendon_env.compilation import kernel
from soft_tendon_env.mechanics.dynamics import point_rows, project
from soft_tendon_env.mechanics.lanes import LANES, largest, load, smallest, spread, sqrt, store
from soft_tendon_env.mechanics.lie import minus, plus, times, twist_scaled, twist_sum
from soft_tendon_env.mechanics.section import (
    factorise,
    inverse_diagonal,
    load3,
    load6,
    load_factor,
    multiply_upper,
    scaled,
    solve,
    solve_lower,
    solve_upper,
    squared_norm,
    store3,
    store6,
    store_factor,
)
from soft_tendon_env.mechanics.tendons import add_stiffness, chord, chord_rate, unit_tangent, wrench_column

MAX_NEWTON = 20
SMALLEST_PART = 1e-4  # of the load, in the continuation from rest


@kernel(inline=True)
def zero6():
    zero = spread(0.0)
    return (zero, zero, zero), (zero, zero, zero)


@kernel(inline=True)
def _scaled_stiffness(h, c):
    """I + C^1/2 h C^1/2."""
    (c0, c1, c2), (c3, c4, c5) = c
    return (
        1.0 + c0 * c0 * h[0],
        c1 * c0 * h[1], 1.0 + c1 * c1 * h[2],
        c2 * c0 * h[3], c2 * c1 * h[4], 1.0 + c2 * c2 * h[5],
        c3 * c0 * h[6], c3 * c1 * h[7], c3 * c2 * h[8], 1.0 + c3 * c3 * h[9],
        c4 * c0 * h[10], c4 * c1 * h[11], c4 * c2 * h[12], c4 * c3 * h[13], 1.0 + c4 * c4 * h[14],
        c5 * c0 * h[15], c5 * c1 * h[16], c5 * c2 * h[17], c5 * c3 * h[18], c5 * c4 * h[19], 1.0 + c5 * c5 * h[20],
    )  # fmt: skip


@kernel(inline=True)
def _zero21():
    o = spread(0.0)
    return o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o


@kernel
def pull(rod, tendons, block, xi, tau, tangent):
    """Sum of the tendons' wrenches tau s and of their stiffness at one block; leaves the tangents in `tangent`."""
    h, total = _zero21(), zero6()
    k, p = xi
    blocks, pack = 2 * rod.packs, block // 2
    for i in range(tendons.size):
        if tendons.first[i] <= pack < tendons.last[i]:
            at = (i * blocks + block) * 5 * LANES
            t, inverse = unit_tangent(chord(tendons.geometry, at, k, p))
            s = wrench_column(tendons.geometry, at, t)
            tension = tau[i] * load(tendons.geometry, at + 4 * LANES)
            total = twist_sum(total, twist_scaled(tension, s))
            h = add_stiffness(h, tendons.geometry, at, tension * inverse, s, rod.free)
            store_at = (i * blocks + block) * 4 * LANES
            store3(tangent, store_at, t)
            store(tangent, store_at + 3 * LANES, inverse)
    return h, total


@kernel
def passive_wrench(strain, blocks, block, q):
    """Phi_p q_p at one block."""
    total = zero6()
    pack = block // 2
    for j in range(strain.active, strain.size):
        if strain.first[j] <= pack < strain.last[j]:
            column = load6(strain.passive, ((j - strain.active) * blocks + block) * 6 * LANES)
            total = twist_sum(total, twist_scaled(q[j], column))
    return total


@kernel
def strain_tension(strain, q, tau):
    """Tensions of the strain law, tau = mixing q_a."""
    for i in range(tau.size):
        tau[i] = 0.0
        for m in range(strain.row[i], strain.row[i + 1]):
            tau[i] += strain.mixing[m] * q[strain.coordinate[m]]


@kernel
def solve_strain(rod, tendons, strain, q, tolerance, work):
    """Newton for the strain (30) at every point, from the guess in work.xi; leaves xi, tangents and factors.

    Stops when the last correction is below `tolerance` of the scaled strain: the factors belong to the iterate before it.
    Returns -1, or the first block where a pivot was not positive or MAX_NEWTON iterations did not do.
    """
    blocks, tau = 2 * rod.packs, work.tau
    floor = 0.0
    for i in range(tau.size):
        floor += abs(tau[i])
    for block in range(blocks):
        at = block * 6 * LANES
        c, reference = load6(rod.root_compliance, at), load6(rod.reference_strain, at)
        xi = load6(work.xi, at)
        e = scaled(load6(rod.root_stiffness, at), twist_sum(xi, twist_scaled(-1.0, reference)))
        target = scaled(c, passive_wrench(strain, blocks, block, q))
        resolution = 1e-15 * floor * c[1][0]
        converged = False
        for _ in range(MAX_NEWTON):
            h, total = pull(rod, tendons, block, xi, tau, work.tangent)
            f = factorise(_scaled_stiffness(h, c), rod.free)
            residual = twist_sum(target, twist_scaled(-1.0, twist_sum(e, scaled(c, total))))
            step = solve(f, residual, rod.free)
            e = twist_sum(e, step)
            xi = twist_sum(reference, scaled(c, e))
            excess = squared_norm(step) - (tolerance * tolerance) * squared_norm(e) - resolution * resolution
            if largest(excess) <= 0.0:
                converged = True
                break
        if not (converged and is_positive(f)):
            return block
        store6(work.xi, at, xi)
        store_factor(work.factor, block, f)
    return -1


@kernel
def solve_strain_from_rest(rod, tendons, strain, q, tolerance, work):
    """The strain at q with no guess: from the stress-free rod, by load continuation in growing or halved parts of q.

    Returns (-1, 1.0), or (the block that stopped it, the part of q that was reached, whose strain is left in work.xi).
    """
    reached, part, last_good = 0.0, 1.0, rod.reference_strain.copy()
    while reached < 1.0:
        part = min(part, 1.0 - reached)
        scaled_q = (reached + part) * q
        strain_tension(strain, scaled_q, work.tau)
        work.xi[:] = last_good
        failed = solve_strain(rod, tendons, strain, scaled_q, tolerance, work)
        if failed < 0:
            reached, part, last_good = reached + part, 2.0 * part, work.xi.copy()
        else:
            part *= 0.5
            if part < SMALLEST_PART:
                work.xi[:] = last_good
                return failed, reached
    return -1, 1.0


@kernel(inline=True)
def is_positive(f):
    """Whether every pivot of every lane is positive (false for NaN)."""
    return (
        smallest(f[15]) > 0.0 and smallest(f[16]) > 0.0 and smallest(f[17]) > 0.0
        and smallest(f[18]) > 0.0 and smallest(f[19]) > 0.0 and smallest(f[20]) > 0.0
    )  # fmt: skip


@kernel(inline=True)
def _add_at(field, at, x):
    store6(field, at, twist_sum(load6(field, at), x))


@kernel(inline=True)
def _solve_column(f, c, root, wrench, free):
    """Y = sqrt(w) D^-1/2 L^-1 C^1/2 wrench and Phi = C^1/2 L^-T D^-1 L^-1 C^1/2 wrench; root = sqrt(w / D), inverse roots in f."""
    lower = solve_lower(f, scaled(c, wrench), free)
    return scaled(root, lower), scaled(c, solve_upper(f, scaled(inverse_diagonal(f), lower), free))


@kernel
def statics_columns(rod, tendons, strain, u, q, q_dot, work):
    """The columns Y and Phi_xi (31) of every coordinate, xi_dot and the mismatch Y (u - q); after solve_strain."""
    blocks = 2 * rod.packs
    for block in range(blocks):
        at, pack = block * 6 * LANES, block // 2
        f, c, weight = load_factor(work.factor, block), load6(rod.root_compliance, at), load(rod.weight, block * LANES)
        i0, i1 = inverse_diagonal(f)
        root = (
            (sqrt(weight * i0[0]), sqrt(weight * i0[1]), sqrt(weight * i0[2])),
            (sqrt(weight * i1[0]), sqrt(weight * i1[1]), sqrt(weight * i1[2])),
        )
        mismatch, rate = zero6(), zero6()
        if strain.mixed:
            for j in range(strain.active):
                store6(work.Y, (j * blocks + block) * 6 * LANES, zero6())
                store6(work.Phi, (j * blocks + block) * 6 * LANES, zero6())
        for i in range(tendons.size):
            if tendons.first[i] <= pack < tendons.last[i]:
                t = load3(work.tangent, (i * blocks + block) * 4 * LANES)
                geometry_at = (i * blocks + block) * 5 * LANES
                presence = load(tendons.geometry, geometry_at + 4 * LANES)
                y, phi = _solve_column(f, c, root, twist_scaled(-presence, wrench_column(tendons.geometry, geometry_at, t)), rod.free)
                mismatch = twist_sum(mismatch, twist_scaled(u[i], y))
                for m in range(strain.row[i], strain.row[i + 1]):
                    j, share = strain.coordinate[m], strain.mixing[m]
                    column_at = (j * blocks + block) * 6 * LANES
                    mismatch = twist_sum(mismatch, twist_scaled(-share * q[j], y))
                    rate = twist_sum(rate, twist_scaled(share * q_dot[j], phi))
                    if strain.mixed:
                        _add_at(work.Y, column_at, twist_scaled(share, y))
                        _add_at(work.Phi, column_at, twist_scaled(share, phi))
                    else:
                        store6(work.Y, column_at, y)
                        store6(work.Phi, column_at, phi)
        for j in range(strain.active, strain.size):
            if strain.first[j] <= pack < strain.last[j]:
                column = load6(strain.passive, ((j - strain.active) * blocks + block) * 6 * LANES)
                y, phi = _solve_column(f, c, root, column, rod.free)
                mismatch = twist_sum(mismatch, twist_scaled(-q[j], y))
                rate = twist_sum(rate, twist_scaled(q_dot[j], phi))
                store6(work.Y, (j * blocks + block) * 6 * LANES, y)
                store6(work.Phi, (j * blocks + block) * 6 * LANES, phi)
        store6(work.mismatch, at, mismatch)
        store6(work.xi_dot, at, rate)


@kernel
def statics_bias(rod, tendons, work):
    """xi_bias = A^-1 Sigma^-1 (Psi_adot + Psi_a_dot) xi_dot (33), Appendix E multiplied out: -H^-1 sum S (2 tau_dot t_dot + tau t_ddot)."""
    blocks, tau, tau_dot = 2 * rod.packs, work.tau, work.tau_dot
    for block in range(blocks):
        at, pack = block * 6 * LANES, block // 2
        rate, total = load6(work.xi_dot, at), zero6()
        for i in range(tendons.size):
            if tendons.first[i] <= pack < tendons.last[i]:
                tangent_at, geometry_at = (i * blocks + block) * 4 * LANES, (i * blocks + block) * 5 * LANES
                t, inverse = load3(work.tangent, tangent_at), load(work.tangent, tangent_at + 3 * LANES)
                stretch, t_dot = tangent_rate(tendons.geometry, geometry_at, rate, t, inverse)
                turning = t_dot[0] * t_dot[0] + t_dot[1] * t_dot[1] + t_dot[2] * t_dot[2]
                pulled = plus(times(2.0 * (tau_dot[i] - tau[i] * stretch), t_dot), times(-tau[i] * turning, t))
                presence = load(tendons.geometry, geometry_at + 4 * LANES)
                total = twist_sum(total, wrench_column(tendons.geometry, geometry_at, times(-presence, pulled)))
        c = load6(rod.root_compliance, at)
        store6(work.xi_bias, at, scaled(c, solve(load_factor(work.factor, block), scaled(c, total), rod.free)))


@kernel(inline=True)
def tangent_rate(geometry, at, xi_dot, t, inverse):
    """The relative rate of |t_c| and t_dot (Appendix E)."""
    rate = times(inverse, chord_rate(geometry, at, xi_dot))
    stretch = rate[0] * t[0] + rate[1] * t[1] + rate[2] * t[2]
    return stretch, minus(rate, times(stretch, t))


@kernel
def actuation_matrix(rod, tendons, strain, work, out):
    """B_ji = int Phi_j^T Phi_a,i dX (40e)."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        for block in range(blocks):
            at, geometry_at = block * 6 * LANES, (i * blocks + block) * 5 * LANES
            weight = load(rod.weight, block * LANES) * load(tendons.geometry, geometry_at + 4 * LANES)
            xi = load6(work.xi, at)
            t = unit_tangent(chord(tendons.geometry, geometry_at, xi[0], xi[1]))[0]
            store6(work.mismatch, at, twist_scaled(-weight, wrench_column(tendons.geometry, geometry_at, t)))
        project(work.Phi, work.mismatch, point_rows(rod), strain.first, strain.last, out[:, i])


# explicit bases -------------------------------------------------------------------------------------------------------


@kernel
def explicit_strain(rod, strain, q, work):
    """xi = xi* + Phi q."""
    blocks = 2 * rod.packs
    for block in range(blocks):
        at, pack = block * 6 * LANES, block // 2
        xi = load6(rod.reference_strain, at)
        for j in range(strain.size):
            if strain.first[j] <= pack < strain.last[j]:
                xi = twist_sum(xi, twist_scaled(q[j], load6(strain.field, (j * blocks + block) * 6 * LANES)))
        store6(work.xi, at, xi)


@kernel
def explicit_columns(rod, tendons, strain, u, q_dot, work):
    """xi_dot; the drive B u - K through the mismatch, and Y with Y^T Y = Phi^T (Sigma - Psi(u)) Phi."""
    blocks = 2 * rod.packs
    for block in range(blocks):
        at, pack = block * 6 * LANES, block // 2
        c, stiff, weight = load6(rod.root_compliance, at), load6(rod.root_stiffness, at), load(rod.weight, block * LANES)
        rate = zero6()
        for j in range(strain.size):
            if strain.first[j] <= pack < strain.last[j]:
                rate = twist_sum(rate, twist_scaled(q_dot[j], load6(strain.field, (j * blocks + block) * 6 * LANES)))
        store6(work.xi_dot, at, rate)
        xi = load6(work.xi, at)
        h, total = pull(rod, tendons, block, xi, u, work.tangent)
        f = factorise(_scaled_stiffness(h, c), rod.free)
        strained = twist_sum(xi, twist_scaled(-1.0, load6(rod.reference_strain, at)))
        stress = twist_sum(scaled(stiff, scaled(stiff, strained)), total)
        store6(work.mismatch, at, twist_scaled(-weight, stress))
        root = _root_pivots(f, weight)
        for j in range(strain.size):
            if strain.first[j] <= pack < strain.last[j]:
                column_at = (j * blocks + block) * 6 * LANES
                y = scaled(root, multiply_upper(f, scaled(stiff, load6(strain.field, column_at)), rod.free))
                store6(work.Y, column_at, y)


@kernel(inline=True)
def _root_pivots(f, weight):
    """sqrt(weight D), a pivot below zero (pushing tendons) counted as zero: Y serves as a stiffness only."""
    i0, i1 = inverse_diagonal(f)
    return (
        (_root_pivot(i0[0], weight), _root_pivot(i0[1], weight), _root_pivot(i0[2], weight)),
        (_root_pivot(i1[0], weight), _root_pivot(i1[1], weight), _root_pivot(i1[2], weight)),
    )


@kernel(inline=True)
def _root_pivot(inverse, weight):
    pivot = weight / inverse
    return sqrt(0.5 * (pivot + sqrt(pivot * pivot)))
