"""`soft-tendon sweep`: trainings with several seeds, and their learning curves put together."""

import signal
import sys
from pathlib import Path

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.learning import sweep
from soft_tendon_env.tools.parallel import run_all


def run(settings: sweep.Sweep) -> None:
    """Train, print and draw. Exit status 1 where a run failed."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # `kill` stops the runs too
    with mistakes():
        extras = ["agents", "pictures"]
        if settings.cluster:
            extras.append("rllib")
        require(*extras)
        jobs = [] if settings.only_plot else settings.jobs()
        writable_folder(Path(settings.out))
        from soft_tendon_env.learning.curves import show_curves

        errors = []
        if jobs:  # without any, no cluster is needed
            errors = run_all(
                sweep.run_job, jobs, settings.workers, "sweep", cluster=settings.cluster
            )
        is_shown = show_curves(settings.folders)
    has_failed = False
    for job, error in zip(jobs, errors, strict=True):
        if error is not None:
            has_failed = True
            print(f"\nfailed: {job.folder}\n{error}", file=sys.stderr)
    if has_failed or not is_shown:
        sys.exit(1)
