"""Error that each preset keeps on twelve arms that do not ship: a section of
docs/appendix/accuracy.md.

    python benchmarks/own_arms.py [--arms spring ...] [--quick] [--out out]

Largest distance of the tip from full physics, at rest under twelve sets of tensions within limits
and over 2 s in two motions of each usual kind, none of which the trial had. The trial's CPU time is
that of one thread; CPU of a step is that of 20 ms in `simulate`.
"""

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from cycler import cycler
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.coordinate_search import search
from soft_tendon_env.accuracy.fidelity import PRESETS, accuracy_of
from soft_tendon_env.accuracy.input_motions import HOLD, USUAL, motion_tensions
from soft_tendon_env.accuracy.reference import distance, reference_motions, tip_path
from soft_tendon_env.scene.scene import Scene, rod_length

RESTS = 12
SEEDS = range(100, 102)
REFERENCE = 1e-4  # share of the length
COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b")
SHOWN = "standard"  # in the page's table; the CSV file and the picture have all presets
HEADER = (
    "arm",
    "fidelity",
    "asked [%]",
    "at rest [%]",
    "in motion [%]",
    "coordinates",
    "intervals",
    "trial [s]",
    "CPU of a step [µs]",
)


def rod(
    length: float,
    young_modulus: float,
    radius: object,
    density: float = 1100.0,
    damping: float = 0.01,
    **more: object,
) -> dict[str, object]:
    """A segment; damping: as a share of Young's modulus [s]."""
    material = {
        "young_modulus": young_modulus,
        "poisson_ratio": 0.45,
        "density": density,
        "damping": damping * young_modulus,
    }
    return {"length": length, "radius": radius, **material, **more}


def around(
    offset: float, limits: tuple[float, float], count: int = 3, **more: object
) -> list[dict[str, object]]:
    """Straight tendons evenly around the axis."""
    angles = 2.0 * np.pi * np.arange(count) / count
    offsets = [[float(offset * np.cos(angle)), float(offset * np.sin(angle))] for angle in angles]
    return [
        {"routing": {"type": "straight", "offset": place}, "tension_limits": limits, **more}
        for place in offsets
    ]


def helix(rate: float, phase: float) -> dict[str, object]:
    return {
        "routing": {"type": "helix", "radius": 0.006, "angular_rate": rate, "phase": phase},
        "tension_limits": (0.0, 6.0),
    }


def spring(
    gravity: tuple[float, float, float], turns: float = 3.0, length: float = 0.6, pitch: float = 0.2
) -> dict[str, object]:
    """A wire of several turns under its weight."""
    rate = 2.0 * np.pi * turns / length
    curvature = (rate * float(np.sin(pitch)), 0.0, rate * float(np.cos(pitch)))
    tendons = around(0.002, (0.0, 1.0), 4)[:2]
    return {
        "segments": [rod(length, 2e7, 0.004, damping=5e-5, curvature=curvature)],
        "tendons": tendons,
        "effects": weight(*gravity),
    }


def weight(*gravity: float) -> dict[str, object]:
    return {"gravity": {"acceleration": gravity}}


ARMS: dict[str, dict[str, object]] = {
    "stocky, force at the tip": {
        "segments": [rod(0.3, 1e6, 0.025)],
        "tendons": around(0.02, (0.0, 60.0)),
        "effects": {"tip_load": {"force": (0.0, 0.0, -5.0)}},
    },
    "sags": {
        "segments": [rod(0.3, 3e5, 0.012, damping=0.02)],
        "tendons": around(0.009, (0.0, 4.0)),
        "effects": weight(0.0, 0.0, -9.81),
    },
    "helices, hangs": {
        "segments": [rod(0.3, 4e5, 0.01)],
        "tendons": [helix(41.9, 0.0), helix(-41.9, 90.0), *around(0.006, (0.0, 6.0))],
        "effects": weight(9.81, 0.0, 0.0),
    },
    "two materials": {
        "segments": [rod(0.2, 2e6, 0.014), rod(0.15, 4e5, 0.009, 950.0)],
        "tendons": [*around(0.01, (0.0, 12.0), end=0.2), *around(0.007, (0.0, 3.0))],
        "effects": weight(0.0, 9.81, 0.0),
    },
    "steel backbone": {
        "segments": [rod(0.5, 207e9, 0.001, 8000.0, damping=5e-4)],
        "tendons": around(0.02, (0.0, 100.0), 4),
        "effects": weight(0.0, 0.0, -9.81),
    },
    "spring, hangs": spring((9.81, 0.0, 0.0)),
    "spring, across": spring((0.0, 9.81, 0.0)),
    "payload": {
        "segments": [rod(0.25, 8e5, 0.012)],
        "tendons": around(0.01, (0.0, 10.0)),
        "effects": {**weight(0.0, 0.0, -9.81), "tip_load": {"mass": 0.03}},
    },
    "pretension": {"segments": [rod(0.4, 1e6, 0.012)], "tendons": around(0.01, (4.0, 20.0))},
    "curved, tapered, stands": {
        "segments": [
            rod(0.5, 6e5, {"type": "linear", "base": 0.02, "tip": 0.006}, curvature=(0.0, 3.0, 0.0))
        ],
        "tendons": [
            {"routing": {"type": "surface", "angle": angle}, "tension_limits": (0.0, 8.0)}
            for angle in (0.0, 120.0, 240.0)
        ],
        "effects": weight(-9.81, 0.0, 0.0),
    },
    "tendons end midway": {
        "segments": [rod(0.4, 1e6, 0.013)],
        "tendons": [
            *around(0.01, (0.0, 12.0), end=0.17),
            *around(0.008, (0.0, 6.0), start=0.05, end=0.31),
        ],
        "effects": {"tip_load": {"force": (0.0, 0.1, 0.0)}},
    },
    "slender": {
        "segments": [rod(0.5, 2e7, 0.0025)],
        "tendons": around(0.002, (0.0, 6.0)),
        "effects": weight(0.0, 0.0, -9.81),
    },
}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--arms", nargs="+", default=[*ARMS], choices=[*ARMS])
    arguments = parser.parse_args()
    names, count, seconds = (
        (arguments.arms[:1], 1, 0.1) if arguments.quick else (arguments.arms, RESTS, 2.0)
    )
    rows = [
        row
        for name in tqdm(names, desc="arms", leave=False)
        for row in measured(name, count, seconds)
    ]
    write_csv(arguments.out / "own_arms.csv", HEADER, rows)
    draw(rows, arguments.out / "own_arms.png")
    shown = [row for row in rows if row[1] == SHOWN]
    write_tables(arguments.out / "own_arms.md", markdown_table(HEADER, shown))


def measured(name: str, count: int, seconds: float) -> list[tuple[str, ...]]:
    """A row for every preset."""
    scene = ste.Scene.parse({"name": name, **ARMS[name]}, name)
    limits = np.array([tendon.tension_limits for tendon in scene.tendons])
    least, greatest = limits.T
    random = np.random.default_rng(1)
    shares = random.random((count, least.size))
    rests = [*(least + shares * (greatest - least))]
    motions = []
    for kind in USUAL:
        for seed in SEEDS[:count]:
            motions.append(motion_tensions(scene, kind, seed, seconds))
    tolerance = REFERENCE * rod_length(scene)
    exact = reference_motions(scene, [*rests, *motions], tolerance).tips
    return [row(scene, preset, rests, motions, exact) for preset in PRESETS]


def row(
    scene: Scene,
    preset: str,
    rests: list[np.ndarray],
    motions: list[np.ndarray],
    exact: tuple[np.ndarray | None, ...],
) -> tuple[str, ...]:
    asked = accuracy_of(scene, preset)
    started = time.process_time()
    found = search(scene, asked)
    trial = time.process_time() - started
    model = ste.build_model(found.applied_to(scene), "scene")
    still = [
        distance(tip_path(model, tension), tip) for tension, tip in zip(rests, exact, strict=False)
    ]
    tip_path(model, motions[0])
    started = time.process_time()
    moving = [
        distance(tip_path(model, table), tips)
        for table, tips in zip(motions, exact[len(rests) :], strict=True)
    ]
    cost = (
        1e6 * HOLD * (time.process_time() - started) / sum(HOLD * len(table) for table in motions)
    )
    errors = [f"{100.0 * np.nanmax(values) / rod_length(scene):.2g}" for values in (still, moving)]
    sizes = str(model.coordinate_count), str(model.grid.real.sum())
    return (
        scene.name,
        preset,
        f"{100.0 * asked.share:g}",
        *errors,
        *sizes,
        f"{trial:.1f}",
        f"{cost:.0f}",
    )


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(8, 4), constrained_layout=True)
    # twelve arms: six colours, each with two markers
    axes.set_prop_cycle(cycler(marker=["o", "^"]) * cycler(color=COLOURS))
    for name in dict.fromkeys(row[0] for row in rows):
        chosen = [row for row in rows if row[0] == name]
        axes.loglog(
            [float(row[2]) for row in chosen],
            [max(float(row[3]), float(row[4])) for row in chosen],
            label=name,
        )
    axes.axline((0.1, 0.1), (1.0, 1.0), color="black", linestyle="--", label="error asked for")
    presets = {float(row[2]): row[1] for row in rows}
    axes.set_xticks([*presets], [f'"{name}"\n{share:g} %' for share, name in presets.items()])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(alpha=0.3)
    axes.set(xlabel="error asked for, share of the length", ylabel="largest error of the tip [%]")
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    write_picture(figure, path)


if __name__ == "__main__":
    main()
