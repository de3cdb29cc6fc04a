"""Train an agent of Stable-Baselines3 as a file in configs/ says.

    python agents/train.py configs/ppo_tip_pose.toml [--seed 0] [--set options.fidelity=fast steps=500000 ...] [--out runs/NAME] [--resume]

Leaves in its folder: `config.json` (the configuration as resolved, versions, commit), `evaluations.csv` (the learning curve, on the fixed
evaluation targets), `best/` and `last/` (checkpoints: agent, its statistics of observations, its configuration) and `tensorboard/`.
Killed at any time, it goes on from the last checkpoint with --resume. Both `model.zip` are policies for evaluate.py and compare.py.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from _agents import STATISTICS, algorithm_class, read_model
from _checkpoints import BUFFER, CONFIG, Evaluations, read_checkpoint, saved
from _command import MISTAKES, command, said, writable_folder
from _files import first_line, read_json, read_pickle
from _hyperparameters import buffer_bytes, memory
from _learning import Learning, shown
from _records import machine
from _training import Training, read_training
from _training_env import check_stages, make_training_env
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.envs import Options
from soft_tendon_env.policies.controller_policy import observation_options


@command("stopped: the same command with --resume goes on from the last checkpoint, if there is one")
def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        training = with_controllers_options(read_training(arguments.config, arguments.set, **given(arguments)))
        folder = arguments.out or Path("runs") / arguments.config.stem / f"seed_{training.seed}"
        checkpoint = prepared(folder, training, arguments.resume)
        check_stages(training)
        model = model_of(training, checkpoint)
        learning = learning_of(training, writable_folder(folder), checkpoint)
    except MISTAKES as error:
        parser.error(said(error))
    print(f"{training.algorithm} on {training.task}, {training.steps} steps, seed {training.seed}, into {folder}; {machine()}")
    if arguments.resume and checkpoint is None:
        print(f"nothing to resume: {folder} has no checkpoint, the training begins at step 0")
    learn(model, learning)


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("config", type=Path, help="a TOML file, see configs/")
    parser.add_argument("--seed", type=int, help="(default: the file's)")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="goes before the file; dotted keys, values as in TOML")
    parser.add_argument("--out", type=Path, help="folder of the run (default: runs/CONFIG/seed_SEED)")
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint in the folder, if there is one")
    return parser


def given(arguments: argparse.Namespace) -> dict[str, Any]:
    return {} if arguments.seed is None else {"seed": arguments.seed}


def with_controllers_options(training: Training) -> Training:
    """With what the controller needs to observe, where the agent adds to one. Raises ValueError."""
    if training.residual is None:
        return training
    period = Options.parse(training.options, "options").control_period
    needed = observation_options(training.residual.controller, training.task, period)
    return Training(**{**dict(training), "options": {**needed, **training.options}})


def prepared(folder: Path, training: Training, resume: bool) -> Path | None:
    """The checkpoint to go on from, if any. Raises FileExistsError, ValueError where the folder has another training, or a damaged one."""
    checkpoint, begun = saved(folder / "last"), folder / CONFIG
    if not resume and (begun.exists() or checkpoint is not None):
        raise FileExistsError(f"{folder} has a training already: give --resume to go on with it, or another folder with --out")
    if checkpoint is None and not begun.exists():
        return None
    before = read_json(begun) if checkpoint is None else read_checkpoint(checkpoint)
    now = training.model_dump(mode="json")
    changed = [key for key in now if key != "steps" and now[key] != before.get(key)]
    if changed:
        differences = "; ".join(f"{key} was {before.get(key)!r} and is {now[key]!r}" for key in changed)
        raise ValueError(f"{folder} has another training, {differences}: only `steps` may change")
    return checkpoint


def train(training: Training, folder: Path, checkpoint: Path | None = None) -> BaseAlgorithm:
    """Learn all that is left to learn. Raises ValueError, OSError before it begins, and Mishap."""
    model = model_of(training, checkpoint)
    learn(model, learning_of(training, folder, checkpoint))
    return model


def model_of(training: Training, checkpoint: Path | None) -> BaseAlgorithm:
    """An agent as it is at the beginning, or as a checkpoint has it. Raises ValueError, OSError."""
    torch.set_num_threads(training.threads)
    return make_model(training) if checkpoint is None else load_model(training, checkpoint)


def learning_of(training: Training, folder: Path, checkpoint: Path | None) -> Learning:
    """What happens beside learning from there on. Raises ValueError, OSError."""
    before = {"steps_done": 0, "seconds_learned": 0.0} if checkpoint is None else read_checkpoint(checkpoint)
    return Learning(training, folder, Evaluations(folder / "evaluations.csv", before["steps_done"]), before["seconds_learned"])


def learn(model: BaseAlgorithm, learning: Learning) -> None:
    """Raises Mishap where an agent's numbers become infinite or undefined."""
    training, done = learning.training, model.num_timesteps
    if done >= training.steps:
        print(f"done before: {done} steps")
        return
    model.set_logger(configure(str(learning.folder / "tensorboard"), ["tensorboard"]))
    try:
        model.learn(training.steps - done, callback=learning, reset_num_timesteps=False)
    except ValueError:
        learning.check()  # what is not finite ends in errors of PyTorch
        raise
    report(learning, model.num_timesteps - done)


def make_model(training: Training) -> BaseAlgorithm:
    """An agent that has learned nothing yet. Raises ValueError."""
    env, settings = make_training_env(training), training.normalise
    check_memory(training, env)
    gamma = training.hyperparameters.get("gamma", 0.99)
    normalised = VecNormalize(
        env, norm_obs=settings.observations, norm_reward=settings.rewards, clip_obs=settings.clip, clip_reward=settings.clip, gamma=gamma
    )
    policy = "MultiInputPolicy" if training.task == "Reach" else "MlpPolicy"
    arguments = {**training.hyperparameters, "learning_rate": learning_rate(training), **network(training), **replay(training)}
    try:
        return algorithm_class(training.algorithm)(policy, normalised, seed=training.seed, device="cpu", **arguments)
    except (AssertionError, RuntimeError, TypeError, ValueError) as error:  # what Stable-Baselines3 and PyTorch refuse
        raise ValueError(f"{training.algorithm} cannot be made of these hyperparameters: {first_line(error)}") from error


def check_memory(training: Training, env: Any) -> None:
    """Raises ValueError where what the algorithm learns from does not fit into the machine."""
    sizes = (gym.spaces.flatdim(space) for space in (env.observation_space, env.action_space))
    needed, there = buffer_bytes(training.algorithm, training.hyperparameters, training.arms, *sizes), memory()
    if needed > there:
        key = "n_steps" if training.algorithm == "PPO" else "buffer_size"
        given = f"hyperparameters.{key} is {training.hyperparameters.get(key, 'left out')}, with {training.arms} arms"
        raise ValueError(f"{given}: that needs {needed / 2**30:.0f} GiB of memory, the machine has {there / 2**30:.0f}")


def load_model(training: Training, checkpoint: Path) -> BaseAlgorithm:
    """The agent of a checkpoint, with all that it needs to learn on. Raises ValueError, OSError."""
    done = read_checkpoint(checkpoint)["steps_done"]
    env = make_training_env(training, done)
    env.seed(training.seed + done)
    statistics = read_pickle(checkpoint / STATISTICS, VecNormalize)
    if statistics.observation_space != env.observation_space:
        raise ValueError(f"{checkpoint / STATISTICS} is of other observations than the training has")
    statistics.set_venv(env)
    rate = learning_rate(training)
    kept = {"learning_rate": rate, "lr_schedule": rate}
    model = read_model(algorithm_class(training.algorithm), checkpoint / "model.zip", env=statistics, custom_objects=kept)
    if model.num_timesteps != done:
        raise ValueError(f"{checkpoint} is of two trainings: its model.zip has learned {model.num_timesteps} steps, {CONFIG} says {done}")
    buffer = checkpoint / BUFFER
    if hasattr(model, "load_replay_buffer"):
        try:
            model.load_replay_buffer(buffer)
        except Exception as error:  # unpickling raises whatever it meets
            raise ValueError(f"{buffer} cannot be loaded, it may be cut or damaged: {first_line(error)}") from error
    return model


def network(training: Training) -> dict[str, Any]:
    """The policy's arguments, its activation function by its name in torch.nn."""
    arguments = dict(training.hyperparameters.get("policy_kwargs", {}))
    if "activation_fn" in arguments:
        arguments["activation_fn"] = getattr(torch.nn, arguments["activation_fn"])
    return {"policy_kwargs": arguments}


def learning_rate(training: Training) -> float | Callable[[float], float]:
    """A number, or a function of the part of the training that remains."""
    if isinstance(training.learning_rate, float):
        return training.learning_rate
    first, last = training.learning_rate
    return lambda remains: last + (first - last) * remains


def replay(training: Training) -> dict[str, Any]:
    if training.hindsight is None:
        return {}
    from stable_baselines3 import HerReplayBuffer

    settings = {"n_sampled_goal": training.hindsight.goals, "goal_selection_strategy": training.hindsight.strategy}
    return {"replay_buffer_class": HerReplayBuffer, "replay_buffer_kwargs": settings}


def report(learning: Learning, steps: int) -> None:
    times = learning.times()
    learned = times.all - times.beside
    share = 100.0 * times.environment / learned
    print(f"{steps} steps in {learned:.0f} s: {steps / learned:.0f} steps/s, {share:.0f} % of the time in the environment;", end=" ")
    print(f"{times.beside:.0f} s of evaluations and checkpoints beside. At the end: {shown(learning.curve.rows[-1])}")


if __name__ == "__main__":
    main()
