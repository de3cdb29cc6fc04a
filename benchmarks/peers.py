"""Accuracy against CPU time on the paper's arm: settings of this package, MuJoCo, PyElastica and
SoRoMoX; and abrupt tensions.

    make peers, or python benchmarks/peers.py [--peers own mujoco ...] [--quick] [--out out]
    where the extra `peers` is installed

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
from _peers import own
from _peers.simulator import HOLD, Array, Motion, Setting, Simulator
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from matplotlib.axes import Axes
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
OWN = "#d1495b"
PEER_LINES = {"MuJoCo": "o-", "PyElastica": "s--", "SoRoMoX": "^:"}
MOTIONS = ("smooth", "step", "redrawn")
SEED = 0
INTEGRATION = {"quadrature.intervals": 24, "integrator.columns": 4, "integrator.step": 5e-4}
FULL_PHYSICS = {"strain": own.explicit(5), **INTEGRATION}
ERROR_BARS = ({"strain": own.explicit(6), **INTEGRATION}, {**FULL_PHYSICS, "integrator.step": 1e-3})
QUICK = {
    "strain": own.explicit(2),
    "quadrature.intervals": 4,
}  # in place of full physics and its error bars
ABRUPT = {"100 N on one tendon": (1,), "150 N on all tendons": tuple(range(1, 11))}
"""Tendons of the hard inputs, held from rest for HARD_SECONDS."""
HARD_SECONDS = 0.4
LEVELS = (10.0, 5.0, 2.0, 0.5)
"""Errors [mm] that the summary asks the cheapest setting for."""
WORTH_A_ROW = 0.95
"""Greatest share of the error of the one before that the next best setting may have."""
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
    usual = usual_inputs(arguments.quick)
    hard = hard_inputs(arguments.quick)
    runs = list[Measured]()
    for simulator in simulators.values():
        runs += measure_all(simulator, usual, hard, arguments.quick)
    write_csv(arguments.out / "peers.csv", HEADER, [run.row() for run in runs])
    draw(runs, arguments.out / "peers.png")
    write_tables(
        arguments.out / "peers.md",
        tables(runs, {**usual, **hard}, simulators, missing),
    )


def load(names: Iterable[str]) -> tuple[dict[str, Simulator], dict[str, str]]:
    """The modules that can be imported, and why the others cannot."""
    simulators: dict[str, Any] = {}
    missing = {}
    for name in names:
        try:
            module = import_module(f"_peers.{SIMULATORS[name]}")
        except ImportError as error:
            missing[name] = f"{error}"
        else:
            simulators[module.NAME] = module
    return simulators, missing


def usual_inputs(quick: bool) -> dict[str, Input]:
    """The inputs of MOTIONS, with their references."""
    scene = ste.load_scene("paper")
    seconds = 0.2 if quick else 2.0
    inputs = {}
    for motion in MOTIONS:
        tensions = motion_tensions(scene, motion, SEED, seconds)
        inputs[motion] = with_reference(tensions, quick)
    return inputs


def hard_inputs(quick: bool) -> dict[str, Input]:
    """The inputs of ABRUPT, with their references."""
    seconds = 0.06 if quick else HARD_SECONDS
    inputs = {}
    for name, tendons in ABRUPT.items():
        tensions = np.zeros((round(seconds / HOLD), 10))
        columns = np.array(tendons) - 1
        tensions[:, columns] = float(name.split()[0])
        inputs[name] = with_reference(tensions, quick)
    return inputs


def with_reference(tensions: Array, quick: bool) -> Input:
    """The input with the tips of full physics, and how far finer models differ from them."""
    models = (QUICK,) if quick else (FULL_PHYSICS, *ERROR_BARS)
    try:
        reference, *others = (tips(tensions, changes) for changes in models)
    except ste.SimulationDiverged:
        return Input(tensions, None, np.nan)
    distances = [largest_distance(reference, other) for other in others]
    return Input(tensions, reference, max(distances, default=np.nan))


def tips(tensions: Array, changes: dict[str, Any]) -> Array:
    """Tip positions (rows + 1, 3) [m] of this package's model with these changes of the scene."""
    model = ste.build_model(ste.load_scene("paper").replace(changes), "scene")
    motion = ste.simulate(model, tensions, HOLD * len(tensions), HOLD)
    return motion.tip_pose[:, :3, 3]


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
        inputs = {**usual, **hard} if setting in robust else usual
        yield from measure(simulator, setting, inputs)


def measure(simulator: Simulator, setting: Setting, inputs: dict[str, Input]) -> Iterator[Measured]:
    """The setting on all inputs; nothing where the simulator has no model with it."""
    run = simulator.prepare(ste.load_scene("paper"), setting)
    if run is None:
        return
    longest = round(simulator.SECONDS / HOLD)
    for name, case in inputs.items():
        rows = min(len(case.tensions), longest)
        motion: Motion = run(case.tensions[:rows])
        yield Measured(
            simulator.NAME,
            setting.label,
            name,
            HOLD * rows,
            error_of(motion, case),
            motion.cpu,
            motion.told,
            motion.restarted,
        )


def error_of(motion: Motion, case: Input) -> float:
    """Largest distance [m] of the tip from the reference: infinite where the motion is not finite,
    NaN without a reference."""
    if not np.isfinite(motion.tip).all():
        return np.inf
    if case.tip is None:
        return np.nan
    return largest_distance(motion.tip, case.tip)


def front(runs: Iterable[Measured]) -> list[Measured]:
    """Those than which no other is both cheaper and nearer, cheapest first."""
    finite = [run for run in runs if np.isfinite(run.error)]
    best: list[Measured] = []
    for run in sorted(finite, key=lambda run: (run.cpu, run.error)):
        if not best or run.error < WORTH_A_ROW * best[-1].error:
            best.append(run)
    return best


def select(runs: Iterable[Measured], simulator: str, name: str) -> list[Measured]:
    """Runs of a simulator on an input, but those of what users choose."""
    choices = [choice.label for choice in own.CHOICES]
    of_input = [run for run in runs if run.simulator == simulator and run.input == name]
    return [run for run in of_input if run.setting not in choices]


def millimetres(distance: float) -> str:
    """Text of a distance [m]."""
    if np.isinf(distance):
        return "not finite"
    return "-" if np.isnan(distance) else f"{1e3 * distance:.3g}"


def milliseconds(cpu: float) -> str:
    """Text of a time [s], of about three digits."""
    digits = 0
    if cpu < 0.1:
        digits = 1
    if cpu < 0.01:
        digits = 2
    return f"{1e3 * cpu:,.{digits}f}"


def tables(
    runs: list[Measured],
    inputs: dict[str, Input],
    simulators: dict[str, Simulator],
    missing: dict[str, str],
) -> str:
    """The tables of the page, as Markdown."""
    versions = []
    for name, simulator in simulators.items():
        versions.append(f"{name} {metadata.version(simulator.DISTRIBUTION)}")
    intro = f"{', '.join(versions)}."
    for name, why in missing.items():
        intro += f" Not measured: {name} ({why})."
    bars = [f"{name} {millimetres(case.error_bar)} mm" for name, case in inputs.items()]
    parts = [intro, summary(runs, list(simulators)), hard_table(runs, list(simulators))]
    parts += [f"Error bars of the reference: {', '.join(bars)}.", settings_table(runs)]
    return "\n\n".join(parts)


def summary(runs: list[Measured], simulators: list[str]) -> str:
    """A row per input and error; CPU times of the others with how many times that of the first
    simulator they are."""
    rows = []
    for name in MOTIONS:
        for level in LEVELS:
            times = []
            for simulator in simulators:
                run = cheapest(select(runs, simulator, name), level)
                times.append(None if run is None else run.cpu)
            if not any(times):
                continue
            first, *others = times
            cells = [in_times(first, None), *(in_times(cpu, first) for cpu in others)]
            rows.append((name, f"{level:g}", *cells))
    return markdown_table(("input", "within [mm]", *simulators), rows)


def settings_table(runs: list[Measured]) -> str:
    """A row per input and error: this package's cheapest setting."""
    rows = []
    for name in MOTIONS:
        for level in LEVELS:
            run = cheapest(select(runs, own.NAME, name), level)
            if run is not None:
                cost = milliseconds(run.cpu)
                rows.append((name, f"{level:g}", run.setting, cost, millimetres(run.error)))
    header = ("input", "within [mm]", f"setting of {own.NAME}", "CPU [ms/s]", "error [mm]")
    return markdown_table(header, rows)


def cheapest(runs: Iterable[Measured], level: float) -> Measured | None:
    """The cheapest run within the error [mm]."""
    within = [run for run in runs if 1e3 * run.error <= level]
    return min(within, key=lambda run: run.cpu, default=None)


def in_times(cpu: float | None, first: float | None) -> str:
    """CPU time [ms/s], and as a multiple of `first` where there is one."""
    if cpu is None:
        return "-"
    if first is None:
        return milliseconds(cpu)
    digits = 1 if cpu < 10 * first else 0
    return f"{milliseconds(cpu)} ({cpu / first:,.{digits}f}x)"


def hard_table(runs: list[Measured], simulators: list[str]) -> str:
    """A row per setting: errors on all inputs, or what happened instead."""
    names = (*MOTIONS, *ABRUPT)
    rows = []
    for simulator in simulators:
        of_simulator = [run for run in runs if run.simulator == simulator]
        settings = dict.fromkeys(run.setting for run in of_simulator if run.input in ABRUPT)
        for setting in settings:
            by_input = {run.input: run for run in of_simulator if run.setting == setting}
            rows.append((simulator, setting, *(outcome(by_input[name]) for name in names)))
    return markdown_table(("simulator", "setting", *(f"{name} [mm]" for name in names)), rows)


def outcome(run: Measured) -> str:
    """Error [mm] of a run, or a word for what became of it; a star: the simulator said so."""
    word = millimetres(run.error)
    if run.restarted:
        word = "restarted"
    elif np.isinf(run.error) and np.isnan(run.cpu):
        word = "stopped"
    star = "*" if run.told else ""
    return f"{word}{star}"


def draw(runs: list[Measured], picture: Path) -> None:
    """Errors over CPU times, a panel per input: this package's settings as a cloud, what users
    choose as named marks, the best settings of the other simulators as lines."""
    figure, panels = plt.subplots(
        1, len(MOTIONS), figsize=(13, 5), constrained_layout=True, sharex=True, sharey=True
    )
    longest = max(run.seconds for run in runs)
    for axes, name in zip(panels, MOTIONS, strict=True):
        for simulator in dict.fromkeys(run.simulator for run in runs):
            measured = select(runs, simulator, name)
            if simulator == own.NAME:
                axes.scatter(*points(measured), s=9, color=OWN, alpha=0.25, linewidths=0)
                axes.plot(*points(front(measured)), color=OWN, label=f"{simulator}, best settings")
            else:
                draw_peer(axes, simulator, measured, longest)
        draw_choices(axes, [run for run in runs if run.input == name])
        axes.set(
            xscale="log", yscale="log", xlabel="CPU time per simulated second [ms]", title=name
        )
        axes.axvline(1e3, color="black", linewidth=0.8, alpha=0.5)
        axes.annotate(
            "slower than real time",
            (1e3, 0.0),
            xycoords=axes.get_xaxis_transform(),
            xytext=(4, 6),
            textcoords="offset points",
            rotation=90,
            fontsize=8,
        )
        axes.grid(alpha=0.2)
    panels[0].set_ylabel("largest tip error [mm], arm of 1 m")
    panels[0].legend(frameon=False, loc="upper right", fontsize=9)
    write_picture(figure, picture, dpi=110)


def draw_peer(axes: Axes, simulator: str, runs: list[Measured], longest: float) -> None:
    """Line through the best settings of another simulator, which may have simulated less than
    `longest` [s]."""
    best = front(runs)
    if best:
        seconds = best[0].seconds
        label = simulator if seconds == longest else f"{simulator}, first {seconds:g} s"
        axes.plot(*points(best), PEER_LINES[simulator], color="0.5", markersize=4, label=label)


def draw_choices(axes: Axes, runs: list[Measured]) -> None:
    """Named marks of what users choose."""
    labels = {choice.label: choice.name for choice in own.CHOICES}
    chosen = [run for run in runs if run.setting in labels and np.isfinite(run.error)]
    axes.scatter(*points(chosen), s=60, marker="*", color="black", zorder=3)
    for run in chosen:
        name = labels[run.setting]
        is_length = name.endswith("mm")
        axes.annotate(
            f'"{name}"',
            (1e3 * run.cpu, 1e3 * run.error),
            # lengths stand to the right, presets to the left: both follow one line
            xytext=(7, 3) if is_length else (-7, -9),
            textcoords="offset points",
            horizontalalignment="left" if is_length else "right",
            fontsize=9,
            fontweight="bold",
            zorder=4,
        )


def points(runs: Iterable[Measured]) -> Array:
    """CPU time [ms/s] and error [mm], (2, runs)."""
    return 1e3 * np.array([(run.cpu, run.error) for run in runs]).reshape(-1, 2).T


if __name__ == "__main__":
    main()
