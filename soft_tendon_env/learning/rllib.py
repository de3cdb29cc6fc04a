"""Distributed training of PPO with RLlib (Ray), as a configuration says: environments in several
processes, or on a Ray cluster.

A run leaves what one of Stable-Baselines3 does, `tensorboard/` aside, and RLlib's own checkpoint in
`last/rllib/`, from which it goes on.
"""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.wrappers.vector import ClipReward, NormalizeReward
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule
from ray.tune.registry import register_env

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.learning.checkpoints import config_record, replace_checkpoint
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.hyperparameters import training_class
from soft_tendon_env.learning.monitor import TrainingMonitor
from soft_tendon_env.learning.networks import new_network
from soft_tendon_env.policies.agent import save_agent
from soft_tendon_env.tools.configuration import ConfigurationError, Problem

COUNTERPARTS = {
    "batch_size": "minibatch_size",
    "clip_range": "clip_param",
    "ent_coef": "entropy_coeff",
    "gae_lambda": "lambda_",
}
COUNTERPARTS |= {
    "gamma": "gamma",
    "max_grad_norm": "grad_clip",
    "n_epochs": "num_epochs",
    "vf_coef": "vf_loss_coeff",
}
"""Arguments of `PPOConfig.training` by those of PPO of Stable-Baselines3 that mean the same."""
ELSEWHERE = (
    "n_steps",
    "policy_kwargs",
    "target_kl",
)  # go into the batch, the network, the penalty on the divergence of policies
BY_ROWS: Any = "vector_entry_point"
RLLIB = "rllib"  # name of the engine, and of the folder of RLlib's own checkpoint in a checkpoint


class RunnerEnv(VectorWrapper):
    """Rows of one runner, with seeds that no other has. Infos stay within: RLlib would make a
    dictionary per row of them at every step."""

    def __init__(self, env: VectorEnv[Any, Any, Any], seed: int) -> None:
        super().__init__(env)
        self._first_seed = seed

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """New episodes; any seed becomes ours, since RLlib's are one apart from runner to runner:
        most arms would be there twice."""
        return (
            self.env.reset(seed=None if seed is None else self._first_seed, options=options)[0],
            {},
        )

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        return *self.env.step(actions)[:4], {}


def make_runner_env(context: Mapping[str, Any]) -> VectorEnv[Any, Any, Any]:
    """Environment of a runner: `training` of the context, `num_envs` of its rows and RLlib's
    `worker_index`."""
    training: Training = context["training"]
    rows, index = context.get("num_envs", 1), max(getattr(context, "worker_index", 0) - 1, 0)
    more: dict[str, Any] = {
        "max_episode_steps": training.episode_steps,
        "threads": 1,
        **training.options,
    }
    arms = RunnerEnv(
        gym.make_vec(IDS[training.task], rows, BY_ROWS, **more), context["seed"] + rows * index
    )
    if not training.normalise.rewards:
        return arms
    return ClipReward(
        NormalizeReward(arms, gamma=training.hyperparameters.get("gamma", 0.99)), -10.0, 10.0
    )  # as VecNormalize


def make_config(training: Training, runners: int, done: int = 0) -> PPOConfig:
    """RLlib's view of a training. Raises ConfigurationError for what RLlib has no counterpart of,
    so that a file never says one thing and trains another, and where the arms cannot be shared out
    among the runners (0: the process that learns has them)."""
    arguments = inspect.signature(training_class("PPO").__init__).parameters
    value = {
        name: argument.default for name, argument in arguments.items()
    } | training.hyperparameters
    unknown = sorted(training.hyperparameters.keys() - COUNTERPARTS.keys() - {*ELSEWHERE})
    strange: list[tuple[str, ...]] = [("algorithm",)] * (training.algorithm != "PPO") + [
        ("hyperparameters", name) for name in unknown
    ]
    strange += [("normalise", "observations")] * training.normalise.observations
    strange += [("learning_rate",)] * (
        isinstance(training.learning_rate, tuple) and len(training.learning_rate) > 2
    )
    problems = [
        Problem(
            key, "has no counterpart in RLlib's PPO: leave it out, or train with Stable-Baselines3"
        )
        for key in strange
    ]
    if training.arms % max(runners, 1):
        problems.append(
            Problem(
                ("arms",),
                f"is {training.arms}: it should be a multiple of the {runners} runners, which share"
                " them",
            )
        )
    if problems:
        raise ConfigurationError(problems, "with RLlib")
    rate, target_kl = training.learning_rate, value["target_kl"]
    register_env("soft_tendon_env", make_runner_env)
    module = RLModuleSpec(
        module_class=ActorCriticModule, model_config={"network": value["policy_kwargs"] or {}}
    )
    config = PPOConfig().learners(num_learners=0).rl_module(rl_module_spec=module)
    config.debugging(seed=(training.seed + done) % 2**31, log_level="ERROR")
    arms, length = {"training": training, "seed": training.arm_seed(done)}, value["n_steps"]
    config.environment(
        "soft_tendon_env", env_config=arms, clip_actions=True, normalize_actions=False
    )  # as Stable-Baselines3 does
    config.env_runners(
        num_env_runners=runners, num_envs_per_env_runner=training.arms // max(runners, 1)
    )
    config.env_runners(rollout_fragment_length=length, gym_env_vectorize_mode=BY_ROWS)
    return config.training(
        **{name: value[ours] for ours, name in COUNTERPARTS.items()},
        train_batch_size_per_learner=length * training.arms,
        lr=rate if isinstance(rate, float) else [[0, rate[0]], [training.steps, rate[1]]],
        grad_clip_by="global_norm",
        use_kl_loss=target_kl is not None,
        kl_target=target_kl or 0.01,
        vf_clip_param=float("inf"),
    )


class ActorCriticModule(TorchRLModule, ValueFunctionAPI):
    """RLlib's module around the actor-critic network of Stable-Baselines3, as `policy`, so that
    agents are saved as any other."""

    def setup(self) -> None:
        self.policy = new_network(
            "PPO", self.model_config["network"], self.observation_space, self.action_space
        )

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        features = self.policy.extract_features(
            batch[Columns.OBS], self.policy.pi_features_extractor
        )
        mean = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return {
            Columns.ACTION_DIST_INPUTS: torch.cat(
                [mean, self.policy.log_std.expand_as(mean)], dim=-1
            )
        }

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        return self.policy.predict_values(batch[Columns.OBS]).squeeze(-1)


class RllibTraining(TrainingMonitor):
    """Training with RLlib, on this machine or a cluster. Raises ValueError, OSError before it
    begins."""

    def __init__(
        self, training: Training, folder: Path, runners: int, checkpoint: Path | None
    ) -> None:
        super().__init__(training, folder, checkpoint)
        torch.set_num_threads(1)
        self.runners, self._done = runners, self.began
        self.algorithm: PPO = make_config(training, runners, self._done).build_algo()
        if checkpoint is not None:
            self.algorithm.restore_from_path(str((checkpoint / RLLIB).absolute()))
        spaces = self.envs.single_observation_space, self.envs.single_action_space
        self._network = new_network(
            "PPO", training.hyperparameters.get("policy_kwargs") or {}, *spaces
        )

    def steps_done(self) -> int:
        return self._done

    def network(self) -> Any:
        """The learner's weights, in a network without Ray."""
        state = self.algorithm.learner_group.get_weights([DEFAULT_MODULE_ID])[DEFAULT_MODULE_ID]
        self._network.load_state_dict(
            {name.removeprefix("policy."): torch.as_tensor(value) for name, value in state.items()}
        )
        return self._network

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        def write(new: Path) -> None:
            save_agent(new, self.network(), None)
            if resumable:
                self.algorithm.save_to_path(str((new / RLLIB).absolute()))

        replace_checkpoint(folder, config, write)

    def learn(self) -> None:
        """Learn all that is left. Raises UserError, and the errors of Ray and PyTorch, after which
        --resume goes on."""
        self.begin(
            {
                **config_record(self.training, episodes_of(self.envs)),
                "engine": RLLIB,
                "runners": self.runners,
            }
        )
        while self._done < self.training.steps:
            self._done = int(self.algorithm.train()["num_env_steps_sampled_lifetime"])
            self.between_rollouts(ends=self._done >= self.training.steps)
        self.report()
