"""Training of an agent with an algorithm of Stable-Baselines3, or with its interface, by a
configuration.

A run leaves in its folder: `config.json` (the configuration as resolved, versions, commit),
`evaluations.csv` (the learning curve, on the fixed validation targets), `best/` and `last/`
(checkpoints, see checkpoints.py) and `tensorboard/`. Killed at any time, it can go on from the last
checkpoint.
"""

import dataclasses
import pickle
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation.provenance import versions
from soft_tendon_env.learning.checkpoints import (
    BUFFER,
    ENVIRONMENT,
    MODEL,
    PICKLED,
    find_checkpoint,
    read_checkpoint,
    restore,
)
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.hyperparameters import training_class
from soft_tendon_env.learning.monitor import TrainingCallback, Watch
from soft_tendon_env.learning.networks import policy_arguments
from soft_tendon_env.learning.vec_env import StableBaselinesVecEnv, make_sb3_vec_env
from soft_tendon_env.policies.agent import CONFIG
from soft_tendon_env.policies.algorithms import network_kind
from soft_tendon_env.tools.files import read_json
from soft_tendon_env.tools.messages import first_line

SB3 = "sb3"  # engine of a training whose record names none


def checkpoint_to_resume(
    folder: Path, training: Training, resume: bool, engine: str = SB3
) -> Path | None:
    """The checkpoint to go on from, if any. Raises FileExistsError, ValueError where the folder has
    another training, or a damaged one."""
    checkpoint, begun = find_checkpoint(folder / "last"), folder / CONFIG
    if not resume and (begun.exists() or checkpoint is not None):
        raise FileExistsError(
            f"{folder} has a training already: give --resume to go on with it, or another folder"
            " with --out"
        )
    if checkpoint is None and not begun.exists():
        return None
    record = read_json(begun) if checkpoint is None else read_checkpoint(checkpoint)
    now = {
        **training.model_dump(mode="json"),
        "engine": engine,
        "version": versions()["soft_tendon_env"],
    }
    before = {
        "engine": SB3,
        **record,
        "version": record.get("record", {}).get("versions", {}).get("soft_tendon_env"),
    }
    if changed := [key for key in now if key != "steps" and now[key] != before.get(key)]:
        differences = "; ".join(
            f"{key} was {before.get(key)!r} and is {now[key]!r}" for key in changed
        )
        raise ValueError(f"{folder} has another training, {differences}: only `steps` may change")
    return checkpoint


def train(
    training: Training, folder: Path, checkpoint: Path | None = None, watch: Watch | None = None
) -> BaseAlgorithm:
    """Train an agent for what is left of its steps. watch: gets every row of the learning curve,
    and ends the training by what it raises.

    Raises ValueError, OSError before it begins, and UserError.
    """
    model, callback = model_of(training, checkpoint), TrainingCallback(training, folder, checkpoint)
    callback.watch = watch
    learn(model, callback)
    return model


def model_of(training: Training, checkpoint: Path | None) -> BaseAlgorithm:
    """Agent as it is at the beginning, or as a checkpoint has it. Raises ValueError, OSError."""
    torch.set_num_threads(
        1
    )  # best where several trainings run side by side, and makes them repeatable
    return make_model(training) if checkpoint is None else load_model(training, checkpoint)


def learn(model: BaseAlgorithm, callback: TrainingCallback) -> None:
    """Learn what is left. Raises UserError where weights become infinite or undefined."""
    training, done = callback.training, model.num_timesteps
    if done >= training.steps:
        print(f"done before: {done} steps")
        return
    callback.model = model  # which `check` asks, where the first reset fails too
    kind = "tensorboard" if find_spec("tensorboard") else "csv"
    model.set_logger(configure(str(callback.folder / kind), [kind]))
    try:
        model.learn(training.steps - done, callback=callback, reset_num_timesteps=False)
    except (ArithmeticError, RuntimeError, ValueError):
        callback.check()  # what is not finite ends in errors of PyTorch
        raise
    callback.report()


def make_training_env(training: Training) -> StableBaselinesVecEnv:
    """Vector environment of a training. The first episode of every arm ends at another time, so
    that every batch has beginnings, middles and ends of episodes. Raises ConfigurationError,
    ValueError."""
    steps = training.episode_steps
    env = make_sb3_vec_env(
        IDS[training.task], training.arms, max_episode_steps=steps, threads=1, **training.options
    )
    env.set_options(
        [{"episode_steps": 1 + steps * row // training.arms} for row in range(training.arms)]
    )
    return env


def make_model(training: Training) -> BaseAlgorithm:
    """Agent that has learned nothing yet, with its environment. Raises ValueError."""
    network_kind(training.algorithm)  # raises where its agents could not act later
    env, normalise, kind = (
        make_training_env(training),
        training.normalise,
        training_class(training.algorithm),
    )
    given: dict[str, Any] = {**training.hyperparameters, "learning_rate": learning_rate(training)}
    normalised = VecNormalize(
        env,
        norm_obs=normalise.observations,
        norm_reward=normalise.rewards,
        gamma=given.get("gamma", 0.99),
    )
    policy = (
        "MultiInputPolicy" if isinstance(env.observation_space, gym.spaces.Dict) else "MlpPolicy"
    )  # of tasks with goals
    given["policy_kwargs"] = policy_arguments(given.get("policy_kwargs", {}))
    try:
        if (settings := getattr(kind, "settings_class", None)) is not None:
            names = [field.name for field in dataclasses.fields(settings) if field.name in given]
            given["settings"] = settings(**{name: given.pop(name) for name in names})
        model: BaseAlgorithm = kind(policy, normalised, seed=training.seed, device="cpu", **given)
    except (
        Exception
    ) as error:  # however Stable-Baselines3 and PyTorch end on hyperparameters that they cannot use
        raise ValueError(
            f"{training.algorithm} cannot be made of these hyperparameters: {first_line(error)}"
        ) from error
    normalised.seed(training.arm_seed())
    return model


def load_model(training: Training, checkpoint: Path) -> BaseAlgorithm:
    """Agent of a checkpoint, with all that it needs to learn on. Loading runs what is in its files.
    Raises ValueError, OSError."""
    midst, rate = pickle.loads((checkpoint / ENVIRONMENT).read_bytes()), learning_rate(training)
    statistics = VecNormalize.load(str(checkpoint / PICKLED), midst["env"])
    kept = {"learning_rate": rate, "lr_schedule": rate}
    model: BaseAlgorithm = training_class(training.algorithm).load(
        checkpoint / MODEL, env=statistics, device="cpu", custom_objects=kept
    )
    if hasattr(model, "load_replay_buffer"):
        whole = {"truncate_last_traj": False} if isinstance(model, OffPolicyAlgorithm) else {}
        model.load_replay_buffer(checkpoint / BUFFER, **whole)
    restore(model, midst)
    return model


def learning_rate(training: Training) -> float | Callable[[float], float]:
    """Learning rate: a number, or a function of the part of the training that remains."""
    if isinstance(training.learning_rate, float):
        return training.learning_rate
    first, last, *kind = training.learning_rate
    return (
        (lambda remains: last * (first / last) ** remains)
        if kind
        else lambda remains: last + (first - last) * remains
    )
