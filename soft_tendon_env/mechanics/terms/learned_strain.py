"""Statics-based strain with a learned wrench of its dead loads (paper III-B): a small network in place of the equilibrium under them.

In xi = Sigma^-1 (Phi_a(xi) q_a + Phi_p q_p + Phi_e) + xi* (35) the wrench of the loads Phi_e depends on the poses of the whole rod. Here it
is sum c_r(q_a) field_r, with amplitudes by a network of the tensions: the strain is that of statics_based.py with a further passive
coordinate c_r per field, which follows the others. So, with z = [q; c(q)],

    Phi = Phi_z dz/dq,    xi_bias = xi_bias_z + sum c_ddot_r Phi_r    (c_ddot at q_ddot = 0)

are the exact derivatives of the learned strain, to round-off, and the columns of the fields are never solved for: wrenches are combined
before the section's factor is applied. Any c(q) makes a sound model, since the loads themselves act as forces on the coordinates, F =
int J^T f dm: the arm moves on the shapes that the strain has, with its energy, and what is not learned shows in how well they fit. At rest
q differs from [u; 0] by so much. G = Phi^T (Sigma - Psi_a) Phi, without the stiffness of the loads, as where they are outside.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import rotate_back, times, twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, load_factor, scaled, solve, store6, zero6
from soft_tendon_env.mechanics.terms.dynamics import damping_matrix, stiffness_matrix
from soft_tendon_env.mechanics.terms.kinematics import load_pose, tip_pose_of
from soft_tendon_env.mechanics.terms.network import amplitude_rates, amplitudes
from soft_tendon_env.mechanics.terms.parametrisation import Parametrisation, parametrises
from soft_tendon_env.mechanics.terms.statics_based import actuation_wrench, add_at, solve_column, statics_rate, turning_wrench
from soft_tendon_env.mechanics.terms.statics_newton import (
    statics_along,
    statics_from_guess,
    statics_from_rest,
    statics_is_firm,
    statics_is_unique,
    strain_tension,
)
from soft_tendon_env.mechanics.types import Learned


@kernel(inline=True)
def learned_wrench(strain, blocks, block, amplitude):
    """Learned wrench sum_r a_r field_r at one block."""
    total, whole = zero6(), strain.whole
    for r in range(whole.size - strain.size):
        field = load6(whole.passive, ((strain.size - whole.active + r) * blocks + block) * 6 * LANES)
        total = twist_sum(total, twist_scaled(amplitude[r], field))
    return total


@kernel(inline=True)
def learned_wrenches(strain, blocks, block, amplitude, other):
    """Learned wrenches of two sets of amplitudes at one block, see learned_wrench()."""
    total, total_other, whole = zero6(), zero6(), strain.whole
    for r in range(whole.size - strain.size):
        field = load6(whole.passive, ((strain.size - whole.active + r) * blocks + block) * 6 * LANES)
        total = twist_sum(total, twist_scaled(amplitude[r], field))
        total_other = twist_sum(total_other, twist_scaled(other[r], field))
    return total, total_other


@kernel
def learned_columns(arm, strain, u, q, q_dot, work):
    """Columns Phi of every coordinate, their wrenches times the weight in Y, xi_dot, bias and the mismatch."""
    rod, tendons = arm.rod, arm.tendons
    amplitude_rates(strain, q_dot, 2 + strain.network.inputs, work.network)
    strain_tension(strain.law, q_dot, work.tau_dot)
    blocks, law, amplitude, slopes = 2 * rod.packs, strain.law, work.network.z[strain.size :], work.network.rates[2:]
    for block in range(blocks):
        at, pack = block * 6 * LANES, block // 2
        f, c, weight = load_factor(work.factor, block), load6(rod.root_compliance, at), load(rod.weight, block * LANES)
        pressed = twist_scaled(-1.0, learned_wrench(strain, blocks, block, amplitude))
        for j in range(0, law.active, 2):
            next_j = min(j + 1, law.active - 1)
            own, of_next = learned_wrenches(strain, blocks, block, slopes[j], slopes[next_j])
            store6(work.Phi, (j * blocks + block) * 6 * LANES, own)
            store6(work.Phi, (next_j * blocks + block) * 6 * LANES, of_next)
        for i in range(tendons.size):
            if tendons.first[i] <= pack < tendons.last[i]:
                column = actuation_wrench(tendons, blocks, block, i, work)
                pressed = twist_sum(pressed, twist_scaled(u[i] - work.tau[i], column))
                for m in range(law.row[i], law.row[i + 1]):
                    add_at(work.Phi, (law.coordinate[m] * blocks + block) * 6 * LANES, twist_scaled(law.mixing[m], column))
        rate = zero6()
        for j in range(strain.size):
            if strain.first[j] <= pack < strain.last[j]:
                column_at = (j * blocks + block) * 6 * LANES
                if j >= law.active:
                    column = load6(law.passive, ((j - law.active) * blocks + block) * 6 * LANES)
                    pressed = twist_sum(pressed, twist_scaled(-q[j], column))
                else:
                    column = load6(work.Phi, column_at)
                phi = solve_column(f, c, column, rod.free)
                rate = twist_sum(rate, twist_scaled(q_dot[j], phi))
                store6(work.Y, column_at, twist_scaled(weight, column))
                store6(work.Phi, column_at, phi)
        store6(work.mismatch, at, twist_scaled(weight, pressed))
        store6(work.xi_dot, at, rate)
    learned_bias(arm, strain, work)


@kernel
def learned_bias(arm, strain, work):
    """Bias xi_bias (33), and what the amplitudes' acceleration c_ddot at q_ddot = 0 strains."""
    rod, tendons, blocks = arm.rod, arm.tendons, 2 * arm.rod.packs
    for block in range(blocks):
        at = block * 6 * LANES
        total = turning_wrench(tendons, blocks, block, load6(work.xi_dot, at), work)
        total = twist_sum(total, learned_wrench(strain, blocks, block, work.network.rates[1]))
        c = load6(rod.root_compliance, at)
        store6(work.xi_bias, at, scaled(c, solve(load_factor(work.factor, block), scaled(c, total), rod.free)))


@kernel
def learned_matrices(arm, strain, work):
    """Stiffness G = Phi^T (Sigma - Psi_a) Phi of the columns, and D."""
    stiffness_matrix(arm.rod, strain, work)
    damping_matrix(arm.rod, strain, work)


@kernel
def learned_loads(arm, strain, work):
    """True, with the wrenches of the loads inside, whose force is int J^T f dm, in work.wrench; after poses()."""
    rod, loads = arm.rod, strain.loads
    none = zero6()[0]
    for pack in range(rod.packs):
        R, _ = load_pose(work.pose, pack * 12 * LANES)
        weight = times(load(rod.node_mass, pack * LANES), rotate_back(R, loads.acceleration))
        store6(work.wrench, pack * 6 * LANES, (none, weight))
    R, _ = tip_pose_of(work.pose)
    moment, force = rotate_back(R, loads.moment), rotate_back(R, loads.force)
    at = (rod.packs - 1) * 6 * LANES + LANES - 1
    for i in range(3):
        work.wrench[at + i * LANES] += moment[i]
        work.wrench[at + (3 + i) * LANES] += force[i]
    return True


@kernel
def learned_from_guess(arm, strain, q, tolerance, work):
    """The strain at q from the guess in work.xi."""
    return statics_from_guess(arm, strain.whole, amplitudes(strain, q, work.network), tolerance, work)


@kernel(counted=True)
def learned_from_rest(arm, strain, q, tolerance, work):
    """The strain at q on the branch on which coordinates and amplitudes grow together from the stress-free rod."""
    return statics_from_rest(arm, strain.whole, amplitudes(strain, q, work.network), tolerance, work)


@kernel(counted=True)
def learned_along(arm, strain, q_from, q, tolerance, work):
    """The strain at q on the branch of that at q_from, with amplitudes that change evenly between them."""
    z_from = amplitudes(strain, q_from, work.network).copy()
    z = amplitudes(strain, q, work.network)
    return statics_along(arm, strain.whole, z_from, z, tolerance, work)


@kernel
def learned_is_unique(arm, strain, q, work):
    """Whether at most one strain belongs to q."""
    return statics_is_unique(arm, strain.law, q, work)


@kernel
def learned_is_firm(arm, strain, q, tolerance, work):
    """Whether q has a strain that keeps clear of others."""
    return statics_is_firm(arm, strain.whole, amplitudes(strain, q, work.network), tolerance, work)


@kernel
def learned_rate(arm, strain, q_dot, work):
    """Strain rate xi_dot alone; the hidden layers are those that learned_from_guess() left."""
    statics_rate(arm, strain.whole, amplitude_rates(strain, q_dot, 2, work.network), work)


parametrises(
    Learned,
    Parametrisation(
        learned_from_guess,
        learned_columns,
        learned_matrices,
        learned_from_rest,
        learned_along,
        learned_is_unique,
        learned_is_firm,
        learned_rate,
        learned_loads,
    ),
)
