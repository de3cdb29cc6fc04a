"""Train every configuration with several seeds, and put their learning curves together.

    python agents/sweep.py configs/ppo_tip_pose.toml [CONFIG.toml ...] [--seeds 5] [--first-seed 0] [--workers 2]
                           [--set KEY=VALUE ...] [--out runs] [--only-plot] [--write-docs FILE]

Every run is a process of train.py in OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are done are not repeated, and
interrupted ones go on: give the same command again. A run that fails stops no other; its log is shown in the end.

Then, per configuration, OUT/CONFIG/learning_curve.csv and a row of a table; per task a picture, OUT/learning_curves.png (_TASK.png where
there are several tasks). Times per run are comparable only where as many ran side by side. OUT/CONFIG is a policy for compare.py.
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from _command import MISTAKES, Mishap, command, said, writable_folder
from _curves import Curves, curve_table, draw_curves, read_curves, write_curves
from _records import machine
from _tables import around_markers, write_between_markers
from _training import parsed_change, read_training
from tqdm import tqdm

TRAIN = Path(__file__).with_name("train.py")
POLL = 0.2  # [s] between looks at what has ended
TAIL = 15  # lines of a log
MOST_RUNS = 10_000


class Job(NamedTuple):
    """One run: a configuration with a seed, its folder, and what is changed of the configuration."""

    config: Path
    seed: int
    folder: Path
    changes: tuple[str, ...]

    @property
    def log(self) -> Path:
        return self.folder / "train.log"

    @property
    def command(self) -> list[str]:
        changes = ["--set", *self.changes] if self.changes else []
        return [sys.executable, str(TRAIN), str(self.config), "--seed", str(self.seed), "--out", str(self.folder), "--resume", *changes]


@command("stopped: the same command goes on")
def main() -> None:
    parser = make_parser()
    arguments = parser.parse_args()
    try:
        check(arguments)
        for task in () if arguments.only_plot else tasks_of(arguments):
            if arguments.write_docs:
                around_markers(arguments.write_docs, marker(task))
        writable_folder(arguments.out)
    except MISTAKES as error:
        parser.error(said(error))
    seeds = list(range(arguments.first_seed, arguments.first_seed + arguments.seeds))
    failed = [] if arguments.only_plot else train_all(jobs_of(arguments, seeds), arguments.workers)
    names = [config.stem for config in arguments.configs]
    tables = show(arguments.out, names, None if arguments.only_plot else seeds)
    if arguments.write_docs:
        for task, table in tables.items():
            text = f"Written by `python agents/sweep.py --write-docs`, on {machine()}.\n\n{table}"
            try:
                write_between_markers(arguments.write_docs, marker(task), text)
            except ValueError as error:
                raise Mishap(said(error)) from error
    for job in failed:
        print(f"\nfailed: {' '.join(job.command)}\n{tail(job.log)}", file=sys.stderr)
    if failed or not tables:
        sys.exit(1)


def marker(task: str) -> str:
    return f"sweep {task}"


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("configs", nargs="+", type=Path, metavar="CONFIG", help="TOML files, see configs/")
    parser.add_argument("--seeds", type=int, default=5, help="how many of each (default 5)")
    parser.add_argument("--first-seed", type=int, default=0, help="(default 0)")
    parser.add_argument("--workers", type=int, default=2, help="runs side by side (default 2)")
    parser.add_argument("--set", nargs="+", default=[], metavar="KEY=VALUE", help="as train.py takes it, for all runs")
    parser.add_argument("--out", type=Path, default=Path("runs"))
    parser.add_argument("--only-plot", action="store_true", help="train nothing, show all seeds that are there")
    text = "tables also go between its <!-- sweep TASK --> and <!-- /sweep TASK -->"
    parser.add_argument("--write-docs", type=Path, metavar="FILE", help=text)
    return parser


def check(arguments: argparse.Namespace) -> None:
    """Raises ValueError, FileNotFoundError."""
    for name, least in (("seeds", 1), ("first_seed", 0), ("workers", 1)):
        if getattr(arguments, name) < least:
            raise ValueError(f"--{name.replace('_', '-')} is {getattr(arguments, name)}: it should be at least {least}")
    if arguments.seeds * len(arguments.configs) > MOST_RUNS:
        raise ValueError(f"--seeds is {arguments.seeds}: that makes more than {MOST_RUNS} runs")
    stems = [config.stem for config in arguments.configs]
    for config in arguments.configs:
        if stems.count(config.stem) > 1:
            raise ValueError(f"{config}: another configuration is called {config.stem} too, and so would be its folder")
    if any(parsed_change(change)[0] == "seed" for change in arguments.set):
        raise ValueError("--set has seed: --seeds and --first-seed say which there are")


def tasks_of(arguments: argparse.Namespace) -> set[str]:
    """Of the configurations, with the first seed and the last. Raises ConfigurationError where they cannot be trained."""
    seeds = {arguments.first_seed, arguments.first_seed + arguments.seeds - 1}
    return {read_training(config, arguments.set, seed=seed).task for config in arguments.configs for seed in seeds}


def jobs_of(arguments: argparse.Namespace, seeds: Sequence[int]) -> list[Job]:
    """Seed by seed, so that mistakes of any configuration show early, and all have come equally far."""
    changes = tuple(arguments.set)
    return [Job(config, seed, arguments.out / config.stem / f"seed_{seed}", changes) for seed in seeds for config in arguments.configs]


def train_all(jobs: Sequence[Job], workers: int) -> list[Job]:
    """Run all, so many at once; those that failed. What still runs when this is left, by Ctrl-C too, is stopped."""
    waiting, running, failed = list(jobs), {}, []
    with tqdm(total=len(jobs), desc="sweep", unit="run") as bar:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    job = waiting.pop(0)
                    running[job] = start(job)
                time.sleep(POLL)
                for job in [job for job, child in running.items() if child.poll() is not None]:
                    if running.pop(job).returncode:
                        failed.append(job)
                        bar.write(f"failed: {job.folder}, see {job.log}")
                    bar.update()
        finally:
            stop(running.values())
    return failed


def start(job: Job) -> subprocess.Popen[bytes]:
    job.folder.mkdir(parents=True, exist_ok=True)
    with open(job.log, "ab") as log:
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(job.command, stdout=log, stderr=subprocess.STDOUT, env=environment)


def stop(children: Iterable[subprocess.Popen[bytes]]) -> None:
    """By SIGTERM: Ctrl-C is ignored by what is started in the background. What follows the last checkpoint is lost."""
    running = list(children)
    for child in running:
        child.terminate()
    for child in running:
        child.wait()


def tail(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").replace("\r", "\n").splitlines()[-TAIL:])


def show(out: Path, names: Sequence[str], seeds: list[int] | None) -> dict[str, str]:
    """Curves of every configuration, by task; their tables."""
    found: dict[str, list[Curves]] = {}
    for name in names:
        try:
            curves = read_curves(out / name, seeds)
        except (ValueError, OSError) as error:
            print(f"not shown: {error}")
            continue
        write_curves(out / name / "learning_curve.csv", curves)
        found.setdefault(curves.task, []).append(curves)
    for task, of_task in found.items():
        draw_curves(of_task, out / ("learning_curves.png" if len(found) == 1 else f"learning_curves_{task}.png"))
        print(f"\n## {task}\n\n{curve_table(of_task)}")
    return {task: curve_table(of_task) for task, of_task in found.items()}


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # `kill` stops the runs too
    main()
