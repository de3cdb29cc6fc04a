"""Observations in PyTorch, by the definitions of the groups, which run on tensors in place of
arrays."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import torch

from soft_tendon_env.differentiable.period import ArmTensors, as_tensors
from soft_tendon_env.differentiable.poses import pose_logarithm
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import CHANGE, Observed, RestValues
from soft_tendon_env.envs.randomization import Measured
from soft_tendon_env.envs.targets import TargetSamples


class TensorObservation:
    """Observations of an environment's rows as tensors, of the step at which this is made and of
    every one after it, in order.

    They are computed in float64; noise of sensors is that of the environment's readings.
    """

    def __init__(self, episodes: Episodes, dtype: torch.dtype) -> None:
        """dtype: of the observations."""
        self._episodes, self._dtype, layout, history = (
            episodes,
            dtype,
            episodes.layout,
            episodes.history,
        )
        self._scale, self._bound, self._kept = as_tensors(layout.scale, layout.bound, layout.kept)
        self._past = (
            None if history is None else torch.tensor(history.frames[:, 1:], dtype=torch.float64)
        )

    def now(self, arms: ArmTensors, action: torch.Tensor, command: torch.Tensor) -> Any:
        """Observation (rows, size) of the present step, for goal-conditioned tasks a dictionary.

        arms: of this step; action: (rows, n_a) the last one; command: (rows, n_a) asked for last.
        """
        observed = observed_tensors(self._episodes, arms, action, command)
        seen, self._past = self.complete(observed, self.groups(observed), self._past)
        return seen

    def groups(self, observed: Any) -> torch.Tensor:
        """The groups' entries (rows, size of the groups), scaled and clipped, of observed
        quantities as tensors."""
        parts: list[Any] = [
            group.values(observed) for group in self._episodes.layout.groups.values()
        ]
        return torch.clamp(torch.cat(parts, dim=1) * self._scale, -self._bound, self._bound)

    def complete(
        self, observed: Any, flat: torch.Tensor, past: torch.Tensor | None
    ) -> tuple[Any, torch.Tensor | None]:
        """Observation of `groups` with their history and goals, and the past of the next step.

        past: (rows, periods, m) of the arm's groups before this step, the latest first; None:
        without history.
        """
        if past is not None:
            frames = torch.cat([flat[:, None, self._kept], past], dim=1)
            past = frames[:, :-1]
            flat = torch.cat([flat, ((frames[:, 1:] - frames[:, :1]) / CHANGE).flatten(1)], dim=1)
        if self._episodes.task.goal is None:
            return flat.to(self._dtype), past
        reach, poses = (
            self._episodes.goal_bound,
            (observed.tip_pose, observed.target.tip_pose[:, 0]),
        )
        achieved, desired = (torch.clamp(pose[:, :3, 3], -reach, reach) for pose in poses)
        named = {"observation": flat, "achieved_goal": achieved, "desired_goal": desired}
        return {name: value.to(self._dtype) for name, value in named.items()}, past


def observed_tensors(
    episodes: Episodes, arms: ArmTensors, action: torch.Tensor, command: torch.Tensor
) -> Any:
    """Observed quantities of the present step as tensors, see TensorObservation.now."""
    seen = episodes.observed
    target, measured = as_tensors(*seen.target), _readings(seen, arms)
    given: dict[str, Any] = {"arms": SimpleNamespace(rows=arms, reading=arms)}
    given |= {
        "measured": measured,
        "error": pose_logarithm(measured.tip_pose, target[0]),
        "action": action,
        "command": command,
    }
    return replace(
        seen, target=TargetSamples(*target), rest=RestValues(*as_tensors(*seen.rest)), **given
    )


def _readings(seen: Observed, arms: ArmTensors) -> Any:
    """Sensor readings as tensors: those of the arms, turned, moved and shifted as the environment's
    noise has it."""
    true, noisy = seen.arms.reading, seen.measured
    if noisy is true:
        return arms
    shifted = {
        name: getattr(arms, name) + torch.tensor(getattr(noisy, name) - getattr(true, name))
        for name in Measured._fields
    }
    turn = torch.tensor(true.tip_pose[:, :3, :3].swapaxes(1, 2) @ noisy.tip_pose[:, :3, :3])
    pose = shifted["tip_pose"]
    pose[:, :3, :3] = arms.tip_pose[:, :3, :3] @ turn
    return Measured(**shifted)
