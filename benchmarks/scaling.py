"""Growth of cost with the size of the problem, memory per row, and what more cores should give: a
section of docs/appendix/speed.md.

    python benchmarks/scaling.py [--quick] [--out out]

- One size changes at a time, with its consequences: each tendon of the statics-based strain is a
  coordinate, and each segment has its own intervals. Costs are the smallest CPU times of several
  turns, in which all sizes are measured one after the other.
- Exponents: the slope p of log(cost) against log(size), cost ~ size^p.
- Memory: allocated by Python and NumPy after twenty steps, per row.
- First step: of a scene of one's own, in a new process, after `soft-tendon demo` has compiled its
  kernels into a new cache; the first process makes the trial of the arm, the second finds it.
- Cores: predicted. Python and NumPy take a + b per row on one thread, the compiled part c per row,
  which threads share, at least eight rows each; a, b and c are measured on one thread. Rates of
  processes are predicted to add up, since they share memory bandwidth alone.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _in_step import evaluate_force_often
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from own_arms import ARMS

import soft_tendon_env as ste
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import save_scene
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
MANY = 4096
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

FIRST_STEP = """
import sys, time
import gymnasium as gym
import soft_tendon_env
env = gym.make("TendonRod-TipPose-v0", scene=sys.argv[1])
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.process_time())
"""
OWN_ARM = "payload"  # of benchmarks/own_arms.py

# sentences above the tables of the page
MEMORY = "Memory of a row:"
TO_FIRST_STEP = (
    "Time to the first step of a scene of one's own, in a new process, after the demo has compiled"
    " its kernels:"
)
STEPS_PER_SECOND = (
    "Steps per second of all rows together, in one process or in one per core, predicted from the"
    " parallel and serial shares of a step on one thread; many cores were not measured:"
)


class Family(NamedTuple):
    """Arms of which one size grows."""

    what: str
    sizes: tuple[int, ...]
    scene: Callable[[int], tuple[ste.Scene, int]]  # and intervals per piece


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    quick = arguments.quick
    warnings.simplefilter("ignore")
    rows = []
    shares = {}
    for family in FAMILIES:
        sizes = family.sizes[:2] if quick else family.sizes
        rows += cost_rows(
            family.what,
            "evaluation",
            sizes,
            evaluation_costs(family, sizes, turns=2 if quick else 15),
        )
        if family.what != "effects" or not quick:
            rows += cost_rows(
                family.what, "env step", sizes, step_costs(family, sizes, turns=1 if quick else 5)
            )
    for fidelity in ("fast",) if quick else ("fast", "standard"):
        shares[fidelity] = measured_shares(fidelity, turns=1 if quick else 5)
        rows += cost_rows(
            f"rows, {fidelity}", "step of all rows", shares[fidelity].rows, shares[fidelity].whole
        )
    write_csv(arguments.out / "scaling.csv", HEADER, rows)
    draw(rows, arguments.out / "scaling.png")
    parts = (
        growth_table(rows),
        MEMORY,
        memory_table(quick),
        TO_FIRST_STEP,
        first_step_table(quick),
        STEPS_PER_SECOND,
        cores_table(shares),
    )
    write_tables(arguments.out / "scaling.md", "\n\n".join(parts))


def straight_arm(tendons: int, segments: int = 1) -> ste.Scene:
    """The segment of `four_tendon` cut into equal segments, with straight tendons evenly around
    it."""
    scene = ste.load_scene("four_tendon")
    table = scene_to_dict(scene)
    segment = table["segments"][0]
    tendon = table["tendons"][0]
    angles = 2.0 * np.pi * np.arange(tendons) / tendons
    offsets = [
        [float(y), float(z)] for y, z in 0.01 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ]
    table["segments"] = [
        {**segment, "length": segment["length"] / segments} for _ in range(segments)
    ]
    table["tendons"] = [
        {**tendon, "routing": {**tendon["routing"], "offset": offset}} for offset in offsets
    ]
    return ste.Scene.parse(table, "scaling")


def of_tendons(size: int) -> tuple[ste.Scene, int]:
    """Helices of different rates, so that every one is a coordinate and none brings intervals."""
    table = scene_to_dict(straight_arm(size))
    for i, tendon in enumerate(table["tendons"]):
        tendon["routing"] = {
            "type": "helix",
            "radius": 0.01,
            "angular_rate": 2.0 * (i - (size - 1) / 2),
            "phase": 360.0 * i / size,
        }
    return ste.Scene.parse(table, "scaling").replace(STATICS_BASED), 16


def of_coordinates(size: int) -> tuple[ste.Scene, int]:
    """Explicit strains of growing order, six fields each."""
    order = size // 6 - 1
    strain = {
        "type": "explicit",
        "modes": [
            {"strains": [*ANGULAR, "stretch", "shear_y", "shear_z"], "order": order, "span": "rod"}
        ],
    }
    return straight_arm(3).replace({"strain": strain}), 16


def of_effects(size: int) -> tuple[ste.Scene, int]:
    changes = {
        f"effects.{name}": values for name, values in itertools.islice(EFFECTS.items(), size - 1)
    }
    return ste.load_scene("paper").replace(changes), 6


FAMILIES = (
    Family(
        "intervals",
        (8, 16, 32, 64, 128),
        lambda size: (ste.load_scene("three_tendon").replace(STATICS_BASED), size),
    ),
    Family("coordinates", (6, 12, 24, 48, 72), of_coordinates),
    Family("tendons", (4, 8, 16, 32), of_tendons),
    Family(
        "segments", (1, 2, 4, 8, 16), lambda size: (straight_arm(4, size).replace(STATICS_BASED), 4)
    ),
    Family("effects", (1, 2, 3, 4, 5, 6, 7), of_effects),
)


def evaluation_costs(family: Family, sizes: Sequence[int], turns: int) -> list[float]:
    """CPU seconds of an evaluation by size."""
    ready = []
    best = [np.inf] * len(sizes)
    for size in sizes:
        model = model_on(*family.scene(size))
        n = model.coordinate_count
        scratch = make_scratch(model.arm, 3)
        random = np.random.default_rng(0)
        scratch.work.strain.xi[:] = model.arm.rod.reference_strain
        q = random.uniform(0.0, 1.0, n) * 0.1 * model.coordinate_scale()
        ready.append(
            (model.arm, np.full(model.tendon_count, 1.0), q, 0.1 * random.normal(size=n), scratch)
        )
        evaluate_force_often(*ready[-1], 5)
    for _ in range(turns):
        for i, arguments in enumerate(ready):
            started = time.thread_time()
            evaluate_force_often(*arguments, EVALUATIONS)
            best[i] = min(best[i], (time.thread_time() - started) / EVALUATIONS)
    return best


def step_costs(family: Family, sizes: Sequence[int], turns: int) -> list[float]:
    """CPU seconds per row and step of a vector environment."""
    ready = []
    best = [np.inf] * len(sizes)
    for size in sizes:
        scene, intervals = family.scene(size)
        own = scene.replace(
            {"quadrature.intervals": intervals, "integrator": {"columns": 3, "step": 0.02}}
        )
        ready.append(
            stepping(
                16,
                scene=own,
                fidelity="scene",
                target={"type": "hold", "tension": [0.0] * len(scene.tendons)},
            )
        )
    for _ in range(turns):
        for i, step in enumerate(ready):
            best[i] = min(best[i], cpu_of(step) / 16)
    return best


def stepping(rows: int, threads: int = 1, **options: Any) -> Callable[[], gym.vector.VectorEnv]:
    """Steps an environment for PERIODS with small random actions; returns it."""
    envs = gym.make_vec(
        "TendonRod-TipPose-v0",
        num_envs=rows,
        threads=threads,
        max_episode_steps=None,
        action="tension",
        **options,
    )
    envs.reset(seed=0)
    actions = (
        np.random.default_rng(0)
        .uniform(-1.0, -0.8, (PERIODS, *envs.action_space.shape))
        .astype(np.float32)
    )
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

    def rate(self, rows: int, cores: int) -> float:
        """Rows stepped a second on so many cores, of which every one has at least eight rows."""
        threads = max(1, min(cores, rows // 8))
        return rows / (self.fixed + self.python * rows + self.compiled * rows / threads)


def measured_shares(fidelity: str, turns: int) -> Shares:
    """What Python and what compiled code take, on one thread."""
    counts = (1, 4, 16, 64, 256)
    whole = [np.inf] * len(counts)
    compiled = [np.inf] * len(counts)
    ready = [stepping(rows, fidelity=fidelity) for rows in counts]
    clocks = [Clock(step().episodes.arms) for step in ready]
    for _ in range(turns):
        for i, (step, clock) in enumerate(zip(ready, clocks, strict=True)):
            clock.total = 0.0
            whole[i] = min(whole[i], cpu_of(step))
            compiled[i] = min(compiled[i], clock.total / PERIODS)
    # seconds = a + b rows in Python, by the first and the last count, and c rows in compiled code
    size = np.array(counts, dtype=float)
    own = np.array(compiled)
    rest = np.array(whole) - own
    more_rows = size[-1] - size[0]
    python = float((rest[-1] - rest[0]) / more_rows)
    fixed = float(rest[0] - python)
    per_row = float(own[-1] / size[-1])
    return Shares(counts, whole, fixed, python, per_row)


class Clock:
    """Adds up the CPU time of the compiled step."""

    def __init__(self, arms: Any) -> None:
        self.total = 0.0
        self._step = arms.step
        arms.step = self

    def __call__(self, *arguments: Any, **named: Any) -> None:
        started = time.process_time()
        self._step(*arguments, **named)
        self.total += time.process_time() - started


HEADER = ("what grows", "cost", "size", "CPU [µs]")


def cost_rows(
    what: str, cost: str, sizes: Sequence[int], seconds: Sequence[float]
) -> list[tuple[str, ...]]:
    """A row for every size."""
    return [
        (what, cost, str(size), f"{1e6 * value:.3g}")
        for size, value in zip(sizes, seconds, strict=True)
    ]


def curves(rows: Sequence[tuple[str, ...]]) -> dict[tuple[str, str], np.ndarray]:
    """Sizes and microseconds (2, sizes) by what grows and what it costs."""
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for what, cost, size, microseconds in rows:
        found.setdefault((what, cost), []).append((float(size), float(microseconds)))
    return {key: np.array(own).T for key, own in found.items()}


def growth_table(rows: Sequence[tuple[str, ...]]) -> str:
    """Ranges and exponents, a row for everything that grows."""
    table = []
    for (what, cost), (sizes, microseconds) in curves(rows).items():
        if cost == "env step":  # in the CSV file
            continue
        exponent = np.polyfit(np.log(sizes), np.log(microseconds), 1)[0]
        ends = [f"{own[0]:g}–{own[-1]:g}" for own in (sizes, microseconds)]
        table.append((what, cost, *ends, f"{exponent:.2f}"))
    return markdown_table(("what grows", "cost", "sizes", "CPU [µs]", "exponent"), table)


def cores_table(shares: dict[str, Shares]) -> str:
    """Rows a second that are predicted."""
    header = (
        "cores",
        *(
            f"{fidelity}, {way}"
            for fidelity in shares
            for way in (f"{MANY} rows", "64 rows per core")
        ),
    )
    table = []
    for cores in CORES:
        rates = [
            rate
            for share in shares.values()
            for rate in (share.rate(MANY, cores), cores * share.rate(64, 1))
        ]
        table.append((str(cores), *(f"{rate:,.0f}" for rate in rates)))
    return markdown_table(header, table)


def memory_table(quick: bool) -> str:
    """Kilobytes that a process grows by per row, of each task."""
    few, many = (2, 8) if quick else (8, 128)
    tasks, fidelities = (
        (("TipPose",), ("fast",))
        if quick
        else (("TipPose", "Shape", "Reach"), ("fast", "standard"))
    )
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    rows = []
    for task in tasks:
        commands = [
            [sys.executable, "-c", GROWTH, f"TendonRod-{task}-v0", own, str(few), str(many)]
            for own in fidelities
        ]
        grown = [
            subprocess.run(
                command, env=environment, check=True, capture_output=True, text=True
            ).stdout
            for command in commands
        ]
        rows.append((task, *(f"{json.loads(own) / 1024:.0f}" for own in grown)))
    return markdown_table(("task", *(f"{fidelity} [kB per row]" for fidelity in fidelities)), rows)


def first_step_table(quick: bool) -> str:
    """Time from the end of the demo to the first step of a scene of one's own, each in a process of
    its own; quick: with the kernels and trials that are in the user's cache."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "own_arm.toml"
        save_scene(ste.Scene.parse({"name": "own_arm", **ARMS[OWN_ARM]}, "own_arm"), scene)
        environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
        if not quick:
            environment["NUMBA_CACHE_DIR"] = folder
            demo = [sys.executable, "-m", "soft_tendon_env", "demo", "--out", f"{folder}/demo"]
            subprocess.run(demo, env=environment, check=True, capture_output=True)
        for label in ("with its trial", "again"):
            started = time.perf_counter()
            process = subprocess.run(
                [sys.executable, "-c", FIRST_STEP, str(scene)],
                env=environment,
                check=True,
                capture_output=True,
                text=True,
            )
            wall = time.perf_counter() - started
            rows.append((label, f"{float(process.stdout):.1f}", f"{wall:.1f}"))
    return markdown_table(("first step of an own arm", "CPU [s]", "wall [s]"), rows)


def draw(rows: Sequence[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for (what, cost), (sizes, microseconds) in curves(rows).items():
        if cost == "evaluation":
            axes.loglog(sizes, microseconds, marker="o", label=what)
    axes.set(xlabel="size", ylabel="CPU time of an evaluation [µs]")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
