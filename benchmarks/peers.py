"""This package beside MuJoCo, PyElastica and SoRoMoX on the paper's arm: accuracy against CPU time,
and abrupt tensions.

    make peers, or python benchmarks/peers.py [--peers own mujoco ...] [--quick]
    [--out out] where the extra `peers` is installed

The models, inputs, errors and times that are compared: docs/appendix/peers.md and the files of
benchmarks/_peers. The reference has all six strains by polynomials of order 5 on each half of the
arm, 72 coordinates; this package integrates it with 24 intervals per half, 4 columns and steps of
0.5 ms. Its error bar is the larger of its distances to order 6 and to steps of 1 ms.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

from collections.abc import Iterable, Iterator
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _peers.own import explicit
from _peers.simulator import HOLD, Array, Motion, Setting, Simulator
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.input_motions import motion_tensions

SIMULATORS = {
    "own": "own",
    "mujoco": "mujoco_chain",
    "pyelastica": "elastica_rod",
    "soromox": "soromox_strains",
}
"""Modules of benchmarks/_peers, by what --peers takes."""
COLOURS = {
    "soft_tendon_env": "#d1495b",
    "MuJoCo": "#2e6f95",
    "PyElastica": "#66a182",
    "SoRoMoX": "#edae49",
}
MOTIONS = ("smooth", "step", "redrawn")
SEED = 0
INTEGRATION = {"quadrature.intervals": 24, "integrator.columns": 4, "integrator.step": 5e-4}
FULL_PHYSICS = {"strain": explicit(5), **INTEGRATION}
ERROR_BARS = ({"strain": explicit(6), **INTEGRATION}, {**FULL_PHYSICS, "integrator.step": 1e-3})
QUICK = {
    "strain": explicit(2),
    "quadrature.intervals": 4,
}  # in place of full physics and its error bars
ABRUPT = {"100 N on one tendon": (1,), "150 N on all tendons": tuple(range(1, 11))}
"""Tendons of the hard inputs, held from rest for HARD_SECONDS."""
HARD_SECONDS = 0.4
LEVELS = (10.0, 5.0, 2.0, 0.5)
"""Errors [mm] that the summary asks the cheapest setting for."""
HEADER = ("simulator", "setting", "input", "simulated [s]", "error [mm]", "CPU [ms/s]", "told")


class Input(NamedTuple):
    """A table of tensions and where full physics goes under it."""

    tensions: Array  # (rows, n_a) [N]
    tip: Array | None  # (rows + 1, 3) [m]; None where full physics has no solution either
    error_bar: float  # [m]


class Measured(NamedTuple):
    """One setting on one input."""

    simulator: str
    setting: str
    input: str
    seconds: float  # simulated
    error: float  # [m]; infinite where a tip is not finite
    cpu: float  # CPU seconds per simulated second
    told: str
    restarted: bool

    def row(self) -> tuple[object, ...]:
        return (
            self.simulator,
            self.setting,
            self.input,
            f"{self.seconds:g}",
            millimetres(self.error),
            f"{1e3 * self.cpu:.4g}",
            self.told,
        )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--peers",
        nargs="+",
        choices=SIMULATORS,
        default=tuple(SIMULATORS),
        help="simulators to measure",
    )
    arguments = parser.parse_args()
    simulators, missing = load(arguments.peers)
    for name, why in missing.items():
        print(f"{name} is left out: {why}")
    usual, hard = usual_inputs(arguments.quick), hard_inputs(arguments.quick)
    runs = [
        run
        for simulator in simulators.values()
        for run in measure_all(simulator, usual, hard, arguments.quick)
    ]
    write_csv(arguments.out / "peers.csv", HEADER, [run.row() for run in runs])
    draw(runs, arguments.out / "peers.png")
    write_tables(
        arguments.out / "peers.md",
        tables(runs, {**usual, **hard}, simulators, missing),
    )


def load(names: Iterable[str]) -> tuple[dict[str, Simulator], dict[str, str]]:
    """The modules that can be imported, and why the others cannot."""
    found: dict[str, Any] = {}
    missing = {}
    for name in names:
        try:
            module = import_module(f"_peers.{SIMULATORS[name]}")
        except ImportError as error:
            missing[name] = f"{error}"
        else:
            found[module.NAME] = module
    return found, missing


def usual_inputs(quick: bool) -> dict[str, Input]:
    scene, seconds = ste.load_scene("paper"), 0.2 if quick else 2.0
    return {
        motion: with_reference(motion_tensions(scene, motion, SEED, seconds), quick)
        for motion in MOTIONS
    }


def hard_inputs(quick: bool) -> dict[str, Input]:
    rows, inputs = round((0.06 if quick else HARD_SECONDS) / HOLD), {}
    for name, tendons in ABRUPT.items():
        tensions = np.zeros((rows, 10))
        tensions[:, np.array(tendons) - 1] = float(name.split()[0])
        inputs[name] = with_reference(tensions, quick)
    return inputs


def with_reference(tensions: Array, quick: bool) -> Input:
    try:
        tip, *others = (
            tips(tensions, changes)
            for changes in ((QUICK,) if quick else (FULL_PHYSICS, *ERROR_BARS))
        )
    except ste.SimulationDiverged:
        return Input(tensions, None, np.nan)
    return Input(
        tensions, tip, max((largest_distance(tip, other) for other in others), default=np.nan)
    )


def tips(tensions: Array, changes: dict[str, Any]) -> Array:
    """Tip positions (rows + 1, 3) [m] of this package's model with these changes of the scene."""
    model = ste.build_model(ste.load_scene("paper").replace(changes), "scene")
    return ste.simulate(model, tensions, HOLD * len(tensions), HOLD).tip_pose[:, :3, 3]


def largest_distance(tip: Array, reference: Array) -> float:
    """Largest distance [m] between tips at the same times; infinite where one is not finite."""
    distance = np.linalg.norm(tip - reference[: len(tip)], axis=1)
    return float(distance.max()) if np.isfinite(distance).all() else np.inf


def measure_all(
    simulator: Simulator, usual: dict[str, Input], hard: dict[str, Input], quick: bool
) -> Iterator[Measured]:
    """All settings on the usual inputs, some of them on the hard ones too."""
    robust = simulator.QUICK[:1] if quick else simulator.HARD
    settings = simulator.QUICK if quick else simulator.settings()
    for setting in tqdm(dict.fromkeys((*settings, *robust)), desc=simulator.NAME):
        yield from measure(simulator, setting, {**usual, **hard} if setting in robust else usual)


def measure(simulator: Simulator, setting: Setting, inputs: dict[str, Input]) -> Iterator[Measured]:
    """The setting on all inputs; nothing where the simulator has no model with it."""
    run = simulator.prepare(ste.load_scene("paper"), setting)
    if run is None:
        return
    for name, given in inputs.items():
        rows = min(len(given.tensions), round(simulator.SECONDS / HOLD))
        motion: Motion = run(given.tensions[:rows])
        finite = bool(np.isfinite(motion.tip).all())
        error = (
            np.inf
            if not finite
            else np.nan
            if given.tip is None
            else largest_distance(motion.tip, given.tip)
        )
        seconds = HOLD * rows
        yield Measured(
            simulator.NAME,
            setting.label,
            name,
            seconds,
            error,
            motion.cpu,
            motion.told,
            motion.restarted,
        )


def front(runs: Iterable[Measured]) -> list[Measured]:
    """Those than which no other is both cheaper and nearer, cheapest first."""
    best: list[Measured] = []
    for run in sorted(
        (run for run in runs if np.isfinite(run.error)), key=lambda run: (run.cpu, run.error)
    ):
        if not best or run.error < 0.95 * best[-1].error:  # 5 %: what is worth a row
            best.append(run)
    return best


def of(runs: Iterable[Measured], simulator: str, name: str) -> list[Measured]:
    return [run for run in runs if run.simulator == simulator and run.input == name]


def millimetres(distance: float) -> str:
    return (
        "not finite"
        if np.isinf(distance)
        else "-"
        if np.isnan(distance)
        else f"{1e3 * distance:.3g}"
    )


def milliseconds(cpu: float) -> str:
    """About three digits."""
    return f"{1e3 * cpu:,.{2 if cpu < 0.01 else 1 if cpu < 0.1 else 0}f}"


def tables(
    runs: list[Measured],
    inputs: dict[str, Input],
    simulators: dict[str, Simulator],
    missing: dict[str, str],
) -> str:
    """The tables of the page, as Markdown."""
    versions = ", ".join(
        f"{name} {metadata.version(simulator.DISTRIBUTION)}"
        for name, simulator in simulators.items()
    )
    bars = ", ".join(f"{name} {millimetres(given.error_bar)} mm" for name, given in inputs.items())
    left_out = "".join(f" Not measured: {name} ({why})." for name, why in missing.items())
    return "\n\n".join(
        [
            f"{versions}.{left_out}",
            summary(runs, list(simulators)),
            hard_table(runs, list(simulators)),
            f"Error bars: {bars}.",
        ]
    )


def summary(runs: list[Measured], simulators: list[str]) -> str:
    """A row per input and error; CPU times of the others with how many times that of the first
    simulator they are."""
    rows = []
    for name in MOTIONS:
        for level in LEVELS:
            first, *others = (
                cheapest(of(runs, simulator, name), level) for simulator in simulators
            )
            if first or any(others):
                rows.append(
                    (
                        name,
                        f"{level:g}",
                        in_times(first, None),
                        *(in_times(cpu, first) for cpu in others),
                    )
                )
    return markdown_table(("input", "within [mm]", *simulators), rows)


def cheapest(runs: Iterable[Measured], level: float) -> float | None:
    """CPU seconds per simulated second of the cheapest run within the error [mm]."""
    return min((run.cpu for run in runs if 1e3 * run.error <= level), default=None)


def in_times(cpu: float | None, first: float | None) -> str:
    """CPU time [ms/s], and as a multiple of `first` where there is one."""
    if cpu is None:
        return "-"
    return (
        milliseconds(cpu)
        if first is None
        else f"{milliseconds(cpu)} ({cpu / first:,.{int(cpu < 10 * first)}f}x)"
    )


def hard_table(runs: list[Measured], simulators: list[str]) -> str:
    """A row per setting: errors on all inputs, or what happened instead."""
    names, rows = (*MOTIONS, *ABRUPT), []
    for simulator in simulators:
        for setting in dict.fromkeys(
            run.setting for run in runs if run.simulator == simulator and run.input in ABRUPT
        ):
            here = {
                run.input: run
                for run in runs
                if (run.simulator, run.setting) == (simulator, setting)
            }
            rows.append((simulator, setting, *(outcome(here[name]) for name in names)))
    return markdown_table(("simulator", "setting", *(f"{name} [mm]" for name in names)), rows)


def outcome(run: Measured) -> str:
    """Error [mm] of a run, or a word for what became of it; a star: the simulator said so."""
    word = (
        "restarted"
        if run.restarted
        else "stopped"
        if np.isinf(run.error) and np.isnan(run.cpu)
        else millimetres(run.error)
    )
    return f"{word}{'*' * bool(run.told)}"


def draw(runs: list[Measured], picture: Path) -> None:
    figure, panels = plt.subplots(
        1, len(MOTIONS), figsize=(15, 5.5), constrained_layout=True, sharex=True, sharey=True
    )
    longest = max(run.seconds for run in runs)
    for axes, name in zip(panels, MOTIONS, strict=True):
        for simulator in dict.fromkeys(run.simulator for run in runs):
            found = [run for run in of(runs, simulator, name) if np.isfinite(run.error)]
            whole = all(run.seconds == longest for run in found)
            colour, label = (
                COLOURS[simulator],
                (
                    simulator
                    if whole
                    else f"{simulator}, first {found[0].seconds:g} s"
                    if found
                    else simulator
                ),
            )
            for chosen, style in ((found, {"s": 10, "alpha": 0.3}), (front(found), {"s": 26})):
                axes.scatter(
                    *points(chosen),
                    color=colour,
                    facecolors=colour if whole else "none",
                    linewidths=1.2,
                    **style,
                )
            axes.plot(
                *points(front(found)),
                color=colour,
                linewidth=2,
                linestyle="-" if whole else ":",
                label=label,
            )
        axes.set(
            xscale="log", yscale="log", xlabel="CPU time per simulated second [ms]", title=name
        )
        axes.axvline(1e3, color="black", linewidth=0.8, alpha=0.5)
        axes.grid(which="both", alpha=0.2)
    panels[0].set_ylabel("largest tip distance from the reference [mm], arm of 1 m")
    panels[0].legend(frameon=False, loc="upper right", fontsize=9)
    figure.suptitle(
        "A dot for every setting, a line through the best of each simulator; right of the vertical"
        " line: slower than the arm"
    )
    write_picture(figure, picture, dpi=110)


def points(runs: Iterable[Measured]) -> Array:
    """CPU time [ms/s] and error [mm], (2, runs)."""
    return 1e3 * np.array([(run.cpu, run.error) for run in runs]).reshape(-1, 2).T


if __name__ == "__main__":
    main()
