"""Checkpoints of a training, atomic, so that a killed training can go on.

One replaces the one before only when it is complete.

A checkpoint is a folder with the agent, as `load_policy` takes it without unpickling:
`weights.npz`, `statistics.npz` and `config.json`, which has the digests of the other files. What a
training goes on from has the other files too, which are unpickled then, and only then.
"""

import pickle
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.evaluation.provenance import origin, write_json
from soft_tendon_env.learning.algorithm import ActorAlgorithm
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.agent import CONFIG, layout_of, save_agent, strain_of
from soft_tendon_env.policies.normalization import normalization_of
from soft_tendon_env.tools.files import check_digests, digests, read_json
from soft_tendon_env.tools.messages import UserError, first_line

# files of a checkpoint
BUFFER = "replay_buffer.pkl"
MODEL = "model.zip"
PICKLED = "vecnormalize.pkl"
ENVIRONMENT = "environment.pkl"
LAST = (
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
    "_last_lstm_states",
    "action_space",
)
"""Attributes of a model that belong to its environment, as far as it has them."""


def midst_of(model: BaseAlgorithm) -> dict[str, Any]:
    """Environment of a model in the midst of its episodes.

    All else is with it that the next step of its training depends on.
    """
    statistics = statistics_of(model)
    return {
        "env": unwrapped(statistics),
        "returns": statistics.returns,
        "last": {name: getattr(model, name) for name in LAST if hasattr(model, name)},
        "generators": (torch.get_rng_state(), np.random.get_state()),
    }


def restore(model: BaseAlgorithm, midst: dict[str, Any]) -> None:
    """Let a model on the environment of `midst_of` go on from there."""
    statistics_of(model).returns = midst["returns"]
    vars(model).update(midst["last"])
    of_torch, of_numpy = midst["generators"]
    torch.set_rng_state(of_torch)
    np.random.set_state(of_numpy)


def write_model(folder: Path, model: BaseAlgorithm, resumable: bool) -> None:
    """Write an agent of Stable-Baselines3 into a folder.

    resumable: with what a training needs to go on from it.
    """
    statistics = statistics_of(model)
    save_agent(folder, acting_network(model), normalization_of(statistics))
    if resumable:
        model.save(folder / MODEL)
        statistics.save(str(folder / PICKLED))
        pickled = pickle.dumps(midst_of(model))
        (folder / ENVIRONMENT).write_bytes(pickled)
        if hasattr(model, "save_replay_buffer"):
            model.save_replay_buffer(folder / BUFFER)


def config_record(training: Training, episodes: Any) -> dict[str, Any]:
    """Content of config.json: the configuration as resolved, and where it comes from.

    It has the layout of observations and the strain parametrisation too.
    """
    return {
        **training.model_dump(mode="json"),
        "layout": layout_of(episodes),
        "strain": strain_of(episodes.model.scene),
        "record": origin(),
    }


def replace_checkpoint(
    folder: Path, config: Mapping[str, Any], write: Callable[[Path], None]
) -> None:
    """Replace a checkpoint by what `write` puts into a folder, and its config.json.

    Raises:
        UserError: the folder cannot be written.
    """
    new = folder.with_name(f"{folder.name}.new")
    old = folder.with_name(f"{folder.name}.old")
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    try:
        new.mkdir(parents=True)
        write(new)
        complete = {**config, "files": digests(new)}
        write_json(new / CONFIG, complete, say=False)
    except (OSError, RuntimeError) as error:  # PyTorch's own, where a disk is full
        shutil.rmtree(new, ignore_errors=True)
        raise UserError(
            f"{folder} cannot be written: {first_line(error)}. What stood there before, if"
            " anything, is as it was"
        ) from error
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def find_checkpoint(folder: Path) -> Path | None:
    """Path of the newest complete checkpoint of that name; None without any."""
    if folder.exists():
        return folder
    new = folder.with_name(f"{folder.name}.new")
    old = folder.with_name(f"{folder.name}.old")
    # killed between the two renamings, when the new one was complete
    if not old.exists():
        return None
    return new


def read_checkpoint(checkpoint: Path) -> dict[str, Any]:
    """Content of config.json of a checkpoint whose files are as they were written.

    Raises ValueError, FileNotFoundError.
    """
    config = read_json(checkpoint / CONFIG)
    known_digests = config.get("files", {})
    check_digests(checkpoint, known_digests, checkpoint / CONFIG)
    return config


def acting_network(model: BaseAlgorithm) -> Any:
    """Network of a model that acts and is saved, which need not be the one that learns."""
    if isinstance(model, ActorAlgorithm):
        return model.acting_policy
    return model.policy


def statistics_of(model: BaseAlgorithm) -> VecNormalize:
    """Normalisation of observations and rewards of a model that trains."""
    statistics = model.get_vec_normalize_env()
    assert statistics is not None, "every training has one"
    return statistics
