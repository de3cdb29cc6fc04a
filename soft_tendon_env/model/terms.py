"""Terms of the equation of motion and energies of an arm, as a model gives them."""

from typing import NamedTuple

from soft_tendon_env.tools.types import Array


class Terms(NamedTuple):
    """Terms of the equation of motion M q_ddot + C q_dot + D q_dot + K = B u + F (23).

    There are n coordinates and n_a tendons; angular comes before linear.

    `stiffness` is the Jacobian of K - B u to first order, exact at rest q = [u; 0]: G = int Phi_w^T
    (Sigma - Psi_a)^-1 Phi_w dX with Phi_w = [Phi_a Phi_p], K = G q. With loads inside the strain it
    is G = int Phi^T Phi_w dX, and `elastic_force` is K minus the force of these loads, again G q.
    Of explicit bases it is int Phi^T (Sigma - Psi(u)) Phi dX, with negative pivots set to zero.
    """

    mass: Array  # M (n, n)
    bias: Array  # C q_dot (n,)
    damping: Array  # D (n, n)
    stiffness: Array  # G (n, n)
    actuation: Array  # B (n, n_a)
    elastic_force: Array  # K (n,)
    external_force: Array  # F (n,) of the effects
    tip_pose: Array  # (4, 4)
    tip_jacobian: Array  # body Jacobian J (6, n)
    tip_bias: Array  # J_dot q_dot (6,)
    # -dF/dq (n, n) to first order, of effects that are stiff, as contact is
    external_stiffness: Array
    # -dF/dq_dot (n, n) likewise, of those that damp, as a fluid does
    external_damping: Array


class Energy(NamedTuple):
    """Kinetic, elastic and load energy [J]."""

    kinetic: float  # of the moving arm [J]
    elastic: float  # of the strained arm [J]
    load: float  # potential energy of the effects [J]

    @property
    def total(self) -> float:
        """Sum of the three [J]."""
        return self.kinetic + self.elastic + self.load
