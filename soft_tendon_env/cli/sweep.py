"""`soft-tendon sweep`: trainings with several seeds, and their learning curves put together."""

import signal
import sys
from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.learning.sweep import Sweep, train_all


class SweepCommand(Sweep):
    """Train every configuration with several seeds (runs that are done are not repeated), and draw and print their learning curves."""

    write_docs: str | None = Field(default=None, description="file in which tables go between <!-- sweep TASK --> and <!-- /sweep TASK -->")
    out: str = Field(default="out/runs", description="folder of the runs, OUT/CONFIG/seed_N; OUT/CONFIG is a policy for compare")


def run(settings: SweepCommand) -> None:
    """Train, print and draw. Exit status 1 where a run failed."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # `kill` stops the runs too
    out = Path(settings.out)
    with mistakes():
        require("agents", "pictures", *(["rllib"] if settings.cluster else []))
        jobs = [] if settings.only_plot else settings.jobs(out)
        markers = [f"sweep {task}" for task in dict.fromkeys(job.training.task for job in jobs)]
        page = Page(settings.write_docs, markers)
        writable_folder(out)
        from soft_tendon_env.learning.curves import show_curves

        failed = train_all(jobs, settings.workers, settings.cluster) if jobs else {}
        tables = show_curves(out, settings.names, None if settings.only_plot else settings.all_seeds)
        for task, table in tables.items():
            page.write(f"sweep {task}", table)
    for folder, text in failed.items():
        print(f"\nfailed: {folder}\n{text}", file=sys.stderr)
    if failed or not tables:
        sys.exit(1)
