"""What recording an episode to a Rerun file costs.

    python benchmarks/recording.py [--steps 500] [--turns 7] [--out out]

The same episode of TendonRod-TipPose-v0 with and without RecordRollout, in turns in the same run; medians over the turns. "during":
wall-clock time of the steps but the last; "at the end": of the last step, in which the recorder writes what it has collected.
"""

import argparse
import time
from pathlib import Path

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from _results import machine, markdown_table, write_csv, write_picture
from tqdm import tqdm

import soft_tendon_env  # noqa: F401  (registers the ids)
from soft_tendon_env.recording import RecordRollout

FIDELITIES = ("fast", "standard")
HEADER = ("fidelity", "steps alone [ms]", "more during [ms]", "more during [%]", "at the end [ms]", "file [MB]")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for fidelity in FIDELITIES:
        path = arguments.out / f"recording-{fidelity}.rrd"
        plain, recorded = make(fidelity, arguments.steps), RecordRollout(make(fidelity, arguments.steps), path)
        times = np.array([(episode(plain), episode(recorded)) for _ in tqdm(range(arguments.turns + 1), desc=fidelity)])
        recorded.close()
        alone, with_it = np.median(times[1:], axis=0)  # in the first, files and kernels warm up
        more, end = with_it - alone
        size = path.stat().st_size / (arguments.turns + 1) / 1e6
        numbers = (1e3 * alone[0], 1e3 * more, 100 * more / alone[0], 1e3 * end)
        rows.append((fidelity, *(f"{number:.1f}" for number in numbers), f"{size:.2f}"))
    print(f"\n{machine()}, {arguments.steps} steps\n")
    print(markdown_table(HEADER, rows))
    write_csv(arguments.out / "recording.csv", HEADER, rows)
    draw(rows, arguments.out / "recording.png")


def make(fidelity: str, steps: int) -> gym.Env:
    return gym.make("TendonRod-TipPose-v0", fidelity=fidelity, max_episode_steps=steps)


def episode(env: gym.Env) -> tuple[float, float]:
    """Wall-clock seconds of all steps but the last, and of the last."""
    env.reset(seed=0)
    action = np.full(env.action_space.shape, -0.8, dtype=np.float32)
    truncated, before, started = False, 0.0, time.perf_counter()
    while not truncated:
        before = time.perf_counter()
        _, _, _, truncated, _ = env.step(action)
    return before - started, time.perf_counter() - before


def draw(rows: list[tuple[str, ...]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 3.5), constrained_layout=True)
    labels = [row[0] for row in rows]
    during, end = [float(row[2]) for row in rows], [float(row[4]) for row in rows]
    axes.barh(labels, during, label="during the episode")
    axes.barh(labels, end, left=np.maximum(during, 0.0), label="at its end")
    axes.set(xlabel="added by recording [ms]")
    axes.legend(frameon=False)
    write_picture(figure, path)


if __name__ == "__main__":
    main()
