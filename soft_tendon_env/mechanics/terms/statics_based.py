"""Statics-based strain parametrisation (30): columns, bias, stiffness and drive.

They are (31), (33) and (34) of the strain that statics_newton finds.

In scaled form, with C = Sigma^-1 (0 for rigid strains), a column is Phi = C^1/2 H^-1 C^1/2 [Phi_a
Phi_p], with the factor of H that the Newton iteration leaves.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import dot, plus, scale_twist, times, twist_sum
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
from soft_tendon_env.mechanics.terms.tendons import (
    actuation_wrench,
    is_present,
    presence_of,
    tangent_rate,
    wrench_column,
)
from soft_tendon_env.mechanics.types import StaticsBased


@kernel(inline=True)
def solve_column(f, c, wrench, free):
    """Column Phi = H^-1 wrench, H^-1 = C^1/2 L^-T D^-1 L^-1 C^1/2."""
    return scale6(c, solve(f, scale6(c, wrench), free))


@kernel(inline=True)
def coordinate_wrenches(arm, law, block, tension, q, strain):
    """Wrenches [Phi_a Phi_p] of every coordinate at a block, and the mismatch.

    They go into strain.Phi, times the weight into strain.Y; the mismatch of tensions u and passive
    wrenches, weight (Phi_a (u - tau) - Phi_p q_p), into strain.mismatch; where solve_statics() has
    left the tangents.
    """
    rod = arm.rod
    tendons = arm.tendons
    pack = block // 2
    blocks = 2 * rod.packs
    weight = load(rod.weight, block * LANES)
    mismatch = zero6()
    if law.mixed:  # columns are sums over tendons
        for j in range(law.active):
            store6(strain.Phi, j * blocks + block, zero6())
    # tensions
    for i in range(tendons.size):
        if is_present(tendons, i, pack):
            wrench = actuation_wrench(tendons, blocks, block, i, strain.tangent)
            missing = tension[i] - strain.tau[i]
            mismatch = twist_sum(mismatch, scale_twist(missing, wrench))
            for m in range(law.row_start[i], law.row_start[i + 1]):
                row = law.column[m] * blocks + block
                column = wrench
                if law.mixed:
                    share = scale_twist(law.weight[m], wrench)
                    before = load6(strain.Phi, row)
                    column = twist_sum(before, share)
                store6(strain.Phi, row, column)
                store6(strain.Y, row, scale_twist(weight, column))
    # passive wrenches
    for j in range(law.active, law.size):
        if is_present(law, j, pack):
            row = j * blocks + block
            passive_row = row - law.active * blocks
            column = load6(law.passive, passive_row)
            mismatch = twist_sum(mismatch, scale_twist(-q[j], column))
            store6(strain.Phi, row, column)
            store6(strain.Y, row, scale_twist(weight, column))
    store6(strain.mismatch, block, scale_twist(weight, mismatch))


@kernel(inline=True)
def turning_wrench(tendons, blocks, block, rate, strain):
    """Wrench -sum S (2 tau_dot t_dot + tau t_ddot) of tendons at a block.

    The block is strained at `rate`, xi_ddot = 0 (Appendix E multiplied out).
    """
    geometry = tendons.geometry
    tau = strain.tau
    pack = block // 2
    total = zero6()
    for i in range(tendons.size):
        if is_present(tendons, i, pack):
            row = i * blocks + block
            tangent_at = row * 4 * LANES
            geometry_at = row * 5 * LANES
            t = load3(strain.tangent, tangent_at)
            inverse = load(strain.tangent, tangent_at + 3 * LANES)
            # t_ddot = -2 stretch t_dot - |t_dot|^2 t, with the chord's rate constant
            stretch, t_dot = tangent_rate(geometry, geometry_at, rate, t, inverse)
            turning = dot(t_dot, t_dot)
            by_rate = 2.0 * (strain.tau_dot[i] - tau[i] * stretch)
            across = times(by_rate, t_dot)
            along = times(-tau[i] * turning, t)
            pulled = plus(across, along)
            presence = presence_of(geometry, geometry_at)
            present = times(-presence, pulled)
            wrench = wrench_column(geometry, geometry_at, present)
            total = twist_sum(total, wrench)
    return total


@kernel
def statics_columns(arm, law, tension, q, q_dot, strain, kinematics):
    """Columns Phi_xi (31) of every coordinate, xi_dot, the bias, and the mismatch.

    The bias is xi_bias = A^-1 Sigma^-1 (Psi_adot + Psi_a_dot) xi_dot (33), the mismatch that of
    which is the drive of the implicit strain (34), G ([u; 0] - q).
    """
    rod = arm.rod
    blocks = 2 * rod.packs
    strain_tension(law, q_dot, strain.tau_dot)
    for block in range(blocks):
        coordinate_wrenches(arm, law, block, tension, q, strain)
        f = load21(strain.factor, block)
        c = load6(rod.root_compliance, block)
        pack = block // 2
        # Phi_xi = A^-1 Sigma^-1 [Phi_a Phi_p] (31), in place of the wrenches
        rate = zero6()
        for j in range(law.size):
            if is_present(law, j, pack):
                row = j * blocks + block
                wrench = load6(strain.Phi, row)
                phi = solve_column(f, c, wrench, rod.free)
                rate = twist_sum(rate, scale_twist(q_dot[j], phi))
                store6(strain.Phi, row, phi)
        turning = turning_wrench(arm.tendons, blocks, block, rate, strain)
        bias = solve_column(f, c, turning, rod.free)
        store6(strain.xi_dot, block, rate)
        store6(strain.xi_bias, block, bias)


@kernel
def statics_matrices(arm, law, strain, ones, matrices):
    """Stiffness G and damping D of the columns.

    G = int Phi_xi^T (Sigma - Psi_a) Phi_xi dX = int Phi_xi^T [Phi_a Phi_p] dX (34).
    """
    stiffness_matrix(arm.rod, law, strain, ones, matrices.G)
    damping_matrix(arm.rod, law, strain, matrices.D)


@kernel(inline=True)
def rate_wrench(tendons, law, blocks, block, q_dot, strain):
    """Wrench [Phi_a Phi_p] q_dot at one block, where tangents and tau_dot are known."""
    total = passive_wrench(law, blocks, block, q_dot)
    pack = block // 2
    for i in range(tendons.size):
        if is_present(tendons, i, pack):
            wrench = actuation_wrench(tendons, blocks, block, i, strain.tangent)
            share = scale_twist(strain.tau_dot[i], wrench)
            total = twist_sum(total, share)
    return total


@kernel
def statics_rate(arm, law, q_dot, strain):
    """Strain rate xi_dot = C^1/2 H^-1 C^1/2 [Phi_a Phi_p] q_dot.

    It is from the tangents and factors that solve_statics() left.
    """
    rod = arm.rod
    blocks = 2 * rod.packs
    strain_tension(law, q_dot, strain.tau_dot)
    for block in range(blocks):
        f = load21(strain.factor, block)
        c = load6(rod.root_compliance, block)
        wrench = rate_wrench(arm.tendons, law, blocks, block, q_dot, strain)
        rate = solve_column(f, c, wrench, rod.free)
        store6(strain.xi_dot, block, rate)


PARAMETRISATIONS[StaticsBased] = Parametrisation(
    solve_statics,
    statics_columns,
    statics_matrices,
    statics_is_unique,
    statics_rate,
)
