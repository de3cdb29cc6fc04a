"""One revision of the package as `paired.py` measures it: only public names, so that every revision
can be measured beside another.

    python benchmarks/_paired_worker.py SCENE CALLS '{"label": {"key": "change", ...}, ...}'

Prints the names of what there is to measure, then reads one of them from each line and answers with
its time in microseconds.
"""

import itertools
import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from typing import NamedTuple

import gymnasium as gym
import numpy as np

import soft_tendon_env as ste

ID = "TendonRod-TipPose-v0"
ROWS = 64
LOADS = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
DRAWN = {"effects": {"tip_load.mass": [0.0, 0.01]}}


class Action(NamedTuple):
    """An action that does something so many times and says how many are to be counted, how much
    longer one takes than the quickest, and the clock."""

    run: Callable[[int], float]
    share: int = 1
    clock: Callable[[], float] = time.process_time


def main() -> None:
    name = sys.argv[1]
    calls = int(sys.argv[2])
    changes = json.loads(sys.argv[3])
    warnings.simplefilter("ignore")
    made = actions_of(ste.load_scene(name), changes)
    for action in made.values():
        action.run(1)
    cores = (
        os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    )  # of what takes one thread both take the same one
    print(json.dumps([*made]), flush=True)
    for line in sys.stdin:
        action = made[line.strip()]
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, cores if action.clock is time.perf_counter else {min(cores)})
        begun = action.clock()
        done = action.run(max(1, calls // action.share))
        print(1e6 * (action.clock() - begun) / done, flush=True)


def actions_of(scene: ste.Scene, changes: dict[str, dict]) -> dict[str, Action]:
    """What is measured of a scene, by name: as the presets have it, and with each of `changes`."""
    made = {}
    arms = {label: (scene.replace(change), "scene") for label, change in changes.items()}
    for label, (own, fidelity) in (
        arms | {preset: (scene, preset) for preset in ("fast", "standard")}
    ).items():
        model = ste.build_model(own, fidelity=fidelity)
        made[f"evaluation, {label} ({model.coordinate_count} coordinates)"] = Action(
            evaluations(model), 10
        )
        options = {"scene": own, "fidelity": fidelity}
        for threads, kind, clock in (
            (1, "CPU", time.process_time),
            (None, "wall, all cores", time.perf_counter),
        ):
            many = gym.make_vec(ID, num_envs=ROWS, threads=threads, **options)
            made[f"step, {ROWS} rows, {label}, {kind}"] = Action(steps(many, ROWS), 20, clock)
        made[f"step, alone, {label}"] = Action(
            steps(gym.make(ID, max_episode_steps=10**9, **options), 1)
        )
    loaded = scene.replace(LOADS)
    resets = {
        "fast": {"scene": scene},
        "under loads": {"scene": loaded},
        "drawn effects": {"scene": loaded, "randomize": DRAWN},
    }
    for label, options in resets.items():
        many = gym.make_vec(ID, num_envs=ROWS, threads=1, fidelity="fast", **options)
        made[f"reset, {ROWS} rows, {label}"] = Action(reset_all(many), 40)
    made["terms"] = Action(terms(ste.build_model(scene, fidelity="scene")))
    return made


def evaluations(model: ste.Model) -> Callable[[int], float]:
    table = np.random.default_rng(0).uniform(0.0, 3.0, (100, model.tendon_count))
    return lambda calls: sum(
        ste.simulate(model, table, 2.0, 0.02).evaluations for _ in range(calls)
    )


def terms(model: ste.Model) -> Callable[[int], float]:
    q = np.full(model.coordinate_count, 0.5)
    q_dot = np.ones(model.coordinate_count)
    return lambda calls: [model.terms(q, q_dot) for _ in range(calls)] and calls


def steps(env: gym.Env | gym.vector.VectorEnv, rows: int) -> Callable[[int], float]:
    actions = (
        np.random.default_rng(0)
        .uniform(-1.0, -0.5, (8, *env.action_space.shape))
        .astype(np.float32)
    )
    env.reset(seed=0)
    held = itertools.cycle(np.repeat(actions, 5, axis=0))
    return lambda calls: [env.step(next(held)) for _ in range(calls)] and rows * calls


def reset_all(envs: gym.vector.VectorEnv) -> Callable[[int], float]:
    return lambda calls: [envs.reset(seed=i) for i in range(calls)] and ROWS * calls


if __name__ == "__main__":
    main()
