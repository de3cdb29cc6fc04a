"""Simulated measurements of a small arm with known parameters."""

import csv
import functools

import numpy as np
import pytest
import tomli_w

from soft_tendon_env import Simulation, load_scene, simulate, static_equilibrium
from soft_tendon_env.identification import load_markers
from soft_tendon_env.identification.readings import Plants
from soft_tendon_env.model.build import build_model

NOISE = 2e-4
TURN = [0.5, 0.5, 0.5, 0.5]  # data (x, y, z) to scene (z, x, y)
MARKERS = {
    "base": (0.08, [0.0, 0.012, 0.0]),
    "middle": (0.16, [0.0, 0.0, 0.012]),
    "tip": (0.24, [0.004, 0.0, 0.0]),
}


@pytest.fixture(scope="session")
def arm():
    """A hanging arm with three tendons, at a fidelity of its own."""
    changes = {
        "effects.gravity.acceleration": [9.81, 0.0, 0.0],
        "strain.passive": [{"strains": ["bend_y", "bend_z"], "order": 2, "span": "rod"}],
    }
    return load_scene("three_tendon").replace(changes)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A folder with markers.toml."""
    path = tmp_path_factory.mktemp("measured")
    table = {
        name: {"arc_length": place, "offset": offset} for name, (place, offset) in MARKERS.items()
    }
    (path / "markers.toml").write_text(
        tomli_w.dumps(
            {"markers": table, "frame": {"quaternion": TURN, "translation": [0.0, 0.0, 0.01]}}
        )
    )
    return path


@pytest.fixture(scope="session")
def placed(arm, folder):
    return load_markers(folder / "markers.toml", arm)


@pytest.fixture(scope="session")
def record_of(folder, placed):
    """record_of(arm, name, truth, tensions, period=0.0, noise=NOISE): the CSV file of holds, or of
    a motion, of an arm with other numbers."""

    def measured(positions, noise, seed):
        """In the frame of the data, with noise."""
        R = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # of TURN
        inside = (positions - placed.frame.translation) @ R
        rng = np.random.default_rng(seed)
        return inside + noise * rng.normal(size=inside.shape)

    def write(arm, name, truth, tensions, period=0.0, noise=NOISE, seed=0):
        scene = arm.replace(truth)
        model = build_model(scene)
        tensions = np.asarray(tensions, dtype=float)
        measurement = Plants(scene, model, placed, ()).measurement(np.zeros(0))
        if period:
            start = Simulation(model).reset_at_rest(tensions[0])
            duration = period * (len(tensions) - 1)
            q = simulate(model, tensions[:-1], duration, period, start).q
        else:
            q = [static_equilibrium(model, u).q for u in tensions]
        poses = np.array([model.backbone_at(sample, placed.arc_lengths) for sample in q])
        poses[..., :3, 3] -= scene.base.position
        positions = measured(measurement.positions(poses), noise, seed)
        times = [[i * period if period else f"{name}{i}"] for i in range(len(q))]
        columns = [
            *(f"tension_{i}" for i in range(3)),
            *(f"{marker}_{axis}" for marker in MARKERS for axis in "xyz"),
        ]
        header = ["time" if period else "hold", *columns]
        path = folder / f"{name}.csv"
        with path.open("w", newline="") as file:
            rows = zip(times, tensions, positions, strict=True)
            csv.writer(file, lineterminator="\n").writerows(
                [header, *([*t, *u, *p.ravel()] for t, u, p in rows)]
            )
        return path

    return write


@pytest.fixture(scope="session")
def record(record_of, arm):
    """record(name, truth, tensions, ...): the same of the hanging arm."""
    return functools.partial(record_of, arm)


@pytest.fixture(scope="session")
def tensions():
    """Tensions of 16 holds."""
    return np.random.default_rng(1).uniform(0.2, 3.0, size=(16, 3)) * (
        np.arange(16)[:, None] % 3 != np.arange(3)
    )


@pytest.fixture(scope="session")
def truth():
    return {"segments.0.young_modulus": 4e5, "segments.0.density": 1300.0}


@pytest.fixture(scope="session")
def holds(record, truth, tensions):
    """Holds of an arm that is softer and heavier than its scene says."""
    return record("holds", truth, tensions)
