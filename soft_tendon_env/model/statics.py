"""Static equilibria B u - K + F = 0 of (23).

Of many it is the one where a slowly loaded arm goes, see load_continuation.
"""

from __future__ import annotations

import dataclasses
import warnings
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.algebra.linear import solve_bounded
from soft_tendon_env.mechanics.types import Explicit, Implicit
from soft_tendon_env.model.coordinates import with_every_tension
from soft_tendon_env.model.equilibrium_residual import At, Balance
from soft_tendon_env.model.load_continuation import MOST_SETTLINGS, RESIDUAL, LoadPath
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.reference_model import equilibrium_error
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.model.tension_limits import erring_actuators, warn_beyond_limits
from soft_tendon_env.tools.checks import checked_array, checked_type
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

MOST_COMMANDED = 50
"""Iterations at most under a command that is no tension."""

SAME_TENSION = 1e-11
"""Relative difference of tensions that counts as none."""

CONTRACTION = 0.5
"""Ratio of a correction to the one before, above which Newton's method with the stiffness of
another equilibrium is given up."""

SEEN = 1e-4
"""Share of the rod's length by which redundant tendons may leave the tip off without a warning."""


class RedundancyWarning(UserWarning):
    """Redundant tendons strain the bent arm in a way that its coordinates lack."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Static equilibrium of an arm with n coordinates.

    If not `converged`, it is the last one on the path from the unloaded arm to the full load.

    `residual` is the angle by which the unbalanced force would bend a rod as stiff as this one:
    sqrt(f^T G^-1 f / (E_1 + q^T G q)), with E_1 from a rod bent by one radian.
    """

    q: Array  # (n,)
    tip_pose: Array  # (4, 4)
    converged: bool
    residual: float  # [rad]
    reason: str  # why the path goes no further; empty when converged
    iterations: int  # linearisations of the balance on the way
    # the energy has a minimum, maybe a flat one; for loads without a potential M q_ddot + D q_dot +
    # S q = 0 does not grow
    stable: bool
    load: float  # the part of the load, tensions and effects, that q balances: 1 when converged
    model: Model = field(repr=False)
    tension: Array = field(repr=False)  # (n_a,) [N] of the full load

    @cached_property
    def tip_error(self) -> float:
        """Estimated distance of the tip [m] from that of the rod itself.

        It is the error of coordinates and quadrature, computed when first read. A converged
        reference model solves the equilibrium again, see reference_model.equilibrium_error.
        Infinite where it has none near.
        """
        return equilibrium_error(self.model, self.q, self.tension, self.load, self.stable)


def static_equilibrium(
    model: Model, tension: ArrayLike, guess: ArrayLike | None = None, *, settle: bool = False
) -> Equilibrium:
    """Computes the static equilibrium of the arm under constant tensions and its effects.

    It is the one that a slowly loaded arm reaches. Tensions and effects grow together from zero
    (continuation), along the branch of stable equilibria that begins at the unloaded arm. Loads
    inside the strain act from the beginning. If the branch ends before the full load (at a limit
    point, a bifurcation, flutter, the strain limit), the result is not `converged`. It then has the
    load reached and the reason.

    Tensions beyond `tension_limits` are used as given, with a TensionLimitWarning.

    Args:
        model: of the arm.
        tension: (n_a,) [N].
        guess: coordinates (n,), from which Newton's method starts at the full load. The result is
            the equilibrium next to them, stable or not, if there is one.
        settle: if the branch ends, let the arm move, with damping and without inertia, until it
            rests, and load it further.

    Returns:
        The equilibrium, or the last one on the way to the full load.

    Raises:
        TypeError: for arguments of wrong types.
        ValueError: for wrong shapes or numbers that are not finite.
    """
    checked_type("model", model, Model, "see build_model")
    u = checked_array("tension", tension, (model.tendon_count,))
    warn_beyond_limits(model.discretisation.tension_limits.tolist(), u)
    with model.workspace() as work:
        balance = Balance(model, u, work)
        path = LoadPath(balance)
        if guess is not None:
            near = path.equilibrium(checked_array("guess", guess, (model.coordinate_count,)), 1.0)
            if near is not None:
                return _found(balance, near.at, near.stability.stable, "")
        if rests_at_tensions(model):
            # q = [u; 0] is at rest, and stable: S = G there, positive definite wherever the strain
            # exists, unless it lacks a potential
            at = balance.at(model.rest_coordinates(u), 1.0)
            if at is not None and at.residual <= RESIDUAL:
                here = None if model.arm.strain.has_potential else balance.linearise(at.q, 1.0)
                return _found(balance, at, here is None or here.stability.stable, "")
        end, reason = path.rest(MOST_SETTLINGS if settle else 0)
        return _found(balance, end.at, end.stability.stable, reason)


def rests_at_tensions(model: Model) -> bool:
    """Whether q = [u; 0] is at rest under tensions u (34), and S = G there."""
    return isinstance(model.arm.strain, Implicit) and not model.arm.effects.load


def _found(balance: Balance, at: At, stable: bool, reason: str) -> Equilibrium:
    tip, loaded = balance.model.tip_pose(at.q), balance.at(at.q, 1.0) if reason else at
    residual = np.inf if loaded is None else loaded.residual
    _warn_of_redundancy(balance, at, tip)
    model, tension = balance.model, balance.tension
    return Equilibrium(
        at.q,
        tip,
        not reason,
        residual,
        reason,
        balance.linearisations,
        stable,
        at.part,
        model,
        tension,
    )


def _warn_of_redundancy(balance: Balance, at: At, tip: Array) -> None:
    """Warns where tensions that have no coordinate would move the tip."""
    model, strain, u = balance.model, balance.model.arm.strain, at.part * balance.tension
    if isinstance(strain, Explicit) or not strain.law.mixed:
        return
    rest = model.rest_coordinates(u)
    left_out = u - strain.law.tensions(rest)
    if np.abs(left_out).max() <= 1e-12 * np.abs(u).max():
        return
    q = rest if rests_at_tensions(model) else at.q
    try:
        every = np.concatenate([strain.law.tensions(q) + left_out, q[strain.law.active :]])
        whole = Model(model.scene, model.grid, with_every_tension(model.arm)).tip_pose(every)
        error = float(np.linalg.norm((whole - tip)[:3, 3]))
    except StrainLimitError:
        error = np.inf
    if error > SEEN * model.length:
        size = (
            f"by {1e3 * error:.2g} mm" if np.isfinite(error) else "by more than its strain allows"
        )
        text = (
            f"redundant tendons of {model.scene.name!r} strain the bent arm in ways that have no"
            f" coordinate: at rest its tip is off {size}"
        )
        warnings.warn(text, RedundancyWarning, stacklevel=4)


def commanded_equilibrium(model: Model, command: ArrayLike) -> tuple[Equilibrium, Array]:
    """Computes the static equilibrium under a command, and the tensions that hold it.

    Newton's method on the tensions, within what elastic tendons and actuators can hold.

    Args:
        model: of the arm.
        command: (n_a,) in the unit `Model.command_unit`.

    Returns:
        The equilibrium, and the tensions (n_a,) [N].

    Raises:
        TypeError: for arguments of wrong types.
        ValueError: for wrong shapes or numbers that are not finite.
    """
    checked_type("model", model, Model, "see build_model")
    given, path, n_a = (
        checked_array("command", command, (model.tendon_count,)),
        model.arm.effects.transmission,
        model.tendon_count,
    )
    if not path.elastic:
        return static_equilibrium(model, given), given
    limits = model.scene.effects.command_limits(model.discretisation.tension_limits)
    warn_beyond_limits(limits.tolist(), given, model.command_unit)
    u, guess, scratch = (
        np.zeros(n_a),
        None,
        (np.zeros(n_a, dtype=np.int64), np.zeros((n_a, n_a + 1))),
    )
    for iteration in range(MOST_COMMANDED):
        with erring_actuators():  # a word of the command is enough
            found = static_equilibrium(model, u, guess)
        shortening = path.length - model.tendon_lengths(found.q)
        wanted = np.clip(path.stiffness * (given - shortening), 0.0, path.strength)
        same = SAME_TENSION * (
            np.abs(wanted).max() + np.abs(u).max() + model.length * path.stiffness
        )
        if not found.converged or (np.abs(wanted - u) <= same).all():
            return dataclasses.replace(found, iterations=found.iterations + iteration), u
        near, guess = ChordSolver(model, found.q, u), found.q
        compliance = np.diag(1.0 / path.stiffness) + near.terms.actuation.T @ near.answer
        missing = given - shortening - u / path.stiffness
        u = u.copy()
        solve_bounded(
            compliance, missing + compliance @ u, np.zeros(n_a), path.strength, u, *scratch
        )
    return (
        dataclasses.replace(
            found, converged=False, reason="tensions and displacements do not come to agree"
        ),
        u,
    )


class ChordSolver:
    """Static equilibria near one that is known, by Newton's method with its stiffness.

    This is the chord iteration.

    answer (n, n_a): dq/du = S^-1 B there; terms: of the equation of motion, there. Raises
    StrainLimitError where there is no strain.
    """

    def __init__(self, model: Model, q: Array, tension: Array) -> None:
        self.model, self.q, self.tension, self._known = model, q, tension, rests_at_tensions(model)
        self.terms = model.terms(q, np.zeros_like(q), tension)
        if self._known:
            self._compliance = np.linalg.pinv(self.terms.stiffness)
        else:
            with model.workspace() as work:
                balance = Balance(model, tension, work)
                here = balance.linearise(q, 1.0)
            if here is None:
                raise StrainLimitError(balance.obstacle)
            self._compliance = here.compliance
        self.answer: Array = self._compliance @ self.terms.actuation

    def at(self, tension: Array) -> tuple[Array, Array] | None:
        """Coordinates (n,) and tip pose (4, 4) of the equilibrium under other tensions (n_a,).

        None where there is none.
        """
        q = (
            self.model.rest_coordinates(tension)
            if self._known
            else self.q + self.answer @ (tension - self.tension)
        )
        with self.model.workspace() as work:
            balance, size = Balance(self.model, tension, work), np.inf
            while (at := balance.at(q, 1.0)) is not None:
                if at.residual <= RESIDUAL:
                    return q, self.model.tip_pose(q)
                change = self._compliance @ at.force
                last, size = size, balance.angle(change)
                if not size < CONTRACTION * last:
                    break
                q = q + change
        found = static_equilibrium(self.model, tension, self.q)
        return (found.q, found.tip_pose) if found.converged else None
