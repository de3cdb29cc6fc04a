"""What a change of the code does to speed: another revision and this one measured in turns, in one
process each.

    python benchmarks/paired.py [HEAD | a revision | a folder with a checkout] [--scenes paper ...]
    [--turns 60] [--out out]

CPU time on one thread: of one evaluation of the equation of motion (a simulation over its
evaluations), of `Model.terms`, of a step of the environment alone and of the native vector
environment with 64 rows, by row (fidelity presets, and those of before, see
benchmarks/fidelity.py), of resets, also under loads and among drawn effects, and of new processes
when everything is compiled: until the package is imported, until the first step, and until the
first action of the agent that ships. Once for each, of a new process until its first step when
nothing is compiled, but for a trial of one turn. Wall-clock time: of a step of 64 rows on all
cores. Medians over turns, and of the ratios of turns that follow one another: other work on the
machine makes both slower, and hardly the ratio. Turns take some ten milliseconds, and one thread
the same core in both: other work changes slower than that, and cores differ. Medians of 60 such
ratios repeat to a few hundredths, where long turns on any core differ by tenths.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture
from tqdm import tqdm

ROOT = Path(__file__).parent.parent
SCENES = ("paper", "four_tendon")
BENDING = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 2, "span": "rod"}]
SETTINGS = {
    name: {
        "strain": {"type": "statics_based", "passive": passive},
        "quadrature": {"intervals": 4},
        "integrator": {"columns": columns},
    }
    for name, passive, columns in (
        ("no passive modes", [], 2),
        ("polynomial passive modes", BENDING, 3),
    )
}
"""Arms that are the same in every revision, whatever its presets are."""
HEADER = (
    "scene",
    "what",
    "before [µs]",
    "now [µs]",
    "now over before",
    "quarter below",
    "quarter above",
)
STARTS = 6  # new processes, one for so many turns
IMPORT = """
import time
import soft_tendon_env
"""
STEP = """
import time
import gymnasium, soft_tendon_env
env = gymnasium.make("TendonRod-TipPose-v0", scene={scene!r})
env.reset(seed=0)
env.step(env.action_space.sample())
"""
AGENT = """
import time
import gymnasium, soft_tendon_env
from soft_tendon_env.policies import load_policy, policy_options
env = gymnasium.make("TendonRod-TipPose-v0", **policy_options("agent", "TipPose", {{}}))
load_policy("agent", env).predict(env.reset(seed=0)[0])
"""
PROCESSES = {"import": IMPORT, "first step": STEP, "first action of the agent": AGENT}
"""Programs that new processes run, by what their times are called."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "before", nargs="?", default="HEAD", help="what git names a commit by, or a folder"
    )
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--turns", type=int, default=60)
    parser.add_argument("--calls", type=int, default=40, help="in a turn")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    rows = []
    with checkout(arguments.before) as before, tqdm(desc="compiles what is not compiled") as bar:
        for scene in arguments.scenes:
            for what, pairs in measured(
                scene, (before, ROOT), arguments.turns, arguments.calls, bar
            ):
                below, median, above = np.quantile(
                    [now / then for then, now in pairs], [0.25, 0.5, 0.75]
                )
                medians = (f"{time:.4g}" for time in np.median(pairs, axis=0))
                rows.append(
                    (scene, what, *medians, *(f"{ratio:.2f}" for ratio in (median, below, above)))
                )
    print(f"\n{arguments.before} and this, {machine()}\n\n{markdown_table(HEADER, rows)}\n")
    write_csv(arguments.out / "paired.csv", HEADER, rows)
    draw(rows, arguments.out / "paired.png")


@contextmanager
def checkout(before: str) -> Iterator[Path]:
    """The folder of a revision."""
    if Path(before).is_dir():
        yield Path(before).resolve()
        return
    with tempfile.TemporaryDirectory() as folder:
        git = ["git", "-C", ROOT, "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", folder, before], check=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run([*git, "remove", "--force", folder], check=True)


def measured(
    scene: str, folders: tuple[Path, ...], turns: int, calls: int, bar: tqdm
) -> Iterator[tuple[str, list[tuple[float, ...]]]]:
    """What is measured, and the microseconds of every turn by folder."""
    command = [
        sys.executable,
        Path(__file__).with_name("_paired_worker.py"),
        scene,
        str(calls),
        json.dumps(SETTINGS),
    ]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    workers = [
        subprocess.Popen(command, cwd=folder, env=environment(folder), **pipes)
        for folder in folders
    ]
    try:
        names = [json.loads(worker.stdout.readline()) for worker in workers]
        for what in names[0]:
            bar.set_description(f"{scene}: {what}")
            actions = [partial(answer, worker, what) for worker in workers]
            yield what, [taken_in_turn(turn, actions, bar) for turn in range(turns)]
    finally:
        for worker in workers:
            worker.kill()
    for what, program in PROCESSES.items():
        bar.set_description(f"{scene}: new process to {what}")
        starts = [partial(start, folder, program.format(scene=scene)) for folder in folders]
        yield (
            f"new process to {what}",
            [taken_in_turn(turn, starts, bar) for turn in range(max(2, turns // STARTS))],
        )
    if turns == 1:  # a trial
        return
    bar.set_description(f"{scene}: cold start")
    yield (
        "new process to first step, nothing compiled",
        [tuple(cold_start(folder, STEP.format(scene=scene)) for folder in folders)],
    )


def taken_in_turn(turn: int, actions: list[Callable[[], float]], bar: tqdm) -> tuple[float, ...]:
    """What each gives; every other time the last is first."""
    order = [*range(len(actions))][:: 1 if turn % 2 else -1]
    found = {i: actions[i]() for i in order}
    bar.update()
    return tuple(found[i] for i in range(len(actions)))


def answer(worker: subprocess.Popen[str], what: str) -> float:
    assert worker.stdin is not None
    assert worker.stdout is not None
    print(what, file=worker.stdin, flush=True)
    return float(worker.stdout.readline())


def start(folder: Path, program: str, **variables: str) -> float:
    """Microseconds of CPU that a new process takes for a program."""
    command = [sys.executable, "-c", f"{program}\nprint(time.process_time())"]
    return 1e6 * float(
        subprocess.run(
            command,
            cwd=folder,
            env=environment(folder) | variables,
            capture_output=True,
            check=True,
        ).stdout
    )


def cold_start(folder: Path, program: str) -> float:
    """The same with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        return start(folder, program, XDG_CACHE_HOME=cache, HOME=cache)


def environment(folder: Path) -> dict[str, str]:
    """Environment variables with which processes run the code in a folder."""
    return {
        **os.environ,
        "PYTHONPATH": str(folder),
        "SOFT_TENDON_ENV_QUIET": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(8, 0.3 * len(rows) + 1), constrained_layout=True)
    axes.barh(
        [f"{scene}: {what}" for scene, what, *_ in rows][::-1],
        [float(row[4]) for row in rows][::-1],
    )
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set(xlabel="time now over time before")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
