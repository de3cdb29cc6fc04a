"""`soft-tendon compile`: machine code of scenes ahead of their first use, as when the image of a container is built."""

import time
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
from tqdm import tqdm

from soft_tendon_env.cli.options import Parser
from soft_tendon_env.compiler.compilation import cache_folder
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.targets.statics import nearest_to_zero
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration

STOPPED = "stopped: what was compiled by then is kept"
STAGES = ("model", "statics", "simulation", *IDS)


class Compile(Configuration):
    """Compile what scenes need and keep the machine code, so that the first use need not wait; prints where it is kept.

    Attributes:
        scenes: names of scenes that ship, or paths of TOML files. Scenes with the same kind of strain share all but their effects.
    """

    scenes: tuple[str, ...] = ("paper",)


def run(arguments: Sequence[str]) -> None:
    """Use every scene in every way that has kernels of its own, with a bar."""
    parser = Parser("compile", Compile)
    settings = parser.read(arguments)
    with parser.mistakes():
        scenes = {name: load_scene(name) for name in settings.scenes}
    started = time.perf_counter()
    with tqdm(total=len(STAGES) * len(scenes), unit="stage") as bar:
        for name, scene in scenes.items():
            for stage in STAGES:
                bar.set_description(f"{name}: {stage}")
                use(scene, stage)
                bar.update()
    folder = cache_folder()
    kept = "not kept: no folder can be written" if folder is None else f"kept in {folder}"
    print(f"ready in {time.perf_counter() - started:.1f} s; machine code is {kept}")


def use(scene: Scene, stage: str) -> None:
    """Do what the stage needs kernels for, once."""
    if stage in IDS:
        env = gym.make(IDS[stage], scene=scene)
        env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        env.close()
        return
    model = build_model(scene)
    tension = nearest_to_zero(np.array([tendon.tension_limits for tendon in scene.tendons]))
    if stage == "statics":
        static_equilibrium(model, tension, settle=True)
        static_equilibrium(model, tension, np.zeros(model.coordinate_count))
    if stage == "simulation":
        Simulation(model).step(tension, scene.integrator.step)
