"""`soft-tendon tune`: hyperparameter optimisation of a training or a controller with Optuna."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.provenance import machine
from soft_tendon_env.learning.config import config_names, find_config
from soft_tendon_env.tools.configuration import Configuration

PREFIX = "tune_"
"""Prefix of the files of searches in configs/."""
STOPPED = "stopped: the same command goes on with the trials that are missing"


class Tune(Configuration):
    """Search for the best parameters of a training or a controller.

    Attributes:
        config: name of a search that ships (listed below), or path of a TOML file.
        trials: number of trials of the study, overrides the file.
        set: overrides the file, dotted keys with values as in TOML, such as seconds=2.0.
        workers: trials side by side.
        cluster: address of a Ray cluster that runs them, or "auto" for the one of this machine, whose machines all see the folder.
        storage: journal file or database URL (sqlite:///..., mysql://..., postgresql://...) of the study, which machines that run the same
            command share (default: OUT/study.log).
        out: folder for results (default: out/tune/CONFIG).
    """

    config: str
    trials: int | None = Field(default=None, ge=1)
    set: tuple[str, ...] = ()
    workers: int = Field(default=1, ge=1)
    cluster: str | None = None
    storage: str | None = None
    out: str | None = None


def run(arguments: Sequence[str]) -> None:
    """Search, print and write."""
    parser = Parser("tune", Tune)
    parser.epilog = f"Searches that ship: {', '.join(config_names(PREFIX))}."
    settings = parser.read(arguments)
    with parser.mistakes():
        require("tuning", *(["rllib"] if settings.cluster else []))
        from soft_tendon_env.tuning.search import read_search
        from soft_tendon_env.tuning.study import Work, open_study, tune

        path = find_config(settings.config, PREFIX)
        search = read_search(path, settings.set, **({} if settings.trials is None else {"trials": settings.trials}))
        folder = writable_folder(Path("out", "tune", path.stem) if settings.out is None else Path(settings.out))
        work = Work(search, settings.storage or str(folder / "study.log"), path.stem, folder)
        open_study(work)
    print(f"{search.trials} trials of {path.stem} into {folder}; {machine()}")
    with parser.mistakes():
        tune(work, settings.workers, settings.cluster)
