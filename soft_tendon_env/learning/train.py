"""Training of an agent with an algorithm of Stable-Baselines3, or with its interface, by a configuration.

A run leaves in its folder: `config.json` (the configuration as resolved, versions, commit), `evaluations.csv` (the learning curve, on the
fixed validation targets), `best/` and `last/` (checkpoints, see checkpoints.py) and `tensorboard/`. Killed at any time, it can go on from
the last checkpoint.
"""

import traceback
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.evaluation.provenance import versions
from soft_tendon_env.learning.callback import TrainingCallback
from soft_tendon_env.learning.checkpoints import (
    BUFFER,
    ENVIRONMENT,
    MODEL,
    PICKLED,
    Midst,
    find_checkpoint,
    read_checkpoint,
    read_pickle,
    unpickling,
)
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.hyperparameters import learns_from_replay, training_class
from soft_tendon_env.learning.monitor import Watch
from soft_tendon_env.learning.training_env import make_training_env
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.agent import load_agent
from soft_tendon_env.policies.agent_files import CONFIG, find_agent
from soft_tendon_env.policies.network import policy_arguments, read_weights
from soft_tendon_env.tools.files import read_json
from soft_tendon_env.tools.messages import UserError, first_line, say

SB3 = "sb3"
"""Engine of a training whose record names none."""
MAY_CHANGE = ("steps", "checkpoint_every", "checkpoint_seconds")
"""Keys of a training that may be other when it goes on."""
REFUSALS = (ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, NameError, RuntimeError, TypeError, ValueError)
"""How Stable-Baselines3 and PyTorch end on hyperparameters that they cannot use."""


def checkpoint_to_resume(folder: Path, training: Training, resume: bool, engine: str = SB3) -> Path | None:
    """The checkpoint to go on from, if any. Raises FileExistsError, ValueError where the folder has another training, or a damaged one."""
    checkpoint, begun = find_checkpoint(folder / "last"), folder / CONFIG
    if not resume and (begun.exists() or checkpoint is not None):
        raise FileExistsError(f"{folder} has a training already: give --resume to go on with it, or another folder with --out")
    if checkpoint is None and not begun.exists():
        return None
    record = read_json(begun) if checkpoint is None else read_checkpoint(checkpoint)
    if (own := record.get("engine", SB3)) != engine:
        raise ValueError(f"{folder} has a training with --engine {own}, which cannot go on with {engine}")
    given = {key: record[key] for key in Training.model_fields if key in record}  # keys that came later were as they are by default
    source = str(begun if checkpoint is None else checkpoint / CONFIG)
    before, now = (of.model_dump(mode="json") for of in (Training.parse(given, source), training))
    changed = [key for key in now if key not in MAY_CHANGE and now[key] != before[key]]
    if changed:
        differences = "; ".join(f"{key} was {before[key]!r} and is {now[key]!r}" for key in changed)
        raise ValueError(f"{folder} has another training, {differences}: only {', '.join(f'`{key}`' for key in MAY_CHANGE)} may change")
    return checkpoint


def train(training: Training, folder: Path, checkpoint: Path | None = None, watch: Watch | None = None) -> BaseAlgorithm:
    """Train an agent for what is left of its steps.

    watch: gets every row of the learning curve, and ends the training by what it raises.

    Raises ValueError, OSError before it begins, and UserError.
    """
    model, callback = model_of(training, checkpoint), TrainingCallback(training, folder, checkpoint)
    callback.watch = watch
    learn(model, callback)
    return model


def model_of(training: Training, checkpoint: Path | None) -> BaseAlgorithm:
    """Agent as it is at the beginning, or as a checkpoint has it. Raises ValueError, OSError."""
    torch.set_num_threads(training.threads)
    model = make_model(training) if checkpoint is None else load_model(training, checkpoint)
    if training.start_from is not None and checkpoint is None:
        copy_network(training.start_from, training.task, model)
        torch.set_num_threads(training.threads)  # agents that are loaded take one
    return model


def learn(model: BaseAlgorithm, callback: TrainingCallback) -> None:
    """Learn what is left. Raises UserError where weights become infinite or undefined, or the algorithm ends before its first update."""
    training, done = callback.training, model.num_timesteps
    if done >= training.steps:
        print(f"done before: {done} steps")
        return
    callback.model = model  # which `check` asks, where the first reset fails too
    kind = "tensorboard" if find_spec("tensorboard") else "csv"
    model.set_logger(configure(str(callback.folder / kind), [kind]))
    try:
        model.learn(training.steps - done, callback=callback, reset_num_timesteps=False)
    except REFUSALS as error:
        callback.check()  # what is not finite ends in errors of PyTorch
        if model._n_updates or _is_of_environment(error):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"({Path(last.filename).name}, line {last.lineno})"
        raise UserError(f"{training.algorithm} cannot learn with these hyperparameters: {first_line(error)} {where}") from error
    finally:
        callback.close()
    if learns_from_replay(training.algorithm) and not model._n_updates:
        say(f"{training.algorithm} has made no update: see learning_starts, gradient_steps and train_freq of its hyperparameters")
    callback.report()


def _is_of_environment(error: BaseException) -> bool:
    """Whether an error was raised in a step or a reset of the environment, as by a reward of a user's own."""
    names = (frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__))
    return any(name.startswith("soft_tendon_env.envs.") for name in names)


def make_model(training: Training) -> BaseAlgorithm:
    """Agent that has learned nothing yet, with its environment. Raises ValueError."""
    env, settings = make_training_env(training), training.normalise
    gamma = training.hyperparameters.get("gamma", 0.99)
    normalised = VecNormalize(
        env, norm_obs=settings.observations, norm_reward=settings.rewards, clip_obs=settings.clip, clip_reward=settings.clip, gamma=gamma
    )
    policy = "MultiInputPolicy" if isinstance(env.observation_space, gym.spaces.Dict) else "MlpPolicy"  # of tasks with goals
    arguments = {**training.hyperparameters, "learning_rate": learning_rate(training), **replay(training)}
    arguments["policy_kwargs"] = policy_arguments(arguments.get("policy_kwargs", {}))
    try:
        model = training_class(training.algorithm)(policy, normalised, seed=training.seed, device="cpu", **arguments)
    except REFUSALS as error:
        raise ValueError(f"{training.algorithm} cannot be made of these hyperparameters: {first_line(error)}") from error
    normalised.seed(training.arm_seed())
    return model


def copy_network(name: str, task: str, model: BaseAlgorithm) -> None:
    """Let a model that has learned nothing begin with the network of an agent. Raises ValueError, OSError where that is of another arm,
    of other observations or actions, or not of the same shape."""
    env = model.get_env()
    assert env is not None, "trainings have one"
    load_agent(name, unwrapped(env).env)  # refuses one that is damaged, or that means something else
    files = find_agent(name, task)
    if files.is_zip or files.statistics.exists():
        raise ValueError(f"start_from is {name}: it should be the folder of an agent that sees observations as they are")
    try:
        model.policy.load_state_dict(read_weights(files.weights))
    except RuntimeError as error:
        raise ValueError(f"start_from is {name}: its network is not of the shape that hyperparameters.policy_kwargs say") from error


def load_model(training: Training, checkpoint: Path) -> BaseAlgorithm:
    """Agent of a checkpoint, with all that it needs to learn on. Raises ValueError, OSError."""
    config, package = read_checkpoint(checkpoint), "soft_tendon_env"
    before, now = config.get("record", {}).get("versions", {}).get(package), versions()[package]
    if before != now:
        text = f"{checkpoint} was written by {package} {before}, this is {now}: only that version can go on with it"
        raise ValueError(f"{text}. `start_from` begins a new training with its network")
    midst = read_pickle(checkpoint / ENVIRONMENT, Midst)
    statistics = read_pickle(checkpoint / PICKLED, VecNormalize)
    if statistics.observation_space != midst.env.observation_space:
        raise ValueError(f"{checkpoint / PICKLED} is of other observations than the training has")
    statistics.set_venv(midst.env)
    rate = learning_rate(training)
    kept = {"learning_rate": rate, "lr_schedule": rate}
    with unpickling(checkpoint / MODEL):
        model = training_class(training.algorithm).load(checkpoint / MODEL, device="cpu", env=statistics, custom_objects=kept)
    if model.num_timesteps != (done := config["steps_done"]):
        raise ValueError(f"{checkpoint} is of two trainings: its {MODEL} has learned {model.num_timesteps} steps, {CONFIG} says {done}")
    if hasattr(model, "load_replay_buffer"):
        with unpickling(checkpoint / BUFFER):
            whole = {"truncate_last_traj": False} if learns_from_replay(training.algorithm) else {}
            model.load_replay_buffer(checkpoint / BUFFER, **whole)
    midst.restore(model)
    return model


def learning_rate(training: Training) -> float | Callable[[float], float]:
    """Learning rate: a number, or a function of the part of the training that remains."""
    if isinstance(training.learning_rate, float):
        return training.learning_rate
    first, last = training.learning_rate
    return lambda remains: last + (first - last) * remains


def replay(training: Training) -> dict[str, Any]:
    """Arguments for hindsight experience replay, if there is any."""
    if training.hindsight is None:
        return {}
    from stable_baselines3 import HerReplayBuffer

    settings = {"n_sampled_goal": training.hindsight.goals, "goal_selection_strategy": training.hindsight.strategy}
    return {"replay_buffer_class": HerReplayBuffer, "replay_buffer_kwargs": settings}
