"""`soft-tendon doctor`: whether the installation works, and what of it is missing."""

import importlib
import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from soft_tendon_env.cli.errors import EXTRAS, install_command, missing_extras
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.versions import fits

STOPPED = "stopped"
PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "gymnasium", "pydantic", "daqp", "tomli_w", "tqdm")
OF_EXTRAS = ("torch", "stable_baselines3", "sb3_contrib", "rerun-sdk", "matplotlib")


class Doctor(Configuration):
    """Check the installation: versions and their bounds, ids, scenes, kernel cache, extras, one step of every task, and of one in a second
    process from the cache. Exit status 1 if something is broken."""


def run(arguments: Sequence[str]) -> None:
    """Print a line per check."""
    Parser("doctor", Doctor).read(arguments)
    checks = (versions, packages, bounds, extras, shipped_scenes, shipped_agents, compiler, kernel_cache, tracking, tasks, second_process)
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


def bounds() -> bool:
    """Whether what is installed is within the bounds that the package was tested with."""
    outside = []
    for requirement in required():
        name, allowed = re.fullmatch(r"([\w.-]+)(?:\[.*\])?\s*(.*)", requirement).groups()  # type: ignore[union-attr]
        found = version_of(name)
        if found is not None and not fits(found, allowed):
            outside.append(f'{name} {found}: pip install "{requirement}"')
    return report("bounds", f"BROKEN: outside are {', '.join(outside)}" if outside else "all versions are within those tested", not outside)


def required() -> list[str]:
    """Requirements of the package and of its extras that share an environment, without their conditions."""
    try:
        listed = importlib.metadata.requires("soft_tendon_env") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    split = (requirement.partition(";") for requirement in listed)
    return [name.strip() for name, _, marker in split if not marker or any(f"'{extra}'" in marker.replace('"', "'") for extra in EXTRAS)]


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
    from soft_tendon_env.registration import IDS

    configs, agents = config_names(), [task for task in IDS if read_config(find_agent("agent", task)).files]
    holds = bool(configs) and len(agents) == len(IDS)
    report("trainings", ", ".join(configs) or "BROKEN: none")
    return report("agents", ", ".join(agents) if holds else "BROKEN: not one per task", holds)


def compiler() -> bool:
    """Whether numba's version is one whose internals are known; nothing is broken without, but compiling takes longer."""
    import numba

    from soft_tendon_env.compiler.numba_internals import IS_TESTED, TESTED

    known = "tested" if IS_TESTED else "used without what is known of the tested versions, so that compiling takes several times as long"
    return report("compiler", f"numba {numba.__version__}, {known} ({TESTED})")


def kernel_cache() -> bool:
    """Where machine code is kept; nothing is broken without, but every process compiles again."""
    from soft_tendon_env.compiler.cache_folder import cache_folder

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

    from soft_tendon_env.registration import IDS

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


KERNEL = """
from soft_tendon_env.compiler.compilation import kernel
import helper

def called(x):
    return helper.scaled(x)

print(kernel(called)(1.0))
"""
HELPER = "from soft_tendon_env.compiler.compilation import kernel\n\n@kernel\ndef scaled(x):\n    return {factor} * x\n"
SECOND = """
import gymnasium as gym
import numpy as np
import soft_tendon_env
env = gym.make({id!r})
env.reset(seed=0)
env.step(np.zeros(env.action_space.shape, dtype=np.float32))
"""


def tracking() -> bool:
    """Whether a kernel is compiled again when one that it calls changes in another file."""
    printed = []
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder, "script.py")
        script.write_text(KERNEL)
        for factor in (2.0, 3.0):
            Path(folder, "helper.py").write_text(HELPER.format(factor=factor))
            printed.append(_run_apart([str(script)], NUMBA_CACHE_DIR=folder).stdout.strip())
    holds = printed == ["2.0", "3.0"]
    return report("tracking", "what kernels call is tracked" if holds else f"BROKEN: kernels gave {printed} after a change", holds)


def second_process() -> bool:
    """Whether a process finds all that a task needs in the cache, at the latest after one that left it there."""
    from soft_tendon_env.compiler.cache_folder import cache_folder
    from soft_tendon_env.registration import IDS

    for _ in range(2):
        started = time.perf_counter()
        said = _run_apart(["-c", SECOND.format(id=next(iter(IDS.values())))], SOFT_TENDON_ENV_QUIET="0").stderr
        compiled, spent = "compiling for first use" in said, time.perf_counter() - started
        if not compiled:
            return report("second process", f"compiled nothing, {spent:.1f} s with its start")
    folder = cache_folder()
    is_kept = folder is not None and os.access(folder, os.W_OK)
    return report("second process", f"{'BROKEN: ' * is_kept}compiled again what the one before it had compiled, {spent:.1f} s", not is_kept)


def _run_apart(arguments: list[str], **variables: str) -> "subprocess.CompletedProcess[str]":
    """Run Python in a process of its own, with this package. Raises RuntimeError with the last line of what it said where it fails."""
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", **variables}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return done
