"""Feedforward from inverse statics: the tensions that would hold the reference if the arm were at rest, followed along it.

Once per control period the equilibrium under the present tensions moves one bounded Gauss-Newton step towards the target, as soon as
the tensions reach the arm: nothing that is measured enters. For shapes that tensions hold the answer is known: u = q_a_bar.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.objectives import Aim, Dynamics, Objective
from soft_tendon_env.control.protocol import Decision, Reference, Situation
from soft_tendon_env.model.model import Model, Terms
from soft_tendon_env.model.statics import static_equilibrium, static_stiffness
from soft_tendon_env.scene.scene import Array

EFFORT = 1e-3
"""Weight of the tensions against that of errors, where both are measured by what they do to the task."""
STRIDE = 0.2
"""Of the rod's length, the longest way to the target that a step looks at."""
FIRST_STEPS, STEPS = 20, 1
"""Gauss-Newton steps at the beginning of an episode, and in every period."""
SHORTEST = 2.0**-6  # of a step, tried before the tensions stay as they are
STILL = 1e-5  # of the range of tensions, steps that are not worth taking


class StaticMemory(NamedTuple):
    """The equilibrium that is being followed, and the multipliers (n_a,) of the last allocation."""

    tension: Array  # (n_a,)
    q: Array  # (n,)
    multipliers: Array


class StaticFeedforward:
    """Feedforward by inverse statics. `limits` (n_a, 2) [N]; the reference is that one `period` [s] ahead, when tensions have acted.

    tight: what the null space of the task is used for: of the tensions that do equally well those nearest to this share of their
    greatest. 0 is least effort, more is co-contraction.
    """

    def __init__(self, model: Model, limits: Array, period: float, objective: Objective, *, tight: float = 0.0) -> None:
        self.model, self.period, self.objective = model, period, objective
        self.least, self.greatest = limits.T.copy()
        self.preferred = np.clip(tight * np.maximum(self.greatest, 0.0), self.least, self.greatest)
        self._tensions_are_coordinates = model.arm.strain.rests_without_search and not model.arm.effects.load

    def act(self, now: Situation, memory: StaticMemory | None = None) -> Decision:
        """See Controller. A target that cannot be reached is followed as near as the statics come."""
        memory, limited = self.followed(now.reference, memory)
        return Decision(memory.tension, memory, {"limited": limited, "singular": 0.0})

    def followed(self, reference: Reference, at: StaticMemory | None = None) -> tuple[StaticMemory, float]:
        """The equilibrium `at` (None: that at which the arm begins) moved towards the reference, and the share of tendons at limits."""
        steps = STEPS if at is not None else FIRST_STEPS
        if at is None:
            slack = np.clip(0.0, self.least, self.greatest)
            at = StaticMemory(slack, static_equilibrium(self.model, slack).q, np.zeros_like(slack))
        limited = 0.0
        for _ in range(steps):
            at, limited = self._improved(at, reference)
        return at, limited

    def distance(self, at: StaticMemory, reference: Reference) -> float:
        """How far the target, when the tensions will have acted, is from the equilibrium, in the objective's metres."""
        return float(np.linalg.norm(self._seen(at, reference)[1].error))

    def _seen(self, at: StaticMemory, reference: Reference) -> tuple[Terms, Aim]:
        rest = np.zeros_like(at.q)
        terms = self.model.terms(at.q, rest, at.tension)
        return terms, self.objective.aim(Dynamics(at.q, rest, terms), reference, self.period, self.period)

    def _improved(self, at: StaticMemory, reference: Reference) -> tuple[StaticMemory, float]:
        """One Gauss-Newton step, halved until it leads to an equilibrium that is nearer."""
        model, u = self.model, at.tension
        terms, aim = self._seen(at, reference)
        error = aim.error * min(1.0, STRIDE * model.length / max(float(np.linalg.norm(aim.error)), 1e-12))
        stiffness = terms.stiffness if self._tensions_are_coordinates else static_stiffness(model, at.q, u)
        task = aim.jacobian @ np.linalg.lstsq(stiffness, terms.actuation, rcond=None)[0]
        cost = EFFORT**2 * np.trace(task.T @ task)
        hessian, gradient = task.T @ task + cost * np.eye(u.size), cost * (u - self.preferred) - task.T @ error
        found = allocate(hessian, gradient, self.least - u, self.greatest - u, at.multipliers)
        if np.abs(found.x).max() <= STILL * np.ptp(np.stack([self.least, self.greatest])):
            return at, found.limited
        present, part = aim.error @ aim.error + cost * np.sum((u - self.preferred) ** 2), 1.0
        while part >= SHORTEST:
            trial = u + part * found.x
            moved = static_equilibrium(model, trial, model.rest_coordinates(trial) if self._tensions_are_coordinates else at.q)
            if moved.converged:
                there = Dynamics(moved.q, np.zeros_like(moved.q), terms._replace(tip_pose=moved.tip_pose))
                left = self.objective.aim(there, reference, self.period, self.period).error
                if left @ left + cost * np.sum((trial - self.preferred) ** 2) <= present:
                    return StaticMemory(trial, moved.q, found.multipliers), found.limited
            part *= 0.5
        return at, found.limited
