"""Statics-based strain parametrisation (30): columns (31), bias (33), stiffness and drive (34) of
the strain that statics_newton finds.

In scaled form, with C = Sigma^-1 (0 for rigid strains), a column is Phi = C^1/2 H^-1 C^1/2 [Phi_a
Phi_p], with the factor of H that the Newton iteration leaves.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import plus, scale_twist, times, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    load3,
    load6,
    load21,
    scale6,
    solve,
    store6,
    zero6,
)
from soft_tendon_env.mechanics.terms.dynamics import damping_matrix, stiffness_matrix
from soft_tendon_env.mechanics.terms.parametrisation import PARAMETRISATIONS, Parametrisation
from soft_tendon_env.mechanics.terms.statics_newton import (
    passive_wrench,
    solve_statics,
    statics_is_unique,
    strain_tension,
)
from soft_tendon_env.mechanics.terms.tendons import actuation_wrench, tangent_rate, wrench_column
from soft_tendon_env.mechanics.types import StaticsBased


@kernel(inline=True)
def solve_column(f, c, wrench, free):
    """Column Phi = H^-1 wrench, H^-1 = C^1/2 L^-T D^-1 L^-1 C^1/2."""
    return scale6(c, solve(f, scale6(c, wrench), free))


@kernel(inline=True)
def coordinate_wrenches(arm, law, block, u, q, work):
    """Wrenches [Phi_a Phi_p] of every coordinate at a block into work.Phi, times the weight into
    work.Y, and the mismatch of tensions and passive wrenches, weight (Phi_a (u - tau) - Phi_p q_p),
    into work.mismatch; where solve_statics() has left the tangents."""
    rod, tendons, pack, blocks = arm.rod, arm.tendons, block // 2, 2 * arm.rod.packs
    weight, mismatch = load(rod.weight, block * LANES), zero6()
    if law.mixed:
        for j in range(law.active):
            store6(work.Phi, (j * blocks + block) * 6 * LANES, zero6())
    for i in range(tendons.size):
        if tendons.pack_begin[i] <= pack < tendons.pack_end[i]:
            wrench = actuation_wrench(tendons, blocks, block, i, work.tangent)
            mismatch = twist_sum(mismatch, scale_twist(u[i] - work.tau[i], wrench))
            for m in range(law.row_start[i], law.row_start[i + 1]):
                at, column = (law.column[m] * blocks + block) * 6 * LANES, wrench
                if law.mixed:
                    column = twist_sum(load6(work.Phi, at), scale_twist(law.weight[m], wrench))
                store6(work.Phi, at, column)
                store6(work.Y, at, scale_twist(weight, column))
    for j in range(law.active, law.size):
        if law.pack_begin[j] <= pack < law.pack_end[j]:
            at, column = (
                (j * blocks + block) * 6 * LANES,
                load6(law.passive, ((j - law.active) * blocks + block) * 6 * LANES),
            )
            mismatch = twist_sum(mismatch, scale_twist(-q[j], column))
            store6(work.Phi, at, column)
            store6(work.Y, at, scale_twist(weight, column))
    store6(work.mismatch, block * 6 * LANES, scale_twist(weight, mismatch))


@kernel(inline=True)
def turning_wrench(tendons, blocks, block, rate, work):
    """Wrench -sum S (2 tau_dot t_dot + tau t_ddot) of tendons at a block strained at `rate`,
    xi_ddot = 0 (Appendix E multiplied out)."""
    tau, tau_dot, total = work.tau, work.tau_dot, zero6()
    for i in range(tendons.size):
        if tendons.pack_begin[i] <= block // 2 < tendons.pack_end[i]:
            tangent_at, geometry_at = (
                (i * blocks + block) * 4 * LANES,
                (i * blocks + block) * 5 * LANES,
            )
            t, inverse = load3(work.tangent, tangent_at), load(work.tangent, tangent_at + 3 * LANES)
            stretch, t_dot = tangent_rate(tendons.geometry, geometry_at, rate, t, inverse)
            turning = t_dot[0] * t_dot[0] + t_dot[1] * t_dot[1] + t_dot[2] * t_dot[2]
            pulled = plus(
                times(2.0 * (tau_dot[i] - tau[i] * stretch), t_dot), times(-tau[i] * turning, t)
            )
            presence = load(tendons.geometry, geometry_at + 4 * LANES)
            total = twist_sum(
                total, wrench_column(tendons.geometry, geometry_at, times(-presence, pulled))
            )
    return total


@kernel
def statics_columns(arm, strain, u, q, q_dot, work):
    """Columns Phi_xi (31) of every coordinate, xi_dot, the bias xi_bias = A^-1 Sigma^-1 (Psi_adot +
    Psi_a_dot) xi_dot (33), and the mismatch, of which is the drive of the implicit strain (34), G
    ([u; 0] - q)."""
    rod, blocks = arm.rod, 2 * arm.rod.packs
    strain_tension(strain, q_dot, work.tau_dot)
    for block in range(blocks):
        coordinate_wrenches(arm, strain, block, u, q, work)
        f, c, rate = (
            load21(work.factor, block * 21 * LANES),
            load6(rod.root_compliance, block * 6 * LANES),
            zero6(),
        )
        for j in range(strain.size):
            if strain.pack_begin[j] <= block // 2 < strain.pack_end[j]:
                at = (j * blocks + block) * 6 * LANES
                phi = solve_column(f, c, load6(work.Phi, at), rod.free)
                rate = twist_sum(rate, scale_twist(q_dot[j], phi))
                store6(work.Phi, at, phi)
        turning = turning_wrench(arm.tendons, blocks, block, rate, work)
        store6(work.xi_dot, block * 6 * LANES, rate)
        store6(work.xi_bias, block * 6 * LANES, solve_column(f, c, turning, rod.free))


@kernel
def statics_matrices(arm, strain, work):
    """Stiffness G = int Phi_xi^T (Sigma - Psi_a) Phi_xi dX = int Phi_xi^T [Phi_a Phi_p] dX (34) and
    D, of the columns."""
    stiffness_matrix(arm.rod, strain, work)
    damping_matrix(arm.rod, strain, work)


@kernel(inline=True)
def rate_wrench(tendons, law, blocks, block, q_dot, work):
    """Wrench [Phi_a Phi_p] q_dot at one block, where tangents and tau_dot are known."""
    total = passive_wrench(law, blocks, block, q_dot)
    for i in range(tendons.size):
        if tendons.pack_begin[i] <= block // 2 < tendons.pack_end[i]:
            total = twist_sum(
                total,
                scale_twist(
                    work.tau_dot[i], actuation_wrench(tendons, blocks, block, i, work.tangent)
                ),
            )
    return total


@kernel
def statics_rate(arm, strain, q_dot, work):
    """Strain rate xi_dot = C^1/2 H^-1 C^1/2 [Phi_a Phi_p] q_dot, from the tangents and factors that
    solve_statics() left."""
    rod, blocks = arm.rod, 2 * arm.rod.packs
    strain_tension(strain, q_dot, work.tau_dot)
    for block in range(blocks):
        c, total = (
            load6(rod.root_compliance, block * 6 * LANES),
            rate_wrench(arm.tendons, strain, blocks, block, q_dot, work),
        )
        store6(
            work.xi_dot,
            block * 6 * LANES,
            solve_column(load21(work.factor, block * 21 * LANES), c, total, rod.free),
        )


PARAMETRISATIONS[StaticsBased] = Parametrisation(
    solve_statics, statics_columns, statics_matrices, statics_is_unique, statics_rate
)
