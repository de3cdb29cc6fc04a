"""What a training leaves in its folder. A checkpoint replaces the one before only when it is complete, so that a killed training can go on.

A checkpoint is a folder with the agent (`model.zip`), the statistics by which it sees observations (`vecnormalize.pkl`), what it was
trained with (`config.json`) and, to go on from it, the transitions that it learns from (`replay_buffer.pkl`, SAC and TQC).
"""

import csv
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from _agents import layout_of
from _records import origin, write_json
from _training import Training
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize


def config_record(training: Training, episodes: Any) -> dict[str, Any]:
    """The configuration as resolved, what its observations are made of, and where it comes from."""
    return {**training.model_dump(mode="json"), "layout": layout_of(episodes), "record": origin()}


def save(folder: Path, model: BaseAlgorithm, config: Mapping[str, Any], buffer: bool) -> None:
    """Replace a checkpoint. buffer: with the transitions that the agent learns from, if it keeps any."""
    new, old = folder.with_name(f"{folder.name}.new"), folder.with_name(f"{folder.name}.old")
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    new.mkdir(parents=True)
    model.save(new / "model.zip")
    statistics_of(model).save(str(new / "vecnormalize.pkl"))
    if buffer and hasattr(model, "save_replay_buffer"):
        model.save_replay_buffer(new / "replay_buffer.pkl")
    write_json(new / "config.json", config, say=False)
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


def steps_done(checkpoint: Path) -> int:
    return int(json.loads((checkpoint / "config.json").read_text())["steps_done"])


def statistics_of(model: BaseAlgorithm) -> VecNormalize:
    statistics = model.get_vec_normalize_env()
    assert statistics is not None, "every training has one"
    return statistics


class Evaluations:
    """The learning curve, a row per evaluation, as CSV."""

    def __init__(self, path: Path, upto: int = 0) -> None:
        """Go on after the row of step `upto`, if the file is there: what follows was learned by an agent that is lost."""
        self._path = path
        self.rows: list[dict[str, float]] = []
        if path.exists():
            with open(path, newline="") as file:
                rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
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
