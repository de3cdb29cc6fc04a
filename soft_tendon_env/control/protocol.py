"""Interfaces of controllers and state estimators: what a controller measures, the reference it follows, the tensions it decides on.

A controller knows a `Model` (which may be a wrong one) and what is measured; never the environment. Its memory is explicit: it goes
in and comes out of `act`, so that one controller serves any number of arms. `policies.ControllerPolicy` makes it an agent with
Stable-Baselines3's `predict`. Conventions are the model's: SI units, twists angular before linear in the body frame, coordinates q.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from soft_tendon_env.scene.scene import Array


class Reference(NamedTuple):
    """Reference trajectory at m instants, the first of them now; None where the task does not give it."""

    ahead: Array  # (m,) [s] from now, increasing from 0, or from before now where the situation is one that is predicted
    tip_pose: Array | None = None  # (m, 4, 4)
    tip_position: Array | None = None  # (m, 3) [m]; the tip may point anywhere where only this is given
    q: Array | None = None  # (m, n) coordinates of the shapes, which tensions can hold
    tension: Array | None = None  # (n_a,) [N] that would hold the first of them, or the nearest that can be held: see Governor


class Situation(NamedTuple):
    """Measured state of one arm and its reference at the beginning of a control period, n coordinates, n_a tendons."""

    q: Array  # (n,)
    q_dot: Array  # (n,)
    tip_pose: Array  # (4, 4) as measured: not that of q, if the model is wrong
    tension: Array  # (n_a,) [N] asked for last
    reference: Reference
    time: float = 0.0  # [s] since the episode began, on which a model's effects may depend


@dataclass(frozen=True)
class Decision:
    """Tensions (n_a,) [N] to hold over the control period, the memory to give back next time, and numbers to look at.

    `report` has at least "limited", the share of tendons held by their limits, and "singular", 1.0 where the task could not be
    resolved and 0.0 otherwise.
    """

    tension: Array
    memory: Any = None
    report: Mapping[str, float] = field(default_factory=dict)


class Controller(Protocol):
    """A feedback or feedforward law: tensions from the measured state and the reference."""

    def act(self, now: Situation, memory: Any = None) -> Decision:
        """The tensions of this period. `memory` is the last decision's, None when an episode begins. Raises nothing for finite arrays."""


class Estimate(NamedTuple):
    """Estimated coordinates and rates, (n,) each."""

    q: Array
    q_dot: Array


class Estimator(Protocol):
    """A state estimator: coordinates and rates of an arm from strain sensors."""

    def estimate(self, strain: Array, strain_rate: Array, last: Estimate | None) -> Estimate:
        """From strains less the stress-free ones and their rates, (sensors, 6) each; `last` is the estimate of the period before."""
