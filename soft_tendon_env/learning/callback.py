"""Callback of Stable-Baselines3: monitor of the training."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback

from soft_tendon_env.learning.checkpoints import config_record, save_checkpoint, statistics_of
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.monitor import TrainingMonitor
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.agent import NetworkPolicy
from soft_tendon_env.policies.protocol import Policy


class TrainingCallback(TrainingMonitor, BaseCallback):
    """Monitor of a training with Stable-Baselines3. Raises ValueError, OSError."""

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        BaseCallback.__init__(self)
        TrainingMonitor.__init__(self, training, folder, checkpoint)

    def steps_done(self) -> int:
        return int(self.num_timesteps)

    def agent(self) -> Policy:
        return NetworkPolicy(self.model.policy, statistics_of(self.model).normalize_obs)

    def network(self) -> torch.nn.Module:
        return self.model.policy

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        save_checkpoint(folder, self.model, config, resumable=resumable)

    def evaluate(self) -> None:
        super().evaluate()
        for name, value in self.curve[-1].items():
            if name not in ("steps", "seconds"):
                self.logger.record(f"evaluation/{name}", value)
        self.logger.dump(self.num_timesteps)

    def _on_training_start(self) -> None:
        self.begin(config_record(self.training, unwrapped(self.training_env).env.episodes))

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.between_rollouts()

    def _on_training_end(self) -> None:
        self.end()
