"""Integral action around a learned policy: it sees the target moved by the integral of the error,
so that no constant error is left."""

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
# error in these units beyond which an arm is on its way, and nothing is integrated (anti-windup)
NEAR = 0.8
MOST = 0.1
"""Largest integral in these units: more than what agents leave of errors, and little where the arm
cannot reach its target at all."""


class IntegralMemory(NamedTuple):
    policy: Any
    integral: Array  # (rows, m) in units of the ways


class IntegralPolicy:
    """A policy that sees its target moved by the integral of the error: of the tip's pose, of its
    position as a goal, or of the shape.

    integral_time: [s] in which a constant error is added once. Raises ValueError where the
    environment's observation has no way to the target, or the integral is quicker than its control
    period.
    """

    def __init__(self, policy: Policy, env: Any, integral_time: float) -> None:
        episodes = episodes_of(env)
        checked_number(
            "integral_time",
            integral_time,
            episodes.period,
            f"at least a control period, {episodes.period:g} s",
        )
        groups = episodes.layout.slices
        self.policy, self.share = policy, episodes.period / integral_time
        self.goal_unit = GOAL_UNIT * episodes.model.length
        self.ways = [
            (groups[now], groups.get(ahead or "", slice(0, 0)))
            for now, ahead in WAYS.items()
            if now in groups
        ]
        if not self.ways and episodes.task.goal is None:
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
        """The policy's actions for one observation or many, and the state to give back; see
        ControllerPolicy.predict."""
        self._lost.notice(state is None and not np.any(episode_start))
        way = self._way(observation)
        integral = np.zeros_like(way) if state is None else state.integral
        if episode_start is not None:
            integral = np.where(np.atleast_1d(episode_start)[:, None], 0.0, integral)
        near = (np.abs(way) <= NEAR).all(axis=1, keepdims=True)
        integral = np.clip(integral + self.share * np.where(near, way, 0.0), -MOST, MOST)
        seen, kept = (
            self._move_target(observation, integral),
            None if state is None else state.policy,
        )
        action, kept = self.policy.predict(seen, kept, episode_start, deterministic)
        return action, IntegralMemory(kept, integral)

    def _way(self, observation: Any) -> Array:
        """To the target, in its units (rows, m)."""
        if isinstance(observation, dict):
            way = np.atleast_2d(observation["desired_goal"]) - np.atleast_2d(
                observation["achieved_goal"]
            )
            return np.asarray(way / self.goal_unit, dtype=np.float64)
        rows = np.atleast_2d(observation)
        return np.concatenate([rows[:, now] for now, _ in self.ways], axis=1, dtype=np.float64)

    def _move_target(self, observation: Any, integral: Array) -> Any:
        """The observation, its target moved by integrals (rows, m)."""
        if isinstance(observation, dict):
            goal = observation["desired_goal"]
            return {
                **observation,
                "desired_goal": (
                    (goal + (self.goal_unit * integral).reshape(goal.shape)).astype(np.float32)
                ),
            }
        moved, first = np.array(np.atleast_2d(observation)), 0
        for now, ahead in self.ways:
            part = integral[:, first : (first := first + now.stop - now.start)]
            moved[:, now] += part
            moved[:, ahead] += np.tile(part, (ahead.stop - ahead.start) // part.shape[1])
        return moved.reshape(np.shape(observation))
