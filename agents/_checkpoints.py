"""What a training leaves in its folder. A checkpoint replaces the one before only when it is complete, so that a killed training can go on.

A checkpoint is a folder with the agent (`model.zip`), the statistics by which it sees observations (`vecnormalize.pkl`), what it was
trained with (`config.json`, with the digests of the other files) and, to go on from it, the transitions that it learns from
(`replay_buffer.pkl`, SAC and TQC).
"""

import csv
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from _agents import STATISTICS, AgentConfig, layout_of
from _command import Mishap
from _files import check_digests, digests, first_line, read_json, read_numbers
from _records import origin, write_json
from _training import Training
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

CONFIG, BUFFER = "config.json", "replay_buffer.pkl"
COLUMNS = ("steps", "seconds", "return", "diverged")
"""Of every learning curve, before the task's own."""


def config_record(training: Training, episodes: Any) -> dict[str, Any]:
    """The configuration as resolved, what its observations are made of, and where it comes from."""
    return {**training.model_dump(mode="json"), "layout": layout_of(episodes), "record": origin()}


def save(folder: Path, model: BaseAlgorithm, config: Mapping[str, Any], buffer: bool) -> None:
    """Replace a checkpoint. buffer: with the transitions that the agent learns from, if it keeps any. Raises Mishap."""
    new, old = folder.with_name(f"{folder.name}.new"), folder.with_name(f"{folder.name}.old")
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    try:
        new.mkdir(parents=True)
        model.save(new / "model.zip")
        statistics_of(model).save(str(new / STATISTICS))
        if buffer and hasattr(model, "save_replay_buffer"):
            model.save_replay_buffer(new / BUFFER)
        write_json(new / CONFIG, {**config, "files": digests(new)}, say=False)
    except (OSError, RuntimeError) as error:  # PyTorch's own, where a disk is full
        shutil.rmtree(new, ignore_errors=True)
        raise Mishap(f"{folder} cannot be written: {first_line(error)}. What stood there before, if anything, is as it was") from error
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def saved(folder: Path) -> Path | None:
    """Where the newest complete checkpoint of that name is; None without any."""
    new, old = (folder.with_name(f"{folder.name}.{kind}") for kind in ("new", "old"))
    if folder.exists():
        return folder
    return new if old.exists() else None  # killed between the two renamings, when the new one was complete


def read_checkpoint(checkpoint: Path) -> dict[str, Any]:
    """The config.json of a checkpoint whose files are as they were written. Raises ValueError, OSError with the remedy."""
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


def statistics_of(model: BaseAlgorithm) -> VecNormalize:
    statistics = model.get_vec_normalize_env()
    assert statistics is not None, "every training has one"
    return statistics


class Evaluations:
    """The learning curve, a row per evaluation, as CSV."""

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
