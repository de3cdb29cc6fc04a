"""Training of an agent with RLlib, as a configuration says: on this machine, or on a Ray cluster.

A run leaves in its folder what one of Stable-Baselines3 does, `tensorboard/` aside; `last/` has RLlib's own checkpoint in `rllib/`, from
which it goes on. Evaluations are by this package, in the process that learns.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import ray
import torch
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule
from ray.tune.registry import register_env

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.learning.checkpoints import config_record, replace_checkpoint, unpickling
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.monitor import TrainingMonitor
from soft_tendon_env.learning.rllib.settings import ENVIRONMENT, NETWORK, make_runner_env, rllib_settings
from soft_tendon_env.policies.agent import NetworkPolicy, save_agent
from soft_tendon_env.policies.network import Architecture, new_network
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.messages import UserError, first_line

RLLIB = "rllib"
"""Name of the engine."""
CHECKPOINT = "rllib"
"""Folder of RLlib's own checkpoint, in a checkpoint."""


class ActorCriticModule(TorchRLModule, ValueFunctionAPI):
    """RLlib's module around the actor-critic network of Stable-Baselines3, as `policy`: agents are saved as any other, without Ray."""

    def setup(self) -> None:
        """Makes the network."""
        self.policy = new_network(Architecture("PPO", self.model_config[NETWORK]), self.observation_space, self.action_space)

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        features = self.policy.extract_features(batch[Columns.OBS], self.policy.pi_features_extractor)
        mean = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, self.policy.log_std.expand_as(mean)], dim=-1)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        """Values (n,) of states."""
        return self.policy.predict_values(batch[Columns.OBS]).squeeze(-1)


def make_algorithm(training: Training, runners: int, done: int = 0) -> PPO:
    """An agent that has learned nothing yet, and its runners. done: steps that a checkpoint has. Raises ConfigurationError."""
    torch.set_num_threads(training.threads)
    register_env(ENVIRONMENT, make_runner_env)
    config = PPOConfig()
    config.rl_module(rl_module_spec=RLModuleSpec(module_class=ActorCriticModule))
    for method, arguments in rllib_settings(training, runners, done).items():
        getattr(config, method)(**arguments)
    return config.build_algo()


class RllibTraining(TrainingMonitor):
    """Training with RLlib, of this machine or a cluster. Raises ValueError, OSError before it begins."""

    def __init__(self, training: Training, folder: Path, runners: int, checkpoint: Path | None) -> None:
        super().__init__(training, folder, checkpoint)
        self.runners, self._done = runners, self.began
        self.algorithm = make_algorithm(training, runners, self._done)
        if checkpoint is not None:
            path = (checkpoint / CHECKPOINT).absolute()
            with unpickling(path, "it may be cut, or of another version of Ray"):
                self.algorithm.restore_from_path(str(path))
        policy, envs = training.hyperparameters.get("policy_kwargs") or {}, self.validation.envs
        self._network = new_network(Architecture(training.algorithm, policy), envs.single_observation_space, envs.single_action_space)

    def steps_done(self) -> int:
        return self._done

    def network(self) -> torch.nn.Module:
        """The learner's weights, in a network without Ray."""
        state = self.algorithm.learner_group.get_weights([DEFAULT_MODULE_ID])[DEFAULT_MODULE_ID]
        self._network.load_state_dict({name.removeprefix("policy."): torch.as_tensor(value) for name, value in state.items()})
        return self._network

    def agent(self) -> Policy:
        return NetworkPolicy(self.network())

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        def write(new: Path) -> None:
            save_agent(new, self.network(), None)
            if resumable:
                self.algorithm.save_to_path(str((new / CHECKPOINT).absolute()))

        replace_checkpoint(folder, config, write)

    def log(self, row: Mapping[str, float]) -> None:
        """Nothing: RLlib's own log stays its own."""

    def learn(self) -> None:
        """Learn all that is left to learn. Raises UserError."""
        if self._done >= self.training.steps:
            print(f"done before: {self._done} steps")
            return
        engine = {"engine": RLLIB, "runners": self.runners}
        self.begin({**config_record(self.training, episodes_of(self.validation.envs)), **engine})
        try:
            while self._done < self.training.steps:
                if self._done > self.began:
                    self.between_rollouts()
                self._iterate()
            self.end()
        finally:
            self.close()
        self.report(note=f" with {self.runners} runners")

    def _iterate(self) -> None:
        """One rollout of all runners, and what is learned from it."""
        try:
            result = self.algorithm.train()
        except ValueError:
            self.check()  # what is not finite ends in errors of PyTorch
            raise
        except ray.exceptions.RayError as error:
            said = f"Ray stopped after {self._done} steps: {first_line(error)}"
            raise UserError(f"{said}; --resume goes on from the last checkpoint") from error
        self._done = int(result["num_env_steps_sampled_lifetime"])
