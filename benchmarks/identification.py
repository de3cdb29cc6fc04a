"""Coverage of the intervals of an identification: how often they hold the truth in simulated
experiments with noise.

    python benchmarks/identification.py [--experiments 100] [--fidelity fine] [--quick] [--out out]

Each experiment draws another hanging arm with three tendons (stiffness and density within 30 %),
whose model is "fine", and 20 holds with noise of 0.5 mm in every marker coordinate. Young's
modulus, density and Poisson's ratio are asked for; bending does not show the last.
"""

import argparse
import functools
import time
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture

from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.identification.fit import fit, intervals
from soft_tendon_env.identification.markers import Marker, MarkerSet
from soft_tendon_env.identification.parameters import read_parameters
from soft_tendon_env.identification.readings import Plants, Readings
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.model.build import build_model
from soft_tendon_env.scene.file import load_scene

ASKED = ("segments.*.young_modulus", "segments.*.density", "segments.*.poisson_ratio")
HOLDS = 20
NOISE = 5e-4  # [m]
LARGEST = 4.0  # tension [N]
SPREAD = 0.3  # of the logarithms of the first two
NU = 0.9  # of the scene's Poisson ratio
HEADER = (
    "model",
    "parameter",
    "truth in the interval",
    "median width",
    "told to be unseen",
    "CPU s each",
)


class Tried(NamedTuple):
    """One experiment: whether intervals hold the truth, their widths in parts of it, whether
    parameters are told to be unseen."""

    hit: np.ndarray
    width: np.ndarray
    unseen: np.ndarray
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--experiments", type=int, default=100)
    parser.add_argument("--fidelity", nargs="+", default=["fine"])
    parser.add_argument("--quick", action="store_true", help="two experiments, one fidelity")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    count, fidelities = (
        (2, ["fine"]) if arguments.quick else (arguments.experiments, arguments.fidelity)
    )
    print(f"{machine()}; {count} experiments\n")
    tried = {
        fidelity: [experiment(fidelity, seed) for seed in range(count)] for fidelity in fidelities
    }
    rows = [row for fidelity, found in tried.items() for row in table(fidelity, found)]
    print(markdown_table(HEADER, rows))
    write_csv(arguments.out / "identification.csv", HEADER, rows)
    draw(tried, arguments.out / "identification.png")


def markers() -> MarkerSet:
    """Three markers off the axis."""
    offsets = ((0.0, 0.0, 0.012), (0.0, 0.012, 0.0), (0.0, 0.0, 0.012))
    return MarkerSet(
        markers={
            f"m{i}": Marker(arc_length=0.1 * (i + 1), offset=offset)
            for i, offset in enumerate(offsets)
        }
    )


@functools.cache
def plants(fidelity: str) -> Plants:
    """Arms at a fidelity, by the parameters that are asked for."""
    scene = load_scene("three_tendon").replace({"effects.gravity.acceleration": [9.81, 0.0, 0.0]})
    accurate = at_fidelity(scene, fidelity)
    placed = markers()
    return Plants(accurate, build_model(accurate), placed, read_parameters(ASKED, accurate, placed))


def experiment(fidelity: str, seed: int) -> Tried:
    """An arm, its holds, and the estimate from them."""
    random = np.random.default_rng(seed)
    robot = plants("fine")
    x = np.array([*random.uniform(-SPREAD, SPREAD, 2), np.log(NU)])
    command = random.uniform(0.0, LARGEST, (HOLDS, 3))
    command[np.arange(HOLDS), random.integers(3, size=HOLDS)] = 0.0
    still = [
        Recording(f"{i}", "simulated", u[None], np.zeros((1, 3, 3)), 0.0, {})
        for i, u in enumerate(command)
    ]
    positions = Readings(robot, still).positions(x)
    positions = positions + NOISE * random.normal(size=positions.shape)
    holds = [
        Recording(own.name, own.where, own.command, at[None], 0.0, {})
        for own, at in zip(still, positions, strict=True)
    ]
    model = plants(fidelity)
    start = time.process_time()
    readings = Readings(model, holds)
    found = fit(readings)
    spread = intervals(found, readings)
    truth = np.array([own.at(at) for own, at in zip(model.parameters, x, strict=True)])
    hit = (spread.low <= truth) & (truth <= spread.high)
    return Tried(
        hit, (spread.high - spread.low) / truth, ~spread.identified, time.process_time() - start
    )


def table(fidelity: str, found: list[Tried]) -> list[tuple[str, ...]]:
    """A row for each parameter."""
    hit, unseen = (
        np.sum([getattr(own, name) for own in found], axis=0) for name in ("hit", "unseen")
    )
    width = np.median([own.width for own in found], axis=0)
    seconds = np.median([own.seconds for own in found])
    return [
        (
            fidelity,
            name,
            f"{hit[i]} of {len(found)}",
            f"{100 * width[i]:.1f} %",
            f"{unseen[i]} of {len(found)}",
            f"{seconds:.2f}",
        )
        for i, name in enumerate(ASKED)
    ]


def draw(tried: dict[str, list[Tried]], path: Path) -> None:
    """Share of intervals that hold the truth."""
    figure, axes = plt.subplots(figsize=(7.0, 3.5), constrained_layout=True)
    for place, (fidelity, found) in enumerate(tried.items()):
        share = np.mean([own.hit for own in found], axis=0)
        axes.bar(np.arange(len(ASKED)) + 0.3 * place, share, 0.28, label=fidelity)
    axes.axhline(0.95, color="black", linewidth=0.8)
    axes.set_xticks(range(len(ASKED)), ASKED, fontsize=8)
    axes.set(ylabel="intervals that hold the truth", ylim=(0.0, 1.05))
    axes.legend()
    write_picture(figure, path)


if __name__ == "__main__":
    main()
