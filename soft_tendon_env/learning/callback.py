"""Callback of Stable-Baselines3: monitor of the training, stages of its curriculum, what is frozen at first or later."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from soft_tendon_env.learning.asymmetric_critic import acting_network
from soft_tendon_env.learning.checkpoints import config_record, save_checkpoint, statistics_of
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.monitor import TrainingMonitor
from soft_tendon_env.learning.training_env import Timed, freeze_observations, make_training_env
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.agent import NetworkPolicy
from soft_tendon_env.policies.protocol import Policy


class TrainingCallback(TrainingMonitor, BaseCallback):
    """Monitor of a training with Stable-Baselines3. Raises ValueError."""

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        BaseCallback.__init__(self)
        TrainingMonitor.__init__(self, training, folder, checkpoint)

    def steps_done(self) -> int:
        return int(self.num_timesteps)

    def agent(self) -> Policy:
        return NetworkPolicy(acting_network(self.model), statistics_of(self.model).normalize_obs)

    def network(self) -> torch.nn.Module:
        return self.model.policy

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        save_checkpoint(folder, self.model, config, resumable=resumable)

    def log(self, row: Mapping[str, float]) -> None:
        for name, value in row.items():
            if name not in ("steps", "seconds"):
                self.logger.record(f"evaluation/{name}", value)
        self.logger.dump(self.num_timesteps)

    def environment_seconds(self) -> float | None:
        """Seconds of this process in steps of the environment; None where the algorithm takes them otherwise, as APG."""
        return self._environment + self._timed.seconds or None

    def _on_training_start(self) -> None:
        self._environment = 0.0
        self._stage = self.training.options_at(self.num_timesteps)
        self._frozen = False  # those of a checkpoint that were are frozen once more, which changes nothing
        self.begin(config_record(self.training, unwrapped(self.training_env).env.episodes))

    @property
    def _timed(self) -> Timed:
        timed = statistics_of(self.model).venv
        assert isinstance(timed, Timed)
        return timed

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.between_rollouts()
        if not self._frozen and (start := self.training.normalise.frozen_from) is not None and start <= self.num_timesteps:
            self._frozen = True
            freeze_observations(statistics_of(self.model))
        if self.training.critic_steps:
            free_actor(self.model, self.num_timesteps >= self.training.critic_steps)
        if (stage := self.training.options_at(self.num_timesteps)) != self._stage:
            self._stage = stage
            self.untimed(self._begin_stage)

    def _on_training_end(self) -> None:
        self.end()

    def _begin_stage(self) -> None:
        """New arms for the agent; its networks and statistics go on."""
        training, statistics = self.training, statistics_of(self.model)
        self._environment += self._timed.seconds
        statistics.venv.close()
        statistics.venv = make_training_env(training, self.num_timesteps)
        statistics.venv.seed(training.arm_seed(self.num_timesteps))
        self.model._last_obs = statistics.reset()
        self.model._last_original_obs = statistics.get_original_obs()
        self.model._last_episode_starts = np.ones(training.arms, dtype=bool)


def free_actor(model: Any, free: bool) -> None:
    """Let the actor of an actor-critic policy learn, or the critic alone."""
    policy: Any = model.policy
    for weights in (*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters(), policy.log_std):
        weights.requires_grad = free
