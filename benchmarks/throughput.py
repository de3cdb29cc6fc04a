"""Environment steps per second: the native vector environment against Gymnasium's ways of running many single ones.

    python benchmarks/throughput.py [--id TendonRod-TipPose-v0] [--seconds 2] [--out out]

Random actions over the whole range (0 to 60 N on each tendon, a new one every control period of 20 ms), all rows together, ends of
episodes and resets included. Wall-clock time; every way is measured in the same run, in turns, and the best turn counts. "compiled" is the
share of the wall-clock time that the native environment spends in its compiled step; the rest is Python around it: actions, targets,
observations, rewards, resets.
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _results import markdown_table, processor, write_csv, write_picture
from tqdm import tqdm

import soft_tendon_env  # noqa: F401  (registers the ids)

FIDELITIES = ("fast", "standard")
WAYS = {"native": (1, 8, 64, 256), "sync": (1, 8, 64), "async": (2, 8)}  # rows; of async a process each
TURNS = 3
AIMS = {("fast", 64): 40_000, ("standard", 64): 15_000}
HEADER = ("fidelity", "way", "rows", "steps/s", "native over this", "compiled [%]", "aim")


class Measured(NamedTuple):
    """The best turn."""

    rate: float  # environment steps per second
    compiled: float | None  # share of the wall-clock time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--id", default="TendonRod-TipPose-v0")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=tuple(WAYS))
    parser.add_argument("--seconds", type=float, default=2.0, help="of one turn")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    cases = [(fidelity, way, rows) for fidelity in FIDELITIES for way in arguments.ways for rows in WAYS[way]]
    best: dict[tuple[str, str, int], Measured] = {}
    with tqdm(total=TURNS * len(cases)) as bar:
        for _ in range(TURNS):
            for case in cases:
                bar.set_description(" ".join(map(str, case)))
                found = measure(arguments.id, *case, arguments.seconds)
                best[case] = max(found, best.get(case, found))
                bar.update()
    rows = [row_of(case, best) for case in cases]
    print(f"\n{arguments.id}, {processor()}, {os.cpu_count()} cores\n")
    print(markdown_table(HEADER, rows))
    write_csv(arguments.out / "throughput.csv", HEADER, rows)
    draw(best, arguments.out / "throughput.png")


def measure(id: str, fidelity: str, way: str, rows: int, seconds: float) -> Measured:
    """Step random actions for about that long, after a little that is not counted."""
    mode = "vector_entry_point" if way == "native" else way
    envs = gym.make_vec(id, num_envs=rows, vectorization_mode=mode, fidelity=fidelity)
    clock = Stopwatch()
    if way == "native":
        envs.episodes.arms.step = clock.timed(envs.episodes.arms.step)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (50, rows, *envs.single_action_space.shape)).astype(np.float32)
    envs.reset(seed=0)
    for action in actions[:5]:
        envs.step(action)
    clock.total, count, started = 0.0, 0, time.perf_counter()
    while time.perf_counter() < started + seconds:
        envs.step(actions[count % len(actions)])
        count += 1
    wall = time.perf_counter() - started
    envs.close()
    return Measured(count * rows / wall, clock.total / wall if way == "native" else None)


class Stopwatch:
    """Adds up the time that a function takes."""

    def __init__(self) -> None:
        self.total = 0.0

    def timed(self, function: Callable[..., None]) -> Callable[..., None]:
        def call(*arguments: object, **named: object) -> None:
            started = time.perf_counter()
            function(*arguments, **named)
            self.total += time.perf_counter() - started

        return call


def row_of(case: tuple[str, str, int], best: dict[tuple[str, str, int], Measured]) -> tuple[str, ...]:
    fidelity, way, rows = case
    measured, native = best[case], best.get((fidelity, "native", rows))
    ratio = "-" if native is None or way == "native" else f"{native.rate / measured.rate:.1f}"
    compiled = "-" if measured.compiled is None else f"{100 * measured.compiled:.0f}"
    aim = AIMS.get((fidelity, rows)) if way == "native" else None
    return fidelity, way, str(rows), f"{measured.rate:,.0f}", ratio, compiled, "-" if aim is None else f">= {aim:,}"


def draw(best: dict[tuple[str, str, int], Measured], path: Path) -> None:
    figure, axes = plt.subplots(1, len(FIDELITIES), figsize=(10, 4), sharey=True, constrained_layout=True)
    for axis, fidelity in zip(axes, FIDELITIES, strict=True):
        for way, marker in zip(WAYS, "osd", strict=True):
            points = {rows: measured.rate for (f, w, rows), measured in best.items() if (f, w) == (fidelity, way)}
            axis.loglog(list(points), list(points.values()), marker=marker, label=way)
        axis.set(title=fidelity, xlabel="rows")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("environment steps per second")
    axes[0].legend(frameon=False)
    write_picture(figure, path)


if __name__ == "__main__":
    main()
