"""Feedforward from inverse statics, followed along the reference, and a reference governor of what
an arm can hold.

Once per control period the equilibrium under the present tensions moves one bounded Gauss-Newton
step towards the target: nothing that is measured enters.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.objectives import Objective
from soft_tendon_env.control.protocol import (
    Controller,
    ControllerInput,
    ControllerOutput,
    ModelController,
    Reference,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import ChordSolver, static_equilibrium
from soft_tendon_env.tools.types import Array

# weight of the tensions against that of errors, where both are measured by what they do to the task
EFFORT = 1e-3
STRIDE = 0.2  # longest way to the target that a step looks at, as a share of the rod's length
FIRST_STEPS, STEPS = 20, 1  # Gauss-Newton steps at the beginning of an episode, and in every period
PARTS = 0.5 ** np.arange(
    7
)  # of a step, tried one after another before the tensions stay as they are
STILL = 1e-5  # of the range of tensions, steps that are not worth taking
# dead band, as a share of the rod's length, within which targets out of reach are left as they are
MARGIN = 0.0005


class StaticMemory(NamedTuple):
    """The equilibrium that is being followed, and the multipliers (n_a,) of the last allocation."""

    tension: Array  # (n_a,)
    q: Array  # (n,)
    tip_pose: Array  # (4, 4)
    multipliers: Array


class StaticFeedforward(ModelController):
    """Feedforward by inverse statics, of least effort, for the reference one period ahead, when
    tensions have acted."""

    def __init__(self, model: Model, limits: Array, period: float, objective: Objective) -> None:
        super().__init__(model, limits, period)
        self.objective = objective
        self.preferred = np.clip(0.0, self.least, self.greatest)

    def act(self, now: ControllerInput, memory: StaticMemory | None = None) -> ControllerOutput:
        """Tensions of the equilibrium nearest to the target; one that cannot be reached is followed
        as near as the statics come."""
        at, steps = memory, STEPS
        if at is None:
            found = static_equilibrium(self.model, self.preferred)
            at, steps = (
                StaticMemory(
                    self.preferred, found.q, found.tip_pose, np.zeros_like(self.preferred)
                ),
                FIRST_STEPS,
            )
        for _ in range(steps):
            at = self._improve(at, now.reference)
        return self.output(at.tension, at)

    def error(self, at: StaticMemory, reference: Reference) -> Array:
        """Error (k,) [m] of the equilibrium from the target when the tensions will have acted."""
        return self.objective.error(at.q, at.tip_pose, reference, self.period)

    def _improve(self, at: StaticMemory, reference: Reference) -> StaticMemory:
        """One Gauss-Newton step, halved until it leads to an equilibrium that is nearer."""
        model, u, near = self.model, at.tension, ChordSolver(self.model, at.q, at.tension)
        away = self.error(at, reference)
        error = away * min(1.0, STRIDE * model.length / max(float(np.linalg.norm(away)), 1e-12))
        task = self.objective.jacobian(near.terms.tip_jacobian) @ near.answer
        cost = EFFORT**2 * np.trace(task.T @ task)
        hessian, gradient = (
            task.T @ task + cost * np.eye(u.size),
            cost * (u - self.preferred) - task.T @ error,
        )
        found = allocate(hessian, gradient, self.least - u, self.greatest - u, at.multipliers)
        if np.abs(found.x).max() <= STILL * np.ptp(np.stack([self.least, self.greatest])):
            return at
        present = away @ away + cost * np.sum((u - self.preferred) ** 2)
        for part in PARTS:
            trial = u + part * found.x
            if (there := near.at(trial)) is not None:
                moved = StaticMemory(trial, *there, found.multipliers)
                left = self.error(moved, reference)
                if left @ left + cost * np.sum((trial - self.preferred) ** 2) <= present:
                    return moved
        return at


@dataclass(frozen=True)
class ReferenceGovernor:
    """Reference governor: `statics` before a `controller` with the same objective replace what an
    arm at rest cannot hold by the nearest.

    Without that, feedback pulls for ever towards what is out of reach, with tensions that jump from
    limit to limit. How far the nearest pose is from the target moves the target by as much, less a
    margin. The controller also gets the tensions that hold the nearest pose.
    """

    statics: StaticFeedforward
    controller: Controller

    def act(
        self, now: ControllerInput, memory: tuple[StaticMemory, Any] | None = None
    ) -> ControllerOutput:
        """Tensions of the controller for a target within reach; memory: of statics and controller.
        `report` also has "out_of_reach" [m]."""
        of_statics, of_controller = memory or (None, None)
        at: StaticMemory = self.statics.act(now, of_statics).memory
        away = float(np.linalg.norm(self.statics.error(at, now.reference)))
        beyond = max(away - MARGIN * self.statics.model.length, 0.0)
        if beyond > 0.0:
            now = now._replace(
                reference=self.statics.objective.moved_back(
                    now.reference, at.tip_pose, self.statics.period, beyond / away
                )
            )
        decision = self.controller.act(
            now._replace(reference=now.reference._replace(tension=at.tension)), of_controller
        )
        return replace(
            decision,
            memory=(at, decision.memory),
            report={**decision.report, "out_of_reach": beyond},
        )
