"""Limits of the strain, in words.

They say which tendon, or which load, is nearest to what no section balances.
"""

import numpy as np

from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded
from soft_tendon_env.model.grid import Grid
from soft_tendon_env.tools.types import Array

# size of a chord below which it is taken for nothing
NO_CHORD = 1e-30


class StrainLimitError(ArithmeticError):
    """Raised where no strain balances the tensions.

    A tendon pulls its chord to nothing, or pushes the section past its shear stiffness.
    """


def nearest_limit(
    arm: Arm, grid: Grid, q: Array, xi: Array, reached: float = 1.0, block: int = -1
) -> str:
    """Message that names what is nearest to the limit of the strain.

    Args:
        arm: of the strain.
        grid: of the arm.
        q: coordinates (n,).
        xi: the strain, in the kernels' flat layout.
        reached: part of q at which the limit was reached.
        block: at which the search for the strain ended, see `mechanics`.
    """
    if block == 2 * grid.packs:
        return "the arm buckles under the loads inside of its strain (strain.include_loads)"
    strain = arm.strain
    if isinstance(strain, Explicit):
        return "an explicit strain has no such limit"
    if reached:
        part = reached * q
    else:
        part = q
    tau = strain.law.tensions(part)
    chord_size, give = _chords_and_give(arm, grid, xi)
    has_chord = chord_size > 0.0
    size = np.maximum(chord_size, NO_CHORD)
    pull = np.abs(tau)[:, None, None]
    softening = pull * has_chord / size * give
    softest = np.argmax(softening)
    tendon, *point = np.unravel_index(softest, softening.shape)
    place = grid.points[*point]
    tension = tau[tendon]
    if not reached:
        cause = "is far beyond what any strain balances"
    elif tension > 0:
        size_left = chord_size[tendon, *point]
        cause = f"pulls its own chord down to {size_left:.2g} of its length"
    else:
        cause = "pushes the section as far as its stiffness holds"
    place_on_rod = f"tendon {tendon} at arc length {place:.4g} m"
    limit = f"{place_on_rod}, with {tension:.4g} N, {cause}"
    if isinstance(strain, Loaded):
        return f"{limit}, or the arm buckles under the loads inside of its strain"
    return limit


def _chords_and_give(arm: Arm, grid: Grid, xi: Array) -> tuple[Array, Array]:
    """Sizes of the tendons' chords, and what the section gives way to their pull.

    They are (n_a, intervals, 2) each; chords are 0 where they are not.
    """
    tendons = arm.tendons
    by_tendon = tendons.geometry.reshape(tendons.size, -1)
    geometry = grid.at_points(by_tendon, 5)
    strain = grid.at_points(xi, 6)
    root_compliance = grid.at_points(arm.rod.root_compliance, 6)
    # one array for each component
    y, z, y_prime, z_prime, presence = np.moveaxis(geometry, -1, 0)
    k_x, k_y, k_z, p_x, p_y, p_z = np.moveaxis(strain, -1, 0)
    # t_c (22)
    first_terms = p_x + k_y * z
    chord_x = first_terms - k_z * y
    chord_y = p_y - k_x * z + y_prime
    chord_z = p_z + k_x * y + z_prime
    chord = np.stack([chord_x, chord_y, chord_z])
    chord_size = presence * np.linalg.norm(chord, axis=0)
    # tr C S S^T
    compliance = np.moveaxis(root_compliance**2, -1, 0)
    torsion, bend_y, bend_z, *linear = compliance
    y_squared = y**2
    z_squared = z**2
    about_x = torsion * (y_squared + z_squared)
    about_y = bend_y * z_squared
    about_z = bend_z * y_squared
    along = np.sum(linear, axis=0)
    give = about_x + about_y + about_z + along
    return chord_size, give
