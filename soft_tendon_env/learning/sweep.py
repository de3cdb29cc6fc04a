"""Sweeps: trainings of every configuration with several seeds, side by side.

They are in processes, or on a Ray cluster.

Every run has its folder OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are
done are not repeated, and interrupted ones go on. A run that fails stops no other.
"""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from soft_tendon_env.learning.config import Training


class Job(NamedTuple):
    """One run: a training, and its folder."""

    training: Training
    folder: Path


@contextmanager
def into_log(path: Path) -> Iterator[None]:
    """Append what is printed meanwhile to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a") as log, redirect_stdout(log), redirect_stderr(log):
        yield


def run_job(job: Job) -> str | None:
    """Error of a run that has failed, once it has ended."""
    from soft_tendon_env.learning import train

    with into_log(job.folder / "train.log"):
        try:
            checkpoint = train.checkpoint_to_resume(job.folder, job.training, resume=True)
            train.train(job.training, job.folder, checkpoint)
        except Exception:
            return traceback.format_exc()
    return None
