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
from soft_tendon_env.mechanics.algebra.lanes import LANES, largest, load
from soft_tendon_env.mechanics.algebra.lie import ad_apply, coad_apply, coefficients, dot, twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, scaled, squared_norm, store6, zero6
from soft_tendon_env.mechanics.terms.dynamics import combined_columns, cross_gram, damping_matrix, point_rows
from soft_tendon_env.mechanics.terms.hessian_solve import columns_under_loads, factorise_hessian, press, release, solve_hessian
from soft_tendon_env.mechanics.terms.interval_derivatives import transposed_dexp_jet
from soft_tendon_env.mechanics.terms.interval_hessian import read_rows, write_rows
from soft_tendon_env.mechanics.terms.kinematics import KAPPA, load_pose, magnus, zanna
from soft_tendon_env.mechanics.terms.load_riccati import motion_of_nodes, total_load_rates
from soft_tendon_env.mechanics.terms.parametrisation import Parametrisation, parametrises
from soft_tendon_env.mechanics.terms.statics_based import coordinate_mismatch, coordinate_wrenches, rate_wrench, turning_wrench
from soft_tendon_env.mechanics.terms.statics_newton import (
    CONTRACTION,
    FIRM_PARTS,
    LEAST_PART,
    MAX_NEWTON,
    SMALLEST_PART,
    SOFT,
    all_pull,
    chords_stay,
    strain_tension,
)
from soft_tendon_env.mechanics.terms.transposed_kinematics import wrench_at_start, zanna_transposed
from soft_tendon_env.mechanics.types import Loaded

SHARPER = 1e-3
"""Part of the tolerance that the last correction may have: the factors are of the iterate before it, and columns are as far off as that."""
ROUND_OFF = 1e-12  # relative size of corrections that rounding leaves


@kernel
def apply_correction(rod, xi, memory):
    """Adds the solution in memory.rhs to the scaled strain; the largest squared corrections and squared strains of a point."""
    size, norm = 0.0, 0.0
    for pack in range(rod.packs):
        for z in range(2):
            at = (2 * pack + z) * 6 * LANES
            step = read_rows(memory.rhs[pack], z, rod.free)
            e = twist_sum(load6(memory.e, at), step)
            store6(memory.e, at, e)
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
    """Newton iteration for the strain under `part` of the loads, from the guess in work.xi; leaves xi, tangents and factors.

    It stays on the branch that it began on: see CONTRACTION. Returns -1, or the block that stopped it, see factorise_hessian().
    """
    memory, xi = work.under_loads, work.xi
    for block in range(2 * rod.packs):
        at = block * 6 * LANES
        strained = twist_sum(load6(xi, at), twist_scaled(-1.0, load6(rod.reference_strain, at)))
        store6(memory.e, at, scaled(load6(rod.root_stiffness, at), strained))
    tolerance = max(SHARPER * tolerance, ROUND_OFF)
    resolution, last = rounding(rod, strain.loads, part, work.tau), 0.0
    for iteration in range(MAX_NEWTON):
        failed = factorise_hessian(rod, tendons, strain, q, part, work)
        if failed >= 0:
            return failed
        solve_hessian(rod.weight, rod.free, memory)
        size, norm = apply_correction(rod, xi, memory)
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

    In growing or halved parts as statics_along(). Returns (-1, 1.0), or (the block that stopped it, the part of the way reached, whose
    strain is in work.xi), and the least pivot of the Hessian on the way.
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
            softest = min(softest, work.under_loads.softest[0])
        else:
            step *= 0.5
            if step < max(SMALLEST_PART * reached, LEAST_PART):
                copy(last_good, work.xi)
                return max(failed, 0), reached, softest
    return -1, 1.0, softest


@kernel(inline=True)
def load_accelerations(rod, work, pack):
    """Second derivatives along the motion of the loads' generalised forces on the two strains of the intervals, over the weight."""
    memory, at, node_at = work.under_loads, 2 * pack * 6 * LANES, pack * 6 * LANES
    h = load(rod.length, pack * LANES)
    mu = (2.0 * KAPPA) * h
    xi_1, xi_2 = load6(work.xi, at), load6(work.xi, at + 6 * LANES)
    rate_1, rate_2 = load6(work.xi_dot, at), load6(work.xi_dot, at + 6 * LANES)
    R, r = load_pose(work.start, pack * 12 * LANES)
    Omega = magnus(h, xi_1, xi_2)
    c = coefficients(dot(Omega[0], Omega[0]))
    Omega_dot = zanna(h, xi_1, xi_2, rate_1, rate_2)
    Omega_ddot = twist_scaled((2.0 * KAPPA) * (h * h), ad_apply(rate_1, rate_2))
    X, X_dot, still = load6(memory.start, node_at), load6(memory.start_dot, node_at), zero6()[0]
    total = load6(memory.total, node_at)
    total_dot = load3(memory.total_dot, node_at), still
    total_ddot = load3(memory.total_ddot, node_at), still
    # Ad_g^T total, with Ad_g' = ad_X Ad_g and ad_X^T = -ad*_X
    once = twist_sum(total_dot, twist_scaled(-1.0, coad_apply(X, total)))
    twice = twist_sum(coad_apply(X, twist_sum(once, total_dot)), coad_apply(X_dot, total))
    twice = twist_sum(total_ddot, twist_scaled(-1.0, twice))
    psi, psi_dot, psi_ddot = wrench_at_start(R, r, total), wrench_at_start(R, r, once), wrench_at_start(R, r, twice)
    t_dot, t_ddot = transposed_dexp_jet(Omega, Omega_dot, Omega_ddot, c, psi, psi_dot, psi_ddot)
    first = twist_sum(zanna_transposed(-mu, xi_2, t_ddot), twist_scaled(2.0 * mu, coad_apply(rate_2, t_dot)))
    return first, twist_sum(zanna_transposed(mu, xi_1, t_ddot), twist_scaled(-2.0 * mu, coad_apply(rate_1, t_dot)))


@kernel
def bias_under_loads(arm, strain, work):
    """Bias xi_bias = -H^-1 d^2 grad U: the balance differentiated twice along the motion with xi_ddot = 0, of tendons and loads."""
    rod, tendons, memory, blocks, free = arm.rod, arm.tendons, work.under_loads, 2 * arm.rod.packs, arm.rod.free
    motion_of_nodes(rod, work)
    total_load_rates(rod.node_mass, strain.loads, work.pose, memory)
    for pack in range(rod.packs):
        at, rhs = 2 * pack * 6 * LANES, memory.rhs[pack]
        first, second = load_accelerations(rod, work, pack)
        first = twist_sum(first, turning_wrench(tendons, blocks, 2 * pack, load6(work.xi_dot, at), work))
        second = twist_sum(second, turning_wrench(tendons, blocks, 2 * pack + 1, load6(work.xi_dot, at + 6 * LANES), work))
        write_rows(scaled(load6(rod.root_compliance, at), first), 0, free, rhs)
        write_rows(scaled(load6(rod.root_compliance, at + 6 * LANES), second), 1, free, rhs)
    solve_hessian(rod.weight, free, memory)
    for pack in range(rod.packs):
        release(rod.root_compliance, free, memory.rhs[pack], pack, work.xi_bias, 2 * pack * 6 * LANES)


@kernel
def loaded_columns(arm, strain, u, q, q_dot, work):
    """Columns, xi_dot, bias and mismatch of the strain with these loads inside (35), of which B u - K + F is made."""
    rod, tendons, law = arm.rod, arm.tendons, strain.law
    strain_tension(law, q_dot, work.tau_dot)
    coordinate_mismatch(rod, tendons, law, u, q, work)
    work.Phi[:] = 0.0
    coordinate_wrenches(rod, tendons, law, work.unit, work, work.Phi)
    columns_under_loads(rod, law, work.Phi, work.under_loads)
    combined_columns(work.Phi, q_dot, work.xi_dot)
    bias_under_loads(arm, strain, work)


@kernel
def loaded_matrices(arm, strain, work):
    """Stiffness G = int Phi^T Phi_w dX and D, of the columns."""
    law = strain.law
    coordinate_wrenches(arm.rod, arm.tendons, law, arm.rod.weight, work, work.Y)
    cross_gram(work.Phi, work.Y, point_rows(arm.rod), law.first, law.last, work.G)
    damping_matrix(arm.rod, strain, work)


@kernel
def loaded_from_guess(arm, strain, q, tolerance, work):
    """The strain at q from the guess in work.xi, on its branch."""
    strain_tension(strain.law, q, work.tau)
    return solve_strain_under_loads(arm.rod, arm.tendons, strain, q, 1.0, tolerance, work)


@kernel(counted=True)
def loaded_from_rest(arm, strain, q, tolerance, work):
    """The strain at q on the branch on which coordinates and loads grow together from the stress-free rod."""
    copy(arm.rod.reference_strain, work.xi)
    failed, reached, _ = follow_loads(arm, np.zeros(q.size), 0.0, q, tolerance, 1.0, work)
    return failed, reached


@kernel
def loaded_along(arm, strain, q_from, q, tolerance, work):
    """The strain at q on the branch of that at q_from."""
    failed, reached, _ = follow_loads(arm, q_from, 1.0, q, tolerance, 1.0, work)
    return failed, reached


@kernel(counted=True)
def loaded_is_unique(arm, strain, q, work):
    """False, since that is never known: loads make the energy non-convex."""
    return False


@kernel(counted=True)
def loaded_is_firm(arm, strain, q, tolerance, work):
    """Whether coordinates and loads grow together to q in FIRM_PARTS parts or more with pivots of the Hessian that stay above SOFT."""
    copy(arm.rod.reference_strain, work.xi)
    failed, _, softest = follow_loads(arm, np.zeros(q.size), 0.0, q, tolerance, 1.0 / FIRM_PARTS, work)
    return failed < 0 and softest > SOFT


@kernel
def loaded_rate(arm, strain, q_dot, work):
    """Strain rate xi_dot = H^-1 Phi_w q_dot, from the tangents and factors that solve_strain_under_loads() left."""
    rod, law, memory, blocks = arm.rod, strain.law, work.under_loads, 2 * arm.rod.packs
    strain_tension(law, q_dot, work.tau_dot)
    for block in range(blocks):
        store6(work.xi_dot, block * 6 * LANES, rate_wrench(arm.tendons, law, blocks, block, q_dot, work))
    for pack in range(rod.packs):
        press(rod.root_compliance, rod.free, work.xi_dot, 2 * pack * 6 * LANES, pack, memory.rhs[pack])
    solve_hessian(rod.weight, rod.free, memory)
    for pack in range(rod.packs):
        release(rod.root_compliance, rod.free, memory.rhs[pack], pack, work.xi_dot, 2 * pack * 6 * LANES)


parametrises(
    Loaded,
    Parametrisation(
        loaded_from_guess,
        loaded_columns,
        loaded_matrices,
        loaded_from_rest,
        loaded_along,
        loaded_is_unique,
        loaded_is_firm,
        loaded_rate,
    ),
)
