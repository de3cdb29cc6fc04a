"""Where constant tensions hold the arm: the equilibria B u - K + F = 0 of (23), for every strain parametrisation.

Newton on the unbalanced force f = B u - K + F with its derivative by differences, damped so that f decreases in the norm of the
energy, f^T G^-1 f. What Newton does not reach at once is approached from the unloaded arm: tensions and effects grow together,
in parts as large as Newton can take. The branch that begins at the unloaded arm is the one that is found.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.checks import checked_array, checked_type
from soft_tendon_env.mechanics.equilibrium import ROUND_OFF, stiffness_by_differences, unbalanced_force
from soft_tendon_env.mechanics.strain import strain_from_rest
from soft_tendon_env.mechanics.types import StaticsBased, make_workspace
from soft_tendon_env.model import Model, StrainLimitError
from soft_tendon_env.scene import Array

RESIDUAL = 1e-10
"""Residual, see Equilibrium, below which forces count as balanced."""
MAX_NEWTON = 25
MAX_ITERATIONS = 300
MAX_HALVINGS = 6
SMALLEST_PART = 1e-3  # of the load, in the continuation from the unloaded arm


class Equilibrium(NamedTuple):
    """Where the arm rests, n coordinates.

    Where `converged` is false, q is the last equilibrium found on the way from the unloaded arm to the full load, and `reason` says
    what stood in the way. `residual` is the angle [rad] by which the unbalanced force would bend a rod as stiff as this one and
    otherwise unloaded, in the sense of energy: sqrt(f^T G^-1 f / (E_1 + q^T G q)), with E_1 from a rod bent by one radian.
    """

    q: Array  # (n,)
    tip_pose: Array  # (4, 4)
    converged: bool
    residual: float
    reason: str  # empty when converged
    iterations: int  # Newton iterations, all parts of the load together


def static_equilibrium(model: Model, tension: ArrayLike, guess: ArrayLike | None = None) -> Equilibrium:
    """Where the tensions (n_a,) [N], held constant, and the scene's effects hold the arm at rest.

    Returns an Equilibrium that is not `converged` where none is found: beyond the strain limit, say. Whether it is stable is not
    asked (a column may buckle sideways); `static_stiffness` tells. `guess`: coordinates (n,) to try first, near the equilibrium.
    Raises ValueError or TypeError for arrays of wrong shape or type, or with NaN or infinity.
    """
    checked_type("model", model, Model, "see build_model")
    u = checked_array("tension", tension, (model.tendon_count,))
    search = _Search(model, u)
    if guess is not None and (near := search.newton(checked_array("guess", guess, (model.coordinate_count,)), 1.0)) is not None:
        return Equilibrium(near.q, model.tip_pose(near.q), True, near.residual, "", search.iterations)
    start = model.rest_coordinates(u) if isinstance(model.arm.strain, StaticsBased) else np.zeros(model.coordinate_count)
    good, reached, part = search.state(np.zeros_like(start), 0.0), 0.0, 1.0
    assert good is not None, "the unloaded arm has a strain"
    while reached < 1.0:
        aim = min(reached + part, 1.0)
        found = search.newton(good.q + (aim - reached) * start, aim)
        if found is not None:
            good, reached, part = found, aim, 2.0 * part
        elif part > SMALLEST_PART and search.iterations < MAX_ITERATIONS:
            part *= 0.5
        else:
            unbalanced, reason = search.state(good.q, 1.0), f"beyond {100 * reached:.4g} % of the load: {search.obstacle}"
            residual = unbalanced.residual if unbalanced else np.inf
            return Equilibrium(good.q, model.tip_pose(good.q), False, residual, reason, search.iterations)
    return Equilibrium(good.q, model.tip_pose(good.q), True, good.residual, "", search.iterations)


def static_stiffness(model: Model, q: ArrayLike, tension: ArrayLike) -> Array:
    """S = -d(B u - K + F)/dq (n, n) at coordinates q (n,) under tensions (n_a,), to about 1e-6 of its largest entries.

    At an equilibrium dq/du = S^-1 B, and the equilibrium is stable if all eigenvalues of S are positive (S is symmetric there if the
    effects have a potential). Raises ValueError or TypeError for bad arrays, StrainLimitError where there is no strain.
    """
    checked_type("model", model, Model, "see build_model")
    q = checked_array("q", q, (model.coordinate_count,))
    search = _Search(model, checked_array("tension", tension, (model.tendon_count,)))
    state = search.state(q, 1.0)
    stiffness = None if state is None else search.stiffness(state, 1.0)
    if stiffness is None:
        raise StrainLimitError(search.obstacle)
    return stiffness


class _State(NamedTuple):
    """What Newton needs at coordinates q under one part of the load."""

    q: Array
    force: Array  # f (n,)
    G: Array  # (n, n)
    residual: float

    @property
    def unbalanced_energy(self) -> float:
        """f^T G^-1 f [J]."""
        return float(self.force @ np.linalg.solve(self.G, self.force))


class _Search:
    """A search for one equilibrium: the model, the full tension, scratch, and what stood in the way last."""

    def __init__(self, model: Model, tension: Array) -> None:
        self.model, self.tension = model, tension
        self.work = make_workspace(model.arm)
        self.energy = model.bending_energy
        self.iterations, self.obstacle = 0, ""

    def newton(self, q: Array, part: float) -> _State | None:
        """The equilibrium under this part of the load, or None."""
        state, steps = self.state(q, part), 0
        while state is not None and not state.residual <= RESIDUAL:  # NaN is not balanced
            if steps == MAX_NEWTON:
                self.obstacle = f"Newton's method did not balance the forces in {MAX_NEWTON} iterations"
                return None
            steps += 1
            self.iterations += 1
            state = self.improved(state, part)
        return state

    def improved(self, state: _State, part: float) -> _State | None:
        """One damped Newton step from the last state that was computed; None if no damping decreases the unbalanced energy."""
        stiffness = self.stiffness(state, part)
        if stiffness is None:
            return None
        try:
            step = np.linalg.solve(stiffness, state.force)
        except np.linalg.LinAlgError:
            self.obstacle = "the stiffness is singular: the arm gives way without further load"
            return None
        for damping in 0.5 ** np.arange(MAX_HALVINGS):
            trial = self.state(state.q + damping * step, part)
            if trial is not None and trial.unbalanced_energy < (1.0 - 0.5 * damping) * state.unbalanced_energy:
                return trial
        if trial is not None:
            self.obstacle = f"Newton's method stalled at a residual of {state.residual:.2g}"
        return None

    def state(self, q: Array, part: float) -> _State | None:
        """Everything at q, or None where there is no strain."""
        arm, force = self.model.arm, np.empty(q.size)
        block, reached = strain_from_rest(arm, q, ROUND_OFF, self.work)
        if block < 0:
            block = unbalanced_force(arm, part * self.tension, q, part, self.work, force)
        if block >= 0:
            self.note_limit(q, reached)
            return None
        G = self.work.G.copy()
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # the energy of an absurd force is infinite or NaN: not balanced
                unbalanced = _State(q, force, G, 0.0).unbalanced_energy
        except np.linalg.LinAlgError:
            self.obstacle = "the stiffness is singular: nothing resists some coordinates, as where tendons push past the stiffness"
            return None
        return _State(q, force, G, float(np.sqrt(unbalanced / (self.energy + q @ G @ q))))

    def stiffness(self, state: _State, part: float) -> Array | None:
        """-df/dq at the last state that was computed, or None where a difference leaves the strains that exist."""
        out = np.empty_like(state.G)
        block = stiffness_by_differences(self.model.arm, part * self.tension, state.q, part, self.energy, self.work, out)
        if block >= 0:
            self.note_limit(state.q, 1.0)
            return None
        return out

    def note_limit(self, q: Array, reached: float) -> None:
        """Notes which tendon is nearest to the limit where this part of q was reached."""
        self.obstacle = f"no strain balances the coordinates: {self.model.nearest_limit(q, self.work.xi, reached)}"
