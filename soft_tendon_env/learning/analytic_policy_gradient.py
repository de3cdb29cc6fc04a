"""Analytic policy gradient: a policy learns by the derivative of the simulation itself.

There is neither a critic nor an expert.

The mean action is taken, without exploration, and the gradient of a cost of tracking goes back
through windows of a rollout, see `differentiable.rollout`: backpropagation through time, truncated
at the ends of windows. Among others: Suh et al., "Do Differentiable Simulators Give Better Policy
Gradients?", ICML 2022; Xu et al., "Accelerated Policy Learning with Parallel Differentiable
Simulation", ICLR 2022, whose terminal critic is not here.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from soft_tendon_env.differentiable import TensorReward, Trajectories, rollout
from soft_tendon_env.differentiable.accuracy import check_gradients
from soft_tendon_env.differentiable.rewards import SQUARES
from soft_tendon_env.envs.environments import TendonRodVectorEnv
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.learning.algorithm import ActorAlgorithm
from soft_tendon_env.learning.recurrent import RecurrentPolicy
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among


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
        averaged_updates: number of last updates over which the weights that act and are saved are
            averaged, exponentially; 0: they are those of the last update.
        cost: name of one of COSTS, or a function of Trajectories to a scalar.

    Raises:
        ValueError: there is no such cost, or no such average.
    """

    n_steps: int = 16
    position_scale: float = 3e-3
    angle_scale: float = 0.03
    far_weight: float = 0.05
    smoothness: float = 3.0
    max_grad_norm: float = 1.0
    max_row_gradient: float = math.inf
    identification: float = 0.0
    averaged_updates: float = 0.0
    cost: str | Callable[[Trajectories], Tensor] = "errors"

    def __post_init__(self) -> None:
        if isinstance(self.cost, str) and self.cost not in COSTS:
            raise ValueError(f"cost is {self.cost!r}: {not_among(self.cost, COSTS)}")
        if 0.0 < self.averaged_updates < 1.0:
            raise ValueError(
                f"averaged_updates is {self.averaged_updates:g}: it should be at least 1, or 0 for"
                " no average"
            )


class TrackingCost:
    """Cost of trajectories that grows as the logarithm of tracking errors.

    Arms on their way to far targets do not hide those that are there. It is Cauchy's, 1/2 log(1 +
    s) of the sum s of squares, with a little of the distance itself and of changes of the action.
    """

    def __init__(self, episodes: Episodes, settings: APGSettings) -> None:
        """Costs of the errors that the environment rewards.

        Raises:
            ConfigurationError: it rewards others than those of SQUARES.
        """
        names = []
        for error in episodes.task.errors:
            own_terms = error.terms.keys()
            terms = episodes.terms.keys()
            is_rewarded = own_terms & terms
            if episodes.task.goal or is_rewarded:
                names.append(error.name)
        if not names or not SQUARES.keys() >= {*names}:
            text = (
                f"rewards {', '.join(names) or 'no error'}: APG has costs of {', '.join(SQUARES)}"
                " alone, give it a `cost`"
            )
            raise ConfigurationError([Problem(("reward",), text)], "environment")
        self._names = names
        self._settings = settings

    def __call__(self, trajectories: Trajectories) -> Tensor:
        """Mean cost () of periods and rows."""
        settings = self._settings
        ratios = []
        for name in self._names:
            scale = settings.position_scale
            if name == "angle_error":
                scale = settings.angle_scale
            square = SQUARES[name](trajectories)
            ratios.append(square / scale**2)
        total = torch.stack(ratios).sum(0)
        # Cauchy's loss, and a distance whose gradient does not fade far off
        near = 0.5 * total.log1p()
        far = (1.0 + total).sqrt()
        weighted = near + settings.far_weight * far
        tracking = weighted.mean()
        change = trajectories.action_change.square().mean()
        return tracking + settings.smoothness * change


class RewardCost:
    """Cost of trajectories that is what they lack of the greatest reward, 1 a period.

    Changes of the action cost what the reward says, and `smoothness` besides.
    """

    def __init__(self, episodes: Episodes, settings: APGSettings) -> None:
        """Costs by the reward of an environment.

        Raises:
            ConfigurationError: gradients cannot pass its reward.
        """
        self._reward = TensorReward(episodes)
        self._settings = settings

    def __call__(self, trajectories: Trajectories) -> Tensor:
        """Mean cost () of periods and rows."""
        missing = 1.0 - self._reward(trajectories)
        change = trajectories.action_change.square().mean()
        return missing.mean() + self._settings.smoothness * change


COSTS: Mapping[str, Callable[[Episodes, APGSettings], Callable[[Trajectories], Tensor]]] = {
    "errors": TrackingCost,
    "reward": RewardCost,
}
"""Costs of trajectories by name: of tracking errors, which leads far ones back, and of what the
reward lacks, which counts as the task does."""


class APG(ActorAlgorithm):
    """Analytic policy gradient with Stable-Baselines3's interface, on this package's rows.

    It minimises one of COSTS, and writes the reward to the log. Rows that have ended or diverged
    begin anew between windows. See APGSettings and ActorAlgorithm for arguments.

    Raises:
        TypeError: the environment is of another package.
        ValueError: gradients cannot pass effects, which it names.
        ConfigurationError: by `learn`, gradients cannot pass observation groups or rewards, which
            it names.

    Warns:
        GradientWarning: gradients through the arm are far from differences.
    """

    settings_class: ClassVar[type] = APGSettings
    policy_aliases: ClassVar[dict[str, Any]] = {
        "MlpPolicy": RecurrentPolicy,
        "MultiInputPolicy": RecurrentPolicy,
    }
    policy: RecurrentPolicy  # network that is trained, with its memory
    _identifier: torch.nn.Linear | None = None
    _average: AveragedModel | None = None

    def _setup_model(self) -> None:
        super()._setup_model()
        updates = self.settings.averaged_updates
        if updates:
            decay = 1.0 - 1.0 / updates
            self._average = AveragedModel(self.policy, multi_avg_fn=get_ema_multi_avg_fn(decay))

    @property
    def acting_policy(self) -> RecurrentPolicy:
        """The network that acts and is saved: that of averaged weights, if there is one."""
        if self._average is None:
            return self.policy
        return cast(RecurrentPolicy, self._average.module)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Computes mean actions by the network that acts, as `BaseAlgorithm.predict`.

        Args:
            observation: one, or rows of them.
            state: memory that the last call gave; None: an episode begins.
            episode_start: (rows,) where an episode begins.
            deterministic: is taken as True.

        Returns:
            Actions, and the memory to give back.
        """
        return self.acting_policy.predict(observation, state, episode_start, deterministic)

    def _prepare(self) -> None:
        episodes = self.rows.episodes
        episodes.arms.check_adjoint()
        if self.settings.identification and self._identifier is None:
            if not self.policy.memory:
                raise ValueError("identification needs a policy with a memory, see RecurrentPolicy")
            drawn = episodes.drawn_shares().shape[1]
            self._identifier = torch.nn.Linear(self.policy.memory, drawn)
            parameters = self._identifier.parameters()
            self.policy.optimizer.add_param_group({"params": parameters})

    def _learn_part(self, callback: BaseCallback) -> bool:
        rows = self.rows
        if self.num_timesteps == 0:
            check_gradients(rows.episodes)
        if self.num_timesteps == self._num_timesteps_at_start:
            self._returns = np.zeros(self.n_envs)
            self._lengths = np.zeros(self.n_envs, dtype=np.int64)
            self._memory = torch.zeros(self.n_envs, self.policy.memory)
        callback.on_rollout_start()
        observations: list[Any] = []
        memories: list[Tensor] = []

        def mean_action(observation: Any) -> Tensor:
            observations.append(observation)
            mean = self._mean_action(observation)
            memories.append(self._memory)
            return mean

        trajectories = rollout(rows, mean_action, self.settings.n_steps)
        # no gradient goes from one window into the one before
        self._memory = self._memory.detach()
        update_statistics(self.get_vec_normalize_env(), observations)
        cost = self._cost(trajectories, memories)
        norm = self._descend(cost)
        self.logger.record("train/cost", float(cost.detach()))
        self.logger.record("train/gradient_norm", norm)
        callback.update_locals(locals())
        for _ in range(self.settings.n_steps):
            self.num_timesteps += self.n_envs
            if not callback.on_step():
                return False
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        # of which row a gradient is not finite is not known
        is_finite = math.isfinite(norm)
        self._begin_ended(rows, trajectories, all_rows=not is_finite)
        callback.on_rollout_end()
        return True

    def _mean_action(self, observation: Any) -> Tensor:
        """Mean actions (rows, n_a), whose gradients are clipped; the memory goes on."""
        seen = normalised(observation, self.get_vec_normalize_env())
        mean, self._memory = self.policy.act(seen, self._memory)
        most = self.settings.max_row_gradient
        if math.isfinite(most):
            mean.register_hook(lambda gradient: clip_rows(gradient, most))
        return mean

    def _cost(self, trajectories: Trajectories, memories: list[Tensor]) -> Tensor:
        """Cost () of a window, that of identification included."""
        settings = self.settings
        episodes = self.rows.episodes
        function = settings.cost
        if isinstance(function, str):
            function = COSTS[function](episodes, settings)
        cost: Tensor = function(trajectories)
        if self._identifier is None:
            return cost
        shares = 2.0 * episodes.drawn_shares() - 1.0  # in [-1, 1]
        drawn = torch.tensor(shares, dtype=torch.float32)
        identified = self._identifier(torch.stack(memories))
        missed = identified - drawn
        mean_square = missed.square().mean()
        return cost + settings.identification * mean_square

    def _descend(self, cost: Tensor) -> float:
        """Norm of the gradient, by which the policy's weights move once, unless it is infinite."""
        optimizer = self.policy.optimizer
        self._update_learning_rate(optimizer)
        optimizer.zero_grad()
        try:
            cost.backward()
        except np.linalg.LinAlgError:  # a row at a configuration without derivatives
            return math.inf
        weights = self.policy.parameters()
        most = self.settings.max_grad_norm
        norm_before = torch.nn.utils.clip_grad_norm_(weights, most)
        norm = float(norm_before)
        if math.isfinite(norm):
            optimizer.step()
            if self._average is not None:
                self._average.update_parameters(self.policy)
        return norm

    def _begin_ended(
        self, rows: TendonRodVectorEnv, trajectories: Trajectories, all_rows: bool
    ) -> None:
        """Begin new episodes in the rows that have timed out or diverged.

        What the ended ones had as return is kept.
        """
        rewards = trajectories.reward.sum(0)
        self._returns += rewards.numpy()
        self._lengths += self.settings.n_steps
        diverged = trajectories.diverged.any(0).numpy()
        over = rows.timed_out | diverged | all_rows
        totals = self._returns[over].tolist()
        lengths = self._lengths[over].tolist()
        for total, length in zip(totals, lengths, strict=True):
            self.ep_info_buffer.append({"r": total, "l": length})  # type: ignore[union-attr]
        self._returns[over] = 0.0
        self._lengths[over] = 0
        if over.any():
            self._memory[over] = 0.0
            rows.reset(options={"reset_mask": over})

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        names = ["policy", "policy.optimizer"]
        if self._identifier is not None:
            names.append("_identifier")
        if self._average is not None:
            names.append("_average")
        return names, []


def normalised(observation: Any, statistics: VecNormalize | None, moments: Any = None) -> Any:
    """Observations as VecNormalize makes them, as tensors that carry gradients.

    Args:
        observation: rows as a tensor, or a dictionary of them.
        statistics: None where there are none.
        moments: of a part of a dictionary; None: those of the whole.
    """
    if statistics is None or not statistics.norm_obs:
        return observation
    moments = moments or statistics.obs_rms
    if isinstance(observation, dict):
        return {
            key: normalised(value, statistics, moments[key]) for key, value in observation.items()
        }
    mean = torch.as_tensor(moments.mean)
    variance = moments.var + statistics.epsilon
    deviation = torch.as_tensor(np.sqrt(variance))
    most = statistics.clip_obs
    scaled = (observation - mean) / deviation
    clamped = torch.clamp(scaled, -most, most)
    return clamped.to(observation.dtype)


def clip_rows(gradient: Tensor, most: float) -> Tensor:
    """Gradient (rows, n_a) whose rows have at most `most` times the norm of the median row.

    It stays as it is where that is zero.
    """
    norm = gradient.norm(dim=1, keepdim=True)
    greatest = most * norm.median()
    if not greatest > 0.0:
        return gradient
    share = (greatest / norm).clamp(max=1.0)
    return gradient * share


def update_statistics(statistics: VecNormalize | None, observations: list[Any]) -> None:
    """Let the running mean and deviation go on by the observations of a window."""
    if statistics is None or not statistics.norm_obs or not statistics.training:
        return
    moments: Any = statistics.obs_rms
    if not isinstance(observations[0], dict):
        _update_moments(moments, observations)
        return
    for key, of_part in moments.items():
        _update_moments(of_part, [observation[key] for observation in observations])


def _update_moments(moments: Any, observations: list[Tensor]) -> None:
    rows = torch.cat(observations)
    moments.update(rows.detach().numpy())
