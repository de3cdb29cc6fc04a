"""Newton iteration for the statics-based strain (30), with the exact Jacobian (31)-(32).

In scaled form, with C = Sigma^-1 (0 for rigid strains) and e = Sigma^1/2 (xi - xi*), the strain
solves e + C^1/2 (sum tau s - Phi_p q_p) =
0. Its Jacobian H is symmetric, and positive definite as long as every tendon pulls: e then
minimises a convex energy.
"""

from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, largest
from soft_tendon_env.mechanics.algebra.lie import (
    dot,
    minus,
    scale_twist,
    twist_difference,
    twist_sum,
)
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
from soft_tendon_env.mechanics.terms.tendons import (
    blocks_of,
    chord,
    is_present,
    presence_of,
    pull,
)

MAX_NEWTON = 20
CONTRACTION = 0.25
"""Largest part of a correction that the next one may be where Newton is to stay on the branch it
began on (Deuflhard, Newton Methods for Nonlinear Problems, 2004, chapter 5): with tendons that
push, the strain that balances them need not be the only one."""
ANY = 1e300  # contraction that is not watched
# of its length, the most that a tendon's chord may move in a part of a push: it alone makes the
# balance nonlinear
MOST_TURN = 0.3
RESOLUTION = 1e-15  # of the strain under the sum of all tensions, what rounding leaves of it


class Search(NamedTuple):
    """Strain that is sought, and the way to it."""

    part: float  # of the loads inside the strain
    tolerance: float  # of the scaled strain, for the last correction
    contraction: float  # see CONTRACTION


@kernel
def passive_wrench(law, blocks, block, q):
    """Passive wrench Phi_p q_p at one block."""
    total = zero6()
    pack = block // 2
    for j in range(law.active, law.size):
        if is_present(law, j, pack):
            row = (j - law.active) * blocks + block
            column = load6(law.passive, row)
            share = scale_twist(q[j], column)
            total = twist_sum(total, share)
    return total


@kernel
def strain_tension(law, q, tau):
    """Tensions of the strain law, tau = mixing q_a."""
    for i in range(tau.size):
        tau[i] = 0.0
        first = law.row_start[i]
        behind = law.row_start[i + 1]
        for m in range(first, behind):
            active = q[law.column[m]]
            tau[i] += law.weight[m] * active


@kernel
def solve_statics(arm, law, q, search, strain, kinematics):
    """Newton iteration for the strain (30) at every point, from the guess in strain.xi.

    It leaves xi, tangents and factors.

    Stops when the last correction is below the tolerance of the scaled strain: the factors belong
    to the iterate before it. Returns -1, or the first block where a pivot was not positive,
    corrections did not shrink, see CONTRACTION, or MAX_NEWTON iterations did not do.
    """
    rod = arm.rod
    blocks = 2 * rod.packs
    tau = strain.tau
    strain_tension(law, q, tau)
    force = 0.0
    for tension in tau:
        force += abs(tension)
    for block in range(blocks):
        c = load6(rod.root_compliance, block)
        reference = load6(rod.reference_strain, block)
        xi = load6(strain.xi, block)
        e = scale6(load6(rod.root_stiffness, block), twist_difference(xi, reference))
        target = scale6(c, passive_wrench(law, blocks, block, q))
        resolution = RESOLUTION * force * c[1][0]
        converged = False
        last = squared_norm(e)
        for iteration in range(MAX_NEWTON):
            # H de = C^1/2 (Phi_p q_p - sum tau s) - e, with H of (32) scaled
            h, total = pull(rod, arm.tendons, block, xi, tau, strain.tangent)
            f = factorise(scaled_stiffness(h, c), rod.free)
            residual = twist_difference(target, twist_sum(e, scale6(c, total)))
            step = solve(f, residual, rod.free)
            e = twist_sum(e, step)
            xi = twist_sum(reference, scale6(c, e))
            size = squared_norm(step)
            allowed = (search.tolerance * search.tolerance) * squared_norm(e)
            excess = size - allowed - resolution * resolution
            if largest(excess) <= 0.0:
                converged = True
                break
            if search.contraction < ANY:
                # points that have converged, while others of the pack have not, shrink no more
                most = search.contraction * search.contraction * last
                contracts = iteration == 0 or largest(excess - most) <= 0.0
                if not (is_positive(f) and contracts):
                    break
            last = size
        if not (converged and is_positive(f)):
            return block
        store6(strain.xi, block, xi)
        store_factor(strain.factor, block, f)
    return -1


@kernel
def chords_stay(rod, tendons, before, after):
    """Tells whether no tendon's chord differs much between two strain fields.

    That is by more than MOST_TURN of its length.
    """
    blocks = 2 * rod.packs
    geometry = tendons.geometry
    for i in range(tendons.size):
        for block in blocks_of(tendons, i):
            at = (i * blocks + block) * 5 * LANES
            k_before, p_before = load6(before, block)
            k_after, p_after = load6(after, block)
            chord_before = chord(geometry, at, k_before, p_before)
            chord_after = chord(geometry, at, k_after, p_after)
            turn = minus(chord_after, chord_before)
            squared_length = dot(chord_before, chord_before)
            allowed = (MOST_TURN * MOST_TURN) * squared_length
            excess = dot(turn, turn) - allowed
            present_excess = presence_of(geometry, at) * excess
            # so that a NaN does not stay
            if not largest(present_excess) <= 0.0:
                return False
    return True


@kernel
def all_pull(tau):
    """Tells whether no tendon pushes.

    The strain then minimises a convex energy, so that there is no other.
    """
    for tension in tau:
        if tension < 0.0:
            return False
    return True


@kernel
def statics_is_unique(arm, law, q, strain):
    """Whether at most one strain belongs to q: no tendon pushes."""
    strain_tension(law, q, strain.tau)
    return all_pull(strain.tau)
