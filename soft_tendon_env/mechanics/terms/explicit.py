"""Explicit strain parametrisation: xi = xi* + Phi q with constant fields Phi."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.lie import scale_twist, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, scale6, store6, symmetric_product
from soft_tendon_env.mechanics.terms.dynamics import stiffness_matrix, sum_columns
from soft_tendon_env.mechanics.terms.parametrisation import PARAMETRISATIONS, Parametrisation
from soft_tendon_env.mechanics.terms.tendons import pull
from soft_tendon_env.mechanics.types import Explicit


@kernel
def explicit_columns(arm, strain, u, q, q_dot, work):
    """Strain rate xi_dot, tangents, and the stress that drives the coordinates under tensions u
    (n_a), times the weight; xi is linear in q, so its columns are constant and its bias stays the
    zero that it is."""
    rod = arm.rod
    explicit_rate(arm, strain, q_dot, work)
    copy(u, work.tau)
    for block in range(2 * rod.packs):
        at, weight = block * 6 * LANES, load(rod.weight, block * LANES)
        stiff, xi = load6(rod.root_stiffness, at), load6(work.xi, at)
        pulled = pull(rod, arm.tendons, block, xi, work.tau, work.tangent)[1]
        strained = twist_sum(xi, scale_twist(-1.0, load6(rod.reference_strain, at)))
        store6(
            work.mismatch,
            at,
            scale_twist(-weight, twist_sum(scale6(stiff, scale6(stiff, strained)), pulled)),
        )


@kernel
def explicit_matrices(arm, strain, work):
    """Stiffness G = int Phi^T (Sigma - Psi(u)) Phi dX, u the tensions of the columns, and D, which
    is constant."""
    rod, blocks = arm.rod, 2 * arm.rod.packs
    for block in range(blocks):
        at, weight = block * 6 * LANES, load(rod.weight, block * LANES)
        stiff, h = (
            load6(rod.root_stiffness, at),
            pull(rod, arm.tendons, block, load6(work.xi, at), work.tau, work.tangent)[0],
        )
        for j in range(strain.size):
            if strain.pack_begin[j] <= block // 2 < strain.pack_end[j]:
                column_at = (j * blocks + block) * 6 * LANES
                phi = load6(strain.field, column_at)
                wrench = twist_sum(scale6(stiff, scale6(stiff, phi)), symmetric_product(h, phi))
                store6(work.Y, column_at, scale_twist(weight, wrench))
    stiffness_matrix(rod, strain, work)
    copy_matrix(strain.damping, work.D)


@kernel
def solve_explicit(arm, strain, q, part, tolerance, contraction, work):
    """Strain xi = xi* + Phi q, which needs no guess."""
    sum_columns(strain.field, q, work.xi)
    for m in range(0, work.xi.size, LANES):
        store(work.xi, m, load(arm.rod.reference_strain, m) + load(work.xi, m))
    return -1


@kernel
def explicit_is_unique(arm, strain, q, work):
    """True, since there is one strain at all coordinates."""
    return True


@kernel
def explicit_rate(arm, strain, q_dot, work):
    """Strain rate xi_dot = Phi q_dot."""
    sum_columns(strain.field, q_dot, work.xi_dot)


PARAMETRISATIONS[Explicit] = Parametrisation(
    solve_explicit, explicit_columns, explicit_matrices, explicit_is_unique, explicit_rate
)
