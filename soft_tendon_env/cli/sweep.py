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
        require("agents", "pictures", *(["rllib"] if settings.cluster else []))
        jobs = [] if settings.only_plot else settings.jobs()
        writable_folder(Path(settings.out))
        from soft_tendon_env.learning.curves import show_curves

        errors = (
            run_all(sweep.run_job, jobs, settings.workers, "sweep", cluster=settings.cluster)
            if jobs
            else []
        )
        is_shown = show_curves(settings.folders)
    failed = [
        (job.folder, error) for job, error in zip(jobs, errors, strict=True) if error is not None
    ]
    for folder, text in failed:
        print(f"\nfailed: {folder}\n{text}", file=sys.stderr)
    if failed or not is_shown:
        sys.exit(1)
