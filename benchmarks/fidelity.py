"""Tip error and CPU time per control period of the fidelity presets.

    python benchmarks/fidelity.py [--scenes paper ...] [--write-docs] [--out out]

- Tip error: the largest distance of the tip from a converged reference over 2 s, in the worst of three motions of each kind. No passive
  mode was made from these motions.
- Kinds of motion (`accuracy/test_inputs.py`): `redrawn`, piecewise-constant random tensions within a quarter of their range, new every
  100 ms; `increments`, a random walk within a third; `smooth`, sin² of 0.8 Hz within a third; `wild`, full-range random tensions, new
  every 20 ms.
- Evaluations of the equation of motion per control period of 20 ms: the mean over the first three kinds.
- CPU time of one control period in a vector environment with 64 rows, everything included, on one thread, under motions like `redrawn`.

`scene` is each arm as its file says: one coordinate per independent tendon, no passive modes, fixed steps.
"""

import argparse
import time
from pathlib import Path

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _results import markdown_table, write_csv, write_page, write_picture
from tqdm import tqdm

import soft_tendon_env as ste
from soft_tendon_env.accuracy.fidelity import AS_SCENE, PRESETS, at_fidelity
from soft_tendon_env.accuracy.reference import reference_motions
from soft_tendon_env.accuracy.test_inputs import HOLD, MOTIONS, USUAL, motion_tensions
from soft_tendon_env.scene.scene import Scene, rod_length

SCENES = ("paper", "four_tendon", "three_tendon", "two_segment_six", "helical")
KINDS = MOTIONS[:4]
SEEDS = range(100, 103)
REFERENCE, WILD_REFERENCE = 5e-5, 2e-3  # of the length
HELD, ROWS, STEPS = 5, 64, 400  # control periods
DOCS = Path(__file__).parent.parent / "docs" / "appendix" / "fidelity.md"
HEADER = ("scene", "fidelity", "coordinates", "evaluations", "CPU [us per env step]", *(f"{kind} [mm]" for kind in KINDS))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES)
    parser.add_argument("--write-docs", action="store_true", help="write docs/appendix/fidelity.md")
    parser.add_argument("--quick", action="store_true", help="try the script: one short motion a kind")
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    seeds, seconds, steps = (SEEDS[:1], 0.2, 2 * HELD) if arguments.quick else (SEEDS, 2.0, STEPS)
    rows = [row for name in tqdm(arguments.scenes, desc="arms", leave=False) for row in measured(name, seeds, seconds, steps)]
    table = markdown_table(HEADER, rows)
    print(f"\n{table}\n")
    write_csv(arguments.out / "fidelity.csv", HEADER, rows)
    draw(rows, arguments.out / "fidelity.png")
    if arguments.write_docs:
        title, _, what = __doc__.split("\n\n", 2)
        write_page(DOCS, "Fidelity presets", (title, what, table))


def measured(name: str, seeds: range, seconds: float, steps: int) -> list[tuple[str, ...]]:
    """A row for every preset, and for the scene as its file says."""
    scene = ste.load_scene(name)
    inputs = {kind: [motion_tensions(scene, kind, seed, seconds) for seed in seeds] for kind in KINDS}
    exact = {}
    for kind in KINDS:
        tolerance = (REFERENCE if kind in USUAL else WILD_REFERENCE) * rod_length(scene)
        exact[kind] = reference_motions(scene, inputs[kind], tolerance).tips
    rows = []
    for label in (AS_SCENE, *PRESETS):
        own = at_fidelity(scene, label)
        model = ste.build_model(own, "scene")
        microseconds = 1e6 * cost(own, steps)
        errors, evaluations = [], []
        for kind in KINDS:
            runs = [ste.simulate(model, table, HOLD * len(table), HOLD) for table in inputs[kind]]
            apart = [np.linalg.norm(run.tip_pose[:, :3, 3] - tips, axis=1) for run, tips in zip(runs, exact[kind], strict=True)]
            errors.append(f"{1e3 * np.max(apart):.3g}")
            evaluations += [run.evaluations / len(run.time[1:]) for run in runs if kind in USUAL]
        rows.append((name, label, str(model.coordinate_count), f"{np.mean(evaluations):.1f}", f"{microseconds:.0f}", *errors))
    return rows


def cost(scene: Scene, steps: int) -> float:
    """CPU seconds of one environment step."""
    quarter = max(tendon.tension_limits[1] for tendon in scene.tendons) / 4.0
    options = {"scene": scene, "fidelity": "scene", "tension_limits": [0.0, quarter], "threads": 1}
    envs = gym.make_vec("TendonRod-TipPose-v0", num_envs=ROWS, **options)
    envs.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps // HELD, *envs.action_space.shape)).astype(np.float32)
    envs.step(actions[0])
    started = time.process_time()
    for step in range(steps):
        envs.step(actions[step // HELD])
    return (time.process_time() - started) / (steps * ROWS)


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    for name in dict.fromkeys(row[0] for row in rows):
        chosen = [row for row in rows if row[0] == name]
        errors = [max(map(float, row[5 : 5 + len(USUAL)])) for row in chosen]
        axes.loglog([float(row[4]) for row in chosen], errors, "o", label=name)
        for row, error in zip(chosen, errors, strict=True):
            axes.annotate(row[1], (float(row[4]), error), xytext=(4, 4), textcoords="offset points", fontsize=7)
    axes.set(xlabel="CPU time [us per environment step]", ylabel="largest tip error [mm]")
    axes.legend(frameon=False)
    axes.grid(alpha=0.3, which="both")
    write_picture(figure, path)


if __name__ == "__main__":
    main()
