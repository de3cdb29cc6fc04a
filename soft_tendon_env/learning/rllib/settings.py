"""RLlib's view of a training, without Ray: PPO of a configuration in the words of `PPOConfig`, and the environment of its runners.

What RLlib has no counterpart of is an error, so that a file never says one thing and trains another.
"""

import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.wrappers.vector import ClipReward, NormalizeReward

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.config import Training
from soft_tendon_env.policies.network import algorithm_class
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown

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
"""Hyperparameters that go into the size of a batch, into the network, and into RLlib's penalty on the divergence of policies."""
ENVIRONMENT = "soft_tendon_env"
"""Name by which the arms of a runner are registered."""
NETWORK = "network"
"""Key of the module's configuration: policy_kwargs."""


class RunnerEnv(VectorWrapper):
    """Rows of one runner, with seeds that no other has. Infos stay within: RLlib would make a dictionary per row of them at every step.

    Args:
        env: rows of the vector environment.
        seed: of the first of them.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], seed: int) -> None:
        super().__init__(env)
        self._first_seed = seed

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """New episodes. RLlib's seeds are one apart from runner to runner: most arms would be there twice, so that any becomes ours."""
        return self.env.reset(seed=None if seed is None else self._first_seed, options=options)[0], {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """A step of all rows, without infos."""
        return *self.env.step(actions)[:4], {}


def make_runner_env(context: Mapping[str, Any]) -> VectorEnv[Any, Any, Any]:
    """Environment of a runner, of what `rllib_settings` says of it, `num_envs` of its rows and RLlib's `worker_index`."""
    rows, index = context.get("num_envs", 1), max(getattr(context, "worker_index", 0) - 1, 0)
    size: dict[str, Any] = {"num_envs": rows, "max_episode_steps": context["episode_steps"], "threads": context["threads"]}
    env = gym.make_vec(IDS[context["task"]], vectorization_mode="vector_entry_point", **size, **context["options"])
    arms = RunnerEnv(env, context["seed"] + rows * index)
    if (scaled := context["rewards"]) is None:
        return arms
    return ClipReward(NormalizeReward(arms, gamma=scaled["gamma"]), -scaled["clip"], scaled["clip"])


def rllib_settings(training: Training, runners: int, done: int = 0) -> dict[str, dict[str, Any]]:
    """Arguments of `PPOConfig`'s methods, by their names; `rl_module` needs the class as well.

    runners: processes with environments, each with an equal part of the arms; 0: the process that learns has them. done: steps learned
    before. Raises ConfigurationError for what RLlib has no counterpart of, and where the arms cannot be shared out.
    """
    if problems := _problems(training, runners):
        raise ConfigurationError(problems, "with RLlib")
    value = _hyperparameters(training)
    first, last = (training.learning_rate,) * 2 if isinstance(training.learning_rate, float) else training.learning_rate
    arms = {"task": training.task, "options": training.options, "episode_steps": training.episode_steps}
    rewards = {"gamma": value["gamma"], "clip": training.normalise.clip} if training.normalise.rewards else None
    divergence = {"use_kl_loss": False} if value["target_kl"] is None else {"use_kl_loss": True, "kl_target": value["target_kl"]}
    return {
        "environment": {
            "env": ENVIRONMENT,
            "env_config": {**arms, "rewards": rewards, "threads": training.threads, "seed": training.arm_seed(done)},
            "clip_actions": True,  # as Stable-Baselines3 does: noise is added before, and its likelihood is that of what was asked for
            "normalize_actions": False,
        },
        "env_runners": {
            "num_env_runners": runners,
            "num_envs_per_env_runner": training.arms // max(runners, 1),
            "gym_env_vectorize_mode": "vector_entry_point",
            "rollout_fragment_length": value["n_steps"],
        },
        "training": {
            **{name: value[own] for own, name in COUNTERPARTS.items()},
            "train_batch_size_per_learner": value["n_steps"] * training.arms,
            "lr": first if first == last else [[0, first], [training.steps, last]],
            "grad_clip_by": "global_norm",
            **divergence,
            "vf_clip_param": float("inf"),
        },
        "learners": {"num_learners": 0},
        "rl_module": {"model_config": {NETWORK: value["policy_kwargs"] or {}}},
        "debugging": {"seed": (training.seed + done) % 2**31, "log_level": "ERROR"},
    }


def _hyperparameters(training: Training) -> dict[str, Any]:
    """All hyperparameters, as Stable-Baselines3 would have them."""
    arguments = inspect.signature(algorithm_class("PPO").__init__).parameters
    defaults = {name: argument.default for name, argument in arguments.items()}
    return {**defaults, **{name: value for name, value in training.hyperparameters.items() if value is not None}}


def _problems(training: Training, runners: int) -> list[Problem]:
    if training.algorithm != "PPO":
        return [Problem(("algorithm",), f"is {training.algorithm!r}: it should be 'PPO', others are with Stable-Baselines3 only")]
    found = []
    if training.start_from is not None:
        found.append(Problem(("start_from",), f"is {training.start_from!r}: it has no counterpart there, and should be left out"))
    if training.normalise.observations:
        text = "is true: it should be false, observations keep the scales that the environment gives them"
        found.append(Problem(("normalise", "observations"), text))
    if training.arms % max(runners, 1):
        found.append(Problem(("arms",), f"is {training.arms}: it should be a multiple of the {runners} runners, which share them"))
    return found + _of_hyperparameters(training)


def _of_hyperparameters(training: Training) -> list[Problem]:
    """Hyperparameters other than the defaults, where RLlib does only what Stable-Baselines3 does by default."""
    value = _hyperparameters(training)
    defaults = _hyperparameters(training.model_copy(update={"hyperparameters": {}}))
    found = [
        Problem(("hyperparameters", name), f"is {shown(value[name])}: it has no counterpart there, and should be {default} or left out")
        for name, default in defaults.items()
        if name not in COUNTERPARTS and name not in ELSEWHERE and value[name] != default
    ]
    if value["batch_size"] > (batch := value["n_steps"] * training.arms):
        text = f"is {value['batch_size']}: it should be at most n_steps times arms, {batch}"
        found.append(Problem(("hyperparameters", "batch_size"), text))
    return found
