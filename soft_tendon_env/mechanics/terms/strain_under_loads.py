"""Statics-based strain with dead loads inside (35): Newton with the exact Hessian, columns, bias
and stiffness (paper III-B).

The strain minimises U = int 1/2 (xi - xi*) . Sigma (xi - xi*) dX + sum tau_i (length of tendon i) -
int xi . Phi_p q_p dX - (work of the dead loads) over the strains at the points, the poses being the
Magnus product of interval exponentials. So

    e + C^1/2 (sum tau s - Phi_p q_p - load_stress) = 0    (scaled as in statics_based)

at every point. Columns Phi = H^-1 [Phi_a Phi_p] reach over the whole rod, see load_hessian. The
equation of motion keeps its form, with K - F = G q for K less the force F of these loads.

Loads make U non-convex: of several strains at the same coordinates the one is taken that is reached
as coordinates and loads grow together from nothing, or along a motion; where the Hessian loses its
positive pivots the arm buckles, and there is no strain.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, largest
from soft_tendon_env.mechanics.algebra.lie import scale_twist, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy, total
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    factorise,
    is_positive,
    load6,
    scale6,
    scaled_stiffness,
    squared_norm,
    store6,
    store_factor,
)
from soft_tendon_env.mechanics.terms.dynamics import (
    damping_matrix,
    point_rows,
    project,
    sum_columns,
)
from soft_tendon_env.mechanics.terms.kinematics import poses
from soft_tendon_env.mechanics.terms.load_hessian import (
    factorise_hessian,
    load_stress,
    solve_hessian,
)
from soft_tendon_env.mechanics.terms.parametrisation import PARAMETRISATIONS, Parametrisation
from soft_tendon_env.mechanics.terms.statics_based import (
    coordinate_wrenches,
    rate_wrench,
    turning_wrench,
)
from soft_tendon_env.mechanics.terms.statics_newton import (
    CONTRACTION,
    MAX_NEWTON,
    passive_wrench,
    strain_tension,
)
from soft_tendon_env.mechanics.terms.tendons import pull
from soft_tendon_env.mechanics.types import Loaded

# part of the tolerance that the last correction may have: columns are as far off as the iterate
# before it
SHARPER = 1e-3
ROUND_OFF = 1e-12  # relative size of corrections that rounding leaves
STENCIL = (
    (-3.0, 1 / 90),
    (-2.0, -0.15),
    (-1.0, 1.5),
    (0.0, -49 / 18),
    (1.0, 1.5),
    (2.0, -0.15),
    (3.0, 1 / 90),
)  # of the second derivative
# [rad] of a step, of the turn of the whole rod: errors of 1e-11 by truncation, less by rounding
ALONG = 0.05


@kernel
def linearise_loaded(arm, strain, q, part, work):
    """Residual into memory.step, and the Hessian, factorised; -1, the block of a section that gives
    way, or 2 packs: the arm buckles."""
    rod, memory, blocks = arm.rod, work.under_loads, 2 * arm.rod.packs
    poses(rod, work)
    load_stress(rod, strain, part, work, memory.step)
    for block in range(blocks):
        at = block * 6 * LANES
        c = load6(rod.root_compliance, at)
        h, pulled = pull(rod, arm.tendons, block, load6(work.xi, at), work.tau, work.tangent)
        h = scaled_stiffness(h, c)
        if not is_positive(factorise(h, rod.free)):
            return block
        store_factor(work.factor, block, h)
        wrench = twist_sum(load6(memory.step, at), passive_wrench(strain.law, blocks, block, q))
        wrench = twist_sum(
            wrench,
            scale_twist(
                -1.0, twist_sum(pulled, scale6(load6(rod.root_stiffness, at), load6(memory.e, at)))
            ),
        )
        store6(memory.step, at, wrench)
    return -1 if factorise_hessian(rod, strain, part, work) > 0.0 else blocks


@kernel
def apply_correction(rod, xi, memory):
    """Adds the solution in memory.step to the scaled strain; the largest squared corrections and
    squared strains of a point."""
    size, norm = 0.0, 0.0
    for block in range(2 * rod.packs):
        at = block * 6 * LANES
        step = scale6(load6(rod.root_stiffness, at), load6(memory.step, at))
        e = twist_sum(load6(memory.e, at), step)
        store6(memory.e, at, e)
        store6(
            xi,
            at,
            twist_sum(load6(rod.reference_strain, at), scale6(load6(rod.root_compliance, at), e)),
        )
        found = largest(squared_norm(step))
        if not found <= size:
            size = found
        norm = max(norm, largest(squared_norm(e)))
    return size, norm


@kernel
def rounding(rod, strain, part, tau):
    """Scaled strain that rounding leaves in the balance of tensions and loads, at most."""
    force, moment, compliance = 0.0, 0.0, 0.0
    for tension in tau:
        force += abs(tension)
    for i in range(3):
        force += part * (abs(strain.force[i]) + rod.mass[0] * abs(strain.acceleration[i]))
        moment += part * abs(strain.moment[i])
    for c in rod.root_compliance:
        compliance = max(compliance, c)
    return 1e-15 * (force * total(rod.length) + moment) * compliance


@kernel
def solve_loaded(arm, strain, q, part, tolerance, contraction, work):
    """Newton iteration for the strain under `part` of the loads, from the guess in work.xi; leaves
    xi, tangents and factors. It stays on its branch, see CONTRACTION, whatever `contraction` is.
    Returns -1, or the block that stopped it, see linearise_loaded()."""
    rod, memory, xi = arm.rod, work.under_loads, work.xi
    copy(arm.base, work.base[:12])  # which no effect moves, and another arm may have left
    for block in range(2 * rod.packs):
        at = block * 6 * LANES
        strained = twist_sum(load6(xi, at), scale_twist(-1.0, load6(rod.reference_strain, at)))
        store6(memory.e, at, scale6(load6(rod.root_stiffness, at), strained))
    strain_tension(strain.law, q, work.tau)
    tolerance, resolution, last = (
        max(SHARPER * tolerance, ROUND_OFF),
        rounding(rod, strain, part, work.tau),
        0.0,
    )
    for iteration in range(MAX_NEWTON):
        failed = linearise_loaded(arm, strain, q, part, work)
        if failed >= 0:
            return failed
        solve_hessian(rod, memory, memory.step, 0)
        size, norm = apply_correction(rod, xi, memory)
        excess = size - tolerance * tolerance * norm - resolution * resolution
        if excess <= 0.0:
            return -1
        if not size < 1e300 or (
            iteration > 0
            and not size - tolerance * tolerance * norm <= CONTRACTION * CONTRACTION * last
        ):
            break
        last = size
    return 2 * rod.packs


@kernel
def load_acceleration(rod, strain, work, out):
    """Second derivative of load_stress() along the motion xi_dot with xi_ddot = 0, out (points x
    6), by differences; moves the poses."""
    memory, turn = work.under_loads, 0.0
    for m in range(out.size):
        turn += rod.weight[m // (6 * LANES) * LANES + m % LANES] * abs(work.xi_dot[m])
    out[:] = 0.0
    if turn < 1e-100:  # at rest
        return
    step = ALONG / turn
    copy(work.xi, memory.e)
    for steps, share in STENCIL:
        for m in range(out.size):
            work.xi[m] = memory.e[m] + steps * step * work.xi_dot[m]
        poses(rod, work)
        load_stress(rod, strain, 1.0, work, memory.step)
        for m in range(out.size):
            out[m] += share / (step * step) * memory.step[m]
    copy(memory.e, work.xi)


@kernel
def loaded_columns(arm, strain, u, q, q_dot, work):
    """Columns, xi_dot, bias and mismatch, of which B u - K + F is made, of the strain with loads
    inside (35). The bias is -H^-1 times the balance, of tendons and loads, differentiated twice
    along the motion with xi_ddot = 0."""
    rod, tendons, law, memory, size = (
        arm.rod,
        arm.tendons,
        strain.law,
        work.under_loads,
        work.xi.size,
    )
    strain_tension(law, q_dot, work.tau_dot)
    work.Phi[:] = 0.0
    for block in range(2 * rod.packs):
        coordinate_wrenches(arm, law, block, u, q, work)
    for j in range(law.size):
        solve_hessian(rod, memory, work.Phi, j * size)
    sum_columns(work.Phi, q_dot, work.xi_dot)
    load_acceleration(rod, strain, work, work.xi_bias)
    for block in range(2 * rod.packs):
        at = block * 6 * LANES
        turning = turning_wrench(tendons, 2 * rod.packs, block, load6(work.xi_dot, at), work)
        store6(work.xi_bias, at, twist_sum(load6(work.xi_bias, at), turning))
    solve_hessian(rod, memory, work.xi_bias, 0)


@kernel
def loaded_matrices(arm, strain, work):
    """Stiffness G = int Phi^T Phi_w dX and D, of the columns."""
    law, size = strain.law, work.xi.size
    for i in range(law.size):
        project(
            work.Y,
            work.Phi[i * size : (i + 1) * size],
            point_rows(arm.rod),
            law.pack_begin,
            law.pack_end,
            work.G[i],
        )
    damping_matrix(arm.rod, strain, work)


@kernel
def loaded_is_unique(arm, strain, q, work):
    """False, since that is never known: loads make the energy non-convex."""
    return False


@kernel
def loaded_rate(arm, strain, q_dot, work):
    """Strain rate xi_dot = H^-1 Phi_w q_dot, from the tangents and factors that solve_loaded()
    left."""
    blocks = 2 * arm.rod.packs
    strain_tension(strain.law, q_dot, work.tau_dot)
    for block in range(blocks):
        store6(
            work.xi_dot,
            block * 6 * LANES,
            rate_wrench(arm.tendons, strain.law, blocks, block, q_dot, work),
        )
    solve_hessian(arm.rod, work.under_loads, work.xi_dot, 0)


PARAMETRISATIONS[Loaded] = Parametrisation(
    solve_loaded, loaded_columns, loaded_matrices, loaded_is_unique, loaded_rate
)
