"""Training of an agent by a configuration.

The algorithm is one of Stable-Baselines3, or has its interface.

A run leaves in its folder: `config.json` (the configuration as resolved, versions, commit),
`evaluations.csv` (the learning curve, on the fixed validation targets), `best/` and `last/`
(checkpoints, see checkpoints.py) and `tensorboard/`. Killed at any time, it can go on from the last
checkpoint.
"""

import dataclasses
import pickle
from collections.abc import Callable, Mapping
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
    acting_network,
    find_checkpoint,
    read_checkpoint,
    restore,
    statistics_of,
)
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.hyperparameters import training_class
from soft_tendon_env.learning.monitor import TrainingCallback, Watch
from soft_tendon_env.learning.networks import policy_arguments
from soft_tendon_env.learning.vec_env import StableBaselinesVecEnv, make_sb3_vec_env, unwrapped
from soft_tendon_env.policies.agent import CONFIG, find_agent, layout_of, read_config
from soft_tendon_env.policies.algorithms import policy_name
from soft_tendon_env.policies.weights import WEIGHTS, acting_arrays, read_weights
from soft_tendon_env.tools.files import read_json
from soft_tendon_env.tools.messages import first_line

SB3 = "sb3"  # engine of a training whose record names none


def checkpoint_to_resume(
    folder: Path, training: Training, resume: bool, engine: str = SB3
) -> Path | None:
    """The checkpoint to go on from, if any.

    Args:
        folder: of the training.
        training: its configuration now.
        resume: whether it may go on.
        engine: that trains.

    Raises:
        FileExistsError: the folder has a training, which should not go on.
        ValueError: the folder has another training, or a damaged one.
    """
    checkpoint = find_checkpoint(folder / "last")
    begun = folder / CONFIG
    if not resume and (begun.exists() or checkpoint is not None):
        raise FileExistsError(
            f"{folder} has a training already: give --resume to go on with it, or another folder"
            " with --out"
        )
    if checkpoint is None and not begun.exists():
        return None
    if checkpoint is None:
        record = read_json(begun)
    else:
        record = read_checkpoint(checkpoint)
    _check_same(folder, training, engine, record)
    return checkpoint


def _check_same(folder: Path, training: Training, engine: str, record: dict[str, Any]) -> None:
    """Raises ValueError where a record is of another training than this one."""
    now = training.model_dump(mode="json")
    now["engine"] = engine
    now["version"] = versions()["soft_tendon_env"]
    before = {"engine": SB3, **record}
    recorded_versions = record.get("record", {}).get("versions", {})
    before["version"] = recorded_versions.get("soft_tendon_env")
    changed = [key for key in now if key != "steps" and now[key] != before.get(key)]
    if changed:
        differences = "; ".join(
            f"{key} was {before.get(key)!r} and is {now[key]!r}" for key in changed
        )
        raise ValueError(f"{folder} has another training, {differences}: only `steps` may change")


def train(
    training: Training, folder: Path, checkpoint: Path | None = None, watch: Watch | None = None
) -> BaseAlgorithm:
    """Trains an agent for the steps that it still lacks.

    Args:
        training: its configuration.
        folder: for what the run leaves.
        checkpoint: to go on from; None: at the beginning.
        watch: gets every row of the learning curve, and ends the training by what it raises.

    Returns:
        The agent.

    Raises:
        ValueError: before it begins, for a training or a checkpoint that cannot be used.
        OSError: before it begins, for files that cannot be read or written.
        UserError: weights became infinite or undefined, or a checkpoint cannot be written.
    """
    model = model_of(training, checkpoint)
    callback = TrainingCallback(training, folder, checkpoint)
    callback.watch = watch
    learn(model, callback)
    return model


def model_of(training: Training, checkpoint: Path | None) -> BaseAlgorithm:
    """Agent as it is at the beginning, or as a checkpoint has it.

    Raises ValueError, OSError.
    """
    # best where several trainings run side by side, and makes them repeatable
    torch.set_num_threads(1)
    if checkpoint is None:
        return make_model(training)
    return load_model(training, checkpoint)


def learn(model: BaseAlgorithm, callback: TrainingCallback) -> None:
    """Learn what is left.

    Raises UserError where weights become infinite or undefined.
    """
    training = callback.training
    done = model.num_timesteps
    if done >= training.steps:
        print(f"done before: {done} steps")
        return
    callback.model = model  # which `check` asks, where the first reset fails too
    if find_spec("tensorboard"):
        kind = "tensorboard"
    else:
        kind = "csv"
    log_folder = str(callback.folder / kind)
    model.set_logger(configure(log_folder, [kind]))
    try:
        steps_left = training.steps - done
        model.learn(steps_left, callback=callback, reset_num_timesteps=False)
    except (ArithmeticError, RuntimeError, ValueError):
        callback.check()  # what is not finite ends in errors of PyTorch
        raise
    callback.report()


def make_training_env(training: Training) -> StableBaselinesVecEnv:
    """Vector environment of a training.

    The first episode of every arm ends at another time, so that every batch has beginnings, middles
    and ends of episodes. Raises ConfigurationError, ValueError.
    """
    steps = training.episode_steps
    env = make_sb3_vec_env(
        IDS[training.task], training.arms, max_episode_steps=steps, threads=1, **training.options
    )
    options = []
    for row in range(training.arms):
        length = 1 + steps * row // training.arms
        options.append({"episode_steps": length})
    env.set_options(options)
    return env


def make_model(training: Training) -> BaseAlgorithm:
    """Agent that has learned nothing yet, with its environment. Raises ValueError."""
    env = make_training_env(training)
    arguments: dict[str, Any] = dict(training.hyperparameters)
    arguments["learning_rate"] = learning_rate(training)
    arguments["policy_kwargs"] = policy_arguments(arguments.get("policy_kwargs", {}))
    normalised = VecNormalize(
        env,
        norm_obs=training.normalise.observations,
        norm_reward=training.normalise.rewards,
        gamma=arguments.get("gamma", 0.99),
    )
    has_goals = isinstance(env.observation_space, gym.spaces.Dict)
    kind = training_class(training.algorithm)
    policy = policy_name(kind, has_goals)
    try:
        _gather_settings(kind, arguments)
        model: BaseAlgorithm = kind(
            policy, normalised, seed=training.seed, device="cpu", **arguments
        )
    # however Stable-Baselines3 and PyTorch end on hyperparameters that they cannot use
    except Exception as error:
        raise ValueError(
            f"{training.algorithm} cannot be made of these hyperparameters: {first_line(error)}"
        ) from error
    normalised.seed(training.arm_seed())
    if training.start_from is not None:
        _begin_with(model, training.start_from, training.task)
    return model


def _begin_with(model: BaseAlgorithm, agent: str, task: str) -> None:
    """Give a model the weights of an agent that observes as it does.

    Args:
        model: which has learned nothing.
        agent: name of one that ships, or its folder.
        task: of the model.

    Raises:
        ValueError: the agent observes or acts otherwise.
        OSError: its files cannot be read.
    """
    folder = find_agent(agent, task)
    config = read_config(folder)
    environment = unwrapped(statistics_of(model)).env
    layout = layout_of(environment.episodes)
    if config.layout != layout or config.normalise.get("observations"):
        raise ValueError(
            f"start_from is {agent!r}, which observes {config.layout}: it should be an agent that"
            f" observes {layout}, not normalised, as this training does"
        )
    arrays = read_weights(folder / WEIGHTS)
    tensors = {name: torch.tensor(values) for name, values in arrays.items()}
    for network in (model.policy, acting_network(model)):
        needed = acting_arrays(network.state_dict())
        if _shapes(needed) != _shapes(arrays):
            raise ValueError(
                f"start_from is {agent!r}, whose weights are of another network:"
                f" {_shapes(arrays)}, not {_shapes(needed)}"
            )
        network.load_state_dict(tensors, strict=False)


def _shapes(arrays: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    """Shapes of arrays by their names."""
    return {name: values.shape for name, values in arrays.items()}


def _gather_settings(kind: Any, arguments: dict[str, Any]) -> None:
    """Puts the settings among the arguments of one of the package's own algorithms into one."""
    settings_class = getattr(kind, "settings_class", None)
    if settings_class is None:
        return
    settings = {}
    for field in dataclasses.fields(settings_class):
        if field.name in arguments:
            settings[field.name] = arguments.pop(field.name)
    arguments["settings"] = settings_class(**settings)


def load_model(training: Training, checkpoint: Path) -> BaseAlgorithm:
    """Agent of a checkpoint, with all that it needs to learn on.

    Loading runs what is in its files. Raises ValueError, OSError.
    """
    midst = pickle.loads((checkpoint / ENVIRONMENT).read_bytes())
    file = str(checkpoint / PICKLED)
    statistics = VecNormalize.load(file, midst["env"])
    rate = learning_rate(training)
    kind = training_class(training.algorithm)
    model: BaseAlgorithm = kind.load(
        checkpoint / MODEL,
        env=statistics,
        device="cpu",
        custom_objects={"learning_rate": rate, "lr_schedule": rate},
    )
    buffer = checkpoint / BUFFER
    # arms go on in the midst of their episodes, which are not cut off in the buffer then
    if isinstance(model, OffPolicyAlgorithm):
        model.load_replay_buffer(buffer, truncate_last_traj=False)
    elif hasattr(model, "load_replay_buffer"):
        model.load_replay_buffer(buffer)
    restore(model, midst)
    return model


def learning_rate(training: Training) -> float | Callable[[float], float]:
    """Learning rate: a number, or a function of the part of the training that remains."""
    if isinstance(training.learning_rate, float):
        return training.learning_rate
    first, last, *kind = training.learning_rate

    def geometric(remains: float) -> float:
        return last * (first / last) ** remains

    def straight(remains: float) -> float:
        return last + (first - last) * remains

    if kind:
        return geometric
    return straight
