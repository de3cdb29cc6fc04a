"""`soft-tendon doctor`: whether the installation works, and what of it is missing."""

import importlib
import importlib.metadata
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from soft_tendon_env.cli.errors import EXTRAS, install_command, missing_extras
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.failures import first_line

STOPPED = "stopped"
PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "gymnasium", "pydantic", "daqp", "tomli_w", "tqdm")
OF_EXTRAS = ("torch", "stable_baselines3", "sb3_contrib", "rerun-sdk", "matplotlib")


class Doctor(Configuration):
    """Check the installation: versions, ids, scenes, kernel cache, extras, one step of every task. Exit status 1 if something is broken."""


def run(arguments: Sequence[str]) -> None:
    """Print a line per check."""
    Parser("doctor", Doctor).read(Doctor, arguments)
    checks = (versions, packages, extras, shipped_scenes, shipped_agents, kernel_cache, tasks)
    broken = [name.__name__.replace("_", " ") for name in checks if not _holds(name)]
    print(f"broken: {', '.join(broken)}" if broken else "all is well")
    sys.exit(1 if broken else 0)


def _holds(check: Callable[[], bool]) -> bool:
    try:
        return check()
    except Exception as error:  # whatever is broken is named, and the other checks go on
        return report(check.__name__.replace("_", " "), f"BROKEN: {first_line(error)}", False)


def report(name: str, text: str, holds: bool = True) -> bool:
    """Print a line; whether it holds."""
    print(f"{name:<16} {text}", flush=True)
    return holds


def versions() -> bool:
    """Of the package, Python and the machine."""
    found = version_of("soft_tendon_env") or "run from its sources, not installed"
    return report("soft_tendon_env", f"{found}, in {Path(__file__).parents[1]}; Python {platform.python_version()}, {platform.machine()}")


def packages() -> bool:
    """Of what must be there."""
    found = {name: version_of(name) for name in PACKAGES}
    missing = [name for name, version in found.items() if version is None]
    text = ", ".join(f"{name} {version}" for name, version in found.items() if version)
    return report("packages", text if not missing else f"BROKEN: {', '.join(missing)} missing", not missing)


def version_of(name: str) -> str | None:
    """None where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def extras() -> bool:
    """Which there are, whether they can be imported, and what installs the others."""
    found = [f"{name} {version}" for name in OF_EXTRAS if (version := version_of(name))]
    report("extras", ", ".join(found) or "none")
    missing, holds = missing_extras(), True
    for extra in [extra for extra in EXTRAS if extra not in missing]:
        for module in EXTRAS[extra]:
            try:
                importlib.import_module(module)
            except Exception as error:  # a library may raise anything where it does not fit the machine
                holds = report("", f"BROKEN: {module} of the extra {extra} cannot be imported: {first_line(error)}", False)
    if missing:
        report("", f"not installed: {', '.join(missing)}; {install_command(missing)}")
    return holds


def shipped_scenes() -> bool:
    """Whether every scene can be read."""
    from soft_tendon_env.scene.file import load_scene, scene_names

    names = [load_scene(name).name for name in scene_names()]
    return report("scenes", ", ".join(names) or "BROKEN: none", bool(names))


def shipped_agents() -> bool:
    """Whether trainings and trained agents are there."""
    from soft_tendon_env.learning.config import config_names
    from soft_tendon_env.policies.agent import find_agent, read_config
    from soft_tendon_env.tools.registration import IDS

    configs, agents = config_names(), [task for task in IDS if read_config(find_agent("agent", task)).files]
    holds = bool(configs) and len(agents) == len(IDS)
    report("trainings", ", ".join(configs) or "BROKEN: none")
    return report("agents", ", ".join(agents) if holds else "BROKEN: not one per task", holds)


def kernel_cache() -> bool:
    """Where machine code is kept; nothing is broken without, but every process compiles again."""
    from soft_tendon_env.tools.cache_folder import cache_folder

    folder = cache_folder()
    if folder is None:
        remedy = "set NUMBA_CACHE_DIR to a folder that can be written"
        return report("kernel cache", f"none can be written: every process compiles again; {remedy}")
    try:
        tempfile.TemporaryFile(dir=folder).close()
        state = "can be written"
    except OSError:
        state = "read-only: what is compiled anew is not kept"
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return report("kernel cache", f"{folder}, {size / 1e6:.0f} MB, {state}")


def tasks() -> bool:
    """One step of every task."""
    import gymnasium as gym
    import numpy as np

    from soft_tendon_env.tools.registration import IDS

    holds = True
    for id in IDS.values():
        try:
            started = time.perf_counter()
            env = gym.make(id)
            observation, _ = env.reset(seed=0)
            ready = time.perf_counter()
            observation, reward, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
            stepped = time.perf_counter()
            env.close()
            if not env.observation_space.contains(observation) or not np.isfinite(float(reward)):
                raise ArithmeticError("the step gave an observation outside of its space, or a reward that is not finite")
            report(id, f"made and reset in {ready - started:.2f} s, one step in {1e3 * (stepped - ready):.1f} ms")
        except Exception as error:  # whatever is broken is named, and the other tasks are tried
            holds = report(id, f"BROKEN: {first_line(error)}", False)
    return holds
