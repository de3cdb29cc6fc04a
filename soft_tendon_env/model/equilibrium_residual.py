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


class At(NamedTuple):
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
    at: At
    stiffness: Array  # S = -df/dq (n, n)
    compliance: Array  # S^-1, 0 for neutral modes
    tangent: Array  # S^-1 df/dpart (n,): at an equilibrium, dq/dpart along its path

    @cached_property
    def stability(self) -> Stability:
        """Stability of the equilibrium: the energy has a minimum there.

        For loads without a potential, motions from it die out.
        """
        balance, S = self.balance, self.balance._by_metric(self.stiffness)
        has_potential = balance._is_symmetric(S)
        values, vectors = np.linalg.eigh(0.5 * (S + S.T)) if has_potential else np.linalg.eig(S)
        order = np.argsort(values.real)
        least, flutters = (
            float(values[order[0]].real),
            not has_potential and balance._flutters(self),
        )
        modes = balance.model.metric_unit @ vectors[:, order].real * math.sqrt(balance.energy)
        return Stability(
            least > -NEUTRAL * float(np.linalg.norm(S)) and not flutters,
            least,
            modes,
            has_potential,
            flutters,
        )


class Stability(NamedTuple):
    """Whether small disturbances of an equilibrium die out."""

    stable: bool  # or neutral
    # least (real part of an) eigenvalue of S in the metric of the unloaded arm: 1 there, 0 where
    # stability is lost
    least: float
    modes: (
        Array  # (n, n) the eigenvectors, softest first, each an angle of 1 rad, see Balance.angle
    )
    has_potential: bool  # S is symmetric
    flutters: bool  # oscillations grow, as only loads without a potential can make them


class Balance:
    """Static balance of one model under one load, f(q, part) = part (B u + F) - K.

    It has its derivatives; where there is no balance they are None, and `obstacle` says why.
    """

    def __init__(self, model: Model, tension: Array, work: Workspace) -> None:
        """work: of the model, that nobody else uses meanwhile."""
        self.model, self.tension, self.size, self.energy = (
            model,
            tension,
            model.coordinate_count,
            model.bending_energy,
        )
        self.work, self.linearisations, self.obstacle = work, 0, ""

    def at(self, q: Array, part: float) -> At | None:
        """The balance at q (n,)."""
        computed = self._compute(q, part, False, np.empty((0, self.size)))
        return None if computed is None else computed[0]

    def linearise(self, q: Array, part: float) -> Linearised | None:
        """The balance at q (n,) and its derivatives."""
        self.linearisations += 1
        unit = self.model.coordinate_scale()
        if (computed := self._compute(q, part, True, np.diag(unit))) is None:
            return None
        at, out = computed
        stiffness = out.slopes / unit
        compliance = self._inverse(stiffness)
        return (
            None
            if compliance is None
            else Linearised(self, at, stiffness, compliance, compliance @ out.rate)
        )

    def _inverse(self, stiffness: Array) -> Array | None:
        """Inverse (n, n) of a tangent stiffness, 0 for neutral modes; None where it is singular."""
        try:
            with np.errstate(all="ignore"):
                inverse = np.linalg.inv(stiffness)
        except np.linalg.LinAlgError:
            inverse = np.full_like(stiffness, np.nan)
        if (
            np.isfinite(inverse).all()
            and np.abs(np.diag(self.model.metric) * np.diag(inverse)).max() < 0.1 / NEUTRAL
        ):
            return np.asarray(inverse)
        S = self._by_metric(stiffness)
        if np.isfinite(S).all() and self._is_symmetric(S):
            values, vectors = np.linalg.eigh(0.5 * (S + S.T))
            stiff = np.abs(values) > NEUTRAL * np.linalg.norm(S)
            modes = self.model.metric_unit @ vectors[:, stiff]
            return np.asarray(modes / values[stiff] @ modes.T)
        self.obstacle = "the stiffness is singular: the arm gives way without further load"
        return None

    def _by_metric(self, matrix: Array) -> Array:
        return np.asarray(self.model.metric_unit.T @ matrix @ self.model.metric_unit)

    def _is_symmetric(self, S: Array) -> bool:
        # G grows without bound where the arm buckles, and differences of forces lose their symmetry
        strain = self.model.arm.strain
        is_conservative = (
            isinstance(strain, Loaded) and strain.has_potential and not self.model.arm.effects.load
        )
        return is_conservative or bool(np.linalg.norm(S - S.T) <= ASYMMETRIC * np.linalg.norm(S))

    def unloaded(self) -> Linearised:
        """The unloaded arm, where S is G."""
        computed = self._compute(np.zeros(self.size), 0.0, True, np.empty((0, self.size)))
        assert computed is not None, "the unloaded arm has a strain and resists every coordinate"
        at, out = computed
        compliance = np.asarray(np.linalg.inv(at.G), dtype=np.float64)
        return Linearised(self, at, at.G, compliance, compliance @ out.rate)

    def curvature(self, q: Array, part: float, modes: Array) -> tuple[At, Array] | None:
        """Balance at q (n,), and its curvature V^T S V (m, m) for modes V (n, m).

        The curvature is 1 for each of them on the unloaded arm.
        """
        computed = self._compute(q, part, False, np.ascontiguousarray(modes.T))
        return (
            None if computed is None else (computed[0], modes.T @ computed[1].slopes / self.energy)
        )

    def _compute(
        self, q: Array, part: float, with_rate: bool, directions: Array
    ) -> tuple[At, Linearisation] | None:
        n = self.size
        out = Linearisation(
            np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, len(directions)))
        )
        block, reached = linearise_balance(
            self.model.arm, self.tension, q, part, with_rate, directions, self.work, out
        )
        if block >= 0:
            limit = nearest_limit(
                self.model.arm, self.model.grid, q, self.work.strain.xi, reached, block
            )
            self.obstacle = f"no strain balances the coordinates: {limit}"
            return None
        try:
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # the energy of an absurd force is infinite or NaN: not balanced
                unbalanced = float(out.force @ np.linalg.solve(out.G, out.force))
                residual = (
                    math.sqrt(unbalanced / (self.energy + q @ out.G @ q))
                    if unbalanced >= 0.0
                    else math.inf
                )
        except np.linalg.LinAlgError:
            self.obstacle = (
                "the stiffness is singular: nothing resists some coordinates, as where tendons push"
                " past the stiffness"
            )
            return None
        return At(q, part, out.force, out.G, residual), out

    def product(self, a: Array, b: Array) -> float:
        """Inner product of `angle`, a^T G b of the unloaded arm [rad^2].

        It is infinite or NaN for absurd coordinates.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return float(a @ self.model.metric @ b) / self.energy

    def angle(self, change: Array) -> float:
        """Size of a change of coordinates (n,) as an angle of bending [rad].

        It is that of a bend of the whole unloaded arm that stores as much energy.
        """
        squared = self.product(change, change)
        return math.sqrt(max(squared, 0.0)) if math.isfinite(squared) else math.inf

    def is_continuous(self, q_from: Array, q: Array) -> bool:
        """Whether the strain changes continuously from that at q_from (n,) to that at q (n,)."""
        if not (
            found := bool(
                strain_is_continuous(
                    self.model.arm, q_from, q, self.work.strain, self.work.kinematics
                )
            )
        ):
            self.obstacle = (
                "no strain balances the coordinates on the way: the tendons push past the section's"
                " stiffness"
            )
        return found

    def _flutters(self, here: Linearised) -> bool:
        """Whether M q_ddot + D q_dot + S q = 0 has oscillations that grow."""
        size = self.size
        terms = self.model.terms(here.at.q, np.zeros(size), here.at.part * self.tension)
        M, D, S = map(self._by_metric, (terms.mass, terms.damping, here.stiffness))
        try:
            acceleration = np.linalg.solve(M, np.hstack([-S, -D]))
        except np.linalg.LinAlgError:  # a quadrature that is too coarse, of which build_model warns
            return False
        rates = np.linalg.eigvals(
            np.vstack([np.hstack([np.zeros((size, size)), np.eye(size)]), acceleration])
        )
        return bool((np.minimum(np.abs(rates.imag), rates.real) > NEUTRAL * np.abs(rates)).any())
