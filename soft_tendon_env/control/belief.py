"""Belief of the Kalman filter: mean, covariance, and the model linearised where it believes.

The state has coordinates z = q / scale and their rates v, and what the model has wrong, see
`innovations.Layout`.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.force_errors import (
    ArmGeometry,
    ForceError,
    TendonFriction,
    holding_matrix,
)
from soft_tendon_env.control.innovations import Layout, Surprise, layout_of
from soft_tendon_env.control.protocol import InputError
from soft_tendon_env.control.rigid_motions import skew
from soft_tendon_env.control.timing_bank import Bank
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.types import Array

GRAVITY = 9.81
"""[m/s^2], by which the mass of the arm makes the unit of loads."""
GREATEST_LOSS = 0.8
"""Greatest share of a tension that friction takes, whatever coefficient is estimated."""


class Locality(NamedTuple):
    """Model at the estimated state, on which the next prediction and the controller build."""

    terms: Terms
    load_jacobian: Array  # J^T (n, 3 places)
    holding: Array  # (n_a, n) tensions nearest to a force, see force_errors.holding_matrix
    loss: Array  # (n_a,) shares of tensions that a coefficient of friction of 1 takes by sliding


class Belief(NamedTuple):
    """Mean and covariance of a filter, and the internal states of the effects."""

    mean: Array  # (m,), see innovations.Layout
    covariance: Array  # (m, m)
    # (2 n, 2 n) what unknown forces of the last period have added to that of coordinates and rates
    noise: Array
    jump: Array  # (m, 3 places) change of the state by loads that have jumped in the last period
    effects: Array  # internal states of the model's effects
    bank: Bank | None  # of the timing; None: it is found, or known
    locality: Locality
    surprise: Surprise


class StateSpace:
    """State of a model's filter: its layout, its units, and the model at a state.

    Args:
        model: of the arm.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._geometry = ArmGeometry(model)
        self.places = self._geometry.places
        self._turn = model.discretisation.tendon_turn  # (n_a,) [rad] of the paths by themselves
        self.layout: Layout = layout_of(model, self.places.size)
        self.scale = model.coordinate_scale()
        self.tension = _bending_tension(model)  # (n_a,) [N] by which one tendon bends it by 1 rad
        self.tip = np.repeat([1.0, model.length], 3)  # a radian counts as the rod's length
        self.mass = float(model.arm.rod.mass[0])
        self.weight = GRAVITY * self.mass

    def coordinates(self, mean: Array) -> tuple[Array, Array]:
        """Coordinates and rates (n,) of a state (m,)."""
        z = mean[self.layout.z]
        v = mean[self.layout.v]
        return self.scale * z, self.scale * v

    def timing(self, mean: Array) -> Timing:
        """Latency and lag [s] of a state (m,)."""
        layout = self.layout
        (latency,) = mean[layout.latency]
        (lag,) = mean[layout.lag]
        return Timing(float(latency), float(lag))

    def variances(self, **deviations: float | Array) -> Array:
        """Variances (m,) of a state from the standard deviations of all parts of its layout."""
        variance = np.zeros(self.layout.size)
        for name, part in self.layout._asdict().items():
            variance[part] = np.asarray(deviations[name]) ** 2
        return variance

    def locality(self, q: Array, q_dot: Array) -> Locality:
        """Model at coordinates and rates (n,). Raises as the model does."""
        terms = self.model.terms(q, q_dot)
        bent = self._geometry.at(q)
        # by the capstan equation a tendon loses this share up to its end, half of it on average
        turn = np.hypot(self._turn, bent.bending)
        return Locality(
            terms=terms,
            load_jacobian=bent.load_jacobian,
            holding=holding_matrix(terms),
            loss=0.5 * turn,
        )

    def input_error(self, mean: Array) -> InputError:
        """Errors of tensions in a state (m,): their gains and offsets."""
        gain = 1.0 + mean[self.layout.gain]
        offset = mean[self.layout.offset]
        return InputError(gain, offset)

    def friction(self, mean: Array, locality: Locality) -> TendonFriction:
        """Friction of the tendons in a state (m,)."""
        coefficient = mean[self.layout.friction]
        loss = np.minimum(coefficient * locality.loss, GREATEST_LOSS)
        return TendonFriction(loss, locality.terms.actuation)

    def force_error(self, mean: Array, locality: Locality) -> ForceError:
        """Force that the model lacks in a state (m,): of loads, and of errors of its numbers.

        Q = J^T f - s K - d D q_dot - m J_t^T (J_t q_ddot + b), with the loads f, the errors s and d
        of the factors of stiffness and damping, and a payload m at the tip, whose acceleration at
        constant rates is b. Friction of the tendons comes besides.
        """
        layout = self.layout
        terms = locality.terms
        tip = terms.tip_jacobian[3:]
        q, q_dot = self.coordinates(mean)
        still = np.zeros_like(q_dot)
        turning = tip.T @ tip_acceleration(terms, q_dot, still)
        loads = locality.load_jacobian @ mean[layout.load]
        weight = mean[layout.payload] * turning
        constant = loads - weight
        stiffness = mean[layout.stiffness] * terms.stiffness
        at_rest = constant - stiffness @ q
        return ForceError(
            constant=constant,
            stiffness=stiffness,
            damping=mean[layout.damping] * terms.damping,
            inertia=mean[layout.payload] * (tip.T @ tip),
            held=locality.holding @ at_rest,
            friction=self.friction(mean, locality),
        )


def tip_acceleration(terms: Terms, q_dot: Array, q_ddot: Array) -> Array:
    """Acceleration (..., 3) of the tip in its own frame: J q_ddot + J_dot q_dot + omega x v.

    It is that of each q_ddot (..., n).
    """
    twist = terms.tip_jacobian @ q_dot
    turning = skew(twist[:3])
    at_constant_rates = terms.tip_bias[3:] + turning @ twist[3:]
    by_rates = q_ddot @ terms.tip_jacobian[3:].T
    return np.asarray(by_rates + at_constant_rates)


def _bending_tension(model: Model) -> Array:
    """Tensions (n_a,) [N] of single tendons that bend the arm by 1 rad."""
    rest = np.zeros(model.coordinate_count)
    terms = model.terms(rest, rest)
    answer, *_ = np.linalg.lstsq(terms.stiffness, terms.actuation, rcond=None)
    # twice the energy that a unit of each stores; none, of a tendon along the axis
    works = terms.actuation * answer
    energy = works.sum(axis=0)
    least = np.finfo(float).tiny
    stored = np.maximum(energy, least)
    share = model.bending_energy / stored
    return np.sqrt(share)
