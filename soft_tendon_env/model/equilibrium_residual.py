"""Static balance of an arm under a part of its load, 0 to 1.

It is the unbalanced force, stiffness and stability at given coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.motion.equilibrium import (
    Linearisation,
    linearise_balance,
    strain_is_continuous,
)
from soft_tendon_env.mechanics.types import Loaded
from soft_tendon_env.mechanics.workspace import Workspace
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.strain_limits import nearest_limit
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

# relative size of S - S^T above which loads have no potential; differences that S comes from leave
# 1e-6 at most
ASYMMETRIC = 1e-4
NEUTRAL = 1e-5
"""Eigenvalue of S, of its norm in the metric of the unloaded arm, that counts as 0, as where a
buckled column rests to any side, and growth of a motion in a radian. Differences leave less than
1e-6."""


class Evaluation(NamedTuple):
    """Balance at coordinates q (n,) under a part of the load."""

    q: Array
    part: float
    force: Array  # f = part (B u + F) - K (n,)
    G: Array  # (n, n), the drive's stiffness
    residual: float  # see statics.Equilibrium


@dataclass(eq=False)
class Linearised:
    """The balance to first order around coordinates."""

    balance: Balance
    evaluation: Evaluation  # there
    stiffness: Array  # S = -df/dq (n, n)
    compliance: Array  # S^-1, 0 for neutral modes
    tangent: Array  # S^-1 df/dpart (n,): at an equilibrium, dq/dpart along its path

    @cached_property
    def stability(self) -> Stability:
        """Stability of the equilibrium: the energy has a minimum there.

        For loads without a potential, motions from it die out.
        """
        balance = self.balance
        S = balance._by_metric(self.stiffness)
        has_potential = balance._is_symmetric(S)
        if has_potential:
            symmetric = 0.5 * (S + S.T)
            values, vectors = np.linalg.eigh(symmetric)
        else:
            values, vectors = np.linalg.eig(S)
        softest_first = np.argsort(values.real)
        least = float(values[softest_first[0]].real)
        flutters = not has_potential and balance._flutters(self)
        # eigenvectors of unit energy, scaled to that of bending by 1 rad
        ordered = vectors[:, softest_first].real
        ordered_modes = balance.model.metric_unit @ ordered
        modes = ordered_modes * math.sqrt(balance.energy)
        size = float(np.linalg.norm(S))
        neutral = NEUTRAL * size
        is_stable = least > -neutral and not flutters
        return Stability(is_stable, least, modes, has_potential, flutters)


class Stability(NamedTuple):
    """Whether small disturbances of an equilibrium die out."""

    stable: bool  # or neutral
    # least (real part of an) eigenvalue of S in the metric of the unloaded arm: 1 there, 0 where
    # stability is lost
    least: float
    modes: Array  # (n, n) eigenvectors, softest first, each an angle of 1 rad, see Balance.angle
    has_potential: bool  # S is symmetric
    flutters: bool  # oscillations grow, as only loads without a potential can make them


class Balance:
    """Static balance of one model under one load, f(q, part) = part (B u + F) - K.

    It has its derivatives; where there is no balance they are None, and `obstacle` says why.
    """

    def __init__(self, model: Model, tension: Array, work: Workspace) -> None:
        """work: of the model, that nobody else uses meanwhile."""
        self.model = model
        self.tension = tension
        self.size = model.coordinate_count
        self.energy = model.bending_energy
        self.work = work
        self.linearisations = 0
        self.obstacle = ""

    def at(self, q: Array, part: float) -> Evaluation | None:
        """The balance at q (n,)."""
        no_directions = np.empty((0, self.size))
        computed = self._compute(q, part, False, no_directions)
        if computed is None:
            return None
        evaluation, _ = computed
        return evaluation

    def linearise(self, q: Array, part: float) -> Linearised | None:
        """The balance at q (n,) and its derivatives."""
        self.linearisations += 1
        unit = self.model.coordinate_scale()
        directions = np.diag(unit)
        computed = self._compute(q, part, True, directions)
        if computed is None:
            return None
        evaluation, out = computed
        stiffness = out.slopes / unit
        compliance = self._inverse(stiffness)
        if compliance is None:
            return None
        tangent = compliance @ out.rate
        return Linearised(self, evaluation, stiffness, compliance, tangent)

    def _inverse(self, stiffness: Array) -> Array | None:
        """Inverse (n, n) of a tangent stiffness, 0 for neutral modes; None where it is singular."""
        try:
            with np.errstate(all="ignore"):
                inverse = np.linalg.inv(stiffness)
        except np.linalg.LinAlgError:
            inverse = np.full_like(stiffness, np.nan)
        # a compliance that is large beside the metric's is that of a neutral mode
        metric = np.diag(self.model.metric)
        inverse_metric = np.diag(inverse)
        compliances = metric * inverse_metric
        is_finite = np.isfinite(inverse).all()
        largest = np.abs(compliances).max()
        if is_finite and largest < 0.1 / NEUTRAL:
            return np.asarray(inverse)
        S = self._by_metric(stiffness)
        if np.isfinite(S).all() and self._is_symmetric(S):
            symmetric = 0.5 * (S + S.T)
            values, vectors = np.linalg.eigh(symmetric)
            least = NEUTRAL * np.linalg.norm(S)
            is_stiff = np.abs(values) > least
            stiff_vectors = vectors[:, is_stiff]
            modes = self.model.metric_unit @ stiff_vectors
            stiff_values = values[is_stiff]
            return np.asarray(modes / stiff_values @ modes.T)
        self.obstacle = "the stiffness is singular: the arm gives way without further load"
        return None

    def _by_metric(self, matrix: Array) -> Array:
        """A matrix (n, n) in coordinates that are orthonormal in the unloaded arm's metric."""
        unit = self.model.metric_unit
        return np.asarray(unit.T @ matrix @ unit)

    def _is_symmetric(self, S: Array) -> bool:
        """Whether S is that of a potential, by what the loads are, else by its numbers."""
        # G grows without bound where the arm buckles, and differences of forces lose their symmetry
        arm = self.model.arm
        is_unloaded = not arm.effects.load
        if isinstance(arm.strain, Loaded) and arm.strain.has_potential and is_unloaded:
            return True
        difference = S - S.T
        asymmetry = np.linalg.norm(difference)
        size = np.linalg.norm(S)
        return bool(asymmetry <= ASYMMETRIC * size)

    def unloaded(self) -> Linearised:
        """The unloaded arm, where S is G."""
        no_directions = np.empty((0, self.size))
        straight = np.zeros(self.size)
        computed = self._compute(straight, 0.0, True, no_directions)
        assert computed is not None, "the unloaded arm has a strain and resists every coordinate"
        evaluation, out = computed
        inverse = np.linalg.inv(evaluation.G)
        compliance = np.asarray(inverse, dtype=np.float64)
        tangent = compliance @ out.rate
        return Linearised(self, evaluation, evaluation.G, compliance, tangent)

    def curvature(self, q: Array, part: float, modes: Array) -> tuple[Evaluation, Array] | None:
        """Balance at q (n,), and its curvature V^T S V (m, m) for modes V (n, m).

        The curvature is 1 for each of them on the unloaded arm.
        """
        directions = np.ascontiguousarray(modes.T)
        computed = self._compute(q, part, False, directions)
        if computed is None:
            return None
        evaluation, out = computed
        product = modes.T @ out.slopes
        curvature = product / self.energy
        return evaluation, curvature

    def _compute(
        self, q: Array, part: float, with_rate: bool, directions: Array
    ) -> tuple[Evaluation, Linearisation] | None:
        """Balance at q (n,), with its rate by the part of the load.

        It has slopes in directions (k, n). None without a strain or a stiffness, as `obstacle`
        says.
        """
        model = self.model
        n = self.size
        out = Linearisation(
            np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, len(directions)))
        )
        block, reached = linearise_balance(
            model.arm, self.tension, q, part, with_rate, directions, self.work, out
        )
        if block >= 0:
            xi = self.work.strain.xi
            limit = nearest_limit(model.arm, model.grid, q, xi, reached, block)
            self.obstacle = f"no strain balances the coordinates: {limit}"
            return None
        try:
            # the energy of an absurd force is infinite or NaN: not balanced
            with np.errstate(over="ignore", invalid="ignore"):
                residual = self._residual(q, out)
        except np.linalg.LinAlgError:
            self.obstacle = (
                "the stiffness is singular: nothing resists some coordinates, as where tendons push"
                " past the stiffness"
            )
            return None
        return Evaluation(q, part, out.force, out.G, residual), out

    def _residual(self, q: Array, out: Linearisation) -> float:
        """Angle [rad] sqrt(f^T G^-1 f / (E_1 + q^T G q)) of the unbalanced force f.

        Raises LinAlgError where G is singular.
        """
        answer = np.linalg.solve(out.G, out.force)
        unbalanced = float(out.force @ answer)
        if not unbalanced >= 0.0:
            return math.inf
        force = q @ out.G
        stored = self.energy + force @ q
        return math.sqrt(unbalanced / stored)

    def product(self, a: Array, b: Array) -> float:
        """Inner product of `angle`, a^T G b of the unloaded arm [rad^2].

        It is infinite or NaN for absurd coordinates.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            dual = a @ self.model.metric
            product = float(dual @ b)
            return product / self.energy

    def angle(self, change: Array) -> float:
        """Size of a change of coordinates (n,) as an angle of bending [rad].

        It is that of a bend of the whole unloaded arm that stores as much energy.
        """
        squared = self.product(change, change)
        if not math.isfinite(squared):
            return math.inf
        return math.sqrt(max(squared, 0.0))

    def is_continuous(self, q_from: Array, q: Array) -> bool:
        """Whether the strain changes continuously from that at q_from (n,) to that at q (n,)."""
        strain = self.work.strain
        kinematics = self.work.kinematics
        is_continuous = strain_is_continuous(self.model.arm, q_from, q, strain, kinematics)
        if not is_continuous:
            self.obstacle = (
                "no strain balances the coordinates on the way: the tendons push past the section's"
                " stiffness"
            )
        return bool(is_continuous)

    def _flutters(self, point: Linearised) -> bool:
        """Whether M q_ddot + D q_dot + S q = 0 has oscillations that grow."""
        still = np.zeros(self.size)
        q = point.evaluation.q
        tension = point.evaluation.part * self.tension
        terms = self.model.terms(q, still, tension)
        M = self._by_metric(terms.mass)
        D = self._by_metric(terms.damping)
        S = self._by_metric(point.stiffness)
        # of the state (q, q_dot): q_dot, and q_ddot = -M^-1 (S q + D q_dot)
        try:
            parts = [-S, -D]
            both = np.hstack(parts)
            acceleration = np.linalg.solve(M, both)
        except np.linalg.LinAlgError:  # a quadrature that is too coarse, of which build_model warns
            return False
        unit = np.eye(self.size)
        no_change = np.zeros_like(unit)
        velocity = np.hstack([no_change, unit])
        companion = np.vstack([velocity, acceleration])
        rates = np.linalg.eigvals(companion)
        # an oscillation turns, and grows by more than round-off while it turns
        turning = np.abs(rates.imag)
        growing_oscillation = np.minimum(turning, rates.real)
        slow = NEUTRAL * np.abs(rates)
        is_growing = growing_oscillation > slow
        return bool(is_growing.any())
