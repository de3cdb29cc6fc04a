"""Sweeps as trials of Ray Tune: every run of a sweep is a trial, on this machine or wherever a cluster has room.

A trial is the same process of `soft-tendon train` that a sweep without Ray starts, and leaves the same folder, which all machines of a
cluster have to see. Tune is told every evaluation, so that its own tools show learning curves.
"""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ray import tune
from tqdm import tqdm

from soft_tendon_env.learning.ray_cluster import cluster
from soft_tendon_env.learning.sweep import POLL, Job, start, stop
from soft_tendon_env.tools.files import read_numbers

FOLDER = "ray_tune"
"""Of Tune's own files, in the folder of a sweep."""


class Bar(tune.Callback):
    """One line about all trials."""

    def __init__(self, runs: int) -> None:
        self._runs = runs

    def setup(self, **info: Any) -> None:
        """At the start, not before: Tune pickles what it is given."""
        self._bar = tqdm(total=self._runs, desc="sweep with Ray Tune", unit="run")

    def on_trial_complete(self, iteration: int, trials: list[Any], trial: Any, **info: Any) -> None:
        """A run has ended well."""
        self._bar.update()

    def on_trial_error(self, iteration: int, trials: list[Any], trial: Any, **info: Any) -> None:
        """A run has failed."""
        self._bar.write(f"failed: {trial.config['run']['folder']}, see train.log there")
        self._bar.update()

    def on_experiment_end(self, trials: list[Any], **info: Any) -> None:
        """Of all."""
        self._bar.close()


def tune_all(jobs: Sequence[Job], workers: int, out: Path, address: str | None) -> list[Job]:
    """Run all, at most so many at once; those that failed. Raises ValueError where there is no Ray, or too little room for a run."""
    each = max(job.processors for job in jobs)
    with cluster(address, each if address else each * workers, "runs"):
        space = [{"index": index, "folder": str(job.folder)} for index, job in enumerate(jobs)]
        trials = tune.with_parameters(run_trial, jobs=[job.absolute() for job in jobs], working_directory=os.getcwd())
        tuner = tune.Tuner(
            tune.with_resources(trials, {"CPU": each}),
            param_space={"run": tune.grid_search(space)},
            tune_config=tune.TuneConfig(max_concurrent_trials=workers),
            run_config=tune.RunConfig(storage_path=str((out / FOLDER).absolute()), callbacks=[Bar(len(jobs))], verbose=0),
        )
        results = tuner.fit()
    return [job for job, result in zip(jobs, results, strict=True) if result.error is not None]


def run_trial(config: dict[str, Any], jobs: Sequence[Job], working_directory: str) -> None:
    """One run, in a process of its own. Raises RuntimeError where it fails."""
    job = jobs[config["run"]["index"]]
    child = start(job, working_directory)
    try:
        told = 0
        while child.poll() is None:
            time.sleep(POLL)
            told = tell(job.folder / "evaluations.csv", told)
    finally:
        stop([child])
    tell(job.folder / "evaluations.csv", told)
    if child.returncode:
        raise RuntimeError(f"{job.folder} failed, see {job.log}")


def tell(path: Path, told: int) -> int:
    """Report the evaluations after the first `told` to Tune; how many there are now."""
    try:
        rows = read_numbers(path)
    except (ValueError, OSError):  # none yet
        return told
    for row in rows[told:]:
        tune.report(row)
    return max(told, len(rows))
