"""Accuracy and cost of the fidelity presets: distance of the tip from full physics, and CPU time per control period.

    python benchmarks/fidelity.py [--write-docs] [--out out]

On the paper's arm: the lively second of the other benchmarks, and five seconds of tensions drawn anew every 100 ms between 0 and 15 N.
Distances: the largest and the root mean square between tips, compared every 20 ms, from full physics (72 coordinates, converged).
Cost: CPU time of one control period of 20 ms in the native vector environment with 64 rows under the second input, everything included,
one thread.
"""

import argparse
import time
from pathlib import Path

import gymnasium as gym
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv
from _trajectory_input import tension_table
from accuracy_against_time import CONVERGED, FULL_PHYSICS
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.envs.fidelity import PRESETS, at_fidelity
from soft_tendon_env.scene.scene import extrapolation_columns

PERIOD = 0.02  # [s]
RANDOM_SECONDS, HELD, LARGEST = 5.0, 5, 15.0  # [s], control periods, [N]
ROWS, STEPS = 64, 400
DOCS = Path(__file__).parent.parent / "docs" / "fidelity.md"
HEADER = (
    "fidelity",
    "coordinates",
    "evaluations per 20 ms",
    "CPU [us per env step]",
    "lively: largest [mm]",
    "rms [mm]",
    "random: largest [mm]",
    "rms [mm]",
)
SUMMARY = (
    "Accuracy and cost of the fidelity presets `fast`, `standard` and `fine`: distance of the tip from full physics, and CPU time per "
    "control period."
)
QUICK = {"quadrature.intervals": 4}  # in place of a converged reference


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write-docs", action="store_true", help="write docs/fidelity.md")
    parser.add_argument("--quick", action="store_true", help="try the script: short, against a coarse reference")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    paper = ste.load_scene("paper")
    inputs = {"lively": tension_table(PERIOD), "random": random_tensions(0.2 if arguments.quick else RANDOM_SECONDS)}
    full = paper.replace({**FULL_PHYSICS, **(QUICK if arguments.quick else CONVERGED)})
    exact = {name: tips(full, table, name) for name, table in inputs.items()}
    rows = []
    for fidelity in PRESETS:
        scene = at_fidelity(paper, fidelity)
        model = ste.build_model(scene)
        columns, substeps = extrapolation_columns(scene), round(PERIOD / scene.integrator.step)
        evaluations = substeps * (columns * (columns - 1) // 2 + 1)
        errors = [np.linalg.norm(tips(scene, table, fidelity) - exact[name], axis=1) for name, table in inputs.items()]
        distances = [f"{1e3 * d:.2f}" for error in errors for d in (error.max(), np.sqrt(np.mean(error**2)))]
        microseconds = 1e6 * cost(fidelity, 2 * HELD if arguments.quick else STEPS)
        rows.append((fidelity, str(model.coordinate_count), str(evaluations), f"{microseconds:.0f}", *distances))
    table = markdown_table(HEADER, rows)
    print(f"\n{table}\n")
    write_csv(arguments.out / "fidelity.csv", HEADER, rows)
    draw(rows, arguments.out / "fidelity.png")
    if arguments.write_docs:
        what = __doc__.split("\n\n", 2)[2]
        written = f"Written by `python benchmarks/fidelity.py --write-docs` on {machine()}."
        DOCS.write_text(f"# Fidelity presets\n\n{SUMMARY}\n\n{written}\n\n{what}\n{table}\n")
        print(f"written: {DOCS}")


def random_tensions(seconds: float) -> np.ndarray:
    """(periods, 10) [N]."""
    draws = round(seconds / PERIOD) // HELD
    return np.repeat(np.random.default_rng(0).uniform(0.0, LARGEST, (draws, 10)), HELD, axis=0)


def tips(scene: ste.Scene, table: np.ndarray, label: str) -> np.ndarray:
    """Tip positions (periods, 3) [m] under a table of tensions (periods, 10)."""
    model, duration = ste.build_model(scene), len(table) * PERIOD
    with tqdm(total=duration, desc=label, unit="s", leave=False) as bar:
        trajectory = ste.simulate(model, table, duration, PERIOD, progress=lambda simulated: bar.update(simulated - bar.n))
    return trajectory.tip_pose[1:, :3, 3]


def cost(fidelity: str, steps: int) -> float:
    """CPU seconds of one environment step."""
    envs = gym.make_vec("TendonRod-TipPose-v0", num_envs=ROWS, fidelity=fidelity, tension_limits=[0.0, LARGEST], threads=1)
    envs.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps // HELD, ROWS, 10)).astype(np.float32)
    envs.step(actions[0])
    started = time.process_time()
    for step in range(steps):
        envs.step(actions[step // HELD])
    return (time.process_time() - started) / (steps * ROWS)


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for label, column in (("lively", 4), ("random", 6)):
        axes.loglog([float(row[3]) for row in rows], [float(row[column]) for row in rows], marker="o", label=f"{label} input")
    for row in rows:
        axes.annotate(row[0], (float(row[3]), float(row[6])), xytext=(4, 6), textcoords="offset points")
    axes.set(xlabel="CPU time [us per environment step]", ylabel="largest distance of the tip from full physics [mm]")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3, which="both")
    figure.savefig(path, dpi=130)
    print(f"written: {path}")


if __name__ == "__main__":
    main()
