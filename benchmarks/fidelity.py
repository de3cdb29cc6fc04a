"""Tip error and CPU time per control period of the fidelity presets: a section of
docs/appendix/speed.md.

    python benchmarks/fidelity.py [--scenes paper ...] [--quick] [--out out]

Largest distance of the tip from a converged reference over 2 s, in the worst of three motions of
each kind, of which no passive mode was made. Evaluations are the mean over the usual kinds. CPU
time is that of a vector environment with 64 rows, everything included, on one thread, under motions
like `redrawn`. `scene` is each arm as its file says: no passive modes, fixed steps.
"""

import time
from pathlib import Path

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _results import (
    markdown_table,
    parser_of,
    write_csv,
    write_picture,
    write_tables,
)
from _scenes import SOFT_ARMS
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import AS_SCENE, PRESETS, at_fidelity
from soft_tendon_env.accuracy.input_motions import HOLD, MOTIONS, USUAL, motion_tensions
from soft_tendon_env.accuracy.reference import reference_motions
from soft_tendon_env.scene.scene import Scene, rod_length

KINDS = MOTIONS[:4]
SHOWN = ("paper", "three_tendon", "helical")  # arms on the page
SEEDS = range(100, 103)
REFERENCE = 5e-5  # share of the length
WILD_REFERENCE = 2e-3  # share of the length
HELD = 5  # control periods
ROWS = 64
STEPS = 400  # control periods
MARKERS = dict(zip((AS_SCENE, *PRESETS), "xos^", strict=True))
"""Matplotlib's markers of the presets."""
HEADER = (
    "scene",
    "fidelity",
    "coordinates",
    "evaluations",
    "CPU [us per env step]",
    *(f"{kind} [mm]" for kind in KINDS),
)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", nargs="+", default=SOFT_ARMS, choices=SOFT_ARMS)
    arguments = parser.parse_args()
    seeds, seconds, steps = (SEEDS[:1], 0.2, 2 * HELD) if arguments.quick else (SEEDS, 2.0, STEPS)
    rows = [
        row
        for name in tqdm(arguments.scenes, desc="arms", leave=False)
        for row in measured(name, seeds, seconds, steps)
    ]
    write_csv(arguments.out / "fidelity.csv", HEADER, rows)
    draw(rows, arguments.out / "fidelity.png")
    write_tables(arguments.out / "fidelity.md", table_of(rows))


def table_of(rows: list[tuple[str, ...]]) -> str:
    """A row for every preset of SHOWN, with the worst error of the usual motions and that of wild
    ones; the CSV file has all arms."""
    header = (
        "scene",
        "fidelity",
        "coordinates",
        "evaluations",
        "CPU [µs]",
        "usual [mm]",
        "wild [mm]",
    )
    shown = [
        (*row[:5], max(row[5 : 5 + len(USUAL)], key=float), row[-1])
        for row in rows
        if row[0] in SHOWN and row[1] in PRESETS
    ]
    return markdown_table(header, shown)


def measured(name: str, seeds: range, seconds: float, steps: int) -> list[tuple[str, ...]]:
    """A row for every preset, and for the scene as its file says."""
    scene = ste.load_scene(name)
    inputs = {
        kind: [motion_tensions(scene, kind, seed, seconds) for seed in seeds] for kind in KINDS
    }
    exact = {}
    for kind in KINDS:
        tolerance = (REFERENCE if kind in USUAL else WILD_REFERENCE) * rod_length(scene)
        exact[kind] = reference_motions(scene, inputs[kind], tolerance).tips
    rows = []
    for label in (AS_SCENE, *PRESETS):
        own = at_fidelity(scene, label)
        model = ste.build_model(own, "scene")
        microseconds = 1e6 * cost(own, steps)
        errors = []
        evaluations = []
        for kind in KINDS:
            runs = [ste.simulate(model, table, HOLD * len(table), HOLD) for table in inputs[kind]]
            apart = [
                np.linalg.norm(run.tip_pose[:, :3, 3] - tips, axis=1)
                for run, tips in zip(runs, exact[kind], strict=True)
            ]
            errors.append(f"{1e3 * np.max(apart):.3g}")
            evaluations += [run.evaluations / len(run.time[1:]) for run in runs if kind in USUAL]
        rows.append(
            (
                name,
                label,
                str(model.coordinate_count),
                f"{np.mean(evaluations):.1f}",
                f"{microseconds:.0f}",
                *errors,
            )
        )
    return rows


def cost(scene: Scene, steps: int) -> float:
    """CPU seconds of one environment step."""
    quarter = max(tendon.tension_limits[1] for tendon in scene.tendons) / 4.0
    options = {
        "scene": scene,
        "fidelity": "scene",
        "action": "tension",
        "tension_limits": [0.0, quarter],
        "threads": 1,
    }
    envs = gym.make_vec("TendonRod-TipPose-v0", num_envs=ROWS, **options)
    envs.reset(seed=0)
    actions = (
        np.random.default_rng(0)
        .uniform(-1.0, 1.0, (steps // HELD, *envs.action_space.shape))
        .astype(np.float32)
    )
    envs.step(actions[0])
    started = time.process_time()
    for step in range(steps):
        envs.step(actions[step // HELD])
    return (time.process_time() - started) / (steps * ROWS)


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    """Errors over CPU times: a colour per arm, a marker per preset, so that no label overlaps."""
    figure, axes = plt.subplots(figsize=(6, 4.5), constrained_layout=True)
    arms = list(dict.fromkeys(row[0] for row in rows))
    colours = dict(zip(arms, plt.rcParams["axes.prop_cycle"].by_key()["color"], strict=False))
    for name in arms:
        chosen = [row for row in rows if row[0] == name]
        errors = [max(map(float, row[5 : 5 + len(USUAL)])) for row in chosen]
        times = [float(row[4]) for row in chosen]
        axes.loglog(times, errors, "-", color=colours[name], linewidth=0.8, label=name)
        for row, time_of_step, error in zip(chosen, times, errors, strict=True):
            axes.plot(time_of_step, error, MARKERS[row[1]], color=colours[name])
    for label, marker in MARKERS.items():
        axes.plot([], [], marker, color="0.4", label=f'"{label}"')
    axes.set(xlabel="CPU time of an environment step [µs]", ylabel="largest tip error [mm]")
    axes.legend(frameon=False, fontsize=8, ncols=2)
    axes.grid(alpha=0.3)
    write_picture(figure, path)


if __name__ == "__main__":
    main()
