"""Observations in PyTorch: the groups of the environments, on tensors in place of arrays."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch.overrides import TorchFunctionMode

from soft_tendon_env.differentiable.period import ArmTensors, as_tensors
from soft_tendon_env.differentiable.poses import pose_logarithm
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.observation import CHANGE, Group, Observed, RestValues
from soft_tendon_env.envs.randomization import Measured
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.tools.messages import first_line


class _Arms(NamedTuple):
    """Arms as observation groups read them, of tensors."""

    rows: ArmTensors
    reading: ArmTensors


class TensorObservation:
    """Observations of an environment's rows as tensors, of this step and of every one after it.

    They are asked for in order, and computed in float64; noise of sensors is that of the
    environment's readings.
    """

    def __init__(self, episodes: Episodes, dtype: torch.dtype) -> None:
        """Begin in the present step; dtype: of the observations."""
        self._episodes = episodes
        self._dtype = dtype
        self._is_tried = False  # whether the groups have given tensors
        layout = episodes.layout
        self._scale, self._bound, self._kept = as_tensors(layout.scale, layout.bound, layout.kept)
        self._past: torch.Tensor | None = None
        if episodes.history is not None:
            past = episodes.history.frames[:, 1:]
            self._past = torch.tensor(past, dtype=torch.float64)

    def now(
        self,
        arms: ArmTensors,
        action: torch.Tensor,
        command: torch.Tensor,
    ) -> Any:
        """Observation of the present step.

        Args:
            arms: of this step.
            action: (rows, n_a) the last one.
            command: (rows, n_a) asked for last.

        Returns:
            A tensor (rows, size), for goal-conditioned tasks a dictionary of them.
        """
        observed = observed_tensors(self._episodes, arms, action, command)
        groups = self.groups(observed)
        observation, self._past = self.complete(observed, groups, self._past)
        return observation

    def groups(self, observed: Any) -> torch.Tensor:
        """Entries of the groups (rows, size of the groups), scaled and clipped.

        Args:
            observed: quantities as tensors.

        Returns:
            The entries side by side.

        Raises:
            ValueError: a group reads what tensors do not have, or makes no tensor; it is named.
        """
        groups = self._episodes.layout.groups
        # a group that uses NumPy does so from its first values on
        watch: AbstractContextManager[Any] = _NoArrays()
        if self._is_tried:
            watch = nullcontext()
        with watch:
            parts = [_tensor_values(name, group, observed) for name, group in groups.items()]
        self._is_tried = True
        whole = torch.cat(parts, dim=1)
        scaled = whole * self._scale
        return torch.clamp(scaled, -self._bound, self._bound)

    def complete(
        self,
        observed: Any,
        flat: torch.Tensor,
        past: torch.Tensor | None,
    ) -> tuple[Any, torch.Tensor | None]:
        """Observation of groups with their history and goals, and the past of the next step.

        Args:
            observed: quantities as tensors.
            flat: the entries of `groups`.
            past: (rows, periods, m) of the arm's groups before this step, the latest first; None:
                without history.

        Returns:
            The observation, and the past of the next step.
        """
        if past is not None:
            present = flat[:, None, self._kept]
            frames = torch.cat([present, past], dim=1)
            past = frames[:, :-1]
            differences = frames[:, 1:] - frames[:, :1]
            changes = differences / CHANGE
            both = [flat, changes.flatten(1)]
            flat = torch.cat(both, dim=1)
        if self._episodes.task.goal is None:
            return flat.to(self._dtype), past
        observation = {
            "observation": flat.to(self._dtype),
            "achieved_goal": self._goal(observed.tip_pose),
            "desired_goal": self._goal(observed.target.tip_pose[:, 0]),
        }
        return observation, past

    def _goal(self, pose: torch.Tensor) -> torch.Tensor:
        """Positions (rows, 3) of poses (rows, 4, 4) as goals, within their space."""
        bound = self._episodes.goal_bound
        position = pose[:, :3, 3]
        clamped = torch.clamp(position, -bound, bound)
        return clamped.to(self._dtype)


class _UsesNumPy(Exception):
    """A tensor was to become an array, which carries no gradients."""


class _NoArrays(TorchFunctionMode):
    """Refuses arrays made of tensors: NumPy's functions would make constants of them unseen."""

    def __torch_function__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        if func in (torch.Tensor.__array__, torch.Tensor.numpy):
            raise _UsesNumPy
        return func(*args, **(kwargs or {}))


def _tensor_values(name: str, group: Group, observed: Any) -> torch.Tensor:
    """Values (rows, size) of a group as a tensor. Raises ValueError that names the group."""
    remedy = (
        "gradients and ONNX files need what PyTorch's tensors have too, as every other use does not"
    )
    try:
        values: Any = group.values(observed)
    except _UsesNumPy:
        raise ValueError(f"the observation group {name!r} uses NumPy: {remedy}") from None
    except (AttributeError, TypeError, RuntimeError) as error:
        raise ValueError(
            f"the observation group {name!r} reads what tensors lack, {first_line(error)}: {remedy}"
        ) from error
    if not isinstance(values, torch.Tensor):
        raise ValueError(
            f"the observation group {name!r} gives {type(values).__name__}, no tensor: {remedy}"
        )
    return values


def observed_tensors(
    episodes: Episodes,
    arms: ArmTensors,
    action: torch.Tensor,
    command: torch.Tensor,
) -> Any:
    """Observed quantities of the present step as tensors, see TensorObservation.now."""
    observed = episodes.observed
    target: Any = TargetSamples._make(as_tensors(*observed.target))
    measured = _readings(observed, arms)
    values: dict[str, Any] = {
        "arms": _Arms(rows=arms, reading=arms),
        "measured": measured,
        "error": pose_logarithm(measured.tip_pose, target.tip_pose),
        "target": target,
        "action": action,
        "command": command,
        "rest": RestValues._make(as_tensors(*observed.rest)),
    }
    return replace(observed, **values)


def _readings(observed: Observed, arms: ArmTensors) -> Any:
    """Sensor readings as tensors, with the noise of the environment's readings.

    They are those of the arms, turned, moved and shifted.
    """
    true = observed.arms.reading
    noisy = observed.measured
    if noisy is true:
        return arms
    error = noisy.tip_pose - true.tip_pose
    pose = arms.tip_pose + torch.tensor(error)
    back = true.tip_pose[:, :3, :3].swapaxes(1, 2)
    turn = back @ noisy.tip_pose[:, :3, :3]
    rotation = arms.tip_pose[:, :3, :3]
    pose[:, :3, :3] = rotation @ torch.tensor(turn)
    error_of_lengths = noisy.tendon_length - true.tendon_length
    length_noise = torch.tensor(error_of_lengths)
    error_of_strains = noisy.strain - true.strain
    strain_noise = torch.tensor(error_of_strains)
    error_of_rates = noisy.strain_rate - true.strain_rate
    rate_noise = torch.tensor(error_of_rates)
    parts: dict[str, Any] = {
        "tip_pose": pose,
        "tendon_length": arms.tendon_length + length_noise,
        "strain": arms.strain + strain_noise,
        "strain_rate": arms.strain_rate + rate_noise,
    }
    return Measured(**parts)
