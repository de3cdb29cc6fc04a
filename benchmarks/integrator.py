"""Accuracy and cost of adaptive order: time-discretisation error and evaluations against the integrator's tolerance.

    python benchmarks/integrator.py [--quick] [--write-docs] [--out out]

All motions are of the paper's arm with control periods of 20 ms.

- Error: the largest distance of the tip, compared every 20 ms, from a converged solution of the same model (4 columns, steps of 0.5 ms). It
  contains the time-discretisation error alone, and no error of strain modes or quadrature.
- Evaluations of the equation of motion per control period, with those of rejected steps. They take nearly all of a simulation's time.
- Tolerances are shares of the rod's length.
- Test motions: 2 s of each [kind](fidelity.md), several seeds, with a fixed number of columns and with a tolerance.
- Jumps: 1 s from rest to 40 N on one tendon, on two or on all, under gravity, a payload and a force at the tip.
- How often an accuracy is kept: 50 motions of mixed kinds with other seeds. Half of them have gravity in a random direction, a random
  payload and a random force at the tip.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _results import markdown_table, write_csv, write_page, write_picture
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.test_inputs import HOLD, USUAL, motion_tensions

SCENES = ("paper_19dof", "paper_16dof")
KINDS = (*USUAL, "wild")
LOAD_SEED = 5  # part of the seed of random loads, which no kind of motion has
SEEDS, SECONDS = 8, 2.0
FIXED = (2, 3, 4, 5)  # columns
TOLERANCES = (2e-6, 5e-6, 1e-5, 3e-5, 1e-4)
STATED = {2e-6: (3e-4, 1e-3), 1e-5: (1e-3, 2e-3), 3e-5: (2e-3, 4e-3), 1e-4: (4e-3, 1e-2)}
"""Own error, as a share of the rod's length, that a tolerance is stated to keep on the usual motions, and on wild ones."""
CONVERGED = {"integrator.columns": 4, "integrator.step": 5e-4}
LOADS = {"effects.gravity.acceleration": [9.81, 0.0, 0.0], "effects.tip_load.mass": 0.05, "effects.tip_load.force": [0.0, 0.2, 0.1]}
JUMP = 40.0  # [N]
JUMPS = ((0,), (3,), (5,), (0, 3), (5, 8), tuple(range(10)))  # tendons
MIXED = 50
DOCS = Path(__file__).parent.parent / "docs" / "appendix" / "integrator.md"
SUMMARY = "Time-discretisation error and cost of the integrator, with a fixed order and with an order that adapts to a tolerance."
HEADER = ("scene", "setting", "motion", "largest error [mm]", "median [mm]", "evaluations: mean", "most", "steps rejected")
JUMP_HEADER = ("scene", "setting", "largest error [mm]", "evaluations: mean", "most", "steps rejected")
KEPT_HEADER = ("tolerance", "motion", "stated [mm]", "kept", "largest error [mm]", "median [mm]", "evaluations: mean")


class Run(NamedTuple):
    """One motion: own error [m], evaluations of every control period, rejected steps."""

    error: float
    evaluations: np.ndarray
    rejected: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write-docs", action="store_true", help="write docs/appendix/integrator.md")
    parser.add_argument("--quick", action="store_true", help="try the script: one scene, few and short motions")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    quick = arguments.quick
    scenes, seeds, seconds, mixed = (SCENES[:1], 1, 0.1, 4) if quick else (SCENES, SEEDS, SECONDS, MIXED)
    rows = [row for name in scenes for row in on_motions(ste.load_scene(name), seeds, seconds)]
    jumps = [row for name in scenes for row in on_jumps(ste.load_scene(name).replace(LOADS), 0.1 if quick else 1.0)]
    kept = list(how_often_kept(ste.load_scene(scenes[0]), mixed, seconds))
    tables = [markdown_table(*table) for table in ((HEADER, rows), (JUMP_HEADER, jumps), (KEPT_HEADER, kept))]
    print("\n" + "\n\n".join(tables) + "\n")
    write_csv(arguments.out / "integrator.csv", HEADER, rows)
    draw([row for row in rows if row[0] == scenes[0]], arguments.out / "integrator.png")
    if arguments.write_docs:
        what = __doc__.split("\n\n", 2)[2]
        titles = ("Test motions", "Jumps under loads", "How often an accuracy is kept")
        parts = "\n\n".join(f"## {title}\n\n{table}" for title, table in zip(titles, tables, strict=True))
        write_page(DOCS, "Adaptive order", (SUMMARY, what, parts))


def settings(scene: ste.Scene) -> dict[str, dict[str, object]]:
    """Changes to the scene by what they are called."""
    fixed = {f"{columns} columns": {"integrator.columns": columns} for columns in FIXED}
    length = sum(segment.length for segment in scene.segments)
    return {**fixed, **{f"tolerance {share:g}": {"integrator.tolerance": share * length} for share in TOLERANCES}}


def converged_tips(scene: ste.Scene, table: np.ndarray) -> np.ndarray:
    """Tip positions (periods, 3) [m] after each row of a table of tensions."""
    return ste.simulate(ste.build_model(scene.replace(CONVERGED), "scene"), table, len(table) * HOLD, HOLD).tip_pose[1:, :3, 3]


def measure(model: ste.Model, table: np.ndarray, exact: np.ndarray) -> Run:
    """The model under a table of tensions (periods, n_a), one control period at a time."""
    simulation, tips, reports = ste.Simulation(model), [], []
    for row in table:
        reports.append(simulation.step(row, HOLD))
        tips.append(simulation.tip_pose[:3, 3])
    error = float(np.linalg.norm(np.array(tips) - exact, axis=1).max())
    return Run(error, np.array([report.evaluations for report in reports]), sum(report.rejected for report in reports))


def on_motions(scene: ste.Scene, seeds: int, seconds: float) -> Iterator[tuple[str, ...]]:
    for kind in KINDS:
        tables = [motion_tensions(scene, kind, seed, seconds) for seed in range(seeds)]
        exact = [converged_tips(scene, table) for table in tqdm(tables, desc=f"{scene.name}, {kind}: converged", leave=False)]
        for label, changes in settings(scene).items():
            model = ste.build_model(scene.replace(changes), "scene")
            runs = [measure(model, *both) for both in zip(tables, exact, strict=True)]
            error, evaluations = np.array([run.error for run in runs]), np.concatenate([run.evaluations for run in runs])
            yield (scene.name, label, kind, millimetres(error.max()), millimetres(np.median(error)), *cost(evaluations), total(runs))


def on_jumps(scene: ste.Scene, seconds: float) -> Iterator[tuple[str, ...]]:
    tables = [np.tile(np.where(np.isin(np.arange(10), jump), JUMP, 0.0), (round(seconds / HOLD), 1)) for jump in JUMPS]
    exact = [converged_tips(scene, table) for table in tqdm(tables, desc=f"{scene.name}, jumps: converged", leave=False)]
    for label, changes in settings(scene).items():
        model = ste.build_model(scene.replace(changes), "scene")
        runs = [measure(model, *both) for both in zip(tables, exact, strict=True)]
        evaluations = np.concatenate([run.evaluations for run in runs])
        yield scene.name, label, millimetres(max(run.error for run in runs)), *cost(evaluations), total(runs)


def how_often_kept(scene: ste.Scene, count: int, seconds: float) -> Iterator[tuple[str, ...]]:
    kinds = [KINDS[i % len(KINDS)] for i in range(count)]
    scenes = [scene if i // len(KINDS) % 2 else scene.replace(random_loads(i)) for i in range(count)]
    tables = [motion_tensions(scene, kind, 1000 + i, seconds) for i, kind in enumerate(kinds)]
    exact = [converged_tips(*both) for both in zip(scenes, tqdm(tables, desc="mixed motions: converged", leave=False), strict=True)]
    length = sum(segment.length for segment in scene.segments)
    for share, (usual, wild) in STATED.items():
        models = (ste.build_model(scene.replace({"integrator.tolerance": share * length}), "scene") for scene in scenes)
        runs = [measure(*each) for each in zip(models, tables, exact, strict=True)]
        for group, stated in ((USUAL, usual), (("wild",), wild)):
            of_group = [run for run, kind in zip(runs, kinds, strict=True) if kind in group]
            error = np.array([run.error for run in of_group])
            kept = f"{np.count_nonzero(error <= stated * length)} of {error.size}"
            mean = np.concatenate([run.evaluations for run in of_group]).mean()
            numbers = (millimetres(stated * length), kept, millimetres(error.max()), millimetres(np.median(error)), f"{mean:.1f}")
            yield f"{share:g}", ", ".join(group), *numbers


def random_loads(seed: int) -> dict[str, object]:
    """Gravity in any direction, a payload of up to 0.1 kg (the arm has 0.2 kg) and a force at the tip of up to 0.3 N in any direction."""
    random = np.random.default_rng([seed, LOAD_SEED])
    down, push = (direction / np.linalg.norm(direction) for direction in random.normal(size=(2, 3)))
    return {
        "effects.gravity.acceleration": (9.81 * down).tolist(),
        "effects.tip_load.mass": random.uniform(0.0, 0.1),
        "effects.tip_load.force": (random.uniform(0.0, 0.3) * push).tolist(),
    }


def millimetres(distance: float) -> str:
    return f"{1e3 * distance:.3g}"


def cost(evaluations: np.ndarray) -> tuple[str, str]:
    """Mean and most per control period."""
    return f"{evaluations.mean():.1f}", str(evaluations.max())


def total(runs: list[Run]) -> str:
    return str(sum(run.rejected for run in runs))


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for kind, colour in zip(KINDS, ("#d1495b", "#edae49", "#66a182", "#2e6f95"), strict=True):
        for way, line in (("columns", ":"), ("tolerance", "-")):
            points = [(float(row[5]), float(row[3])) for row in rows if row[2] == kind and way in row[1]]
            axes.loglog(*zip(*sorted(points), strict=True), line, marker="o", color=colour, label=f"{kind}, {way}")
    axes.set(xlabel="evaluations per control period of 20 ms", ylabel="own error of the tip [mm]")
    axes.legend(frameon=False, fontsize=7)
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
