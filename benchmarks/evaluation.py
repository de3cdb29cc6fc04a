"""What one evaluation of the equations of motion costs, by number of coordinates, kind of strain
and effect; and what starting costs.

    python benchmarks/evaluation.py [--repeats 75] [--evaluations 100] [--no-start] [--out out]

An evaluation is everything that the equations of motion need at one state
(mechanics.terms.evaluate), to the accuracy of the time steps. "at one state": the same state again,
whose strain is known. "along the motion": states 5 ms apart on the input, each strain predicted
from the one before and solved for. "in a step": the same without stiffness and damping, which a
time step computes at its start alone. "paired difference": to the first arm, in a step.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _results import cpu_times, machine, markdown_table, write_csv, write_picture
from _trajectory_input import DURATION, tension_table

import soft_tendon_env as ste
from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE, predict_strain
from soft_tendon_env.mechanics.terms.evaluate import evaluate, evaluate_forces, rod_matrices
from soft_tendon_env.mechanics.workspace import make_workspace

STEP = 0.005  # [s] between the states
WAYS = "at one state", "along the motion", "in a step"
MIDDLE = 100  # of the states: 0.5 s, where two tensions jump
ALL = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]


def constant_strain(strains: list[str]) -> dict:
    """Changes to a scene: these strains constant on each half, the others rigid."""
    return {
        "strain": {"type": "explicit", "modes": [{"strains": strains, "order": 0, "span": "piece"}]}
    }


def moments(order: int) -> dict:
    """Changes to a scene: passive moments up to an order over the whole rod."""
    return {"strain.passive": [{"strains": ALL[:3], "order": order, "span": "rod"}]}


# what it is, scene, changes
ARMS = (
    ("paper", "paper", {}),
    ("paper_16dof", "paper_16dof", {}),
    ("paper, moments 0-2", "paper", moments(2)),
    ("paper, moments 0-3", "paper", moments(3)),
    ("paper_48dof", "paper_48dof", {}),
    ("paper, rigid shear", "paper", {"strain.strains": ALL[:4]}),
    ("paper, Kirchhoff (no shear, no stretch)", "paper", {"strain.strains": ALL[:3]}),
    ("constant strain per half", "paper", constant_strain(ALL)),
    ("constant bending and torsion per half", "paper", constant_strain(ALL[:3])),
    ("constant curvature per half", "paper", constant_strain(ALL[1:3])),
    ("paper + gravity", "paper", {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}),
    ("paper + tip load", "paper", {"effects.tip_load.force": [0.0, 0.0, -0.1]}),
    (
        "paper + gravity + tip load",
        "paper",
        {
            "effects.gravity.acceleration": [0.0, 0.0, -9.81],
            "effects.tip_load.force": [0.0, 0.0, -0.1],
        },
    ),
    (
        "paper + gravity inside the strain",
        "paper",
        {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True},
    ),
    (
        "paper_16dof + gravity inside the strain",
        "paper_16dof",
        {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True},
    ),
)

FIRST_STEP = """
import time
started = time.perf_counter(), time.process_time()
import numpy as np
import soft_tendon_env as ste
simulation = ste.Simulation(ste.build_model(ste.load_scene("paper"), "scene"))
simulation.step(np.zeros(10), 0.01)
print(time.perf_counter() - started[0], time.process_time() - started[1])
"""


@kernel
def evaluate_often(arm, u, q, q_dot, count, work):
    """The same state `count` times."""
    for _ in range(count):
        evaluate(arm, u, q, q_dot, STEP_TOLERANCE, work)


@kernel
def evaluate_along(arm, u, q, q_dot, count, in_step, work):
    """The states (count, n) in turn, each strain predicted from the one before; in a step without
    stiffness and damping."""
    for i in range(count):
        if i > 0:
            predict_strain(arm.strain, q[i], q[i - 1], work.strain, work.spare.stress)
        evaluate_forces(arm, u[i], q[i], q_dot[i], STEP_TOLERANCE, work)
        if not in_step:
            rod_matrices(arm, work)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=75)
    parser.add_argument("--evaluations", type=int, default=100, help="per repeat, at most 200")
    parser.add_argument(
        "--arms", type=int, default=len(ARMS), help="how many of the arms, from the first"
    )
    parser.add_argument(
        "--no-start",
        action="store_true",
        help="do not measure compilation and start, which takes a minute",
    )
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    print(f"{machine()}; median of {arguments.repeats} x {arguments.evaluations} evaluations\n")

    prepared = [prepare(*arm, arguments.evaluations) for arm in ARMS[: arguments.arms]]
    times = measure(prepared, arguments.repeats)
    base = np.median(times[0, -1])
    header = (
        "arm",
        "coordinates",
        *(f"{what}, µs" for what in WAYS),
        "ratio to paper",
        "paired difference, µs",
    )
    rows = []
    for arm, own in zip(prepared, times, strict=True):
        ratio, difference = np.median(own[-1]) / base, np.median(own[-1] - times[0, -1])
        rows.append(
            (
                arm.label,
                arm.coordinates,
                *(f"{np.median(way):.2f}" for way in own),
                f"{ratio:.2f}",
                f"{difference:+.2f}",
            )
        )
    print(markdown_table(header, rows))
    write_csv(arguments.out / "evaluation.csv", header, rows)
    draw(rows, arguments.out / "evaluation.png")
    if not arguments.no_start:
        report_start()


class Prepared(NamedTuple):
    """An arm and what to evaluate of it."""

    label: str
    coordinates: int
    evaluations: int
    ways: tuple[Callable[[], None], ...]  # WAYS


def prepare(label: str, scene: str, changes: dict, evaluations: int) -> Prepared:
    """Compiled or loaded, with the strain of the first state known."""
    model = ste.build_model(
        ste.load_scene(scene).replace({"integrator.step": STEP, **changes}), "scene"
    )
    quiet = ste.build_model(
        model.scene.replace({"effects": {}}), "scene"
    )  # its own motion would compile steps for every set of effects
    u = tension_table(STEP)
    motion = ste.simulate(quiet, u, DURATION, STEP)
    u = np.concatenate([u, u[-1:]])
    one, many = make_workspace(model.arm), make_workspace(model.arm)
    one.strain.xi[:], many.strain.xi[:] = (
        quiet.packed_strain(motion.q[MIDDLE]),
        quiet.packed_strain(motion.q[0]),
    )
    one_state = model.arm, u[MIDDLE], motion.q[MIDDLE], motion.q_dot[MIDDLE], evaluations, one

    def at_one_state() -> None:
        evaluate_often(*one_state)

    def along_the_motion() -> None:
        evaluate_along(model.arm, u, motion.q, motion.q_dot, evaluations, False, many)

    def in_a_step() -> None:
        evaluate_along(model.arm, u, motion.q, motion.q_dot, evaluations, True, many)

    ways = at_one_state, along_the_motion, in_a_step
    for way in ways:
        way()
    if changes and "effects" in next(iter(changes)) and not many.forces.load.any():
        raise AssertionError(f"{label}: the effect does nothing")
    return Prepared(label, model.coordinate_count, evaluations, ways)


def measure(prepared: list[Prepared], repeats: int) -> np.ndarray:
    """CPU time per evaluation [µs], (arms, WAYS, repeats).

    All arms in turn, again and again, so that what disturbs the machine meets them alike.
    """
    times = np.zeros((len(prepared), len(WAYS), repeats))
    for repeat in range(repeats):
        for i, arm in enumerate(prepared):
            for j, way in enumerate(arm.ways):
                times[i, j, repeat] = 1e6 * cpu_times(way, 1)[0] / arm.evaluations
    return times


def draw(rows: list[tuple], picture: Path) -> None:
    figure, axes = plt.subplots(figsize=(9, 5), constrained_layout=True)
    names = [f"{row[0]}  ({row[1]})" for row in rows]
    axes.barh(names, [float(row[4]) for row in rows], color="#2e6f95")
    axes.bar_label(axes.containers[0], fmt="%.1f", padding=3)
    axes.invert_yaxis()
    axes.set(
        xlabel="CPU time [µs]",
        title="One evaluation of the equations of motion in a step  (coordinates)",
    )
    axes.spines[["top", "right"]].set_visible(False)
    write_picture(figure, picture)


def report_start() -> None:
    """Time to the end of the first step of a new process, with nothing compiled before and with
    everything."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "SOFT_TENDON_ENV_QUIET": "1"}
        print("\nfrom the start of a process's imports to the end of its first step:")
        for what, runs in (("nothing compiled", 1), ("compiled before, best of 3", 3)):
            times = min(first_step(environment) for _ in range(runs))
            print(f"  {what}: {times[0]:.2f} s wall, {times[1]:.2f} s CPU")


def first_step(environment: dict[str, str]) -> tuple[float, float]:
    """Wall and CPU seconds."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_STEP],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    wall, cpu = map(float, done.stdout.split())
    return wall, cpu


if __name__ == "__main__":
    main()
