"""What it costs to find where tensions hold the arm, and which tensions hold its tip at a pose or a position.

    python benchmarks/statics.py [--targets 10] [--models paper ...] [--out out]

Tensions are random, each up to 20 N, and the poses wanted are those that they hold, so that they can be reached. "from rest" knows
nothing; "next on a path" starts from the tensions that were found for a neighbour of the pose (every tension 2 % up or down).
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture

from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.inverse_statics import tension_for_tip_pose, tension_for_tip_position
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene

MODELS = ("paper", "paper_22dof", "paper_48dof")
LARGEST = 20.0  # [N]
HEADER = ("model", "question", "median [ms]", "largest [ms]", "answered")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    print(f"{machine()}; CPU times over {arguments.targets} random targets\n")

    results = [(name, *result) for name in arguments.models for result in measure(name, arguments.targets)]
    rows = [
        (name, what, f"{1e3 * np.median(times):.2f}", f"{1e3 * max(times):.2f}", f"{answered} of {len(times)}")
        for name, what, times, answered in results
    ]
    print(markdown_table(HEADER, rows))
    write_csv(arguments.out / "statics.csv", HEADER, rows)
    draw(results, arguments.models, arguments.out / "statics.png")


def measure(name: str, targets: int) -> list[tuple[str, list[float], int]]:
    """What was asked, the CPU seconds for each target, the number of answers."""
    model = build_model(load_scene(name))
    dice = np.random.default_rng(0)
    tensions = dice.uniform(0.0, LARGEST, (targets, model.tendon_count))
    neighbours = tensions * dice.uniform(0.98, 1.02, tensions.shape)
    poses, near = ([static_equilibrium(model, u).tip_pose for u in table] for table in (tensions, neighbours))
    found = [tension_for_tip_pose(model, pose).tension for pose in near]
    return [
        timed("equilibrium under tensions", [lambda u=u: static_equilibrium(model, u).converged for u in tensions]),
        timed("tensions for a pose, from rest", pose_questions(model, poses, [None] * targets)),
        timed("tensions for a pose, next on a path", pose_questions(model, poses, found)),
        timed(
            "tensions for a position, from rest",
            [lambda pose=pose: tension_for_tip_position(model, pose[:3, 3]).reachable for pose in poses],
        ),
    ]


def pose_questions(model: Model, poses: list[np.ndarray], starts: Sequence[np.ndarray | None]) -> list[Callable[[], bool]]:
    return [
        lambda pose=pose, start=start: tension_for_tip_pose(model, pose, start=start).reachable
        for pose, start in zip(poses, starts, strict=True)
    ]


def timed(what: str, questions: list[Callable[[], bool]]) -> tuple[str, list[float], int]:
    questions[0]()  # compiles or loads
    times, answered = [], 0
    for question in questions:
        started = time.process_time()
        answered += question()
        times.append(time.process_time() - started)
    return what, times, answered


def draw(results: list[tuple[str, str, list[float], int]], models: list[str], picture: Path) -> None:
    figure, axes = plt.subplots(figsize=(9, 5), constrained_layout=True)
    questions = list(dict.fromkeys(what for _, what, _, _ in results))
    for i, what in enumerate(questions):
        places = np.arange(len(models)) + 0.2 * (i - 0.5 * (len(questions) - 1))
        for place, times in zip(places, [times for _, asked, times, _ in results if asked == what], strict=True):
            axes.scatter(np.full(len(times), place), 1e3 * np.array(times), s=12, color=f"C{i}", alpha=0.6, label=what)
    axes.set(yscale="log", ylabel="CPU time [ms]", title="Statics: a dot for every target")
    axes.set_xticks(range(len(models)), models)
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), frameon=False)
    axes.grid(axis="y", alpha=0.3)
    write_picture(figure, picture)


if __name__ == "__main__":
    main()
