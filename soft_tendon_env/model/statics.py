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
from soft_tendon_env.model.arm import with_every_tension
from soft_tendon_env.model.equilibrium_residual import Balance, Evaluation
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
    converged: bool  # whether q balances the full load
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
    limits = model.discretisation.tension_limits
    warn_beyond_limits(limits.tolist(), u)
    with model.workspace() as work:
        balance = Balance(model, u, work)
        path = LoadPath(balance)
        if guess is not None:
            q = checked_array("guess", guess, (model.coordinate_count,))
            near = path.equilibrium(q, 1.0)
            if near is not None:
                return _equilibrium(balance, near.evaluation, near.stability.stable, "")
        if rests_at_tensions(model):
            # q = [u; 0] is at rest, and stable: S = G there, positive definite wherever the strain
            # exists, unless it lacks a potential
            q = model.rest_coordinates(u)
            evaluation = balance.at(q, 1.0)
            if evaluation is not None and evaluation.residual <= RESIDUAL:
                is_stable = True
                if not model.arm.strain.has_potential:
                    linearised = balance.linearise(q, 1.0)
                    is_stable = linearised is None or linearised.stability.stable
                return _equilibrium(balance, evaluation, is_stable, "")
        if settle:
            settlings = MOST_SETTLINGS
        else:
            settlings = 0
        end, reason = path.rest(settlings)
        return _equilibrium(balance, end.evaluation, end.stability.stable, reason)


def rests_at_tensions(model: Model) -> bool:
    """Whether q = [u; 0] is at rest under tensions u (34), and S = G there."""
    is_implicit = isinstance(model.arm.strain, Implicit)
    return is_implicit and not model.arm.effects.load


def _equilibrium(
    balance: Balance, evaluation: Evaluation, stable: bool, reason: str
) -> Equilibrium:
    """Equilibrium at an evaluation of the balance; a reason says why the load goes no further."""
    q = evaluation.q
    tip = balance.model.tip_pose(q)
    # that of the full load, also where the path ends before
    if reason:
        loaded = balance.at(q, 1.0)
    else:
        loaded = evaluation
    if loaded is None:
        residual = np.inf
    else:
        residual = loaded.residual
    _warn_of_redundancy(balance, evaluation, tip)
    return Equilibrium(
        q,
        tip,
        converged=not reason,
        residual=residual,
        reason=reason,
        iterations=balance.linearisations,
        stable=stable,
        load=evaluation.part,
        model=balance.model,
        tension=balance.tension,
    )


def _warn_of_redundancy(balance: Balance, evaluation: Evaluation, tip: Array) -> None:
    """Warns where tensions that have no coordinate would move the tip."""
    model = balance.model
    strain = model.arm.strain
    if isinstance(strain, Explicit) or not strain.law.mixed:
        return
    u = evaluation.part * balance.tension
    rest = model.rest_coordinates(u)
    left_out = u - strain.law.tensions(rest)
    round_off = 1e-12 * np.abs(u).max()
    if np.abs(left_out).max() <= round_off:
        return
    if rests_at_tensions(model):
        q = rest
    else:
        q = evaluation.q
    try:
        # the arm with a coordinate for each tension
        arm = with_every_tension(model.arm)
        whole_model = Model(model.scene, model.grid, arm)
        every_tension = strain.law.tensions(q) + left_out
        passive = q[strain.law.active :]
        every_coordinate = np.concatenate([every_tension, passive])
        whole_tip = whole_model.tip_pose(every_coordinate)
        difference = (whole_tip - tip)[:3, 3]
        error = float(np.linalg.norm(difference))
    except StrainLimitError:
        error = np.inf
    if error > SEEN * model.length:
        if np.isfinite(error):
            size = f"by {1e3 * error:.2g} mm"
        else:
            size = "by more than its strain allows"
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
    n_a = model.tendon_count
    command_values = checked_array("command", command, (n_a,))
    path = model.arm.effects.transmission
    if not path.elastic:
        return static_equilibrium(model, command_values), command_values
    limits = model.scene.effects.command_limits(model.discretisation.tension_limits)
    warn_beyond_limits(limits.tolist(), command_values, model.command_unit)
    none = np.zeros(n_a)
    pivots = np.zeros(n_a, dtype=np.int64)
    system = np.zeros((n_a, n_a + 1))
    u = np.zeros(n_a)
    guess = None
    for iteration in range(MOST_COMMANDED):
        with erring_actuators():  # a word of the command is enough
            equilibrium = static_equilibrium(model, u, guess)
        # tensions of the springs: k (command - shortening), within what drives can hold
        lengths = model.tendon_lengths(equilibrium.q)
        shortening = path.length - lengths
        stretch = command_values - shortening
        pull = path.stiffness * stretch
        spring_tension = np.clip(pull, 0.0, path.strength)
        spring_size = np.abs(spring_tension).max()
        command_size = np.abs(u).max()
        largest = spring_size + command_size
        per_length = model.length * path.stiffness
        same = SAME_TENSION * (largest + per_length)
        difference = np.abs(spring_tension - u)
        is_same = difference <= same
        if not equilibrium.converged or is_same.all():
            iterations = equilibrium.iterations + iteration
            return dataclasses.replace(equilibrium, iterations=iterations), u
        # (1 / k + B^T dq/du) step = stretch - u / k
        near = ChordSolver(model, equilibrium.q, u)
        guess = equilibrium.q
        spring_compliance = np.diag(1.0 / path.stiffness)
        arm_compliance = near.terms.actuation.T @ near.answer
        compliance = spring_compliance + arm_compliance
        missing = stretch - u / path.stiffness
        right = missing + compliance @ u
        u = u.copy()
        solve_bounded(compliance, right, none, path.strength, u, pivots, system)
    reason = "tensions and displacements do not come to agree"
    return dataclasses.replace(equilibrium, converged=False, reason=reason), u


class ChordSolver:
    """Static equilibria near one that is known, by Newton's method with its stiffness.

    This is the chord iteration.

    answer (n, n_a): dq/du = S^-1 B there; terms: of the equation of motion, there. Raises
    StrainLimitError where there is no strain.
    """

    def __init__(self, model: Model, q: Array, tension: Array) -> None:
        self.model = model
        self.q = q
        self.tension = tension
        self._known = rests_at_tensions(model)
        still = np.zeros_like(q)
        self.terms = model.terms(q, still, tension)
        if self._known:
            self._compliance = np.linalg.pinv(self.terms.stiffness)
        else:
            with model.workspace() as work:
                balance = Balance(model, tension, work)
                linearised = balance.linearise(q, 1.0)
            if linearised is None:
                raise StrainLimitError(balance.obstacle)
            self._compliance = linearised.compliance
        self.answer: Array = self._compliance @ self.terms.actuation

    def at(self, tension: Array) -> tuple[Array, Array] | None:
        """Coordinates (n,) and tip pose (4, 4) of the equilibrium under other tensions (n_a,).

        None where there is none.
        """
        model = self.model
        if self._known:
            q = model.rest_coordinates(tension)
        else:
            change = tension - self.tension
            q = self.q + self.answer @ change
        with model.workspace() as work:
            balance = Balance(model, tension, work)
            size = np.inf
            evaluation = balance.at(q, 1.0)
            while evaluation is not None:
                if evaluation.residual <= RESIDUAL:
                    return q, model.tip_pose(q)
                step = self._compliance @ evaluation.force
                last_size = size
                size = balance.angle(step)
                if not size < CONTRACTION * last_size:
                    break
                q = q + step
                evaluation = balance.at(q, 1.0)
        equilibrium = static_equilibrium(model, tension, self.q)
        if not equilibrium.converged:
            return None
        return equilibrium.q, equilibrium.tip_pose
