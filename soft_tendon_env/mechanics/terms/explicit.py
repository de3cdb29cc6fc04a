"""Explicit strain parametrisation: xi = xi* + Phi q with constant fields Phi."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, sqrt
from soft_tendon_env.mechanics.algebra.lie import twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    factorise,
    inverse_diagonal,
    load6,
    multiply_upper,
    scaled,
    scaled_stiffness,
    store6,
    zero6,
)
from soft_tendon_env.mechanics.terms.dynamics import gram, point_rows
from soft_tendon_env.mechanics.terms.parametrisation import Parametrisation, parametrises
from soft_tendon_env.mechanics.terms.tendons import pull
from soft_tendon_env.mechanics.types import Explicit


@kernel(inline=True)
def combined(strain, blocks, block, amplitudes):
    """Sum of the fields Phi with these amplitudes at one block."""
    total, pack = zero6(), block // 2
    for j in range(strain.size):
        if strain.first[j] <= pack < strain.last[j]:
            total = twist_sum(total, twist_scaled(amplitudes[j], load6(strain.field, (j * blocks + block) * 6 * LANES)))
    return total


@kernel
def explicit_mismatch(rod, tendons, work):
    """The stress that drives the coordinates under the tensions of work.tau, times the weight; leaves the tangents."""
    for block in range(2 * rod.packs):
        at, weight = block * 6 * LANES, load(rod.weight, block * LANES)
        stiff, xi = load6(rod.root_stiffness, at), load6(work.xi, at)
        pulled = pull(rod, tendons, block, xi, work.tau, work.tangent)[1]
        strained = twist_sum(xi, twist_scaled(-1.0, load6(rod.reference_strain, at)))
        store6(work.mismatch, at, twist_scaled(-weight, twist_sum(scaled(stiff, scaled(stiff, strained)), pulled)))


@kernel
def explicit_weighted_columns(rod, tendons, strain, work):
    """Weighted columns Y with Y^T Y = Phi^T (Sigma - Psi(u)) Phi, u in work.tau, by the factor L D L^T of the section stiffness, scaled by
    C^1/2. A pivot below zero (pushing tendons) counts as zero: Y serves as a stiffness only."""
    blocks = 2 * rod.packs
    for block in range(blocks):
        at, pack = block * 6 * LANES, block // 2
        stiff, weight = load6(rod.root_stiffness, at), load(rod.weight, block * LANES)
        h = pull(rod, tendons, block, load6(work.xi, at), work.tau, work.tangent)[0]
        f = factorise(scaled_stiffness(h, load6(rod.root_compliance, at)), rod.free)
        (a, b, c), (d, e, g) = inverse_diagonal(f)
        bending = root_pivot(a, weight), root_pivot(b, weight), root_pivot(c, weight)
        root = bending, (root_pivot(d, weight), root_pivot(e, weight), root_pivot(g, weight))
        for j in range(strain.size):
            if strain.first[j] <= pack < strain.last[j]:
                column_at = (j * blocks + block) * 6 * LANES
                store6(work.Y, column_at, scaled(root, multiply_upper(f, scaled(stiff, load6(strain.field, column_at)), rod.free)))


@kernel(inline=True)
def root_pivot(inverse, weight):
    """Root sqrt(weight D) of a pivot."""
    pivot = weight / inverse
    return sqrt(0.5 * (pivot + sqrt(pivot * pivot)))


@kernel
def explicit_columns(arm, strain, u, q, q_dot, work):
    """Strain rate xi_dot and mismatch; xi is linear in q, so its columns are constant and its bias stays the zero that it is."""
    explicit_rate(arm, strain, q_dot, work)
    copy(u, work.tau)
    explicit_mismatch(arm.rod, arm.tendons, work)


@kernel
def explicit_matrices(arm, strain, work):
    """Stiffness G = int Phi^T (Sigma - Psi(u)) Phi dX, u the tensions of the columns, and D, which is constant."""
    explicit_weighted_columns(arm.rod, arm.tendons, strain, work)
    gram(work.Y, work.unit, point_rows(arm.rod), strain.first, strain.last, work.G)
    copy_matrix(strain.damping, work.D)


@kernel
def solve_explicit(arm, strain, q, part, tolerance, contraction, work):
    """Strain xi = xi* + Phi q, which needs no guess."""
    rod, blocks = arm.rod, 2 * arm.rod.packs
    for block in range(blocks):
        at = block * 6 * LANES
        store6(work.xi, at, twist_sum(load6(rod.reference_strain, at), combined(strain, blocks, block, q)))
    return -1


@kernel
def explicit_is_unique(arm, strain, q, work):
    """True, since there is one strain at all coordinates."""
    return True


@kernel
def explicit_softest(arm, strain, work):
    """1, since every strain exists and is the only one."""
    return 1.0


@kernel
def explicit_rate(arm, strain, q_dot, work):
    """Strain rate xi_dot = Phi q_dot."""
    blocks = 2 * arm.rod.packs
    for block in range(blocks):
        store6(work.xi_dot, block * 6 * LANES, combined(strain, blocks, block, q_dot))


parametrises(
    Explicit, Parametrisation(solve_explicit, explicit_columns, explicit_matrices, explicit_is_unique, explicit_softest, explicit_rate)
)
