"""Integral action around a learned policy.

The policy sees the target moved by the integral of the error, so that no constant error remains.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.protocol import LostState, Policy
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.types import Array

WAYS: Mapping[str, str | None] = {
    "target_error": "preview",
    "target_coordinates": "coordinate_preview",
    "target_lengths": None,
}
"""Observation groups of the way to the target now, and those of the ways to where it will be, which
move with it."""
GOAL_UNIT = 0.1
"""Unit of ways to goals, as a share of the rod's length; ways in observations have units already,
poses this one and half a radian."""
NEAR = 0.8
"""Error in these units beyond which an arm is on its way, and nothing is integrated
(anti-windup)."""
MOST = 0.1
"""Largest integral in these units: more than what agents leave of errors, and little where the arm
cannot reach its target at all."""


class IntegralMemory(NamedTuple):
    """Memory of integral action from one control period to the next."""

    policy: Any
    integral: Array  # (rows, m) in units of the ways


class _Way(NamedTuple):
    """Columns of an observation that say how far a target is."""

    now: slice
    ahead: slice  # at each preview time, which move with it


class IntegralPolicy:
    """A policy that sees its target moved by the integral of the error.

    The error is that of the tip's pose, of its position as a goal, or of the shape.
    """

    def __init__(self, policy: Policy, env: Any, integral_time: float) -> None:
        """Integral action around a policy.

        Args:
            policy: what acts.
            env: its environment.
            integral_time: [s] in which a constant error is added once.

        Raises:
            ValueError: the environment's observation has no way to the target, or the integral is
                quicker than its control period.
        """
        episodes = episodes_of(env)
        period = episodes.period
        allowed = f"at least a control period, {period:g} s"
        checked_number("integral_time", integral_time, period, allowed)
        self.policy = policy
        self.share = period / integral_time
        self.goal_unit = GOAL_UNIT * episodes.model.length
        groups = episodes.layout.slices
        nothing = slice(0, 0)
        self._ways: list[_Way] = []
        for now, ahead in WAYS.items():
            if now in groups:
                preview = nothing if ahead is None else groups.get(ahead, nothing)
                self._ways.append(_Way(groups[now], preview))
        if not self._ways and episodes.task.goal is None:
            raise ValueError(
                f"integral_time needs an observation with one of {', '.join(WAYS)}; it has"
                f" {', '.join(groups)}"
            )
        self._lost = LostState("the integral of the error")

    def predict(
        self,
        observation: Any,
        state: IntegralMemory | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, IntegralMemory]:
        """The policy's actions for one observation or many, and the state to give back.

        Arguments are those of `ControllerPolicy.predict`.
        """
        is_first = np.any(episode_start)
        self._lost.notice(state is None and not is_first)
        way = self.way_to_target(observation)
        integral = np.zeros_like(way)
        memory = None
        if state is not None:
            integral = state.integral
            memory = state.policy
        if episode_start is not None:
            begins = np.atleast_1d(episode_start)
            integral = np.where(begins[:, None], 0.0, integral)
        is_near = (np.abs(way) <= NEAR).all(axis=1, keepdims=True)
        grown = integral + self.share * np.where(is_near, way, 0.0)
        integral = np.clip(grown, -MOST, MOST)
        seen = self.move_target(observation, integral)
        action, memory = self.policy.predict(seen, memory, episode_start, deterministic)
        return action, IntegralMemory(memory, integral)

    def way_to_target(self, observation: Any) -> Array:
        """Ways (rows, m) from the arm to its target in their units, of one observation or many."""
        if isinstance(observation, dict):
            goal = np.atleast_2d(observation["desired_goal"])
            tip = np.atleast_2d(observation["achieved_goal"])
            in_units = (goal - tip) / self.goal_unit
            return np.asarray(in_units, dtype=np.float64)
        rows = np.atleast_2d(observation)
        parts = [rows[:, way.now] for way in self._ways]
        return np.concatenate(parts, axis=1, dtype=np.float64)

    def move_target(self, observation: Any, integral: Array) -> Any:
        """A copy of one observation or many with the target moved by integrals (rows, m)."""
        if isinstance(observation, dict):
            goal = observation["desired_goal"]
            shift = (self.goal_unit * integral).reshape(goal.shape)
            moved_goal = (goal + shift).astype(np.float32)
            return {**observation, "desired_goal": moved_goal}
        moved = np.array(np.atleast_2d(observation))
        first = 0
        for way in self._ways:
            width = way.now.stop - way.now.start
            part = integral[:, first : first + width]
            first += width
            moved[:, way.now] += part
            times = (way.ahead.stop - way.ahead.start) // width
            moved[:, way.ahead] += np.tile(part, times)
        return moved.reshape(np.shape(observation))
