"""`soft-tendon doctor`: whether the installation works, and which parts of it are missing."""

import importlib
import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from soft_tendon_env.cli.errors import EXTRAS, install_command, missing_extras
from soft_tendon_env.cli.options import Parser
from soft_tendon_env.registration import IDS
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.versions import fits


class Doctor(Configuration):
    """Check the installation: versions and their bounds, ids, scenes, kernel cache, extras, one step of every task, and of one in a second
    process from the cache. Exit status 1 if something is broken."""


class Broken(Exception):
    """Raised by a check for what does not work."""


Check = Callable[[], Iterator[str]]
"""Yields lines about what it finds, and raises where something is broken."""


def run(arguments: Sequence[str]) -> None:
    """Run all checks, those of tasks one by one."""
    Parser("doctor", Doctor).read(arguments)
    checks: dict[str, Check] = {
        "soft_tendon_env": package,
        "packages": packages,
        **{f"extra {name}": partial(extra, name) for name in EXTRAS},
        "files": files,
        "kernel cache": kernel_cache,
        **{id: partial(task, id) for id in IDS.values()},
        "second process": second_process,
    }
    broken = [name for name, check in checks.items() if not holds(name, check)]
    print(f"broken: {', '.join(broken)}" if broken else "all is well")
    sys.exit(1 if broken else 0)


def holds(name: str, check: Check) -> bool:
    """Print the lines of a check; False if it found something broken."""
    try:
        for line in check():
            print(f"{name:<16} {line}", flush=True)
    except Exception as error:  # any error is named, and the other checks go on
        print(f"{name:<16} BROKEN: {error if isinstance(error, Broken) else first_line(error)}", flush=True)
        return False
    return True


def package() -> Iterator[str]:
    """Version and place of the package, Python and the machine."""
    found = version_of("soft_tendon_env") or "run from its sources, not installed"
    yield f"{found}, in {Path(__file__).parents[1]}; Python {platform.python_version()}, {platform.machine()}"


def version_of(name: str) -> str | None:
    """Version of an installed package; None if it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def packages(extra: str = "") -> Iterator[str]:
    """Versions of what the package, or an extra, requires, which should be within the bounds that it was tested with."""
    try:
        listed = importlib.metadata.requires("soft_tendon_env") or []
    except importlib.metadata.PackageNotFoundError:
        listed = []
    found, broken = [], []
    for requirement, _, marker in (line.partition(";") for line in listed):
        name, bounds = re.fullmatch(r"([\w.-]+)(?:\[.*\])?\s*(.*?)\s*", requirement).groups()  # type: ignore[union-attr]
        if bool(marker) != bool(extra) or (extra and f"extra == '{extra}'" not in marker.replace('"', "'")):
            continue
        version = version_of(name)
        found.append(f"{name} {version}")
        if version is None or not fits(version, bounds):
            broken.append(f'{name} is {version or "missing"}: pip install "{requirement.strip()}"')
    yield ", ".join(found) or "not known, since this one is not installed"
    if broken:
        raise Broken(", ".join(broken))


def extra(name: str) -> Iterator[str]:
    """Versions of what an extra requires, and whether it can be imported; or the command that installs it."""
    if missing_extras((name,)):
        yield f"not installed: {install_command([name])}"
        return
    yield from packages(name)
    for module in EXTRAS[name]:
        try:
            importlib.import_module(module)
        except Exception as error:  # a library may raise anything where it does not fit the machine
            raise Broken(f"{module} cannot be imported: {first_line(error)}") from error


def files() -> Iterator[str]:
    """Scenes, trainings and agents that ship."""
    from soft_tendon_env.learning.config import config_names
    from soft_tendon_env.policies.agent_files import AGENT, find_agent, read_config, shipped_as
    from soft_tendon_env.scene.file import load_scene, scene_names

    agents = [f"{task} ({shipped_as(AGENT, task)})" for task in IDS if read_config(find_agent(AGENT, task)).files]
    shipped = {"scenes": [load_scene(name).name for name in scene_names()], "trainings": config_names(), "agents": agents}
    for kind, names in shipped.items():
        yield f"{kind}: {', '.join(names)}"
        if len(names) < (len(IDS) if kind == "agents" else 1):
            raise Broken(f"not all {kind} are there")


def kernel_cache() -> Iterator[str]:
    """Folder of machine code; nothing is broken without, but every process compiles again."""
    from soft_tendon_env.compiler.compilation import cache_folder
    from soft_tendon_env.tools.user_cache import WRITABLE

    folder = cache_folder()
    if folder is None:
        yield f"none can be written: every process compiles again; {WRITABLE}"
        return
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    yield f"{folder}, {size / 1e6:.0f} MB"


def task(id: str) -> Iterator[str]:
    """One step of an environment."""
    import gymnasium as gym
    import numpy as np

    started = time.perf_counter()
    env = gym.make(id)
    env.reset(seed=0)
    ready = time.perf_counter()
    observation, reward, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    stepped = time.perf_counter()
    env.close()
    if not env.observation_space.contains(observation) or not np.isfinite(float(reward)):
        raise Broken("the step gave an observation outside of its space, or a reward that is not finite")
    yield f"made and reset in {ready - started:.2f} s, one step in {1e3 * (stepped - ready):.1f} ms"


SECOND = "from soft_tendon_env.cli.doctor import task; print(*task({id!r}))"


def second_process() -> Iterator[str]:
    """Whether a process finds all that a task needs in the cache, at the latest after one that left it there."""
    from soft_tendon_env.compiler.compilation import cache_folder

    for _ in range(2):
        started = time.perf_counter()
        said = _said_apart(SECOND.format(id=next(iter(IDS.values()))))
        spent = f"{time.perf_counter() - started:.1f} s with its start"
        if "compiling for first use" not in said:
            yield f"compiled nothing, {spent}"
            return
    again = f"compiled again what the one before it had compiled, {spent}"
    if cache_folder() is not None:
        raise Broken(again)
    yield again


def _said_apart(program: str) -> str:
    """Return what a program says on stderr in a process of its own, with this package. Raises Broken with its last line where it fails."""
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path, "SOFT_TENDON_ENV_QUIET": "0"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    if done.returncode:
        raise Broken((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return done.stderr
