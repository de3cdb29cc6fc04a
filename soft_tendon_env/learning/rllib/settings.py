"""RLlib's settings of a training: PPO of a configuration that is written for Stable-Baselines3, in the words of `PPOConfig`.

Nothing here needs Ray. What RLlib has no counterpart of is an error, so that a file never says one thing and trains another.
"""

import inspect
from typing import Any

from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.hyperparameters import problem_below
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
"""Hyperparameters that go into the size of a batch, the network and the learner."""
ENVIRONMENT = "soft_tendon_env"
"""The name that the arms of a runner are registered by."""
NETWORK = "network"
"""Key of the configuration of the module: policy_kwargs."""
REWARDS, TARGET_KL = "rewards", "target_kl"
"""Keys of the configuration of the learner: discount and clip of normalised rewards, None without; greatest divergence, or None."""


def rllib_settings(training: Training, runners: int, done: int = 0) -> dict[str, dict[str, Any]]:
    """Arguments of `PPOConfig`'s methods, by their names; `rl_module` needs the class as well.

    runners: processes with environments, each with an equal part of the arms; 0: the process that learns has them. done: steps learned
    before. Raises ConfigurationError for what RLlib has no counterpart of, and where the arms cannot be shared out.
    """
    if problems := _problems(training, runners):
        raise ConfigurationError(problems, "with RLlib")
    value = hyperparameters(training)
    rows = training.arms // max(runners, 1)
    first, last = (training.learning_rate,) * 2 if isinstance(training.learning_rate, float) else training.learning_rate
    arms = {"task": training.task, "options": training.options, "episode_steps": training.episode_steps(training.options)}
    return {
        "environment": {
            "env": ENVIRONMENT,
            "env_config": {**arms, "threads": training.threads, "seed": training.arm_seed(done)},
            "clip_actions": True,  # as Stable-Baselines3 does: noise is added before, and its likelihood is that of what was asked for
            "normalize_actions": False,
        },
        "env_runners": {
            "num_env_runners": runners,
            "num_envs_per_env_runner": rows,
            "gym_env_vectorize_mode": "vector_entry_point",
            "rollout_fragment_length": value["n_steps"],
        },
        "training": {
            **{name: value[own] for own, name in COUNTERPARTS.items()},
            "train_batch_size_per_learner": value["n_steps"] * training.arms,
            "lr": first if first == last else [[0, first], [training.steps, last]],
            "grad_clip_by": "global_norm",
            "use_kl_loss": False,
            "vf_clip_param": float("inf"),
        },
        "learners": {
            "num_learners": 0,
            "learner_config_dict": {
                REWARDS: {"gamma": value["gamma"], "clip": training.normalise.clip} if training.normalise.rewards else None,
                TARGET_KL: value["target_kl"],
            },
        },
        "rl_module": {"model_config": {NETWORK: value["policy_kwargs"] or {}}},
        "debugging": {"seed": (training.seed + done) % 2**31, "log_level": "ERROR"},
    }


def hyperparameters(training: Training) -> dict[str, Any]:
    """All of them, as Stable-Baselines3 would have them."""
    arguments = inspect.signature(algorithm_class("PPO").__init__).parameters
    defaults = {name: argument.default for name, argument in arguments.items()}
    return {**defaults, **{name: value for name, value in training.hyperparameters.items() if value is not None}}


def _problems(training: Training, runners: int) -> list[Problem]:
    if training.algorithm != "PPO":
        return [Problem(("algorithm",), f"is {training.algorithm!r}: it should be 'PPO', others are with Stable-Baselines3 only")]
    found = [
        Problem((key,), f"is {shown(given)}: it has no counterpart there, and should be left out")
        for key in ("curriculum", "residual", "start_from", "exploration")
        if (given := getattr(training, key)) != Training.model_fields[key].default
    ]
    if training.normalise.observations:
        text = "is true: it should be false, observations keep the scales that the environment gives them"
        found.append(Problem(("normalise", "observations"), text))
    if training.arms % max(runners, 1):
        found.append(Problem(("arms",), f"is {training.arms}: it should be a multiple of the {runners} runners, which share them"))
    return found + [problem_below(problem) for problem in _of_hyperparameters(training)]


def _of_hyperparameters(training: Training) -> list[Problem]:
    """What differs from what Stable-Baselines3 does by default, if RLlib does only that."""
    value = hyperparameters(training)
    defaults = hyperparameters(training.model_copy(update={"hyperparameters": {}}))
    found = [
        Problem((name,), f"is {shown(value[name])}: it has no counterpart there, and should be {default} or left out")
        for name, default in defaults.items()
        if name not in COUNTERPARTS and name not in ELSEWHERE and value[name] != default
    ]
    if value["batch_size"] > (batch := value["n_steps"] * training.arms):
        found.append(Problem(("batch_size",), f"is {value['batch_size']}: it should be at most n_steps times arms, {batch}"))
    return found
