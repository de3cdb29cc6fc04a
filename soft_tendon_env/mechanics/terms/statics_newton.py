"""Newton iteration for the statics-based strain (30), with the exact Jacobian (31)-(32).

In scaled form, with C = Sigma^-1 (0 for rigid strains) and e = Sigma^1/2 (xi - xi*), the strain
solves e + C^1/2 (sum tau s - Phi_p q_p) =
0. Its Jacobian H is symmetric, and positive definite as long as every tendon pulls: e then
minimises a convex energy.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, largest, load
from soft_tendon_env.mechanics.algebra.lie import dot, minus, scale_twist, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    factorise,
    is_positive,
    load6,
    scale6,
    scaled_stiffness,
    solve,
    squared_norm,
    store6,
    store_factor,
    zero6,
)
from soft_tendon_env.mechanics.terms.tendons import chord, pull

MAX_NEWTON = 20
CONTRACTION = 0.25
"""Largest part of a correction that the next one may be where Newton is to stay on the branch it
began on (Deuflhard, Newton Methods for Nonlinear Problems, 2004, chapter 5): with tendons that
push, the strain that balances them need not be the only one."""
ANY = 1e300  # contraction that is not watched
# of its length, the most that a tendon's chord may move in a part of a push: it alone makes the
# balance nonlinear
MOST_TURN = 0.3


@kernel
def passive_wrench(strain, blocks, block, q):
    """Passive wrench Phi_p q_p at one block."""
    total = zero6()
    pack = block // 2
    for j in range(strain.active, strain.size):
        if strain.pack_begin[j] <= pack < strain.pack_end[j]:
            column = load6(strain.passive, ((j - strain.active) * blocks + block) * 6 * LANES)
            total = twist_sum(total, scale_twist(q[j], column))
    return total


@kernel
def strain_tension(strain, q, tau):
    """Tensions of the strain law, tau = mixing q_a."""
    for i in range(tau.size):
        tau[i] = 0.0
        for m in range(strain.row_start[i], strain.row_start[i + 1]):
            tau[i] += strain.weight[m] * q[strain.column[m]]


@kernel
def solve_statics(arm, strain, q, part, tolerance, contraction, work):
    """Newton iteration for the strain (30) at every point, from the guess in work.xi; leaves xi,
    tangents and factors.

    Stops when the last correction is below `tolerance` of the scaled strain: the factors belong to
    the iterate before it. Returns -1, or the first block where a pivot was not positive,
    corrections did not shrink, see CONTRACTION, or MAX_NEWTON iterations did not do.
    """
    rod, blocks, tau, floor = arm.rod, 2 * arm.rod.packs, work.tau, 0.0
    strain_tension(strain, q, tau)
    for i in range(tau.size):
        floor += abs(tau[i])
    for block in range(blocks):
        at = block * 6 * LANES
        c, reference = load6(rod.root_compliance, at), load6(rod.reference_strain, at)
        xi = load6(work.xi, at)
        e = scale6(load6(rod.root_stiffness, at), twist_sum(xi, scale_twist(-1.0, reference)))
        target = scale6(c, passive_wrench(strain, blocks, block, q))
        resolution = 1e-15 * floor * c[1][0]
        converged, last = False, squared_norm(e)
        for iteration in range(MAX_NEWTON):
            h, total = pull(rod, arm.tendons, block, xi, tau, work.tangent)
            f = factorise(scaled_stiffness(h, c), rod.free)
            residual = twist_sum(target, scale_twist(-1.0, twist_sum(e, scale6(c, total))))
            step = solve(f, residual, rod.free)
            e = twist_sum(e, step)
            xi = twist_sum(reference, scale6(c, e))
            size = squared_norm(step)
            excess = size - (tolerance * tolerance) * squared_norm(e) - resolution * resolution
            if largest(excess) <= 0.0:
                converged = True
                break
            # points that have converged, while others of the pack have not, shrink no more
            if contraction < ANY and not (
                is_positive(f)
                and (iteration == 0 or largest(excess - contraction * contraction * last) <= 0.0)
            ):
                break
            last = size
        if not (converged and is_positive(f)):
            return block
        store6(work.xi, at, xi)
        store_factor(work.factor, block, f)
    return -1


@kernel
def chords_stay(rod, tendons, before, after):
    """Whether no tendon's chord differs by more than MOST_TURN of its length between two strain
    fields."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        for block in range(2 * tendons.pack_begin[i], 2 * tendons.pack_end[i]):
            at = (i * blocks + block) * 5 * LANES
            (k0, p0), (k1, p1) = load6(before, block * 6 * LANES), load6(after, block * 6 * LANES)
            c0, c1 = chord(tendons.geometry, at, k0, p0), chord(tendons.geometry, at, k1, p1)
            turn, presence = minus(c1, c0), load(tendons.geometry, at + 4 * LANES)
            excess = dot(turn, turn) - (MOST_TURN * MOST_TURN) * dot(c0, c0)
            if not largest(presence * excess) <= 0.0:
                return False
    return True


@kernel
def all_pull(tau):
    """Whether no tendon pushes: the strain then minimises a convex energy, so that there is no
    other."""
    for tension in tau:
        if tension < 0.0:
            return False
    return True


@kernel
def statics_is_unique(arm, strain, q, work):
    """Whether at most one strain belongs to q: no tendon pushes."""
    strain_tension(strain, q, work.tau)
    return all_pull(work.tau)
