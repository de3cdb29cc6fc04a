"""Reference governor: what an arm at rest cannot hold is replaced by the nearest that it can, before a controller sees it.

Without that, feedback pulls for ever towards what is out of reach, with tensions that jump from limit to limit. The nearest pose is
that of `StaticFeedforward`, which follows the target by itself; how far it is from the target moves the target by as much, less a
margin within which the dynamic controller does better. The controller also gets the tensions that hold the nearest pose.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from soft_tendon_env.control.feedforward import StaticFeedforward, StaticMemory
from soft_tendon_env.control.protocol import Controller, Decision, Situation

MARGIN = 0.0005
"""Dead band, as a share of the rod's length, within which targets out of reach are left as they are."""


class ReferenceGovernorMemory(NamedTuple):
    """Memories of the statics and of the controller behind."""

    statics: StaticMemory | None
    controller: Any


@dataclass(frozen=True)
class ReferenceGovernor:
    """Reference governor: `statics` before a `controller` with the same objective."""

    statics: StaticFeedforward
    controller: Controller

    def act(self, now: Situation, memory: ReferenceGovernorMemory | None = None) -> Decision:
        """Tensions of the controller for a target within reach. `report` also has "out_of_reach" [m]."""
        before = memory or ReferenceGovernorMemory(None, None)
        at: StaticMemory = self.statics.act(now, before.statics).memory
        nearest = self.statics.model.tip_pose(at.q)
        away = self.statics.distance(at, now.reference)
        beyond = max(away - MARGIN * self.statics.model.length, 0.0)
        if beyond > 0.0:
            now = now._replace(reference=self.statics.objective.moved_back(now.reference, nearest, self.statics.period, beyond / away))
        decision = self.controller.act(now._replace(reference=now.reference._replace(tension=at.tension)), before.controller)
        return replace(decision, memory=ReferenceGovernorMemory(at, decision.memory), report={**decision.report, "out_of_reach": beyond})
