"""Rollouts of a policy through an environment in PyTorch, with gradients for its parameters."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import torch
from gymnasium.error import ResetNeeded

from soft_tendon_env.differentiable.accuracy import check_elastic_gradients
from soft_tendon_env.differentiable.actuation import TensorActuation, inward_clip
from soft_tendon_env.differentiable.observation import TensorObservation
from soft_tendon_env.differentiable.period import arm_tensors, control_period
from soft_tendon_env.differentiable.poses import pose_logarithm
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.tools.checks import checked_array, checked_count


class Trajectories(NamedTuple):
    """Motion of an environment's rows under a policy as tensors, by control period.

    They are float64, but for what is said otherwise.
    """

    # (periods, rows, 6) SE(3) logarithms from the true tip to the target, angular [rad] before
    # linear [m]
    error: torch.Tensor
    # (periods, rows, 3) [m] from the true tip to the target, in the world frame
    position_error: torch.Tensor
    # (periods, rows, stations, 3) [m] from the true backbone to the target's; no stations but for
    # shapes
    backbone_error: torch.Tensor
    action: torch.Tensor  # (periods, rows, n_a) as taken, in [-1, 1]
    action_change: torch.Tensor  # (periods, rows, n_a) from the action before
    # (periods, rows, n_a) asked for: tensions [N], or what effects of the scene make tensions of
    command: torch.Tensor
    # (periods, rows, n_a) that acted at the end of a period, late and with the errors of actuators
    applied: torch.Tensor
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
    """Runs a policy from where an environment's rows are, with gradients.

    The environment itself takes the steps, and stays where they lead: randomisation, latency, noise
    and targets are its own, and another rollout goes on from there, without gradients into this
    one. Rows are reset by the environment's `reset` alone, none within a rollout; a row whose step
    fails stays where it is, and no gradient passes that step. Actions and commands beyond their
    limits are clipped with gradients that lead back inside.

    Args:
        env: an environment of this package, single or vector, wrapped or not, after a `reset`.
        policy: actions (rows, n_a) of observations (rows, size) of this dtype, of goal-conditioned
            tasks a dictionary of them.
        periods: control periods.
        dtype: of the observations.

    Returns:
        Trajectories that are differentiable in the policy's parameters.

    Raises:
        ResetNeeded: before the first reset.
        TypeError: for other environments, and actions that are no tensors.
        ValueError: for actions of another shape or with NaN. `backward` raises what Arms.adjoint
            does, as where effects have internal states that follow the motion, or rows have been
            drawn anew.

    Warns:
        GradientWarning: once, where gradients through elastic tendons are far from differences.
    """
    episodes = episodes_of(env)
    periods = checked_count("periods", periods, 1)
    if not hasattr(episodes, "present"):
        raise ResetNeeded("rollout was called before reset")
    if torch.is_grad_enabled():
        check_elastic_gradients(episodes)
    arms = arm_tensors(episodes.arms)
    actuation = TensorActuation(episodes.actuation)
    action = torch.tensor(episodes.observed.action)
    observation = TensorObservation(episodes, dtype)
    observed = observation.now(arms, action, actuation.command)
    steps: list[tuple[torch.Tensor, ...]] = []
    for _ in range(periods):
        action_before = action
        action = _action(policy(observed), episodes)
        commands = actuation.apply(action)
        numbers = action.detach().numpy()
        advance = partial(episodes.step, numbers)
        arms = control_period(episodes.arms, arms, commands, advance=advance)
        observed = observation.now(arms, action, actuation.command)
        first_pose = episodes.target.tip_pose[:, :1]
        target_pose = torch.tensor(first_pose)
        # in the order of Trajectories
        step = (
            pose_logarithm(arms.tip_pose, target_pose)[:, 0],
            target_pose[:, 0, :3, 3] - arms.tip_pose[:, :3, 3],
            torch.tensor(episodes.target_backbone) - arms.backbone_position,
            action,
            action - action_before,
            actuation.command,
            commands[:, -1],
            arms.q,
            arms.tip_twist,
            torch.tensor(episodes.reward),
            torch.tensor(episodes.diverged),
        )
        steps.append(step)
    columns = zip(*steps, strict=True)
    stacked: list[Any] = [torch.stack(values) for values in columns]
    return Trajectories._make([*stacked, observed])


def _action(action: torch.Tensor, episodes: Episodes) -> torch.Tensor:
    """Actions (rows, n_a) within their limits.

    Raises TypeError or ValueError.
    """
    if not isinstance(action, torch.Tensor):
        raise TypeError(f"policy should return a tensor of actions, not {type(action).__name__}")
    shape = (episodes.size, episodes.model.tendon_count)
    numbers = action.detach().cpu().numpy()
    checked_array("the policy's action", numbers, shape)
    on_cpu = action.to("cpu", torch.float64)
    return inward_clip(on_cpu, -1.0, 1.0)
