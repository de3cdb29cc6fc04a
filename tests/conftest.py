"""What many tests need: models (built once each), states to try them at, the reference numbers, processes of their own, environments."""

import functools
import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import CONTROLLERS, ControllerOutput
from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.envs import IDS, TARGETS, TASKS
from soft_tendon_env.envs.tracking import OWN_TERMS
from soft_tendon_env.mechanics.terms.evaluate import configure, evaluate
from soft_tendon_env.mechanics.types import Explicit
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.model import Model
from soft_tendon_env.policies.controller_policy import ControllerPolicy
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.files import PACKAGE

DATA = Path(__file__).parent / "data"
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
LOADED = {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.tip_load.mass": 0.005}
ARMS = {
    "three_tendon": {"scene": "three_tendon", "fidelity": "fast"},
    "loaded": {"scene": LOADED, "fidelity": "fast"},
    "loads inside": {
        "scene": {**LOADED, "strain.include_loads": True},
        "fidelity": "fast",
    },
    "explicit": {
        "scene": {
            "scene": "three_tendon",
            "quadrature.intervals": 4,
            "strain": {"type": "explicit", "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}]},
        }
    },
}
EVERYTHING = {
    "stiffness": [0.8, 1.2],
    "damping": [0.5, 1.5],
    "density": [0.8, 1.2],
    "payload": [0.0, 0.01],
    "tension_gain": [0.9, 1.1],
    "tension_offset": [-0.1, 0.1],
    "latency": [0.0, 0.05],
    "noise": {"position": 0.001, "rotation": 0.01, "length": 0.001, "curvature": 0.1, "stretch": 0.01, "stretch_rate": 0.1},
}


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
        if not isinstance(strain, Explicit):
            q = model.rest_coordinates(u)
            q[strain.law.active :] += (size * rng.normal(size=size.size))[strain.law.active :]
        else:
            q = np.linalg.solve(strain.stiffness, rest.actuation @ u)
        return q, 10.0 * size * rng.normal(size=size.size)

    return state


def _energy(rest, u):
    """Elastic energy of the linear answer to the tensions u."""
    load = rest.actuation @ u
    return 0.5 * load @ np.linalg.lstsq(rest.stiffness, load)[0]


@pytest.fixture(scope="session")
def workspace_at():
    """workspace_at(model, q, q_dot, tension): the workspace after `evaluate`."""

    def at(model, q, q_dot=None, tension=None):
        work = make_workspace(model.arm)
        q = np.array(q, dtype=float)
        q_dot = np.zeros_like(q) if q_dot is None else np.array(q_dot, dtype=float)
        tension = np.zeros(model.tendon_count) if tension is None else np.array(tension, dtype=float)
        assert configure(model.arm, q, 1e-12, work) == (-1, 1.0)
        assert evaluate(model.arm, tension, q, q_dot, 1e-12, work) == -1
        return work

    return at


class Malice:
    """What makes a folder where it is unpickled."""

    def __init__(self, folder):
        self.folder = str(folder)

    def __reduce__(self):
        return os.mkdir, (self.folder,)


@pytest.fixture(scope="session")
def malice():
    """malice(folder): what makes that folder where it is unpickled."""
    return Malice


@pytest.fixture
def run(tmp_path):
    """run(script, NAME="value"): a Python script in a process of its own, with a kernel cache of its own in `tmp_path / "cache"`."""

    def run(script: str, **variables: str) -> subprocess.CompletedProcess[str]:
        (tmp_path / "script.py").write_text(script)
        inherited = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "SOFT_TENDON_ENV_", "XDG_"))}
        environment = {**inherited, "PYTHONPATH": str(PACKAGE.parent), "XDG_CACHE_HOME": str(tmp_path / "cache"), **variables}
        command = [sys.executable, tmp_path / "script.py"]
        process = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
        assert process.returncode == 0, process.stderr
        return process

    return run


@pytest.fixture(scope="session")
def arms():
    """Options by name: a plain arm, one with gravity and a payload, one with an explicit strain."""
    return ARMS


@pytest.fixture(params=ARMS)
def arm(request):
    """The options of each of them."""
    return ARMS[request.param]


@pytest.fixture(scope="session")
def everything():
    """Every randomisation at once."""
    return EVERYTHING


def _same(a, b):
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, np.ndarray) and a.dtype == object:
        return isinstance(b, np.ndarray) and _same(a.tolist(), b.tolist())
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and bool(np.all(a == b))


@pytest.fixture(scope="session")
def same():
    """same(a, b): whether nested values are alike bit for bit."""
    return _same


@pytest.fixture(scope="session")
def live():
    """live(env, seed, steps, actions=None): what reset and every step gave, with a reset whenever an episode ends.

    actions (steps, n_a); random ones that depend on the seed alone by default.
    """

    def lived(env, seed, steps, actions=None):
        if actions is None:
            actions = np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, *env.action_space.shape))
        history = [env.reset(seed=seed)]
        for action in actions:
            history.append(env.step(action))
            if history[-1][2] or history[-1][3]:
                history.append(env.reset())
        return history

    return lived


class Probe:
    """A controller that keeps the situations and memories it is given, asks for tensions that depend on all of them, and counts."""

    def __init__(self, tendons, least, span):
        self.weights, self.least, self.span, self.seen = np.arange(1.0, tendons + 1), least, span, []

    def act(self, now, memory=None):
        self.seen.append((now, memory))
        told = (now.q, now.q_dot, now.tip_pose, now.tension, now.reference.tip_pose, now.reference.tip_position, now.reference.q)
        phase = (memory or 0) + sum(values.sum() for values in told if values is not None)
        return ControllerOutput(self.least + 0.5 * self.span * (1.0 + np.sin(self.weights * phase)), (memory or 0) + 1)


@pytest.fixture(scope="session")
def probed():
    """probed(env): a policy for three tendons and the probe it asks, for tensions from `least` [N] over `span` [N]."""

    def make(env, least=0.5, span=3.0):
        probe = Probe(3, least, span)
        return ControllerPolicy(probe, env), probe

    return make


@pytest.fixture(scope="session")
def short():
    """short(kind, id, **options): episodes of six steps, in a "single" environment or three rows of Gymnasium ("vector") or "sb3"."""

    def make(kind, id, **options):
        options = {"max_episode_steps": 6, "scene": "three_tendon", "fidelity": "fast", "preview": (0.02, 0.04, 0.1), **options}
        if kind == "single":
            return gym.make(id, **options)
        if kind == "vector":
            return gym.make_vec(id, num_envs=3, **options)
        from soft_tendon_env.learning.vec_env import make_sb3_vec_env  # loads torch, which few tests need

        return make_sb3_vec_env(id, 3, **options)

    return make


@pytest.fixture(scope="session")
def begun():
    """begun(env): the first observation, of seed 0."""

    def begin(env):
        if isinstance(env, gym.Env | gym.vector.VectorEnv):
            return env.reset(seed=0)[0]
        env.seed(0)
        return env.reset()

    return begin


@pytest.fixture
def forgotten():
    """Tasks, targets, reward terms, controllers and effects that a test registers are forgotten at its end."""
    tables = [TASKS, TARGETS, OWN_TERMS, IDS, EFFECTS, gym.registry, *CONTROLLERS.values()]
    before = [dict(table) for table in tables]
    yield
    for table, content in zip(tables, before, strict=True):
        table.clear()
        table.update(content)
