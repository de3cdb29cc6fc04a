"""Limits of the strain: which tendon, or which load, is nearest to what no section balances, in
words."""

import numpy as np

from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded
from soft_tendon_env.model.grid import Grid
from soft_tendon_env.tools.types import Array


class StrainLimitError(ArithmeticError):
    """Raised where no strain balances the tensions: a tendon pulls its chord to nothing, or pushes
    the section past its shear stiffness."""


def nearest_limit(
    arm: Arm, grid: Grid, q: Array, xi: Array, reached: float = 1.0, block: int = -1
) -> str:
    """Message that names what is nearest to the limit where a part of q was reached; block: at
    which its search ended, see mechanics."""
    if block == 2 * grid.packs:
        return "the arm buckles under the loads inside of its strain (strain.include_loads)"
    rod, strain, tendons = arm.rod, arm.strain, arm.tendons
    if isinstance(strain, Explicit):
        return "an explicit strain has no such limit"
    tau = strain.law.tensions(reached * q if reached else q)
    y, z, y_prime, z_prime, presence = np.moveaxis(
        grid.at_points(tendons.geometry.reshape(tendons.size, -1), 5), -1, 0
    )
    k_x, k_y, k_z, *p = np.moveaxis(grid.at_points(xi, 6), -1, 0)
    chord = np.stack(
        [p[0] + k_y * z - k_z * y, p[1] - k_x * z + y_prime, p[2] + k_x * y + z_prime]
    )  # t_c (22)
    size = presence * np.linalg.norm(chord, axis=0)
    compliance = np.moveaxis(grid.at_points(rod.root_compliance, 6), -1, 0) ** 2
    give = (
        compliance[0] * (y**2 + z**2)
        + compliance[1] * z**2
        + compliance[2] * y**2
        + compliance[3:].sum(axis=0)
    )  # tr C S S^T
    softening = np.abs(tau)[:, None, None] * (size > 0.0) / np.maximum(size, 1e-30) * give
    tendon, *point = np.unravel_index(np.argmax(softening), size.shape)
    pull = f"pulls its own chord down to {size[tendon, *point]:.2g} of its length"
    push = "pushes the section as far as its stiffness holds"
    cause = (
        "is far beyond what any strain balances"
        if not reached
        else pull
        if tau[tendon] > 0
        else push
    )
    found = (
        f"tendon {tendon} at arc length {grid.points[*point]:.4g} m, with {tau[tendon]:.4g} N,"
        f" {cause}"
    )
    return (
        f"{found}, or the arm buckles under the loads inside of its strain"
        if isinstance(strain, Loaded)
        else found
    )
