"""Analytic policy gradient: a policy learns by the derivative of the simulation itself, without a
critic or a teacher.

The mean action is taken, without exploration, and the gradient of a cost of tracking goes back
through windows of a rollout, see `differentiable.rollout`: backpropagation through time, truncated
at the ends of windows. Among others: Suh et al., "Do Differentiable Simulators Give Better Policy
Gradients?", ICML 2022; Xu et al., "Accelerated Policy Learning with Parallel Differentiable
Simulation", ICLR 2022, whose terminal critic is not here.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.differentiable import Trajectories, rollout
from soft_tendon_env.differentiable.accuracy import check_gradients
from soft_tendon_env.envs.environments import TendonRodVectorEnv
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.learning.algorithm import ActorAlgorithm
from soft_tendon_env.learning.recurrent import RecurrentPolicy
from soft_tendon_env.tools.configuration import ConfigurationError, Problem

SQUARES: Mapping[str, Callable[[Trajectories, float, float], torch.Tensor]] = {
    "position_error": lambda found, position, angle: (
        (found.position_error / position).square().sum(-1)
    ),
    "angle_error": lambda found, position, angle: (found.error[..., :3] / angle).square().sum(-1),
    "backbone_error": lambda found, position, angle: (
        (found.backbone_error / position).square().sum(-1).mean(-1)
    ),
}
"""Squares (periods, rows) of tracking errors in units of the scales of position [m] and angle
[rad], by the names of the errors."""


@dataclass(frozen=True)
class APGSettings:
    """Settings of an analytic policy gradient.

    Attributes:
        n_steps: control periods of a window, after which the policy's weights move once.
        position_scale, angle_scale: errors [m], [rad] from which on the cost grows slower than
            their squares.
        far_weight: weight of the distance, which leads arms back that are far off.
        smoothness: weight of the mean square change of actions; unknown latency needs 10 to 20, or
            6 with a memory.
        max_grad_norm: greatest norm of a gradient.
        max_row_gradient: greatest gradient by a row's action, in those of the median row: arms that
            oscillate would lead all others.
        identification: weight of the mean square error at which a linear layer reads from the
            memory what `randomize` has drawn; this teaches the memory, and takes no part in the
            policy. 0: there is none.
        cost: function of Trajectories to a scalar, in place of TrackingCost.
    """

    n_steps: int = 16
    position_scale: float = 3e-3
    angle_scale: float = 0.03
    far_weight: float = 0.05
    smoothness: float = 3.0
    max_grad_norm: float = 1.0
    max_row_gradient: float = math.inf
    identification: float = 0.0
    cost: Callable[[Trajectories], torch.Tensor] | None = None


class TrackingCost:
    """Cost of trajectories that grows as the logarithm of tracking errors, so that arms on their
    way to far targets do not hide those that are there: Cauchy's, 1/2 log(1 + s) of the sum s of
    squares, with a little of the distance itself and of changes of the action.
    """

    def __init__(self, episodes: Episodes, settings: APGSettings) -> None:
        """Costs of the errors that the environment rewards. Raises ConfigurationError for others
        than those of SQUARES."""
        names = [
            error.name
            for error in episodes.task.errors
            if episodes.task.goal or error.terms.keys() & episodes.terms.keys()
        ]
        if not names or not SQUARES.keys() >= {*names}:
            text = (
                f"rewards {', '.join(names) or 'no error'}: APG has costs of {', '.join(SQUARES)}"
                " alone, give it a `cost`"
            )
            raise ConfigurationError([Problem(("reward",), text)], "environment")
        self._squares, self._settings = [SQUARES[name] for name in names], settings

    def __call__(self, found: Trajectories) -> torch.Tensor:
        """Mean cost () of periods and rows."""
        of = self._settings
        square = torch.stack(
            [error(found, of.position_scale, of.angle_scale) for error in self._squares]
        ).sum(0)
        near, far = 0.5 * square.log1p(), (1.0 + square).sqrt()
        return (
            near + of.far_weight * far
        ).mean() + of.smoothness * found.action_change.square().mean()


class APG(ActorAlgorithm):
    """Analytic policy gradient with the interface of Stable-Baselines3, on the vector environments
    of this package.

    It minimises a cost of its own, `TrackingCost`, of the errors that the environment rewards, not
    the reward: that is written to the log. Rows that have ended or diverged begin anew between
    windows. See APGSettings and ActorAlgorithm for arguments.

    Raises TypeError for environments of other packages; ValueError for effects, and
    ConfigurationError from `learn` for observation groups and rewards, naming what gradients cannot
    pass. Warns (GradientWarning) where gradients through the arm are far from differences.
    """

    settings_class: ClassVar[type] = APGSettings
    policy_aliases: ClassVar[dict[str, Any]] = dict.fromkeys(
        ("MlpPolicy", "MultiInputPolicy"), RecurrentPolicy
    )
    policy: RecurrentPolicy
    _identifier: torch.nn.Linear | None = None

    def _prepare(self) -> None:
        self.rows.episodes.arms.check_adjoint()
        if self.settings.identification and self._identifier is None:
            if not self.policy.memory:
                raise ValueError("identification needs a policy with a memory, see RecurrentPolicy")
            self._identifier = torch.nn.Linear(
                self.policy.memory, self.rows.episodes.drawn_shares().shape[1]
            )
            self.policy.optimizer.add_param_group({"params": self._identifier.parameters()})

    def _learn_part(self, callback: BaseCallback) -> bool:
        if self.num_timesteps == 0:
            check_gradients(self.rows.episodes)
        if self.num_timesteps == self._num_timesteps_at_start:
            self._returns, self._lengths = (
                np.zeros(self.n_envs),
                np.zeros(self.n_envs, dtype=np.int64),
            )
            self._memory = torch.zeros(self.n_envs, self.policy.memory)
        callback.on_rollout_start()
        rows = self.rows
        statistics, settings, seen, memories = self.get_vec_normalize_env(), self.settings, [], []

        def mean_action(observation: Any) -> torch.Tensor:
            seen.append(observation)
            mean, self._memory = self.policy.act(normalised(observation, statistics), self._memory)
            memories.append(self._memory)
            if math.isfinite(settings.max_row_gradient):
                mean.register_hook(lambda gradient: clip_rows(gradient, settings.max_row_gradient))
            return mean

        found, self._memory = rollout(rows, mean_action, settings.n_steps), self._memory.detach()
        update_statistics(statistics, seen)
        cost = (settings.cost or TrackingCost(rows.episodes, settings))(found)
        if self._identifier is not None:
            drawn = torch.tensor(2.0 * rows.episodes.drawn_shares() - 1.0, dtype=torch.float32)
            cost = (
                cost
                + settings.identification
                * (self._identifier(torch.stack(memories)) - drawn).square().mean()
            )
        self._update_learning_rate(self.policy.optimizer)
        self.policy.optimizer.zero_grad()
        try:
            cost.backward()
            norm = torch.nn.utils.clip_grad_norm_(self.policy.parameters(), settings.max_grad_norm)
            passed = bool(torch.isfinite(norm))
        except np.linalg.LinAlgError:  # a row at a configuration without derivatives
            norm, passed = torch.tensor(torch.inf), False
        if passed:
            self.policy.optimizer.step()
        self.logger.record("train/cost", float(cost.detach()))
        self.logger.record("train/gradient_norm", float(norm))
        callback.update_locals(locals())
        for _ in range(settings.n_steps):
            self.num_timesteps += self.n_envs
            if not callback.on_step():
                return False
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        self._begin_ended(rows, found, all_rows=not passed)
        callback.on_rollout_end()
        return True

    def _begin_ended(self, rows: TendonRodVectorEnv, found: Trajectories, all_rows: bool) -> None:
        """Begin new episodes in the rows that have timed out or diverged, and keep what the ended
        ones had as return."""
        self._returns += found.reward.sum(0).numpy()
        self._lengths += self.settings.n_steps
        over = rows.timed_out | found.diverged.any(0).numpy() | all_rows
        for total, length in zip(
            self._returns[over].tolist(), self._lengths[over].tolist(), strict=True
        ):
            self.ep_info_buffer.append({"r": total, "l": length})  # type: ignore[union-attr]
        self._returns[over], self._lengths[over] = 0.0, 0
        if over.any():
            self._memory[over] = 0.0
            rows.reset(options={"reset_mask": over})

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return [
            "policy",
            "policy.optimizer",
            *(["_identifier"] if self._identifier is not None else []),
        ], []


def normalised(observation: Any, statistics: VecNormalize | None, moments: Any = None) -> Any:
    """Observations as VecNormalize makes them, as tensors that carry gradients; moments: of a part
    of a dictionary."""
    if statistics is None or not statistics.norm_obs:
        return observation
    moments = moments or statistics.obs_rms
    if isinstance(observation, dict):
        return {
            key: normalised(value, statistics, moments[key]) for key, value in observation.items()
        }
    mean, deviation = (
        torch.as_tensor(moments.mean),
        torch.as_tensor(np.sqrt(moments.var + statistics.epsilon)),
    )
    return torch.clamp(
        (observation - mean) / deviation, -statistics.clip_obs, statistics.clip_obs
    ).to(observation.dtype)


def clip_rows(gradient: torch.Tensor, most: float) -> torch.Tensor:
    """Gradient (rows, n_a) whose rows have at most `most` times the norm of the median row, unless
    that is zero."""
    norm = gradient.norm(dim=1, keepdim=True)
    greatest = most * norm.median()
    return gradient * (greatest / norm).clamp(max=1.0) if greatest > 0.0 else gradient


def update_statistics(statistics: VecNormalize | None, seen: list[Any]) -> None:
    """Let the running mean and deviation go on by the observations of a window."""
    if statistics is not None and statistics.norm_obs and statistics.training:
        named: Any = statistics.obs_rms if isinstance(seen[0], dict) else {None: statistics.obs_rms}
        for key, moments in named.items():
            moments.update(
                torch.cat(
                    [observation if key is None else observation[key] for observation in seen]
                )
                .detach()
                .numpy()
            )
