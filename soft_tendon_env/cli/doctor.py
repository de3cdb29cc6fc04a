"""`soft-tendon doctor`: whether the installation works, and which parts of it are missing."""

import importlib
import importlib.metadata
import platform
import sys
from pathlib import Path
from time import perf_counter

import gymnasium as gym
import numpy as np
from pydantic import Field

from soft_tendon_env.cli.errors import EXTRAS, is_installed
from soft_tendon_env.compiler.kept_code import cache_folder
from soft_tendon_env.registration import IDS
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.messages import first_line


class Doctor(Configuration):
    """Check versions, extras, kernel cache and a step of every task, which compiles its kernels.
    Exit status 1 if something is broken."""

    scene: str = Field(
        default="paper", description="a shipped scene's name, or the path of a TOML file"
    )


def run(settings: Doctor) -> None:
    """Run all checks, and go on after one that fails."""
    versions = [
        f"{name} {importlib.metadata.version(name)}"
        for name in ("numpy", "scipy", "numba", "gymnasium", "pydantic")
    ]
    print(
        f"{'soft_tendon_env':<16} in {Path(__file__).parents[1]}; Python"
        f" {platform.python_version()}, {', '.join(versions)}"
    )
    without = "none can be written, every process compiles again: set NUMBA_CACHE_DIR"
    print(f"{'kernel cache':<16} {cache_folder() or without}")
    broken = []
    for name in (*EXTRAS, *IDS.values()):
        try:
            print(
                f"{name:<16}"
                f" {import_extra(name) if name in EXTRAS else step(name, settings.scene)}",
                flush=True,
            )
        except Exception as error:  # any error is named, and the other checks go on
            print(f"{name:<16} BROKEN: {first_line(error)}", flush=True)
            broken.append(name)
    print(f"broken: {', '.join(broken)}" if broken else "all is well")
    sys.exit(1 if broken else 0)


def import_extra(name: str) -> str:
    """Whether all modules of an extra can be imported, or the command that installs it. Raises what
    an import raises."""
    if not is_installed(name):
        return f'extra is not installed: pip install "soft_tendon_env[{name}]"'
    return (
        f"{', '.join(importlib.import_module(module).__name__ for module in EXTRAS[name])} can be"
        " imported"
    )


def step(id: str, scene: str) -> str:
    """Time of a step of an environment. Raises ValueError for an observation outside of its
    space."""
    env = gym.make(id, scene=scene)
    env.reset(seed=0)
    action = np.zeros_like(env.action_space.sample())
    env.step(action)  # loads the kernels, or compiles them
    started = perf_counter()
    observation, reward, *_ = env.step(action)
    seconds = perf_counter() - started
    if not env.observation_space.contains(observation) or not np.isfinite(float(reward)):
        raise ValueError(
            "the step gave an observation outside of its space, or a reward that is not finite"
        )
    return f"one step in {1e3 * seconds:.1f} ms"
