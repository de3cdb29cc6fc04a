"""What many tests need: models (built once each), states to try them at, the reference numbers,
processes of their own, environments."""

import functools
import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env import Model, load_scene
from soft_tendon_env.envs import IDS, starts
from soft_tendon_env.mechanics.terms.evaluate import configure, evaluate
from soft_tendon_env.mechanics.types import Explicit
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.compilation_progress import PROGRESS
from soft_tendon_env.tools.registry import temporary_registrations

# What tests read from stderr does not depend on how long kernels are compiled for them.
PROGRESS.silence()

DATA = Path(__file__).parent / "data"
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
LOADED = {
    "scene": "three_tendon",
    "effects.gravity.acceleration": [0.0, 0.0, -9.81],
    "effects.tip_load.mass": 0.005,
}
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
            "strain": {
                "type": "explicit",
                "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}],
            },
        }
    },
}
FEW_ARMS = 8
"""Arms in the bank of an environment with every randomisation."""
EVERYTHING = {
    "stiffness": [0.8, 1.2],
    "damping": [0.5, 1.5],
    "density": [0.8, 1.2],
    "payload": [0.0, 0.01],
    "tension_gain": [0.9, 1.1],
    "tension_offset": [-0.1, 0.1],
    "latency": [0.0, 0.05],
    "noise": {
        "position": 0.001,
        "rotation": 0.01,
        "length": 0.001,
        "curvature": 0.1,
        "stretch": 0.01,
        "stretch_rate": 0.1,
    },
}


@functools.cache
def _build(name, changes):
    name, _, order = name.partition(" moments 0-")
    scene = load_scene(name)
    if order:
        moments = {"strains": STRAINS[:3], "order": int(order), "span": "rod"}
        scene = scene.replace({"strain.passive": [moments]})
    return build_model(scene.replace(json.loads(changes)))


@pytest.fixture(scope="session")
def build():
    """build("paper", {"quadrature.intervals": 2}): the model of a shipped scene with dotted
    changes.

    "paper moments 0-2" has passive moments up to quadratic over the whole rod besides.
    """
    return lambda name, changes=None: _build(name, json.dumps(changes or {}))


@pytest.fixture(scope="session")
def reference():
    """reference("statics"): what is in tests/data/statics.json."""
    return lambda name: json.loads((DATA / f"{name}.json").read_text())


@pytest.fixture(scope="session")
def random_state():
    """random_state(model, seed): coordinates and rates of a lively motion, whatever the coordinates
    mean.

    Tensions are random within a fifth of their limits; the coordinates follow as at rest, and
    passive ones get about a tenth of the energy of the tensions'. Rates: as if every coordinate
    changed by its own size some ten times a second.
    """

    def state(model: Model, seed: int):
        rng = np.random.default_rng(seed)
        least, greatest = np.array([tendon.tension_limits for tendon in model.scene.tendons]).T
        u = least + 0.2 * rng.random(model.tendon_count) * (greatest - least)
        rest = model.terms(np.zeros(model.coordinate_count), np.zeros(model.coordinate_count))
        stiffness = rest.stiffness
        strain = model.arm.strain
        load = rest.actuation @ u
        energy = (
            0.5 * load @ np.linalg.lstsq(stiffness, load)[0]
        )  # elastic, of the linear answer to the tensions
        size = np.sqrt(0.1 * energy / np.diag(stiffness))
        if not isinstance(strain, Explicit):
            q = model.rest_coordinates(u)
            q[strain.law.active :] += (size * rng.normal(size=size.size))[strain.law.active :]
        else:
            q = np.linalg.solve(strain.stiffness, rest.actuation @ u)
        return q, 10.0 * size * rng.normal(size=size.size)

    return state


@pytest.fixture(scope="session")
def workspace_at():
    """workspace_at(model, q, q_dot, tension): the workspace after `evaluate`."""

    def at(model, q, q_dot=None, tension=None):
        work = make_workspace(model.arm)
        q = np.array(q, dtype=float)
        if q_dot is None:
            q_dot = np.zeros_like(q)
        else:
            q_dot = np.array(q_dot, dtype=float)
        tension = (
            np.zeros(model.tendon_count) if tension is None else np.array(tension, dtype=float)
        )
        assert configure(model.arm, q, 1e-12, work) == (-1, 1.0)
        assert evaluate(model.arm, tension, q, q_dot, 1e-12, work) == -1
        return work

    return at


@pytest.fixture(scope="session")
def arms():
    """Options by name: a plain arm, one with gravity and a payload, one with an explicit strain."""
    return ARMS


@pytest.fixture(params=ARMS)
def arm(request):
    """The options of each of them."""
    return ARMS[request.param]


@pytest.fixture
def everything(monkeypatch):
    """Every randomisation at once, of arms from a bank of a few: to make 64 takes longest."""
    monkeypatch.setattr(starts, "BANK", FEW_ARMS)
    return EVERYTHING


def _same(a, b):
    if isinstance(a, dict):
        have_same_keys = isinstance(b, dict) and a.keys() == b.keys()
        return have_same_keys and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, np.ndarray):
        are_alike = isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape
        if not are_alike:
            return False
        if a.dtype == object:
            return _same(a.tolist(), b.tolist())
        # by their bytes, so that NaN is the same as NaN
        return a.tobytes() == b.tobytes()
    return type(a) is type(b) and bool(np.all(a == b))


@pytest.fixture(scope="session")
def same():
    """same(a, b): whether nested values are alike bit for bit."""
    return _same


@pytest.fixture(scope="session")
def live():
    """live(env, seed, steps, actions=None): what reset and every step gave, with a reset whenever
    an episode ends.

    actions (steps, n_a); random ones that depend on the seed alone by default.
    """

    def lived(env, seed, steps, actions=None):
        if actions is None:
            actions = np.random.default_rng(seed).uniform(
                -1.0, 1.0, (steps, *env.action_space.shape)
            )
        history = [env.reset(seed=seed)]
        for action in actions:
            history.append(env.step(action))
            if history[-1][2] or history[-1][3]:
                history.append(env.reset())
        return history

    return lived


@pytest.fixture
def forgotten():
    """What a test registers is forgotten at its end, Gymnasium's ids too."""
    tables = [IDS, gym.registry]
    before = [dict(table) for table in tables]
    with temporary_registrations():
        yield
    for table, content in zip(tables, before, strict=True):
        table.clear()
        table.update(content)


@pytest.fixture(scope="session")
def table():
    """The table of a small training: 256 steps of PPO in four rows."""
    return {
        "task": "TipPose",
        "algorithm": "PPO",
        "steps": 256,
        "arms": 4,
        "seconds": 0.4,
        "hyperparameters": {"n_steps": 16, "batch_size": 32, "n_epochs": 1},
        "options": {"scene": "three_tendon", "fidelity": "fast"},
        "evaluation": {"every": 128, "episodes": 2, "skip": 0.2},
    }
