"""Arrays of an arm that the kernels read: rod, tendons, strain parametrisation.

Shapes, units and layout are stated here, once.

The rod is cut into Magnus intervals, none across a breakpoint, and LANES neighbouring intervals
form a pack (the last pack is filled up with empty intervals at the tip). An interval carries two
Gauss points, z = 0, 1; the points z of the intervals of pack p form block b = 2 p + z. All fields
are flat float64 vectors with the lane running fastest:

    a field over points   [.., block, component, lane]
    a field over nodes    [.., pack, component, lane]     (node = the end of an interval; at the
    base everything is known)

Letters follow docs/reference/symbols.md, five of which have two meanings. Here xi is the strain,
eta the body twist, J the body Jacobian, e = Sigma^1/2 (xi - xi*) the scaled strain, and H = I -
C^1/2 Psi C^1/2 with C = Sigma^-1 the scaled section stiffness (H = L D L^T). Phi has the columns of
xi_dot = Phi q_dot, and Y their wrenches, with G = sum Phi^T Y. M, D and G are the mass, damping and
stiffness matrices.
"""

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LANES, aligned_copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import EffectTable

FloatVector = np.ndarray
IntVector = np.ndarray


class Rod(Struct):
    """The rod's section and quadrature."""

    packs: int
    free: tuple[
        int, ...
    ]  # the leading strains up to the last that is not rigid: 3, 4 or 6 of them, see section
    # (1) [kg] of the nodes, with what effects add; the base is no node, so its share is missing
    # here as in M
    mass: FloatVector
    length: FloatVector  # (4 P) of each interval [m], 0 for the empty ones
    weight: FloatVector  # points [m], the integral's weight, lengths / 2
    root_compliance: FloatVector  # points x 6, diag(Sigma)^-1/2, 0 for a rigid strain
    root_stiffness: FloatVector  # points x 6, diag(Sigma)^1/2, 0 for a rigid strain
    reference_strain: FloatVector  # points x 6, xi*
    viscosity: FloatVector  # points x 6, diag(Upsilon) times weight
    # nodes x 6, screw inertia of the section times the node's weight [kg m^2, kg], that which
    # effects add included
    inertia: FloatVector
    node_mass: FloatVector  # nodes [kg], what gravity pulls at: rod and payload


class Tendons(Struct):
    """Threadlike actuators: d = (0, y, z), d' and where they are present."""

    size: int
    geometry: (
        FloatVector  # tendon x points x 5: y, z [m], y', z', presence (1 on [start, end], else 0)
    )
    pack_begin: IntVector  # (n_a) first pack that holds a part of the tendon
    pack_end: IntVector  # (n_a) one past the last such pack


class Strain(Struct):
    """Base of the strain parametrisations: what their n coordinates q mean."""

    size: int  # n
    pack_begin: IntVector  # (n) first pack in which the coordinate strains the rod
    pack_end: IntVector  # (n) one past the last
    jacobian_end: (
        IntVector  # (n) the number of packs: a strain anywhere moves all nodes up to the tip
    )
    is_tensions = False  # whether q_i is the tension of tendon i, and nothing else is a coordinate
    has_potential = (
        True  # whether all that acts inside of the strain has a potential, so that G is symmetric
    )


class Implicit(Strain):
    """Base of the strains that static equilibrium defines implicitly.

    Coordinates are tensions and passive wrenches.

    Tensions u are in balance, with the loads inside, at q = [u; 0] (34).
    """

    law: "StaticsBased"  # of tensions and passive wrenches

    @property
    def is_tensions(self) -> bool:  # type: ignore[override]
        """True if every tension is a coordinate and there are no passive ones."""
        return self.law.active == self.size and not self.law.mixed

    def rest_coordinates(self, tension: FloatVector) -> FloatVector:
        """Coordinates (n,) at which tensions (n_a,) are in balance, [u; 0] of (34).

        The loads inside are in balance with them.
        """
        law = self.law
        q = np.zeros(self.size)
        # of each tendon its tension, once for every combination that it is in
        combinations = np.diff(law.row_start)
        tensions = np.repeat(tension, combinations)
        np.add.at(q, law.column, law.weight * tensions)
        return q


class StaticsBased(Implicit):
    """Statics-based strain (30).

    Tensions of the strain law: tau_i = sum weight[m] q[column[m]], m in
    row_start[i]..row_start[i+1].
    """

    row_start: IntVector  # (n_a + 1)
    column: IntVector
    weight: FloatVector
    mixed: (
        int  # 1 where redundant tendons share coordinates, 0 where q_i is the tension of tendon i
    )
    active: int  # coordinates 0..active-1 are tensions, the rest passive
    passive: FloatVector  # passive coordinate x points x 6, the wrench fields Phi_p

    @property
    def law(self) -> "StaticsBased":  # type: ignore[override]
        """The strain law of tensions and passive wrenches: this strain itself."""
        return self

    def tensions(self, q: FloatVector) -> FloatVector:
        """Tensions (n_a,) of the strain law at q (n,), tau = mixing q_a."""
        tau = np.zeros(self.row_start.size - 1)
        np.add.at(
            tau,
            np.repeat(np.arange(tau.size), np.diff(self.row_start)),
            self.weight * q[self.column],
        )
        return tau


class Loaded(Implicit):
    """Statics-based strain with dead loads inside (35).

    These have every tension strain the whole rod.
    """

    law: StaticsBased  # of the tensions and passive wrenches
    acceleration: tuple[
        float, float, float
    ]  # of gravity [m/s^2], on all mass; as the next in the world frame
    force: tuple[float, float, float]  # at the tip [N]
    moment: tuple[float, float, float]  # at the tip [N m]

    @property
    def has_potential(self) -> bool:  # type: ignore[override]
        """True without a dead moment, which has no potential."""
        return not any(self.moment)


class Explicit(Strain):
    """Explicit strain parametrisation, xi = xi* + Phi q."""

    field: FloatVector  # coordinate x points x 6, Phi
    stiffness: np.ndarray  # (n, n) int Phi^T Sigma Phi
    damping: np.ndarray  # (n, n) int Phi^T Upsilon Phi

    def rest_coordinates(self, tension: FloatVector) -> FloatVector:
        """Coordinates (n,) of the stress-free rod, at which a search for the equilibrium begins."""
        return np.zeros(self.size)


class Arm(Struct):
    """Arrays of a whole arm, as the kernels read it.

    The type of `strain` selects code when a kernel is compiled.
    """

    base: FloatVector  # (12) pose of the base, before effects move it: R rows and r, world frame
    rod: Rod
    tendons: Tendons
    strain: StaticsBased | Loaded | Explicit
    effects: EffectTable


def point_field(values: np.ndarray) -> np.ndarray:
    """Packs values at the points (..., intervals, 2, components) into the kernels' flat layout."""
    *lead, intervals, two, components = values.shape
    packs = intervals // LANES
    by_lane = values.reshape(*lead, packs, LANES, two, components)
    packed = np.moveaxis(by_lane, -3, -1)
    return aligned_copy(packed).ravel()


def node_field(values: np.ndarray) -> np.ndarray:
    """Packs values at the nodes (intervals, components) into the kernels' flat layout."""
    return aligned_copy(values.reshape(-1, LANES, values.shape[-1]).swapaxes(-1, -2)).ravel()
