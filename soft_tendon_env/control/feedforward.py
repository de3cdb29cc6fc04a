"""Feedforward from inverse statics, and a reference governor of what an arm can hold.

The feedforward is followed along the reference.

Once per control period the equilibrium under the present tensions moves one bounded Gauss-Newton
step towards the target: nothing that is measured enters.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.objectives import TrackedObjective
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
FIRST_STEPS = 20  # Gauss-Newton steps at the beginning of an episode
STEPS = 1  # and in every period
PARTS = 0.5 ** np.arange(7)  # of a step, tried in turn before the tensions stay as they are
LEAST_ERROR = 1e-12  # [m] that counts as one, where its size divides
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
    """Feedforward by inverse statics, of least effort.

    It is for the reference one period ahead, when tensions have acted.
    """

    def __init__(
        self, model: Model, limits: Array, period: float, objective: TrackedObjective
    ) -> None:
        super().__init__(model, limits, period)
        self.objective = objective
        self.preferred = np.clip(0.0, self.least, self.greatest)

    def act(self, now: ControllerInput, memory: StaticMemory | None = None) -> ControllerOutput:
        """Computes the tensions of the equilibrium nearest to the target.

        A target that cannot be reached is followed as near as the statics come.
        """
        equilibrium = memory
        steps = STEPS
        if equilibrium is None:
            rest = static_equilibrium(self.model, self.preferred)
            equilibrium = StaticMemory(
                tension=self.preferred,
                q=rest.q,
                tip_pose=rest.tip_pose,
                multipliers=np.zeros_like(self.preferred),
            )
            steps = FIRST_STEPS
        for _ in range(steps):
            equilibrium = self._improve(equilibrium, now.reference)
        return self.output(equilibrium.tension, equilibrium)

    def error(self, equilibrium: StaticMemory, reference: Reference) -> Array:
        """Error (k,) [m] of an equilibrium from the target when the tensions will have acted."""
        return self.objective.error(equilibrium.q, equilibrium.tip_pose, reference, self.period)

    def _improve(self, equilibrium: StaticMemory, reference: Reference) -> StaticMemory:
        """One Gauss-Newton step, halved until it leads to an equilibrium that is nearer."""
        u = equilibrium.tension
        nearby = ChordSolver(self.model, equilibrium.q, u)
        # change of the task by tensions
        task = self.objective.jacobian(nearby.terms.tip_jacobian) @ nearby.answer
        curvature = task.T @ task
        effort = EFFORT**2 * np.trace(curvature)
        error = self.error(equilibrium, reference)
        distance = max(float(np.linalg.norm(error)), LEAST_ERROR)
        longest = STRIDE * self.model.length
        stride = error * min(1.0, longest / distance)
        allocation = allocate(
            curvature + effort * np.eye(u.size),
            effort * (u - self.preferred) - task.T @ stride,
            self.least - u,
            self.greatest - u,
            equilibrium.multipliers,
        )
        span = np.ptp(np.stack([self.least, self.greatest]))
        if np.abs(allocation.x).max() <= STILL * span:
            return equilibrium
        present = self._cost(equilibrium, reference, effort)
        for part in PARTS:
            tension = u + part * allocation.x
            solution = nearby.at(tension)
            if solution is None:
                continue
            q, tip_pose = solution
            trial = StaticMemory(
                tension=tension,
                q=q,
                tip_pose=tip_pose,
                multipliers=allocation.multipliers,
            )
            if self._cost(trial, reference, effort) <= present:
                return trial
        return equilibrium

    def _cost(self, equilibrium: StaticMemory, reference: Reference, effort: float) -> float:
        """Square of the error [m^2], and of the tensions by the weight of their effort."""
        error = self.error(equilibrium, reference)
        excess = equilibrium.tension - self.preferred
        square = error @ error
        excess_square = np.sum(excess**2)
        return float(square + effort * excess_square)


@dataclass(frozen=True)
class ReferenceGovernor:
    """Reference governor: replaces what an arm at rest cannot hold by the nearest.

    `statics` act before a `controller` with the same objective.

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

        `report` also has "out_of_reach" [m].
        """
        static_memory, controller_memory = memory or (None, None)
        nearest: StaticMemory = self.statics.act(now, static_memory).memory
        reference = now.reference
        error = self.statics.error(nearest, reference)
        distance = float(np.linalg.norm(error))
        margin = MARGIN * self.statics.model.length
        beyond = max(distance - margin, 0.0)
        if beyond > 0.0:
            share = beyond / distance
            reference = self.statics.objective.moved_back(
                reference, nearest.tip_pose, self.statics.period, share
            )
        reference = reference._replace(tension=nearest.tension)
        decision = self.controller.act(now._replace(reference=reference), controller_memory)
        return replace(
            decision,
            memory=(nearest, decision.memory),
            report={**decision.report, "out_of_reach": beyond},
        )
