"""Train an agent of Stable-Baselines3 as a file in configs/ says.

    python agents/train.py configs/ppo_tip_pose.toml [--seed 0] [--set options.fidelity=fast steps=500000 ...] [--out runs/NAME] [--resume]

Leaves in its folder: `config.json` (the configuration as resolved, versions, commit), `evaluations.csv` (the learning curve, on the fixed
evaluation targets), `best/` and `last/` (checkpoints: agent, its statistics of observations, its configuration) and `tensorboard/`.
Killed at any time, it goes on from the last checkpoint with --resume. Both `model.zip` are policies for evaluate.py and compare.py.
"""

import argparse
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from _agents import algorithm_class
from _checkpoints import Evaluations, saved, steps_done
from _learning import Learning, shown
from _records import machine
from _training import Training, read_training
from _training_env import make_training_env
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.policy import observation_options


def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        training = with_controllers_options(read_training(arguments.config, arguments.set, **given(arguments)))
        folder = arguments.out or Path("runs") / arguments.config.stem / f"seed_{training.seed}"
        checkpoint = prepared(folder, training, arguments.resume)
    except (ValueError, TypeError, OSError, ModuleNotFoundError) as error:
        parser.error(str(error))
    print(f"{training.algorithm} on {training.task}, {training.steps} steps, seed {training.seed}, into {folder}; {machine()}")
    train(training, folder, checkpoint)


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
    """The checkpoint to go on from, if any. Raises FileExistsError, ValueError where the folder has another training."""
    checkpoint = saved(folder / "last")
    if not resume and (folder / "config.json").exists():
        raise FileExistsError(f"{folder} has a training already: give --resume to go on with it, or another folder with --out")
    if checkpoint is None:
        return None
    before = json.loads((checkpoint / "config.json").read_text())
    now = training.model_dump(mode="json")
    changed = [key for key in now if key != "steps" and now[key] != before.get(key)]
    if changed:
        differences = "; ".join(f"{key} was {before.get(key)!r} and is {now[key]!r}" for key in changed)
        raise ValueError(f"{folder} has another training, {differences}: only `steps` may change")
    return checkpoint


def train(training: Training, folder: Path, checkpoint: Path | None = None) -> BaseAlgorithm:
    """Learn all that is left to learn."""
    torch.set_num_threads(training.threads)
    model = make_model(training) if checkpoint is None else load_model(training, checkpoint)
    done = model.num_timesteps
    if done >= training.steps:
        print(f"done before: {done} steps")
        return model
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    curve = Evaluations(folder / "evaluations.csv", done)
    before = 0.0 if checkpoint is None else json.loads((checkpoint / "config.json").read_text())["seconds_learned"]
    learning = Learning(training, folder, curve, before)
    model.learn(training.steps - done, callback=learning, reset_num_timesteps=False)
    report(learning, model.num_timesteps - done, curve)
    return model


def make_model(training: Training) -> BaseAlgorithm:
    """An agent that has learned nothing yet."""
    env, settings = make_training_env(training), training.normalise
    gamma = training.hyperparameters.get("gamma", 0.99)
    normalised = VecNormalize(
        env, norm_obs=settings.observations, norm_reward=settings.rewards, clip_obs=settings.clip, clip_reward=settings.clip, gamma=gamma
    )
    policy = "MultiInputPolicy" if training.task == "Reach" else "MlpPolicy"
    arguments = {**training.hyperparameters, "learning_rate": learning_rate(training), **network(training), **replay(training)}
    return algorithm_class(training.algorithm)(policy, normalised, seed=training.seed, device="cpu", **arguments)


def load_model(training: Training, checkpoint: Path) -> BaseAlgorithm:
    """The agent of a checkpoint, with all that it needs to learn on."""
    env = make_training_env(training, steps_done(checkpoint))
    env.seed(training.seed + steps_done(checkpoint))
    with open(checkpoint / "vecnormalize.pkl", "rb") as file:
        statistics = pickle.load(file)
    statistics.set_venv(env)
    rate = learning_rate(training)
    model = algorithm_class(training.algorithm).load(
        checkpoint / "model.zip", env=statistics, device="cpu", custom_objects={"learning_rate": rate, "lr_schedule": rate}
    )
    buffer = checkpoint / "replay_buffer.pkl"
    if buffer.exists():
        model.load_replay_buffer(buffer)
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


def report(learning: Learning, steps: int, curve: Evaluations) -> None:
    times = learning.times()
    learned = times.all - times.beside
    share = 100.0 * times.environment / learned
    print(f"{steps} steps in {learned:.0f} s: {steps / learned:.0f} steps/s, {share:.0f} % of the time in the environment;", end=" ")
    print(f"{times.beside:.0f} s of evaluations and checkpoints beside. At the end: {shown(curve.rows[-1])}")


if __name__ == "__main__":
    main()
