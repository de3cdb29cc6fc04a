"""`soft-tendon doctor`: whether the installation works, and which parts of it are missing."""

import importlib
import importlib.metadata
import platform
import sys
from collections.abc import Callable
from functools import partial
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

PACKAGE = "soft_tendon_env"

REQUIRED = ("numpy", "scipy", "numba", "gymnasium", "pydantic")
"""Distributions whose versions decide what the simulator does."""

OPTIONAL = {
    "torch": "agents",
    "stable-baselines3": "agents",
    "sb3-contrib": "agents",
    "rerun-sdk": "recording",
}
"""Distributions whose versions decide what learning and recording do, by the extra with each."""

LABEL_WIDTH = len("stable-baselines3")
"""Characters that the names on the left take."""


class Doctor(Configuration):
    """Check versions, extras, kernel cache and a step of every task, which compiles its kernels.
    Exit status 1 if something is broken."""

    scene: str = Field(
        default="paper", description="a shipped scene's name, or the path of a TOML file"
    )


def run(settings: Doctor) -> None:
    """Run all checks, and go on after one that fails."""
    checks: dict[str, Callable[[], str]] = {PACKAGE: package_version, "Python": python_versions}
    for name in OPTIONAL:
        checks[name] = partial(library_version, name)
    checks["kernel cache"] = kernel_cache
    for extra in EXTRAS:
        checks[extra] = partial(import_extra, extra)
    for id in IDS.values():
        checks[id] = partial(step, id, settings.scene)

    broken = []
    for name, check in checks.items():
        try:
            text = check()
        except Exception as error:  # any error is named, and the other checks go on
            text = f"BROKEN: {first_line(error)}"
            broken.append(name)
        print(f"{name:<{LABEL_WIDTH}} {text}", flush=True)
    print(f"broken: {', '.join(broken)}" if broken else "all is well")
    sys.exit(1 if broken else 0)


def package_version() -> str:
    """Version and folder of this package."""
    version = importlib.metadata.version(PACKAGE)
    folder = Path(__file__).parents[1]
    return f"{version} in {folder}"


def python_versions() -> str:
    """Versions of Python and of what every installation has."""
    versions = [f"{name} {importlib.metadata.version(name)}" for name in REQUIRED]
    return f"{platform.python_version()}, {', '.join(versions)}"


def library_version(name: str) -> str:
    """Version of a library that an extra brings, or the command that installs it. Raises what the
    import of torch raises."""
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return f"not installed: {install_command(OPTIONAL[name])}"
    if name == "torch":
        return f"{version}, {torch_build()}"
    return version


def torch_build() -> str:
    """Which processors this build of PyTorch computes on. Raises what its import raises."""
    version = importlib.import_module("torch").version
    if version.cuda is not None:
        return f"a build for CUDA {version.cuda}, of which this package uses the CPU alone"
    # `hip` is the counterpart of `cuda` in builds for GPUs by AMD.
    if version.hip is not None:
        return f"a build for ROCm {version.hip}, of which this package uses the CPU alone"
    return "a build for CPUs"


def kernel_cache() -> str:
    """Folder in which compiled kernels are kept, or what to do where there is none."""
    without = "none can be written, every process compiles again: set NUMBA_CACHE_DIR"
    return str(cache_folder() or without)


def import_extra(name: str) -> str:
    """Whether all modules of an extra can be imported, or the command that installs it. Raises what
    an import raises."""
    if not is_installed(name):
        return f"extra is not installed: {install_command(name)}"
    modules = [importlib.import_module(module).__name__ for module in EXTRAS[name]]
    return f"{', '.join(modules)} can be imported"


def install_command(extra: str) -> str:
    """The command that installs an extra."""
    return f'pip install "{PACKAGE}[{extra}]"'


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
    is_outside = not env.observation_space.contains(observation)
    if is_outside or not np.isfinite(float(reward)):
        raise ValueError(
            "the step gave an observation outside of its space, or a reward that is not finite"
        )
    return f"one step in {1e3 * seconds:.1f} ms"
