"""CPU time of one evaluation of the equation of motion by coordinates and packs, beside the cost model of `soft-tendon accuracy`.

    python benchmarks/evaluation_cost.py [--write] [--out out]

Loads inside of the strain: the same times with gravity inside, as a ratio to those with gravity outside.

Least time of several runs of one second (redrawn tensions, 3 columns, steps of 20 ms) over its evaluations, one thread. --write makes the
least-squares fit in relative error that is printed here the cost model: soft_tendon_env/accuracy/evaluation_cost.toml.
"""

import argparse
import itertools
import time
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tomli_w
from _results import machine, markdown_table, write_csv, write_picture
from scipy.optimize import nnls

import soft_tendon_env as ste
from soft_tendon_env.accuracy.settings import FITTED, CostModel, evaluation_cost, kernel_digest
from soft_tendon_env.accuracy.test_inputs import motion_tensions
from soft_tendon_env.model.model import model_on

SCENES = ("paper", "four_tendon", "helical", "two_segment_six")
ANGULAR = ["torsion", "bend_y", "bend_z"]
PASSIVE = ((), ((2, "rod"),), ((2, "piece"),), ((4, "piece"),))
ORDERS = (2, 3, 4)
INTERVALS = (4, 8, 16)
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
HEADER = ("scene", "strain", "coordinates", "packs", "measured [us]", "cost model [us]")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="try the script: one scene")
    parser.add_argument("--write", action="store_true", help=f"write {FITTED.name}, which settings are ranked by")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    for name in SCENES[1:2] if arguments.quick else SCENES:
        scene = ste.load_scene(name)
        for strain, intervals in itertools.product(strains(scene), INTERVALS):
            model = model_on(scene.replace({"strain": strain, "integrator": {"columns": 3, "step": 0.02}}), intervals)
            measured = measure(model, arguments.repeats)
            rows.append((name, strain["type"], model.coordinate_count, model.grid.packs, measured, evaluation_cost(model)))
    written = [(*row[:4], *(f"{1e6 * value:.2f}" for value in row[4:])) for row in rows]
    print(f"{machine()}\n\n{markdown_table(HEADER, written)}\n")
    model = fit(rows, loads_inside(arguments.quick, arguments.repeats))
    if arguments.write:
        FITTED.write_text(toml(model))
        print(f"written: {FITTED}")
    write_csv(arguments.out / "evaluation_cost.csv", HEADER, written)
    draw(rows, arguments.out / "evaluation_cost.png")


def strains(scene: ste.Scene) -> list[dict]:
    """Statics-based and explicit ones of several sizes."""
    passive = [[{"strains": ANGULAR, "order": order, "span": span} for order, span in groups] for groups in PASSIVE]
    explicit = [[{"strains": list(scene.strain.free), "order": order, "span": "piece"}] for order in ORDERS]
    return [{"type": "statics_based", "passive": own} for own in passive] + [{"type": "explicit", "modes": own} for own in explicit]


def measure(model: ste.Model, repeats: int) -> float:
    """CPU seconds of one evaluation."""
    tensions, times = motion_tensions(model.scene, "redrawn", 0, 1.0), []
    for _ in range(repeats + 1):
        started = time.thread_time()
        motion = ste.simulate(model, tensions, 1.0, 0.02)
        times.append((time.thread_time() - started) / motion.evaluations)
    return min(times[1:])


def loads_inside(quick: bool, repeats: int) -> float:
    """What gravity inside of the strain multiplies the time by: geometric mean of several models, least and greatest printed."""
    ratios = []
    for name in SCENES[1:2] if quick else SCENES:
        scene = ste.load_scene(name).replace({**GRAVITY, "integrator": {"columns": 3, "step": 0.02}})
        for passive, intervals in itertools.product(strains(scene)[:2], INTERVALS):
            models = [model_on(scene.replace({"strain": {**passive, "include_loads": value}}), intervals) for value in (False, True)]
            outside, inside = (measure(model, repeats) for model in models)
            ratios.append(inside / outside)
    found = float(np.exp(np.mean(np.log(ratios))))
    print(f"loads inside: {found:.2f} times ({min(ratios):.2f} to {max(ratios):.2f})")
    return found


def fit(rows: list[tuple], inside: float) -> CostModel:
    """The cost model that fits best; printed: how well it does, and the one as it stands."""
    n, packs, measured, predicted = (np.array([row[i] for row in rows], dtype=float) for i in (2, 3, 4, 5))
    explicit = np.array([row[1] == "explicit" for row in rows])
    terms = np.array([np.ones_like(n), packs, packs * n * ~explicit, packs * n * explicit, n**2]).T
    found, _ = nnls(terms / measured[:, None], np.ones_like(n))
    for name, own in (("the best fit", terms @ found), ("the model, but for a factor", predicted)):
        error = np.log(own / measured)
        error -= np.median(error)
        print(f"relative error of {name}: {100 * np.sqrt(np.mean(error**2)):.1f} % rms, {100 * np.abs(error).max():.0f} % at most")
    fixed, per_pack, statics_based, explicit, solve = np.maximum(found, 1e-12).tolist()
    per_field = {"statics_based": statics_based, "explicit": explicit}
    made = dict(machine=machine(), kernels=kernel_digest(), fixed=fixed, per_pack=per_pack, solve=solve, loads_inside=inside)
    return CostModel(**made, per_field=per_field)


def toml(model: CostModel) -> str:
    """The text of FITTED, with three digits."""
    head = "# Written by `python benchmarks/evaluation_cost.py --write`: CPU times [s], see CostModel in settings.py."
    table = model.model_dump()
    per_field = {name: float(f"{value:.3g}") for name, value in table.pop("per_field").items()}
    numbers = {name: value if isinstance(value, str) else float(f"{value:.3g}") for name, value in table.items()}
    return f"{head}\n{tomli_w.dumps({**numbers, 'per_field': per_field})}"


def draw(rows: list[tuple], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for kind in ("statics_based", "explicit"):
        axes.loglog(*zip(*[(1e6 * row[5], 1e6 * row[4]) for row in rows if row[1] == kind], strict=True), "o", label=kind)
    axes.set(xlabel="cost model [us per evaluation]", ylabel="measured [us per evaluation]")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
