"""What many tests need: models (built once each), states to try them at, the reference numbers, processes of their own."""

import functools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from soft_tendon_env.cache_folder import PACKAGE
from soft_tendon_env.mechanics.types import StaticsBased
from soft_tendon_env.model import Model, build_model
from soft_tendon_env.scene_file import load_scene

DATA = Path(__file__).parent / "data"


@functools.cache
def _build(name, changes):
    return build_model(load_scene(name).replace(json.loads(changes)))


@pytest.fixture(scope="session")
def build():
    """build("paper", {"quadrature.intervals": 2}): the model of a shipped scene with dotted changes."""
    return lambda name, changes=None: _build(name, json.dumps(changes or {}))


@pytest.fixture(scope="session")
def reference():
    """reference("statics"): what is in tests/data/statics.json."""
    return lambda name: json.loads((DATA / f"{name}.json").read_text())


@pytest.fixture(scope="session")
def random_state():
    """random_state(model, seed): coordinates and rates of a lively motion, whatever the coordinates mean.

    Tensions are random within a fifth of their limits; the coordinates follow as at rest, and passive ones get about a tenth of the
    energy of the tensions'. Rates: as if every coordinate changed by its own size some ten times a second.
    """

    def state(model: Model, seed: int):
        rng = np.random.default_rng(seed)
        least, greatest = np.array([tendon.tension_limits for tendon in model.scene.tendons]).T
        u = least + 0.2 * rng.random(model.tendon_count) * (greatest - least)
        rest = model.terms(np.zeros(model.coordinate_count), np.zeros(model.coordinate_count))
        stiffness, strain = rest.stiffness, model.arm.strain
        size = np.sqrt(0.1 * _energy(rest, u) / np.diag(stiffness))
        if isinstance(strain, StaticsBased):
            q = model.rest_coordinates(u)
            q[strain.active :] += (size * rng.normal(size=size.size))[strain.active :]
        else:
            q = np.linalg.solve(strain.stiffness, rest.actuation @ u)
        return q, 10.0 * size * rng.normal(size=size.size)

    return state


def _energy(rest, u):
    """Elastic energy of the linear answer to the tensions u."""
    load = rest.actuation @ u
    return 0.5 * load @ np.linalg.lstsq(rest.stiffness, load)[0]


@pytest.fixture
def start(tmp_path):
    """start(script, NAME="value"): a Python script in a process of its own, with a kernel cache of its own in `tmp_path / "cache"`."""
    started = []

    def start(script: str, stderr=subprocess.PIPE, **variables: str) -> subprocess.Popen[str]:
        file = tmp_path / "script.py"
        if not file.exists() or file.read_text() != script:  # another process may be reading it
            file.write_text(script)
        inherited = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "SOFT_TENDON_ENV_", "XDG_"))}
        environment = {**inherited, "PYTHONPATH": str(PACKAGE.parent), "XDG_CACHE_HOME": str(tmp_path / "cache"), **variables}
        environment = {name: value for name, value in environment.items() if value is not None}
        process = subprocess.Popen([sys.executable, file], env=environment, stdout=subprocess.PIPE, stderr=stderr, text=True)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def run(start):
    """run(script, NAME="value"): the same, run to its end, which should be a good one."""

    def run(script: str, **options) -> subprocess.CompletedProcess[str]:
        process = start(script, **options)
        stdout, stderr = process.communicate(timeout=120)
        assert process.returncode == 0, stderr
        return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr or "")

    return run


@pytest.fixture
def two_kernels():
    """A script with two kernels that prints a result, and how many times the outer one was compiled."""
    return """
from soft_tendon_env.compilation import kernel

@kernel(inline=True)
def square(x):
    return x * x

@kernel
def sum_of_squares(n):
    total = 0.0
    for i in range(n):
        total += square(i)
    return total

print(sum_of_squares(4), sum(sum_of_squares.stats.cache_misses.values()))
"""


@pytest.fixture
def problems():
    """problems(stderr): its lines without that kernels are compiled."""
    return lambda text: [line for line in text.splitlines() if not re.search("compiling for first use|compiled [0-9]+ functions", line)]


@pytest.fixture
def small_disk(tmp_path):
    """A folder that is a file system of its own, of 64 KiB; skips where none can be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], capture_output=True).returncode:
        pytest.skip("file systems cannot be mounted here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.fixture
def slowly():
    """slowly(script, seconds, together=1, PATIENCE=1.0): the script with compilations that take longer by so many seconds.

    It begins when as many processes as should be `together` have come so far, and sees other constants in `kernel_cache`.
    """

    def changed(script: str, seconds: float, together: int = 1, **constants: float) -> str:
        return f"""
import os, pathlib, time
from numba.core import event
from soft_tendon_env import kernel_cache

class Slow(event.Listener):
    def on_start(self, _):
        time.sleep({seconds})
    def on_end(self, _):
        pass

event.register("numba:compile", Slow())
vars(kernel_cache).update({constants})
folder = pathlib.Path(__file__).parent
(folder / f"ready-{{os.getpid()}}").touch()
while len(list(folder.glob("ready-*"))) < {together}:
    time.sleep(0.01)
""" + script

    return changed
