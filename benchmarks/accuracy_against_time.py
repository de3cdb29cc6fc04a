"""Tip error against CPU time, for every way of simulating the paper's arm: a section of
docs/appendix/accuracy.md.

    python benchmarks/accuracy_against_time.py [--repeats 3] [--quick] [--out out]

CPU time is that of one `simulate` call over one second on one thread, with the table of tensions,
checks and a tip pose per step. Errors are largest distances of the tip, after every step, or about
every 10 ms for shorter ones. With steps of 40 ms the jump of the tensions at 0.5 s falls in the
middle of a step.
"""

import itertools
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import (
    cpu_times,
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from _trajectory_input import DURATION, tension_table

import soft_tendon_env as ste
from soft_tendon_env.model.build import QuadratureWarning
from soft_tendon_env.scene.scene import extrapolation_columns

MODELS = {
    "paper": "#d1495b",
    "paper_16dof": "#edae49",
    "moments 0-2": "#66a182",
    "moments 0-3": "#2e6f95",
    "paper_48dof": "#3d2c5e",
}
PASSIVE = {  # of the scene "paper"
    f"moments 0-{order}": {
        "strain.passive": [
            {"strains": ["torsion", "bend_y", "bend_z"], "order": order, "span": "rod"}
        ]
    }
    for order in (2, 3)
}
COLUMNS = (1, 2, 3, 4)
STEPS = (0.04, 0.02, 1 / 60, 0.01, 0.005, 0.0025)
INTERVALS = (3, 4, 6, 8)
COMPARED_EVERY = 0.01  # [s]
WORST = 0.01  # [m] of settings in the table
CONVERGED = {"quadrature.intervals": 24, "integrator.columns": 3, "integrator.step": 1 / 2400}
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
FULL_PHYSICS = {
    "strain": {"type": "explicit", "modes": [{"strains": STRAINS, "order": 5, "span": "piece"}]}
}

COLUMN_NAMES = (
    "model",
    "coordinates",
    "columns",
    "step [ms]",
    "intervals",
    "CPU [ms/s]",
    "to own [mm]",
    "to full physics [mm]",
)


@dataclass(frozen=True)
class Run:
    """One way of simulating, CPU seconds per simulated second, largest distances [m]."""

    model: str
    coordinates: int
    columns: int
    step: float
    intervals: int
    cpu: float
    own: float
    full: float

    @property
    def setting(self) -> str:
        return f"{self.columns}, {1e3 * self.step:.4g} ms, {self.intervals}"

    def row(self) -> tuple[object, ...]:
        numbers = f"{1e3 * self.cpu:.2f}", f"{1e3 * self.own:.3f}", f"{1e3 * self.full:.3f}"
        return (
            self.model,
            self.coordinates,
            self.columns,
            f"{1e3 * self.step:.4g}",
            self.intervals,
            *numbers,
        )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--repeats", type=int, default=3, help="CPU times are the median of so many"
    )
    arguments = parser.parse_args()
    warnings.simplefilter(
        "ignore", QuadratureWarning
    )  # what too few intervals do is what is measured
    runs = measure_all(arguments.repeats, arguments.quick)
    write_csv(
        arguments.out / "accuracy_against_time.csv", COLUMN_NAMES, [run.row() for run in runs]
    )
    draw(runs, arguments.out / "accuracy_against_time.png")
    write_tables(arguments.out / "accuracy_against_time.md", table_of(runs))


def measure_all(repeats: int, quick: bool) -> list[Run]:
    models = ("paper", "moments 0-2") if quick else tuple(MODELS)
    settings = list(
        itertools.product((2, 3), (0.02, 0.01), (4,))
        if quick
        else itertools.product(COLUMNS, STEPS, INTERVALS)
    )
    converged = {**CONVERGED, "integrator.step": 1 / 300} if quick else CONVERGED
    full = tips("paper", {**converged, **FULL_PHYSICS})
    runs = []
    for name in models:
        own = tips(name, converged)
        for columns, step, intervals in settings:
            changes = {
                "integrator.columns": columns,
                "integrator.step": step,
                "quadrature.intervals": intervals,
            }
            runs += measured(name, changes, own, full, repeats)
    return runs


def scene_of(name: str) -> ste.Scene:
    """A scene that ships, or the paper's with passive moments."""
    return ste.load_scene("paper" if name in PASSIVE else name).replace(PASSIVE.get(name, {}))


def tips(name: str, changes: dict) -> np.ndarray:
    """Tip positions (steps + 1, 3) [m]."""
    model = ste.build_model(scene_of(name).replace(changes), "scene")
    step = model.scene.integrator.step
    return ste.simulate(model, tension_table(step), DURATION, step).tip_pose[:, :3, 3]


def largest_distance(tip: np.ndarray, reference: np.ndarray) -> float:
    """Largest distance [m] between two series of tip positions over the same time, the second a
    multiple as fine as the first."""
    tip = tip[:: max(1, round(COMPARED_EVERY / DURATION * (len(tip) - 1)))]
    every, rest = divmod(len(reference) - 1, len(tip) - 1)
    assert rest == 0, "the references have no sample at these times"
    return float(np.linalg.norm(tip - reference[::every], axis=1).max())


def measured(
    name: str, changes: dict, own: np.ndarray, full: np.ndarray, repeats: int
) -> list[Run]:
    """The run with these changes; none if it diverges, or has too few quadrature points for its
    coordinates."""
    scene = scene_of(name).replace(changes)
    integrator, step = scene.integrator, scene.integrator.step
    try:
        model = ste.build_model(scene, "scene")
    except ste.ConfigurationError:
        return []

    def simulate() -> ste.Trajectory:
        return ste.simulate(model, tension_table(step), DURATION, step)

    try:
        motion = simulate()
    except ste.SimulationDiverged:
        return []
    to_own, to_full = (
        largest_distance(motion.tip_pose[:, :3, 3], reference) for reference in (own, full)
    )
    cpu = float(np.median(cpu_times(simulate, repeats))) / DURATION
    return [
        Run(
            name,
            model.coordinate_count,
            integrator.columns,
            step,
            model.grid.per_piece,
            cpu,
            to_own,
            to_full,
        )
    ]


def front(runs: Iterable[Run], distance: str, nearer: float = 0.95) -> list[Run]:
    """Those than which no other is both cheaper and nearer, cheapest first, each at most `nearer`
    times as far off as the one before."""
    best: list[Run] = []
    for run in sorted(runs, key=lambda run: (run.cpu, getattr(run, distance))):
        if not best or getattr(run, distance) < nearer * getattr(best[-1], distance):
            best.append(run)
    return best


def table_of(runs: list[Run]) -> str:
    """Scenes as they ship, and the best settings of all for the distance to the converged
    reference."""
    best = [run for run in front(runs, "full", 0.5) if not is_as_shipped(run) and run.full < WORST]
    rows = [("shipped", run) for run in runs if is_as_shipped(run)] + [
        ("best", run) for run in best
    ]
    header = (
        "",
        "model",
        "columns, step, intervals",
        "CPU [ms/s]",
        "to own [mm]",
        "to reference [mm]",
    )
    return markdown_table(
        header, [(kind, run.model, run.setting, *run.row()[-3:]) for kind, run in rows]
    )


def is_as_shipped(run: Run) -> bool:
    scene = scene_of(run.model)
    integrator = scene.integrator
    shipped = (
        extrapolation_columns(scene),
        integrator.step,
        ste.build_model(scene, "scene").grid.per_piece,
    )
    return shipped == (run.columns, run.step, run.intervals)


def draw(runs: list[Run], picture: Path) -> None:
    figure, panels = plt.subplots(1, 2, figsize=(13, 5.5), constrained_layout=True)
    titles = {
        "own": "From the model's own converged solution",
        "full": "From the converged reference (72 coordinates)",
    }
    for axes, (distance, title) in zip(panels, titles.items(), strict=True):
        for name, colour in MODELS.items():
            draw_model(axes, [run for run in runs if run.model == name], distance, colour)
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="CPU time per simulated second [ms]",
            ylabel="largest tip distance [mm], arm of 1 m",
        )
        axes.set_title(title)
        axes.grid(which="both", alpha=0.2)
        handles, labels = axes.get_legend_handles_labels()
        unique = dict(zip(labels, handles, strict=True))
        axes.legend(unique.values(), unique.keys(), frameon=False, loc="lower left", fontsize=8)
    figure.suptitle(
        "Accuracy against time: a dot for every setting, a line through the best of each model"
    )
    write_picture(figure, picture, dpi=110)


def draw_model(axes: plt.Axes, runs: list[Run], distance: str, colour: str) -> None:
    if not runs:
        return
    axes.scatter(*milliseconds_and_millimetres(runs, distance), s=8, color=colour, alpha=0.4)
    best = milliseconds_and_millimetres(front(runs, distance), distance)
    axes.plot(
        *best,
        color=colour,
        linewidth=2,
        label=f"{runs[0].model}: {runs[0].coordinates} coordinates",
    )


def milliseconds_and_millimetres(runs: Iterable[Run], distance: str) -> np.ndarray:
    """(2, runs)."""
    return 1e3 * np.array([(run.cpu, getattr(run, distance)) for run in runs]).reshape(-1, 2).T


if __name__ == "__main__":
    main()
