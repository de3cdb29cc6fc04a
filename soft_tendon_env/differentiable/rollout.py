"""Rollouts of a policy through an environment in PyTorch, differentiable in the policy's
parameters."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import torch
from gymnasium.error import ResetNeeded

from soft_tendon_env.differentiable.actuation import TensorActuation, inward_clip
from soft_tendon_env.differentiable.observation import TensorObservation
from soft_tendon_env.differentiable.period import arm_tensors, control_period
from soft_tendon_env.differentiable.poses import pose_logarithm
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.tools.checks import checked_array, checked_count


class Trajectories(NamedTuple):
    """Motion of an environment's rows under a policy as tensors, by control period: float64, but
    for what is said otherwise."""

    # (periods, rows, 6) SE(3) logarithms from the true tip to the target, angular [rad] before
    # linear [m]
    error: torch.Tensor
    position_error: (
        torch.Tensor
    )  # (periods, rows, 3) [m] from the true tip to the target, in the world frame
    # (periods, rows, stations, 3) [m] from the true backbone to the target's; no stations but for
    # shapes
    backbone_error: torch.Tensor
    action: torch.Tensor  # (periods, rows, n_a) as taken, in [-1, 1]
    action_change: torch.Tensor  # (periods, rows, n_a) from the action before
    command: (
        torch.Tensor
    )  # (periods, rows, n_a) asked for: tensions [N], or what effects of the scene make tensions of
    q: torch.Tensor  # (periods, rows, n)
    tip_twist: torch.Tensor  # (periods, rows, 6) body twist
    reward: torch.Tensor  # (periods, rows) the environment's, without gradients
    diverged: torch.Tensor  # (periods, rows) bool: what environments call so
    observation: Any  # after the last period, as policies get it: for a critic


def rollout(
    env: Any,
    policy: Callable[[Any], torch.Tensor],
    periods: int,
    dtype: torch.dtype = torch.float32,
) -> Trajectories:
    """Trajectories of a policy from where an environment's rows are, differentiable in the policy's
    parameters.

    The environment itself takes the steps, and stays where they lead: randomisation, latency, noise
    and targets are its own, and another rollout goes on from there, without gradients into this
    one. Rows are reset by the environment's `reset` alone, none within a rollout; a row whose step
    fails stays where it is, and no gradient passes that step.

    env: an environment of this package, single or vector, wrapped or not, after a `reset`; policy:
    actions (rows, n_a) of observations (rows, size) of this dtype, of goal-conditioned tasks a
    dictionary of them. Actions and commands beyond their limits are clipped with gradients that
    lead back inside.

    Raises ResetNeeded before the first reset, TypeError or ValueError for other environments and
    for actions of another shape or with NaN; `backward` raises what Arms.adjoint does, as where
    effects have internal states that follow the motion, or rows have been drawn anew.
    """
    episodes, periods = episodes_of(env), checked_count("periods", periods, 1)
    if not hasattr(episodes, "present"):
        raise ResetNeeded("rollout was called before reset")
    arms, actuation, action = (
        arm_tensors(episodes.arms),
        TensorActuation(episodes.actuation),
        torch.tensor(episodes.observed.action),
    )
    observation = TensorObservation(episodes, dtype)
    steps: list[tuple[torch.Tensor, ...]] = []
    seen = observation.now(arms, action, actuation.command)
    for _ in range(periods):
        before, action = action, _action(policy(seen), episodes)
        commands, taken = actuation.apply(action), action.detach().numpy()
        arms = control_period(episodes.arms, arms, commands, advance=partial(episodes.step, taken))
        seen = observation.now(arms, action, actuation.command)
        wanted = torch.tensor(episodes.target.tip_pose[:, :1])
        error, position_error = (
            pose_logarithm(arms.tip_pose, wanted)[:, 0],
            wanted[:, 0, :3, 3] - arms.tip_pose[:, :3, 3],
        )
        backbone_error = torch.tensor(episodes.target_backbone) - arms.backbone_position
        errors, without = (
            (error, position_error, backbone_error),
            (torch.tensor(episodes.reward), torch.tensor(episodes.diverged)),
        )
        steps.append(
            (*errors, action, action - before, actuation.command, arms.q, arms.tip_twist, *without)
        )
    stacked: list[Any] = [torch.stack(values) for values in zip(*steps, strict=True)]
    return Trajectories._make([*stacked, seen])


def _action(wanted: torch.Tensor, episodes: Episodes) -> torch.Tensor:
    """Actions (rows, n_a) within their limits. Raises TypeError or ValueError."""
    if not isinstance(wanted, torch.Tensor):
        raise TypeError(f"policy should return a tensor of actions, not {type(wanted).__name__}")
    checked_array(
        "the policy's action",
        wanted.detach().cpu().numpy(),
        (episodes.size, episodes.model.tendon_count),
    )
    return inward_clip(wanted.to("cpu", torch.float64), -1.0, 1.0)
