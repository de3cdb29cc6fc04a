"""Time-discretisation error and evaluations of the integrator, of fixed and of adaptive order: a
section of docs/appendix/accuracy.md.

    python benchmarks/integrator.py [--quick] [--out out]

Motions of the paper's arm, with passive moments up to quadratic, last 2 s from rest, with control
periods of 20 ms. The reference is the same model with 4 columns and steps of 0.5 ms, so that errors
of strain modes and quadrature are left out. Evaluations include those of rejected steps.
"""

from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.input_motions import HOLD, USUAL, motion_tensions
from soft_tendon_env.scene.scene import rod_length

SCENE = ste.load_scene("paper").replace(
    {"strain.passive": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 2, "span": "rod"}]}
)
LOAD_SEED = 5  # part of the seed of random loads, which no kind of motion has
SEEDS = 8
SECONDS = 2.0  # length of a motion
FIXED = (3, 4, 5)  # columns
TOLERANCES = (2e-6, 1e-5, 3e-5, 1e-4)
STATED = {2e-6: (3e-4, 1e-3), 1e-5: (1e-3, 2e-3), 3e-5: (2e-3, 4e-3), 1e-4: (4e-3, 1e-2)}
"""Error, as a share of the rod's length, that a tolerance is stated to keep on the usual motions,
and on wild ones."""
CONVERGED = {"integrator.columns": 4, "integrator.step": 5e-4}
LOADS = {
    "effects.gravity.acceleration": [9.81, 0.0, 0.0],
    "effects.tip_load.mass": 0.05,
    "effects.tip_load.force": [0.0, 0.2, 0.1],
}
JUMP = 40.0  # [N]
JUMPS = ((0,), (3,), (5,), (0, 3), (5, 8), tuple(range(10)))  # tendons
MIXED = 50
GROUPS = ("usual", "wild", "jumps")
HEADER = (
    "setting",
    *(f"{group} {what}" for group in GROUPS for what in ("[mm]", "evaluations")),
    "rejected",
)
KEPT_HEADER = (
    "tolerance",
    *(
        f"{group}, {what}"
        for group in GROUPS[:2]
        for what in ("stated [mm]", "kept", "largest [mm]")
    ),
)


class Case(NamedTuple):
    """A motion to be simulated: tensions (periods, n_a) [N] and the converged tip positions
    (periods, 3) [m]."""

    scene: ste.Scene
    table: np.ndarray
    exact: np.ndarray


class Run(NamedTuple):
    """One motion: error [m], evaluations per control period, rejected steps."""

    error: float
    evaluations: float
    rejected: int


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    seeds, seconds, mixed = (1, 0.1, 8) if arguments.quick else (SEEDS, SECONDS, MIXED)
    rows = compared(seeds, seconds)
    kept = how_often_kept(mixed, seconds)
    write_csv(arguments.out / "integrator.csv", HEADER, rows)
    draw(rows, arguments.out / "integrator.png")
    tables = f"{markdown_table(HEADER, rows)}\n\n{markdown_table(KEPT_HEADER, kept)}"
    write_tables(arguments.out / "integrator.md", tables)


def settings() -> dict[str, dict[str, object]]:
    """Changes to the scene by what they are called."""
    fixed = {f"{columns} columns": {"integrator.columns": columns} for columns in FIXED}
    return {**fixed, **{f"tolerance {share:g}": with_tolerance(share) for share in TOLERANCES}}


def with_tolerance(share: float) -> dict[str, object]:
    return {"integrator.tolerance": share * rod_length(SCENE)}


def cases_of(scenes: list[ste.Scene], tables: list[np.ndarray], what: str) -> list[Case]:
    """Motions with their converged solutions."""
    made = []
    for scene, table in zip(
        scenes, tqdm(tables, desc=f"{what}: converged", leave=False), strict=True
    ):
        model = ste.build_model(scene.replace(CONVERGED), "scene")
        made.append(
            Case(
                scene,
                table,
                ste.simulate(model, table, len(table) * HOLD, HOLD).tip_pose[1:, :3, 3],
            )
        )
    return made


def measure(case: Case, changes: dict[str, object]) -> Run:
    """A motion from rest with a setting."""
    motion = ste.simulate(
        ste.build_model(case.scene.replace(changes), "scene"),
        case.table,
        len(case.table) * HOLD,
        HOLD,
    )
    error = float(np.linalg.norm(motion.tip_pose[1:, :3, 3] - case.exact, axis=1).max())
    return Run(error, motion.evaluations / len(case.table), motion.rejected)


def compared(seeds: int, seconds: float) -> list[tuple[str, ...]]:
    """A row for every setting."""
    scene = SCENE
    usual, wild = (
        [motion_tensions(scene, kind, i, seconds) for kind in kinds for i in range(seeds)]
        for kinds in (USUAL, ("wild",))
    )
    jumps = [
        np.tile(np.where(np.isin(np.arange(10), jump), JUMP, 0.0), (round(0.5 * seconds / HOLD), 1))
        for jump in JUMPS
    ]
    groups = [
        cases_of([own] * len(tables), tables, group)
        for group, own, tables in zip(
            GROUPS, (scene, scene, scene.replace(LOADS)), (usual, wild, jumps), strict=True
        )
    ]
    rows = []
    for label, changes in settings().items():
        runs = [[measure(case, changes) for case in cases] for cases in groups]
        numbers = [
            (
                millimetres(max(run.error for run in own)),
                f"{np.mean([run.evaluations for run in own]):.1f}",
            )
            for own in runs
        ]
        rows.append(
            (
                label,
                *(text for pair in numbers for text in pair),
                str(sum(run.rejected for own in runs for run in own)),
            )
        )
    return rows


def how_often_kept(count: int, seconds: float) -> list[tuple[str, ...]]:
    """A row for every tolerance that is stated to keep an accuracy."""
    kinds = [(*USUAL, "wild")[i % 4] for i in range(count)]
    scene = SCENE
    scenes = [scene if i // 4 % 2 else scene.replace(random_loads(i)) for i in range(count)]
    cases = cases_of(
        scenes,
        [motion_tensions(scene, kind, 1000 + i, seconds) for i, kind in enumerate(kinds)],
        "mixed motions",
    )
    rows = []
    for share, stated in STATED.items():
        errors = np.array([measure(case, with_tolerance(share)).error for case in cases])
        numbers = []
        for within, wild in zip(stated, (False, True), strict=True):
            own = errors[[(kind == "wild") == wild for kind in kinds]]
            kept = f"{np.count_nonzero(own <= within * rod_length(scene))} of {own.size}"
            numbers += [millimetres(within * rod_length(scene)), kept, millimetres(own.max())]
        rows.append((f"{share:g}", *numbers))
    return rows


def random_loads(seed: int) -> dict[str, object]:
    """Gravity in any direction, a payload of up to 0.1 kg (the arm has 0.2 kg) and a force at the
    tip of up to 0.3 N in any direction."""
    random = np.random.default_rng([seed, LOAD_SEED])
    down, push = (direction / np.linalg.norm(direction) for direction in random.normal(size=(2, 3)))
    return {
        "effects.gravity.acceleration": (9.81 * down).tolist(),
        "effects.tip_load.mass": random.uniform(0.0, 0.1),
        "effects.tip_load.force": (random.uniform(0.0, 0.3) * push).tolist(),
    }


def millimetres(distance: float) -> str:
    return f"{1e3 * distance:.3g}"


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for k, (group, colour) in enumerate(
        zip(GROUPS, ("#66a182", "#2e6f95", "#d1495b"), strict=True)
    ):
        for way, line in (("columns", ":"), ("tolerance", "-")):
            points = [
                (float(row[2 + 2 * k]), float(row[1 + 2 * k])) for row in rows if way in row[0]
            ]
            axes.loglog(
                *zip(*sorted(points), strict=True),
                line,
                marker="o",
                color=colour,
                label=f"{group}, {way}",
            )
    axes.set(
        xlabel="evaluations per control period of 20 ms", ylabel="largest error of the tip [mm]"
    )
    axes.legend(frameon=False, fontsize=7)
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
