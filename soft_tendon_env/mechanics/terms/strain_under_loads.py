"""Statics-based strain with dead loads inside (35), paper III-B.

It has Newton with the exact Hessian, columns, bias and stiffness.

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
from soft_tendon_env.mechanics.algebra.lie import twist_difference, twist_sum
from soft_tendon_env.mechanics.algebra.linear import total
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
    RESOLUTION,
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
)
"""Steps and weights of the second derivative."""
# [rad] of a step, of the turn of the whole rod: errors of 1e-11 by truncation, less by rounding
ALONG = 0.05
AT_REST = 1e-100  # turn of the whole rod by its rates, below which it does not move


@kernel
def linearise_loaded(arm, law, q, part, strain, kinematics):
    """Residual into memory.step, and the Hessian, factorised.

    Returns -1, the block of a section that gives way, or 2 packs: the arm buckles.
    """
    rod = arm.rod
    memory = strain.under_loads
    blocks = 2 * rod.packs
    poses(rod, arm.base, strain.xi, kinematics)  # of a base that no effect moves
    load_stress(rod, law, part, strain.xi, kinematics, memory.step)
    for block in range(blocks):
        c = load6(rod.root_compliance, block)
        xi = load6(strain.xi, block)
        h, pulled = pull(rod, arm.tendons, block, xi, strain.tau, strain.tangent)
        h = scaled_stiffness(h, c)
        if not is_positive(factorise(h, rod.free)):
            return block
        store_factor(strain.factor, block, h)
        # load_stress + Phi_p q_p - sum tau s - Sigma^1/2 e
        passive = passive_wrench(law.law, blocks, block, q)
        of_loads = load6(memory.step, block)
        outside = twist_sum(of_loads, passive)
        stiff = load6(rod.root_stiffness, block)
        e = load6(memory.e, block)
        elastic = scale6(stiff, e)
        inside = twist_sum(pulled, elastic)
        store6(memory.step, block, twist_difference(outside, inside))
    least_pivot = factorise_hessian(rod, law, part, strain, kinematics)
    return -1 if least_pivot > 0.0 else blocks


@kernel
def apply_correction(rod, xi, memory):
    """Adds the solution in memory.step to the scaled strain.

    Returns the largest squared corrections and squared strains of a point.
    """
    size = 0.0
    norm = 0.0
    for block in range(2 * rod.packs):
        stiff = load6(rod.root_stiffness, block)
        soft = load6(rod.root_compliance, block)
        reference = load6(rod.reference_strain, block)
        # step and strain, both times Sigma^1/2
        step = scale6(stiff, load6(memory.step, block))
        e = twist_sum(load6(memory.e, block), step)
        store6(memory.e, block, e)
        strained = scale6(soft, e)
        store6(xi, block, twist_sum(reference, strained))
        block_size = largest(squared_norm(step))
        if not block_size <= size:  # a NaN stays
            size = block_size
        block_norm = largest(squared_norm(e))
        norm = max(norm, block_norm)
    return size, norm


@kernel
def rounding(rod, law, part, tau):
    """Scaled strain that rounding leaves in the balance of tensions and loads, at most."""
    force = 0.0
    moment = 0.0
    for tension in tau:
        force += abs(tension)
    for i in range(3):
        weight = rod.mass[0] * abs(law.acceleration[i])
        whole = abs(law.force[i]) + weight
        force += part * whole
        moment += part * abs(law.moment[i])
    compliance = 0.0
    for c in rod.root_compliance:
        compliance = max(compliance, c)
    whole_moment = force * total(rod.length) + moment
    return RESOLUTION * whole_moment * compliance


@kernel
def scale_strain(rod, xi, e):
    """Scaled strain e = Sigma^1/2 (xi - xi*), fields over points."""
    for block in range(2 * rod.packs):
        reference = load6(rod.reference_strain, block)
        strained = twist_difference(load6(xi, block), reference)
        stiff = load6(rod.root_stiffness, block)
        store6(e, block, scale6(stiff, strained))


@kernel
def solve_loaded(arm, law, q, search, strain, kinematics):
    """Newton iteration for the strain under part of the loads, from the guess in strain.xi.

    It leaves xi, tangents and factors, and stays on its branch, see CONTRACTION, whatever the
    search says. Returns -1, or the block that stopped it, see linearise_loaded().
    """
    rod = arm.rod
    memory = strain.under_loads
    scale_strain(rod, strain.xi, memory.e)
    strain_tension(law.law, q, strain.tau)
    tolerance = max(SHARPER * search.tolerance, ROUND_OFF)
    resolution = rounding(rod, law, search.part, strain.tau)
    last = 0.0
    for iteration in range(MAX_NEWTON):
        failed = linearise_loaded(arm, law, q, search.part, strain, kinematics)
        if failed >= 0:
            return failed
        solve_hessian(rod, memory, memory.step, 0)
        size, norm = apply_correction(rod, strain.xi, memory)
        over = size - tolerance * tolerance * norm
        if over - resolution * resolution <= 0.0:
            return -1
        is_finite = size < 1e300
        contracts = iteration == 0 or over <= CONTRACTION * CONTRACTION * last
        if not (is_finite and contracts):
            break
        last = size
    return 2 * rod.packs


@kernel
def load_acceleration(arm, law, strain, kinematics, out):
    """Second derivative of load_stress() along the motion xi_dot with xi_ddot = 0.

    It goes into out (points x 6), by differences; moves the poses.
    """
    rod = arm.rod
    memory = strain.under_loads
    moved = memory.e
    turn = 0.0
    for m in range(out.size):
        weight_at = m // (6 * LANES) * LANES + m % LANES
        weight = rod.weight[weight_at]
        turn += weight * abs(strain.xi_dot[m])
    out[:] = 0.0
    if turn < AT_REST:
        return
    step = ALONG / turn
    squared_step = step * step
    for steps, share in STENCIL:
        way = steps * step
        for m in range(out.size):
            moved[m] = strain.xi[m] + way * strain.xi_dot[m]
        poses(rod, arm.base, moved, kinematics)
        load_stress(rod, law, 1.0, moved, kinematics, memory.step)
        factor = share / squared_step
        for m in range(out.size):
            out[m] += factor * memory.step[m]


@kernel
def loaded_columns(arm, loaded, tension, q, q_dot, strain, kinematics):
    """Columns, xi_dot, bias and mismatch of the strain with loads inside (35).

    B u - K + F is made of them. The bias is -H^-1 times the balance, of tendons and loads,
    differentiated twice along the motion with xi_ddot = 0.
    """
    rod = arm.rod
    law = loaded.law
    memory = strain.under_loads
    blocks = 2 * rod.packs
    # Phi = H^-1 [Phi_a Phi_p]
    strain_tension(law, q_dot, strain.tau_dot)
    strain.Phi[:] = 0.0
    for block in range(blocks):
        coordinate_wrenches(arm, law, block, tension, q, strain)
    for j in range(law.size):
        solve_hessian(rod, memory, strain.Phi, j * strain.xi.size)
    sum_columns(strain.Phi, q_dot, strain.xi_dot)
    # xi_bias
    load_acceleration(arm, loaded, strain, kinematics, strain.xi_bias)
    for block in range(blocks):
        rate = load6(strain.xi_dot, block)
        turning = turning_wrench(arm.tendons, blocks, block, rate, strain)
        of_loads = load6(strain.xi_bias, block)
        store6(strain.xi_bias, block, twist_sum(of_loads, turning))
    solve_hessian(rod, memory, strain.xi_bias, 0)


@kernel
def loaded_matrices(arm, loaded, strain, ones, matrices):
    """Stiffness G = int Phi^T Phi_w dX and D, of the columns."""
    law = loaded.law
    size = strain.xi.size
    rows = point_rows(arm.rod)
    for i in range(law.size):
        begin = i * size
        phi = strain.Phi[begin : begin + size]
        project(strain.Y, phi, rows, law.pack_begin, law.pack_end, matrices.G[i])
    damping_matrix(arm.rod, loaded, strain, matrices.D)


@kernel
def loaded_is_unique(arm, loaded, q, strain):
    """False, since that is never known: loads make the energy non-convex."""
    return False


@kernel
def loaded_rate(arm, loaded, q_dot, strain):
    """Strain rate xi_dot = H^-1 Phi_w q_dot.

    It is from the tangents and factors that solve_loaded() left.
    """
    law = loaded.law
    blocks = 2 * arm.rod.packs
    strain_tension(law, q_dot, strain.tau_dot)
    for block in range(blocks):
        wrench = rate_wrench(arm.tendons, law, blocks, block, q_dot, strain)
        store6(strain.xi_dot, block, wrench)
    solve_hessian(arm.rod, strain.under_loads, strain.xi_dot, 0)


PARAMETRISATIONS[Loaded] = Parametrisation(
    solve_loaded,
    loaded_columns,
    loaded_matrices,
    loaded_is_unique,
    loaded_rate,
)
