"""Distributed training of PPO with RLlib (Ray), as a configuration says.

Environments are in several processes, or on a Ray cluster.

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
    "gamma": "gamma",
    "max_grad_norm": "grad_clip",
    "n_epochs": "num_epochs",
    "vf_coef": "vf_loss_coeff",
}
"""Arguments of `PPOConfig.training` by those of PPO of Stable-Baselines3 that mean the same."""
ELSEWHERE = ("n_steps", "policy_kwargs", "target_kl")
"""Arguments that go into the batch, the network, the penalty on the divergence of policies."""
BY_ROWS: Any = "vector_entry_point"  # how Gymnasium makes environments with many rows
RLLIB = "rllib"  # name of the engine, and of the folder of RLlib's own checkpoint in a checkpoint
MOST_REWARD = 10.0  # greatest magnitude of normalised rewards, as VecNormalize's
KL_TARGET = 0.01  # RLlib's own, where the divergence has no penalty


class RunnerEnv(VectorWrapper):
    """Rows of one runner, with seeds that no other has.

    Infos stay within: RLlib would make a dictionary per row of them at every step.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], seed: int) -> None:
        super().__init__(env)
        self._first_seed = seed

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """New episodes; any seed becomes ours.

        RLlib's are one apart from runner to runner: most arms would be there twice.
        """
        if seed is None:
            own_seed = None
        else:
            own_seed = self._first_seed
        observation, _ = self.env.reset(seed=own_seed, options=options)
        return observation, {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        observation, reward, terminated, truncated, _ = self.env.step(actions)
        return observation, reward, terminated, truncated, {}


def make_runner_env(context: Mapping[str, Any]) -> VectorEnv[Any, Any, Any]:
    """Environment of a runner.

    context: `training`, `num_envs` of its rows and RLlib's `worker_index`.
    """
    training: Training = context["training"]
    rows = context.get("num_envs", 1)
    index = max(getattr(context, "worker_index", 0) - 1, 0)
    options: dict[str, Any] = {
        "max_episode_steps": training.episode_steps,
        "threads": 1,
        **training.options,
    }
    env_id = IDS[training.task]
    envs = gym.make_vec(env_id, rows, BY_ROWS, **options)
    seed = context["seed"] + rows * index
    arms = RunnerEnv(envs, seed)
    if not training.normalise.rewards:
        return arms
    gamma = training.hyperparameters.get("gamma", 0.99)
    normalised = NormalizeReward(arms, gamma=gamma)
    return ClipReward(normalised, -MOST_REWARD, MOST_REWARD)


def make_config(training: Training, runners: int, done: int = 0) -> PPOConfig:
    """RLlib's view of a training.

    Args:
        training: its configuration.
        runners: that share the arms; 0: the process that learns has them.
        done: steps that it has done.

    Raises:
        ConfigurationError: RLlib has no counterpart of something, so that a file never says one
            thing and trains another, or the arms cannot be shared out among the runners.
    """
    _check_counterparts(training, runners)
    arguments = inspect.signature(training_class("PPO").__init__).parameters
    value = {name: argument.default for name, argument in arguments.items()}
    value |= training.hyperparameters
    register_env("soft_tendon_env", make_runner_env)
    network = {"network": value["policy_kwargs"] or {}}
    module = RLModuleSpec(module_class=ActorCriticModule, model_config=network)
    config = PPOConfig().learners(num_learners=0).rl_module(rl_module_spec=module)
    seed = (training.seed + done) % 2**31
    config.debugging(seed=seed, log_level="ERROR")
    # actions are clipped, not scaled, as Stable-Baselines3 does
    config.environment(
        "soft_tendon_env",
        env_config={"training": training, "seed": training.arm_seed(done)},
        clip_actions=True,
        normalize_actions=False,
    )
    length = value["n_steps"]
    config.env_runners(
        num_env_runners=runners,
        num_envs_per_env_runner=training.arms // max(runners, 1),
        rollout_fragment_length=length,
        gym_env_vectorize_mode=BY_ROWS,
    )
    target_kl = value["target_kl"]
    return config.training(
        **{name: value[ours] for ours, name in COUNTERPARTS.items()},
        train_batch_size_per_learner=length * training.arms,
        lr=_learning_rate(training),
        grad_clip_by="global_norm",
        use_kl_loss=target_kl is not None,
        kl_target=target_kl or KL_TARGET,
        vf_clip_param=float("inf"),
    )


def _learning_rate(training: Training) -> float | list[list[float]]:
    """Learning rate: a number, or [steps, rate] between which it is straight."""
    rate = training.learning_rate
    if isinstance(rate, float):
        return rate
    begin = [0, rate[0]]
    return [begin, [training.steps, rate[1]]]


def _check_counterparts(training: Training, runners: int) -> None:
    """Raises ConfigurationError for what RLlib has no counterpart of, and arms of no runner."""
    keys: list[tuple[str, ...]] = []
    if training.algorithm != "PPO":
        keys.append(("algorithm",))
    known = {*COUNTERPARTS, *ELSEWHERE}
    for name in sorted(training.hyperparameters.keys() - known):
        keys.append(("hyperparameters", name))
    if training.normalise.observations:
        keys.append(("normalise", "observations"))
    rate = training.learning_rate
    if isinstance(rate, tuple) and len(rate) > 2:
        keys.append(("learning_rate",))
    text = "has no counterpart in RLlib's PPO: leave it out, or train with Stable-Baselines3"
    problems = [Problem(key, text) for key in keys]
    if training.arms % max(runners, 1):
        shared = (
            f"is {training.arms}: it should be a multiple of the {runners} runners, which share"
            " them"
        )
        problems.append(Problem(("arms",), shared))
    if problems:
        raise ConfigurationError(problems, "with RLlib")


class ActorCriticModule(TorchRLModule, ValueFunctionAPI):
    """RLlib's module around the actor-critic network of Stable-Baselines3.

    That is `policy`, so that agents are saved as any other.
    """

    def setup(self) -> None:
        self.policy = new_network(
            "PPO", self.model_config["network"], self.observation_space, self.action_space
        )

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        policy = self.policy
        observation = batch[Columns.OBS]
        features = policy.extract_features(observation, policy.pi_features_extractor)
        latent = policy.mlp_extractor.forward_actor(features)
        mean = policy.action_net(latent)
        log_std = policy.log_std.expand_as(mean)
        distribution = torch.cat([mean, log_std], dim=-1)
        return {Columns.ACTION_DIST_INPUTS: distribution}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        observation = batch[Columns.OBS]
        values = self.policy.predict_values(observation)
        return values.squeeze(-1)


class RllibTraining(TrainingMonitor):
    """Training with RLlib, on this machine or a cluster.

    Raises ValueError, OSError before it begins.
    """

    def __init__(
        self, training: Training, folder: Path, runners: int, checkpoint: Path | None
    ) -> None:
        super().__init__(training, folder, checkpoint)
        torch.set_num_threads(1)
        self.runners = runners
        self._done = self.began
        config = make_config(training, runners, self._done)
        self.algorithm: PPO = config.build_algo()
        if checkpoint is not None:
            own = (checkpoint / RLLIB).absolute()
            self.algorithm.restore_from_path(str(own))
        self._network = new_network(
            "PPO",
            training.hyperparameters.get("policy_kwargs") or {},
            self.envs.single_observation_space,
            self.envs.single_action_space,
        )

    def steps_done(self) -> int:
        return self._done

    def network(self) -> Any:
        """The learner's weights, in a network without Ray."""
        modules = self.algorithm.learner_group.get_weights([DEFAULT_MODULE_ID])
        state = {}
        for name, value in modules[DEFAULT_MODULE_ID].items():
            state[name.removeprefix("policy.")] = torch.as_tensor(value)
        self._network.load_state_dict(state)
        return self._network

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        def write(new: Path) -> None:
            save_agent(new, self.network(), None)
            if resumable:
                own = (new / RLLIB).absolute()
                self.algorithm.save_to_path(str(own))

        replace_checkpoint(folder, config, write)

    def learn(self) -> None:
        """Learn all that is left.

        Raises UserError, and the errors of Ray and PyTorch, after which --resume goes on.
        """
        record = config_record(self.training, episodes_of(self.envs))
        self.begin({**record, "engine": RLLIB, "runners": self.runners})
        while self._done < self.training.steps:
            results = self.algorithm.train()
            self._done = int(results["num_env_steps_sampled_lifetime"])
            is_end = self._done >= self.training.steps
            self.between_rollouts(ends=is_end)
        self.report()
