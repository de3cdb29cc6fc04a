"""`soft-tendon tune`: hyperparameter optimisation of a training or a controller with Optuna."""

from pathlib import Path

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.learning.config import config_names, find_config
from soft_tendon_env.tools.configuration import Configuration

SEARCH = "tune_"
"""Beginning of the names of searches in configs/."""


class Tune(Configuration):
    """Search for the best parameters of a training or a controller."""

    config: Positional[str] = Field(
        description=(
            f"a search that ships ({', '.join(config_names(SEARCH))}), or the path of a TOML file"
        )
    )
    trials: int | None = Field(
        default=None, ge=1, description="number of trials of the study, overrides the file"
    )
    set: tuple[str, ...] = Field(
        default=(), description="overrides of the file, such as seconds=2.0"
    )
    workers: int = Field(default=1, ge=1, description="trials side by side")
    cluster: str | None = Field(
        default=None,
        description=(
            'address of a Ray cluster that runs them, or "auto"; its machines see the folder'
        ),
    )
    out: str | None = Field(
        default=None,
        description="folder for results, which machines may share (default: out/tune/CONFIG)",
    )


def run(settings: Tune) -> None:
    """Search, print and write."""
    with mistakes():
        extras = ["tuning"]
        if settings.cluster:
            extras.append("rllib")
        require(*extras)
        from soft_tendon_env.tuning import study
        from soft_tendon_env.tuning.search import TrainingSearch, read_search

        path = find_config(settings.config, SEARCH)
        changes = {}
        if settings.trials is not None:
            changes["trials"] = settings.trials
        search = read_search(path, settings.set, **changes)
        if isinstance(search, TrainingSearch):
            require("agents")
        folder = Path("out", "tune", path.stem)
        if settings.out is not None:
            folder = Path(settings.out)
        folder = writable_folder(folder)
        study.open_study(search, folder)
    print(f"{search.trials} trials of {path.stem} into {folder}; {machine()}")
    with mistakes():
        study.tune(search, folder, settings.workers, settings.cluster)
