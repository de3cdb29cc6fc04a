"""How cost grows with the size of the problem, memory per row, and what more cores should give.

    python benchmarks/scaling.py [--quick] [--write-docs] [--out out]

- Exponents: the slope p of log(cost) against log(size), cost ~ size^p, over all sizes and between the last two. One size changes at a
  time, with its consequences: each tendon of the statics-based strain is a coordinate, and each segment has its own intervals.
- Evaluation: CPU time of all terms of (23). Env step: CPU time of a row of TipPose for one control period of 20 ms with three columns.
  Both are the smallest of several turns, in which all sizes are measured one after the other.
- Memory: allocated by Python and NumPy after twenty steps, per row.
- Cores: predicted from a model of a step of all rows. Python and NumPy take a us + b us per row on one thread. The compiled part takes c
  us per row, which threads share, at least eight rows each. Threads therefore help until c / threads is smaller than b.
- a, b and c are measured on one thread. Two threads are measured too; the ratio of their CPU time to that of one thread is the overhead
  of threads. More cores than this machine has were not measured.
- Processes share memory bandwidth alone, of which a step needs little, since the data of a row stay in a core's cache. Their rates are
  predicted to add up."""

import argparse
import itertools
import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _in_step import evaluate_force_often
from _results import machine, markdown_table, write_csv, write_page, write_picture

import soft_tendon_env as ste
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.scene import scene_to_dict

ANGULAR = ["torsion", "bend_y", "bend_z"]
EFFECTS = {
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "tip_load": {"force": [0.0, 0.0, -0.1]},
    "fluid": {"density": 1000.0, "current": [0.0, 0.2, 0.0]},
    "disturbance": {"loads": [{"at": 0.8, "force": [0.0, 0.1, 0.0]}]},
    "nonlinear_elasticity": {"bending": 5.0},
    "viscoelastic_memory": {"branches": [{"modulus": 0.5, "relaxation_time": 0.2}]},
}
EVALUATIONS = 300
PERIODS = 50
CORES = (1, 2, 16, 64)
MANY = (64, 512, 4096)
DOCS = Path(__file__).parent.parent / "docs" / "appendix" / "scaling.md"
SUMMARY = "How cost grows with tendons, segments, coordinates, intervals, effects and rows; memory per row; what more cores should give."
STATICS_BASED = {"strain": {"type": "statics_based"}}

GROWTH = """
import sys, tracemalloc
import gymnasium as gym
import numpy as np
import soft_tendon_env
def run(rows):
    envs = gym.make_vec(sys.argv[1], num_envs=rows, fidelity=sys.argv[2], threads=1)
    envs.reset(seed=0)
    for _ in range(20):
        envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
    return envs
run(2)
tracemalloc.start()
few, many = int(sys.argv[3]), int(sys.argv[4])
kept = run(few)
before = tracemalloc.get_traced_memory()[0]
kept = kept, run(many)
print((tracemalloc.get_traced_memory()[0] - before) / many)
"""


class Family(NamedTuple):
    """Arms of which one size grows."""

    what: str
    sizes: tuple[int, ...]
    scene: Callable[[int], tuple[ste.Scene, int]]  # and intervals per piece


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="try the script: small sizes, few turns")
    parser.add_argument("--write-docs", action="store_true", help="write docs/appendix/scaling.md")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    quick = arguments.quick
    warnings.simplefilter("ignore")
    rows, curves = [], {}
    for family in FAMILIES:
        sizes = family.sizes[:2] if quick else family.sizes
        evaluation, numbers = evaluation_costs(family, sizes, turns=2 if quick else 15)
        step = [] if family.what == "effects" and quick else step_costs(family, sizes, turns=1 if quick else 5)
        curves[family.what] = sizes, evaluation
        rows += [growth_row(f"{family.what}: {numbers}", "evaluation", sizes, evaluation)]
        rows += [growth_row(f"{family.what}: {numbers}", "env step", sizes, step)] if step else []
    shares = {fidelity: measured_shares(fidelity, turns=1 if quick else 5) for fidelity in (("fast",) if quick else ("fast", "standard"))}
    for fidelity, share in shares.items():
        rows.append(growth_row(f"rows: TipPose, {fidelity}", "step of all rows", share.rows, share.whole))
    growth = markdown_table(GROWTH_HEADER, rows)
    memory = memory_table(quick)
    cores = markdown_table(CORES_HEADER, [row for fidelity, share in shares.items() for row in core_rows(fidelity, share)])
    print(f"\n{machine()}\n\n{growth}\n\n{memory}\n\n{cores}\n")
    write_csv(arguments.out / "scaling.csv", GROWTH_HEADER, rows)
    draw(curves, arguments.out / "scaling.png")
    if arguments.write_docs:
        what = __doc__.split("\n\n", 2)[2]
        law = "\n".join(f"- {fidelity}: {share.law}" for fidelity, share in shares.items())
        write_page(DOCS, "Scaling", (SUMMARY, what, "## Growth", growth, "## Memory", memory, "## Cores", law, cores))


def straight_arm(tendons: int, segments: int = 1) -> ste.Scene:
    """The segment of `four_tendon` cut into equal segments, with straight tendons evenly around it."""
    scene = ste.load_scene("four_tendon")
    table = scene_to_dict(scene)
    segment, tendon = table["segments"][0], table["tendons"][0]
    angles = 2.0 * np.pi * np.arange(tendons) / tendons
    offsets = [[float(y), float(z)] for y, z in 0.01 * np.stack([np.cos(angles), np.sin(angles)], axis=1)]
    table["segments"] = [{**segment, "length": segment["length"] / segments} for _ in range(segments)]
    table["tendons"] = [{**tendon, "routing": {**tendon["routing"], "offset": offset}} for offset in offsets]
    return ste.Scene.parse(table, "scaling")


def of_tendons(size: int) -> tuple[ste.Scene, int]:
    """Helices of different rates, so that every one is a coordinate and none brings intervals."""
    table = scene_to_dict(straight_arm(size))
    for i, tendon in enumerate(table["tendons"]):
        tendon["routing"] = {"type": "helix", "radius": 0.01, "angular_rate": 2.0 * (i - (size - 1) / 2), "phase": 360.0 * i / size}
    return ste.Scene.parse(table, "scaling").replace(STATICS_BASED), 16


def of_coordinates(size: int) -> tuple[ste.Scene, int]:
    """Explicit strains of growing order, six fields each."""
    order = size // 6 - 1
    strain = {"type": "explicit", "modes": [{"strains": [*ANGULAR, "stretch", "shear_y", "shear_z"], "order": order, "span": "rod"}]}
    return straight_arm(3).replace({"strain": strain}), 16


def of_effects(size: int) -> tuple[ste.Scene, int]:
    changes = {f"effects.{name}": values for name, values in itertools.islice(EFFECTS.items(), size - 1)}
    return ste.load_scene("paper").replace(changes), 6


FAMILIES = (
    Family("intervals", (8, 16, 32, 64, 128), lambda size: (ste.load_scene("three_tendon").replace(STATICS_BASED), size)),
    Family("coordinates", (6, 12, 24, 48, 72), of_coordinates),
    Family("tendons", (4, 8, 16, 32), of_tendons),
    Family("segments", (1, 2, 4, 8, 16), lambda size: (straight_arm(4, size).replace(STATICS_BASED), 4)),
    Family("effects", (1, 2, 3, 4, 5, 6, 7), of_effects),
)


def evaluation_costs(family: Family, sizes: Sequence[int], turns: int) -> tuple[list[float], str]:
    """CPU seconds of an evaluation by size, and the numbers of coordinates and packs."""
    ready, best = [], [np.inf] * len(sizes)
    for size in sizes:
        model = model_on(*family.scene(size))
        n, scratch, random = model.coordinate_count, make_scratch(model.arm, 3), np.random.default_rng(0)
        scratch.work.xi[:] = model.arm.rod.reference_strain
        q = random.uniform(0.0, 1.0, n) * 0.1 * model.coordinate_scale()
        ready.append((model, (model.arm, np.full(model.tendon_count, 1.0), q, 0.1 * random.normal(size=n), scratch)))
        evaluate_force_often(*ready[-1][1], 5)
    for _ in range(turns):
        for i, (_, arguments) in enumerate(ready):
            started = time.thread_time()
            evaluate_force_often(*arguments, EVALUATIONS)
            best[i] = min(best[i], (time.thread_time() - started) / EVALUATIONS)
    few, many = ready[0][0], ready[-1][0]
    return best, f"{few.coordinate_count}-{many.coordinate_count} coordinates, {few.grid.packs}-{many.grid.packs} packs"


def step_costs(family: Family, sizes: Sequence[int], turns: int) -> list[float]:
    """CPU seconds per row and step of a vector environment."""
    ready, best = [], [np.inf] * len(sizes)
    for size in sizes:
        scene, intervals = family.scene(size)
        own = scene.replace({"quadrature.intervals": intervals, "integrator": {"columns": 3, "step": 0.02}})
        ready.append(stepping(16, scene=own, fidelity="scene", target={"type": "hold", "tension": [0.0] * len(scene.tendons)}))
    for _ in range(turns):
        for i, step in enumerate(ready):
            best[i] = min(best[i], cpu_of(step) / 16)
    return best


def stepping(rows: int, threads: int = 1, **options: Any) -> Callable[[], gym.vector.VectorEnv]:
    """Steps an environment for PERIODS with small random actions; returns it."""
    envs = gym.make_vec("TendonRod-TipPose-v0", num_envs=rows, threads=threads, max_episode_steps=None, **options)
    envs.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, -0.8, (PERIODS, *envs.action_space.shape)).astype(np.float32)
    envs.step(actions[0])

    def step() -> gym.vector.VectorEnv:
        for action in actions:
            envs.step(action)
        return envs

    return step


def cpu_of(step: Callable[[], Any]) -> float:
    """CPU seconds of one step of all rows."""
    started = time.process_time()
    step()
    return (time.process_time() - started) / PERIODS


class Shares(NamedTuple):
    """Seconds of a step of all rows, by the number of rows."""

    rows: tuple[int, ...]
    whole: list[float]
    fixed: float  # a
    python: float  # b, per row
    compiled: float  # c, per row
    sharing: float  # CPU time of 64 rows on two threads in parts of that on one

    def rate(self, rows: int, cores: int) -> float:
        """Rows stepped a second on so many cores, of which every one has at least eight rows."""
        threads = max(1, min(cores, rows // 8))
        return rows / (self.fixed + self.python * rows + self.compiled * rows / threads)

    @property
    def law(self) -> str:
        """The law in words."""
        law = f"a = {1e6 * self.fixed:.0f} us, b = {1e6 * self.python:.2f} us, c = {1e6 * self.compiled:.1f} us"
        return f"{law}; two threads take {self.sharing:.2f} times the CPU time of one"


def measured_shares(fidelity: str, turns: int) -> Shares:
    """What Python and what compiled code take, on one thread."""
    counts = (1, 4, 16, 64, 256)
    whole, compiled = [np.inf] * len(counts), [np.inf] * len(counts)
    ready = [stepping(rows, fidelity=fidelity) for rows in counts]
    clocks = [Clock(step().episodes.arms) for step in ready]
    for _ in range(turns):
        for i, (step, clock) in enumerate(zip(ready, clocks, strict=True)):
            clock.total = 0.0
            whole[i] = min(whole[i], cpu_of(step))
            compiled[i] = min(compiled[i], clock.total / PERIODS)
    size, own = np.array(counts, dtype=float), np.array(compiled)
    rest = np.array(whole) - own
    python = float((rest[-1] - rest[0]) / (size[-1] - size[0]))
    pair = [stepping(64, threads, fidelity=fidelity) for threads in (1, 2)]
    one, two = (min(cpu_of(step) for _ in range(2 * turns)) for step in pair)
    return Shares(counts, whole, float(rest[0] - python), python, float(own[-1] / size[-1]), two / one)


class Clock:
    """Adds up the CPU time of the compiled step."""

    def __init__(self, arms: Any) -> None:
        self.total, self._step = 0.0, arms.step
        arms.step = self

    def __call__(self, *arguments: Any, **named: Any) -> None:
        started = time.process_time()
        self._step(*arguments, **named)
        self.total += time.process_time() - started


GROWTH_HEADER = ("what grows", "cost", "sizes", "us", "exponent", "between the last two")


def growth_row(what: str, cost: str, sizes: Sequence[int], seconds: Sequence[float]) -> tuple[str, ...]:
    """Sizes, costs and exponents as text."""
    x, y = np.log(sizes), np.log(seconds)
    slope, last = np.polyfit(x, y, 1)[0], (y[-1] - y[-2]) / (x[-1] - x[-2])
    times = ", ".join(f"{1e6 * value:.3g}" for value in seconds)
    return what, cost, ", ".join(map(str, sizes)), times, f"{slope:.2f}", f"{last:.2f}"


CORES_HEADER = ("fidelity", "cores", *(f"{rows} rows, one process" for rows in MANY), "a process of 64 rows per core")


def core_rows(fidelity: str, share: Shares) -> list[tuple[str, ...]]:
    """Rows a second that the law foretells."""
    table = []
    for cores in CORES:
        rates = [f"{share.rate(rows, cores):,.0f}" for rows in MANY]
        table.append((fidelity, str(cores), *rates, f"{cores * share.rate(64, 1):,.0f}"))
    return table


def memory_table(quick: bool) -> str:
    """Kilobytes that a process grows by per row, of each task."""
    few, many = (2, 8) if quick else (8, 128)
    rows, tasks, fidelities = [], ("TipPose", "Shape", "Reach"), ("fast", "standard")
    for task, fidelity in itertools.product(tasks[:1], fidelities[:1]) if quick else itertools.product(tasks, fidelities):
        command = [sys.executable, "-c", GROWTH, f"TendonRod-{task}-v0", fidelity, str(few), str(many)]
        environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
        grown = json.loads(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)
        rows.append((task, fidelity, f"{grown / 1024:.0f}"))
    return markdown_table(("task", "fidelity", "kB per row"), rows)


def draw(curves: dict[str, tuple[Sequence[int], Sequence[float]]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for what, (sizes, seconds) in curves.items():
        axes.loglog(sizes, 1e6 * np.array(seconds), marker="o", label=what)
    axes.set(xlabel="size", ylabel="CPU time of an evaluation [us]")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
