"""Analytic policy gradient: a policy learns by the derivative of the simulation itself, without a critic or a teacher.

The mean action is taken, without exploration, and the gradient of a cost of tracking goes back through windows of a rollout, see
`differentiable.rollout`: backpropagation through time, truncated at the ends of windows. Among others: Suh et al., "Do Differentiable
Simulators Give Better Policy Gradients?", ICML 2022; Xu et al., "Accelerated Policy Learning with Parallel Differentiable Simulation",
ICLR 2022, whose terminal critic is not here.
"""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import safe_mean
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.differentiable import Trajectories, rollout
from soft_tendon_env.differentiable.accuracy import check_gradients
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.vector import TendonRodVectorEnv
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.tools.configuration import ConfigurationError, Problem

SQUARES: Mapping[str, Callable[[Trajectories, float, float], torch.Tensor]] = {
    "position_error": lambda found, position, angle: (found.position_error / position).square().sum(-1),
    "angle_error": lambda found, position, angle: (found.error[..., :3] / angle).square().sum(-1),
    "backbone_error": lambda found, position, angle: (found.backbone_error / position).square().sum(-1).mean(-1),
}
"""Squares (periods, rows) of tracking errors in units of the scales of position [m] and angle [rad], by the names of the errors."""


@dataclass(frozen=True)
class APGSettings:
    """Settings of an analytic policy gradient.

    Attributes:
        n_steps: control periods of a window, after which the policy's weights move once.
        position_scale, angle_scale: errors [m], [rad] from which on the cost grows slower than their squares.
        far_weight: weight of the distance, which leads arms back that are far off.
        smoothness: weight of the mean square change of actions; unknown latency needs 10 to 20.
        max_grad_norm: greatest norm of a gradient.
    """

    n_steps: int = 16
    position_scale: float = 3e-3
    angle_scale: float = 0.03
    far_weight: float = 0.05
    smoothness: float = 3.0
    max_grad_norm: float = 1.0


class TrackingCost:
    """Cost of trajectories that grows as the logarithm of tracking errors, so that arms on their way to far targets do not hide those
    that are there: Cauchy's, 1/2 log(1 + s) of the sum s of squares, with a little of the distance itself and of changes of the action.
    """

    def __init__(self, episodes: Episodes, settings: APGSettings) -> None:
        """Costs of the errors that the environment rewards. Raises ConfigurationError for others than those of SQUARES."""
        names = [error.name for error in episodes.task.errors if episodes.task.goal or error.term in episodes.terms]
        if unknown := [name for name in names if name not in SQUARES]:
            text = f"rewards {', '.join(unknown)}: the analytic policy gradient has costs of {', '.join(SQUARES)} alone"
            raise ConfigurationError([Problem(("reward",), text)], "environment")
        if not names:
            text = f"has no term of {', '.join(SQUARES)}, of which the analytic policy gradient makes a cost: give it a `cost`"
            raise ConfigurationError([Problem(("reward",), text)], "environment")
        self._squares, self._settings = [SQUARES[name] for name in names], settings

    def __call__(self, found: Trajectories) -> torch.Tensor:
        """Mean cost () of periods and rows."""
        of = self._settings
        square = torch.stack([error(found, of.position_scale, of.angle_scale) for error in self._squares]).sum(0)
        near, far = 0.5 * square.log1p(), (1.0 + square).sqrt()
        return (near + of.far_weight * far).mean() + of.smoothness * found.action_change.square().mean()


class APG(BaseAlgorithm):
    """Analytic policy gradient with the interface of Stable-Baselines3, on the vector environments of this package.

    It minimises a cost of its own, `TrackingCost`, of the errors that the environment rewards, not the reward: that is written to the
    log. Rows that have ended or diverged begin anew between windows. Policies are those of PPO, whose value network is not used.

    Args:
        cost: function of Trajectories to a scalar, in place of TrackingCost.
        others: see APGSettings and BaseAlgorithm; `device` is "cpu" by default.

    Raises TypeError for environments of other packages; ValueError for effects, and ConfigurationError from `learn` for observation
    groups and rewards, naming what gradients cannot pass. Warns (GradientWarning) where gradients through the arm are far from differences.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = PPO.policy_aliases
    settings_class: ClassVar[type] = APGSettings
    policy: ActorCriticPolicy

    def __init__(
        self,
        policy: str | type[ActorCriticPolicy],
        env: GymEnv | str,
        learning_rate: float | Schedule = 1e-3,
        settings: APGSettings | None = None,
        cost: Callable[[Trajectories], torch.Tensor] | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        _init_setup_model: bool = True,
        **general: Any,
    ) -> None:
        super().__init__(policy, env, learning_rate, policy_kwargs, support_multi_env=True, **{"device": "cpu", **general})
        self.settings, self.cost = settings or APGSettings(), cost
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        spaces = self.observation_space, self.action_space
        self.policy = cast(ActorCriticPolicy, self.policy_class(*spaces, self.lr_schedule, **self.policy_kwargs)).to(self.device)
        if self.env is not None:
            self._rows()

    def _rows(self) -> TendonRodVectorEnv:
        """The environment within its wrappers. Raises TypeError, ConfigurationError where its rows have no gradients."""
        assert self.env is not None, "learning needs an environment"
        rows = unwrapped(self.env).env
        rows.episodes.arms.check_adjoint()
        return rows

    def learn(self, total_timesteps: int, callback: MaybeCallback = None, log_interval: int = 10, **others: Any) -> "APG":  # type: ignore[override]
        """Learn for so many steps of all rows together; log_interval: windows between entries of the log; see `BaseAlgorithm.learn`.

        Raises as the class says.
        """
        reset, bar = others.get("reset_num_timesteps", True), others.get("progress_bar", False)
        total, called = self._setup_learn(total_timesteps, callback, reset, others.get("tb_log_name", "APG"), bar)
        called.on_training_start(locals(), globals())
        if self.num_timesteps == 0:
            check_gradients(self._rows().episodes)
        windows, self._returns, self._lengths = 0, np.zeros(self.n_envs), np.zeros(self.n_envs, dtype=np.int64)
        while self.num_timesteps < total and self._learn_window(called):
            windows += 1
            if log_interval and windows % log_interval == 0:
                self._log()
        called.on_training_end()
        return self

    def _learn_window(self, callback: BaseCallback) -> bool:
        """Learn from a window of all rows; False where the callback ends the training."""
        callback.on_rollout_start()
        rows = self._rows()
        statistics, settings, seen = self.get_vec_normalize_env(), self.settings, []

        def mean_action(observation: Any) -> torch.Tensor:
            seen.append(observation)
            mean: torch.Tensor = self.policy.get_distribution(normalised(observation, statistics)).mode()
            return mean

        found = rollout(rows, mean_action, settings.n_steps)
        update_statistics(statistics, seen)
        cost = (self.cost or TrackingCost(rows.episodes, settings))(found)
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
        """Begin new episodes in the rows that have timed out or diverged, and keep what the ended ones had as return."""
        self._returns += found.reward.sum(0).numpy()
        self._lengths += self.settings.n_steps
        over = rows.timed_out | found.diverged.any(0).numpy() | all_rows
        for total, length in zip(self._returns[over].tolist(), self._lengths[over].tolist(), strict=True):
            self.ep_info_buffer.append({"r": total, "l": length})  # type: ignore[union-attr]
        self._returns[over], self._lengths[over] = 0.0, 0
        if over.any():
            rows.reset(options={"reset_mask": over})

    def _log(self) -> None:
        seconds = max(1e-9 * (time.time_ns() - self.start_time), sys.float_info.epsilon)
        self.logger.record("time/fps", int((self.num_timesteps - self._num_timesteps_at_start) / seconds))
        for name, key in (("ep_rew_mean", "r"), ("ep_len_mean", "l")):
            self.logger.record(f"rollout/{name}", safe_mean([episode[key] for episode in self.ep_info_buffer or ()]))
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []


def normalised(observation: Any, statistics: VecNormalize | None, moments: Any = None) -> Any:
    """Observations as VecNormalize makes them, as tensors that carry gradients; moments: of a part of a dictionary."""
    if statistics is None or not statistics.norm_obs:
        return observation
    moments = moments or statistics.obs_rms
    if isinstance(observation, dict):
        return {key: normalised(value, statistics, moments[key]) for key, value in observation.items()}
    mean, deviation = torch.as_tensor(moments.mean), torch.as_tensor(np.sqrt(moments.var + statistics.epsilon))
    return torch.clamp((observation - mean) / deviation, -statistics.clip_obs, statistics.clip_obs).to(observation.dtype)


def update_statistics(statistics: VecNormalize | None, seen: list[Any]) -> None:
    """Let the running mean and deviation go on by the observations of a window."""
    if statistics is not None and statistics.norm_obs and statistics.training:
        named: Any = statistics.obs_rms if isinstance(seen[0], dict) else {None: statistics.obs_rms}
        for key, moments in named.items():
            moments.update(torch.cat([observation if key is None else observation[key] for observation in seen]).detach().numpy())
