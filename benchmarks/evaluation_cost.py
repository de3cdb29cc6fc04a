"""CPU time of one evaluation of the equation of motion by coordinates and packs, beside the cost model of `soft-tendon accuracy`.

    python benchmarks/evaluation_cost.py [--out out]

Least time of several runs of one second (redrawn tensions, 3 columns, steps of 20 ms) over its evaluations, one thread. The numbers of the
least-squares fit in relative error are printed as they stand in soft_tendon_env/accuracy/pareto.py.
"""

import argparse
import itertools
import time
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture
from scipy.optimize import nnls

import soft_tendon_env as ste
from soft_tendon_env.accuracy.input_motions import motion_tensions
from soft_tendon_env.accuracy.pareto import evaluation_cost
from soft_tendon_env.model.model import model_on

SCENES = ("paper", "four_tendon", "helical", "two_segment_six")
ANGULAR = ["torsion", "bend_y", "bend_z"]
PASSIVE = ((), ((2, "rod"),), ((2, "piece"),), ((4, "piece"),))
INTERVALS = (4, 8, 16)
HEADER = ("scene", "coordinates", "packs", "measured [us]", "cost model [us]")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="try the script: one scene")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    for name in SCENES[1:2] if arguments.quick else SCENES:
        scene = ste.load_scene(name)
        for strain, intervals in itertools.product(strains(scene), INTERVALS):
            model = model_on(scene.replace({"strain": strain, "integrator": {"columns": 3, "step": 0.02}}), intervals)
            measured = measure(model, arguments.repeats)
            rows.append((name, model.coordinate_count, model.grid.packs, measured, evaluation_cost(model)))
    written = [(*row[:3], *(f"{1e6 * value:.2f}" for value in row[3:])) for row in rows]
    print(f"{machine()}\n\n{markdown_table(HEADER, written)}\n")
    fit(rows)
    write_csv(arguments.out / "evaluation_cost.csv", HEADER, written)
    draw(rows, arguments.out / "evaluation_cost.png")


def strains(scene: ste.Scene) -> list[dict]:
    """Statics-based ones of several sizes."""
    passive = [[{"strains": ANGULAR, "order": order, "span": span} for order, span in groups] for groups in PASSIVE]
    return [{"type": "statics_based", "passive": own} for own in passive]


def measure(model: ste.Model, repeats: int) -> float:
    """CPU seconds of one evaluation."""
    tensions, times = motion_tensions(model.scene, "redrawn", 0, 1.0), []
    for _ in range(repeats + 1):
        started = time.thread_time()
        motion = ste.simulate(model, tensions, 1.0, 0.02)
        times.append((time.thread_time() - started) / motion.evaluations)
    return min(times[1:])


def fit(rows: list[tuple]) -> None:
    """Print the cost model that fits best, and how well it does beside the one as it stands."""
    n, packs, measured, predicted = (np.array([row[i] for row in rows], dtype=float) for i in (1, 2, 3, 4))
    terms = np.array([np.ones_like(n), packs, packs * n, n**2]).T
    found, _ = nnls(terms / measured[:, None], np.ones_like(n))
    for name, own in (("the best fit", terms @ found), ("the model, but for a factor", predicted)):
        error = np.log(own / measured)
        error -= np.median(error)
        print(f"relative error of {name}: {100 * np.sqrt(np.mean(error**2)):.1f} % rms, {100 * np.abs(error).max():.0f} % at most")
    print(f"FIXED, PER_PACK, PER_FIELD, SOLVE = {', '.join(f'{value:.3g}' for value in found)}")


def draw(rows: list[tuple], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    axes.loglog(*zip(*[(1e6 * row[4], 1e6 * row[3]) for row in rows], strict=True), "o")
    axes.set(xlabel="cost model [us per evaluation]", ylabel="measured [us per evaluation]")
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
