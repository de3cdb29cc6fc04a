"""`soft-tendon sweep`: trainings with several seeds, and their learning curves put together."""

import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from soft_tendon_env.cli.errors import require, writable_folder
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.evaluation.pages import Page
from soft_tendon_env.learning.sweep import Sweep, train_all
from soft_tendon_env.tools.messages import UserError, describe

STOPPED = "stopped: the same command goes on"


class SweepCommand(Sweep):
    """Train every configuration with several seeds (runs that are done are not repeated), and draw and print their learning curves.

    Attributes:
        write_docs: a file in which tables also go between <!-- sweep TASK --> and <!-- /sweep TASK -->.
        out: folder of the runs, OUT/CONFIG/seed_N; OUT/CONFIG is a policy for compare.
    """

    write_docs: str | None = None
    out: str = "out/runs"


def run(arguments: Sequence[str]) -> None:
    """Train, print and draw. Exit status 1 where a run failed."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # `kill` stops the runs too
    parser = Parser("sweep", SweepCommand)
    settings = parser.read(arguments)
    out = Path(settings.out)
    with parser.mistakes():
        require("agents", "pictures", *(["rllib"] if settings.cluster else []))
        jobs = [] if settings.only_plot else settings.jobs(out)
        markers = [f"sweep {task}" for task in dict.fromkeys(job.training.task for job in jobs)]
        page = Page(settings.write_docs, markers, "of each training", ["soft_tendon_env/learning"])
        writable_folder(out)
    from soft_tendon_env.learning.curves import show_curves

    with parser.mistakes():
        failed = train_all(jobs, settings.workers, settings.cluster) if jobs else {}
    tables = show_curves(out, settings.names, None if settings.only_plot else settings.all_seeds)
    for task, table in tables.items():
        try:
            page.write(f"sweep {task}", table)
        except ValueError as error:
            raise UserError(describe(error)) from error
    for folder, text in failed.items():
        print(f"\nfailed: {folder}\n{text}", file=sys.stderr)
    if failed or not tables:
        sys.exit(1)
