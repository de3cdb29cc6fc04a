"""`soft-tendon compile`: machine code of scenes ahead of their first use, as when the image of a container is built."""

import time

import gymnasium as gym
import numpy as np
from pydantic import Field
from tqdm import tqdm

from soft_tendon_env.cli.errors import mistakes
from soft_tendon_env.compiler.compilation import cache_folder
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.targets.statics import nearest_to_zero
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import Configuration


class Compile(Configuration):
    """Compile what scenes need and keep the machine code, so that the first use need not wait; prints where it is kept."""

    scenes: tuple[str, ...] = Field(default=("paper",), description="names of scenes that ship, or paths of TOML files")


def run(settings: Compile) -> None:
    """Use every scene in every way that has kernels of its own, with a bar."""
    with mistakes():
        scenes = [load_scene(name) for name in settings.scenes]
    started = time.perf_counter()
    for scene in tqdm(scenes, unit="scene"):
        model = build_model(scene)
        tension = nearest_to_zero(np.array([tendon.tension_limits for tendon in scene.tendons]))
        static_equilibrium(model, tension, settle=True)
        static_equilibrium(model, tension, np.zeros(model.coordinate_count))
        Simulation(model).step(tension, scene.integrator.step)
        for id in IDS.values():
            env = gym.make(id, scene=scene)
            env.reset(seed=0)
            env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    kept = cache_folder() or "no folder, since none can be written"
    print(f"ready in {time.perf_counter() - started:.1f} s; machine code is kept in {kept}")
