"""`soft-tendon doctor`: whether the installation works, and which parts of it are missing."""

import importlib.metadata
import platform
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from soft_tendon_env.cli.errors import EXTRAS, is_installed
from soft_tendon_env.registration import IDS
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.messages import first_line


class Doctor(Configuration):
    """Check the installation: versions, extras, kernel cache, and one step of every task. Exit status 1 if something is broken."""


def run(settings: Doctor) -> None:
    """Run all checks, and go on after one that fails."""
    extras, tasks = {f"extra {name}": partial(extra, name) for name in EXTRAS}, {id: partial(task, id) for id in IDS.values()}
    checks: dict[str, Callable[[], str]] = {"soft_tendon_env": package, **extras, "kernel cache": kernel_cache, **tasks}
    broken = []
    for name, check in checks.items():
        try:
            print(f"{name:<16} {check()}", flush=True)
        except Exception as error:  # any error is named, and the other checks go on
            print(f"{name:<16} BROKEN: {first_line(error)}", flush=True)
            broken.append(name)
    print(f"broken: {', '.join(broken)}" if broken else "all is well")
    sys.exit(1 if broken else 0)


def package() -> str:
    """The package's folder, and versions of Python and of what every simulation needs."""
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "scipy", "numba", "gymnasium", "pydantic")]
    return f"in {Path(__file__).parents[1]}; Python {platform.python_version()}, {platform.machine()}; {', '.join(versions)}"


def extra(name: str) -> str:
    """Whether all modules of an extra can be imported, or the command that installs it. Raises what an import raises."""
    if not is_installed(name):
        return f'not installed: pip install "soft_tendon_env[{name}]"'
    return f"{', '.join(importlib.import_module(module).__name__ for module in EXTRAS[name])} can be imported"


def kernel_cache() -> str:
    """Folder of machine code; nothing is broken without, but every process compiles again."""
    from soft_tendon_env.compiler.compilation import cache_folder

    return str(cache_folder() or "none can be written: every process compiles again; set NUMBA_CACHE_DIR to a folder that can be written")


def task(id: str) -> str:
    """Time of one step of an environment. Raises ValueError for an observation outside of its space."""
    import gymnasium as gym
    import numpy as np

    env = gym.make(id)
    env.reset(seed=0)
    started = time.perf_counter()
    observation, reward, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    if not env.observation_space.contains(observation) or not np.isfinite(float(reward)):
        raise ValueError("the step gave an observation outside of its space, or a reward that is not finite")
    return f"one step in {1e3 * (time.perf_counter() - started):.1f} ms"
