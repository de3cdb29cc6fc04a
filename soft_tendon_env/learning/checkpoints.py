"""Checkpoints of a training, atomic: one replaces the one before only when it is complete, so that a killed training can go on.

A checkpoint is a folder with the agent, as `load_policy` takes it without unpickling: `weights.pt`, `statistics.npz` (running mean and
variance of observations) and `config.json` (what it was trained with, and the digests of the other files). What a training goes on from
has the model with its optimiser (`model.zip`), `vecnormalize.pkl`, the environment in the midst of its episodes with the generators
(`environment.pkl`) and, for off-policy algorithms, the transitions (`replay_buffer.pkl`) as well; these are unpickled when it goes on, and
only then.
"""

import csv
import pickle
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.vec_env import StableBaselinesVecEnv, unwrapped
from soft_tendon_env.policies.agent import save_agent
from soft_tendon_env.policies.agent_checks import layout_of, strain_of
from soft_tendon_env.policies.agent_files import CONFIG, AgentConfig
from soft_tendon_env.policies.normalization import normalization_of
from soft_tendon_env.tools.files import check_digests, digests, open_file, read_json, read_numbers
from soft_tendon_env.tools.messages import UserError, first_line

BUFFER, MODEL, PICKLED, ENVIRONMENT = "replay_buffer.pkl", "model.zip", "vecnormalize.pkl", "environment.pkl"
LAST = ("_last_obs", "_last_original_obs", "_last_episode_starts", "action_space")
"""Attributes of a model that belong to the environment as it is."""
Kind = TypeVar("Kind")
COLUMNS = ("steps", "seconds", "return", "diverged")
"""First columns of every learning curve, before the task's own."""


class Midst(NamedTuple):
    """An environment in the midst of its episodes, with all else that the next step of a training depends on."""

    env: StableBaselinesVecEnv
    returns: Any  # (rows,) discounted, as VecNormalize has them
    last: dict[str, Any]  # see LAST
    torch_state: Any  # of the generators of PyTorch and NumPy
    numpy_state: Any

    @classmethod
    def of(cls, model: BaseAlgorithm) -> "Midst":
        """Environment of a model as it is now, with the generators."""
        statistics, last = statistics_of(model), {name: getattr(model, name) for name in LAST}
        return cls(unwrapped(statistics), statistics.returns, last, torch.get_rng_state(), np.random.get_state())

    def restore(self, model: BaseAlgorithm) -> None:
        """Let a model on this environment go on from there."""
        statistics_of(model).returns = self.returns
        for name, value in self.last.items():
            setattr(model, name, value)
        torch.set_rng_state(self.torch_state)
        np.random.set_state(self.numpy_state)


def config_record(training: Training, episodes: Any) -> dict[str, Any]:
    """Content of config.json: the configuration as resolved, layout of observations, strain parametrisation, and provenance."""
    known = {"layout": layout_of(episodes), "strain": strain_of(episodes.model.scene)}
    return {**training.model_dump(mode="json"), **known, "record": origin()}


def save_checkpoint(folder: Path, model: BaseAlgorithm, config: Mapping[str, Any], resumable: bool) -> None:
    """Replace a checkpoint. resumable: with what a training needs to go on from it. Raises UserError."""

    def write(new: Path) -> None:
        save_agent(new, model.policy, normalization_of(statistics_of(model)))
        if resumable:
            model.save(new / MODEL)
            statistics_of(model).save(str(new / PICKLED))
            (new / ENVIRONMENT).write_bytes(pickle.dumps(Midst.of(model)))
            if hasattr(model, "save_replay_buffer"):
                model.save_replay_buffer(new / BUFFER)

    replace_checkpoint(folder, config, write)


def replace_checkpoint(folder: Path, config: Mapping[str, Any], write: Callable[[Path], None]) -> None:
    """Replace a checkpoint by what `write` puts into a folder, and its config.json. Raises UserError."""
    new, old = folder.with_name(f"{folder.name}.new"), folder.with_name(f"{folder.name}.old")
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    try:
        new.mkdir(parents=True)
        write(new)
        write_json(new / CONFIG, {**config, "files": digests(new)}, say=False)
    except (OSError, RuntimeError) as error:  # PyTorch's own, where a disk is full
        shutil.rmtree(new, ignore_errors=True)
        raise UserError(f"{folder} cannot be written: {first_line(error)}. What stood there before, if anything, is as it was") from error
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def find_checkpoint(folder: Path) -> Path | None:
    """Path of the newest complete checkpoint of that name; None without any."""
    new, old = (folder.with_name(f"{folder.name}.{kind}") for kind in ("new", "old"))
    if folder.exists():
        return folder
    return new if old.exists() else None  # killed between the two renamings, when the new one was complete


def read_checkpoint(checkpoint: Path) -> dict[str, Any]:
    """Content of config.json of a checkpoint whose files are as they were written. Raises ValueError, OSError with the remedy."""
    path = checkpoint / CONFIG
    try:
        config = read_json(path)
        for key, least in (("steps_done", 0), ("seconds_learned", 0.0)):
            if not isinstance(config.get(key), type(least) | int) or not config[key] >= least:
                raise ValueError(f"{path}: {key} is {config.get(key)!r}: it should be a number of at least 0")
        check_digests(checkpoint, AgentConfig.parse(config, str(path)).files, path)
    except (ValueError, OSError) as error:
        raise ValueError(f"{error}. Nothing can go on from it: take {checkpoint} away to begin again") from error
    return config


def learned_before(checkpoint: Path) -> tuple[int, float]:
    """Steps of all arms, and seconds, that the agent of a checkpoint has learned. Raises ValueError, OSError."""
    config = read_checkpoint(checkpoint)
    return config["steps_done"], config["seconds_learned"]


@contextmanager
def unpickling(path: Path, cause: str = "it may be cut or damaged") -> Iterator[None]:
    """Errors of what unpickles a file, which raises whatever it meets, as a ValueError; FileNotFoundError where it is not there."""
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        yield
    except Exception as error:
        raise ValueError(f"{path} cannot be loaded, {cause}: {first_line(error)}") from error


def read_pickle(path: Path, kind: type[Kind]) -> Kind:
    """Unpickle an object of a class. Loading runs what is in the file. Raises ValueError, FileNotFoundError."""
    with unpickling(path), open_file(path) as file:
        value = pickle.load(file)
    if not isinstance(value, kind):
        raise ValueError(f"{path} should hold a {kind.__name__}, not {type(value).__name__}")
    return value


def statistics_of(model: BaseAlgorithm) -> VecNormalize:
    """Normalisation of observations and rewards of a model that trains."""
    statistics = model.get_vec_normalize_env()
    assert statistics is not None, "every training has one"
    return statistics


class Evaluations:
    """Learning curve in a CSV file, a row per evaluation."""

    def __init__(self, path: Path, upto: int = 0) -> None:
        """Go on after the row of step `upto`, if the file is there: what follows was learned by an agent that is lost.

        Raises ValueError where it is no learning curve.
        """
        self._path = path
        rows = read_numbers(path, COLUMNS) if path.exists() else []
        self.rows = [row for row in rows if row["steps"] <= upto]

    def append(self, row: Mapping[str, float]) -> None:
        """Add a row, and write them all."""
        self.rows.append(dict(row))
        new = self._path.with_suffix(".new")
        with open(new, "w", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            writer.writeheader()
            writer.writerows({name: f"{value:.9g}" for name, value in row.items()} for row in self.rows)
        new.replace(self._path)
