"""Explicit strain parametrisation: xi = xi* + Phi q with constant fields Phi."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.lie import scale_twist, twist_difference, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, scale6, store6, symmetric_product
from soft_tendon_env.mechanics.terms.dynamics import stiffness_matrix, sum_columns
from soft_tendon_env.mechanics.terms.parametrisation import PARAMETRISATIONS, Parametrisation
from soft_tendon_env.mechanics.terms.tendons import is_present, pull
from soft_tendon_env.mechanics.types import Explicit


@kernel
def explicit_columns(arm, law, tension, q, q_dot, strain, kinematics):
    """Strain rate xi_dot, tangents, and the stress that drives the coordinates.

    The stress is under tensions (n_a), times the weight; xi is linear in q, so its columns are
    constant and its bias stays the zero that it is.
    """
    rod = arm.rod
    explicit_rate(arm, law, q_dot, strain)
    copy(tension, strain.tau)
    for block in range(2 * rod.packs):
        weight = load(rod.weight, block * LANES)
        stiff = load6(rod.root_stiffness, block)
        xi = load6(strain.xi, block)
        # -weight (Sigma (xi - xi*) + sum tau s)
        _, pulled = pull(rod, arm.tendons, block, xi, strain.tau, strain.tangent)
        reference = load6(rod.reference_strain, block)
        strained = twist_difference(xi, reference)
        elastic = scale6(stiff, scale6(stiff, strained))
        stress = twist_sum(elastic, pulled)
        store6(strain.mismatch, block, scale_twist(-weight, stress))


@kernel
def explicit_matrices(arm, law, strain, ones, matrices):
    """Stiffness G = int Phi^T (Sigma - Psi(u)) Phi dX and D, which is constant.

    u are the tensions of the columns.
    """
    rod = arm.rod
    blocks = 2 * rod.packs
    for block in range(blocks):
        weight = load(rod.weight, block * LANES)
        stiff = load6(rod.root_stiffness, block)
        xi = load6(strain.xi, block)
        h, _ = pull(rod, arm.tendons, block, xi, strain.tau, strain.tangent)
        # Y = weight (Sigma - Psi) Phi
        pack = block // 2
        for j in range(law.size):
            if is_present(law, j, pack):
                column_row = j * blocks + block
                phi = load6(law.field, column_row)
                elastic = scale6(stiff, scale6(stiff, phi))
                of_tendons = symmetric_product(h, phi)
                wrench = twist_sum(elastic, of_tendons)
                store6(strain.Y, column_row, scale_twist(weight, wrench))
    stiffness_matrix(rod, law, strain, ones, matrices.G)
    copy_matrix(law.damping, matrices.D)


@kernel
def solve_explicit(arm, law, q, search, strain, kinematics):
    """Strain xi = xi* + Phi q, which needs no guess."""
    xi = strain.xi
    sum_columns(law.field, q, xi)
    for m in range(0, xi.size, LANES):
        reference = load(arm.rod.reference_strain, m)
        store(xi, m, reference + load(xi, m))
    return -1


@kernel
def explicit_is_unique(arm, law, q, strain):
    """True, since there is one strain at all coordinates."""
    return True


@kernel
def explicit_rate(arm, law, q_dot, strain):
    """Strain rate xi_dot = Phi q_dot."""
    sum_columns(law.field, q_dot, strain.xi_dot)


PARAMETRISATIONS[Explicit] = Parametrisation(
    solve_explicit,
    explicit_columns,
    explicit_matrices,
    explicit_is_unique,
    explicit_rate,
)
