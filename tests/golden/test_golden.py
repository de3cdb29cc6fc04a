"""Golden numbers: what is computed is what was computed before the code was made smaller, see
golden.json for the commit."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from soft_tendon_env.evaluation.provenance import machine, versions

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
import golden_numbers  # noqa: E402

sys.path.remove(str(HERE))
MADE = json.loads((HERE / "golden.json").read_text())
IS_HERE = MADE["machine"] == machine() and all(
    MADE["versions"][name] == versions()[name] for name in ("numpy", "scipy", "numba")
)
TOLERANCE = 1e-8 if IS_HERE else 1e-5
"""Largest difference as a share of an array's largest number; other processors and libraries round
differently, and motions grow that."""
REWRITTEN = {"gradients": 1e-8}
"""Of parts whose way of computing has changed since."""
ARBITRARY = {"three_tendon stands": 1e-5}
"""Of arrays by the beginning of their names: the direction in which a symmetric column falls
follows from rounding."""


MOTIONS = [("motions", scene) for scene in golden_numbers.PRESETS]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "scene"),
    [*((part, "") for part in golden_numbers.PARTS if part != "motions"), *MOTIONS],
)
def test_numbers_are_those_of_before(part, scene):
    if scene:
        beginning = f"{part}/{scene} "
    else:
        beginning = f"{part}/"
    with np.load(HERE / "golden.npz") as kept:
        wanted = {
            name.partition("/")[2]: kept[name] for name in kept.files if name.startswith(beginning)
        }
    found = golden_numbers.PARTS[part](*scene.split())
    tolerance = max(TOLERANCE, REWRITTEN.get(part, 0.0))
    assert found.keys() == wanted.keys()
    for name, array in wanted.items():
        largest = max(tolerance, ARBITRARY.get(name.rpartition(" ")[0], 0.0)) * max(
            1e-6, np.abs(array).max()
        )
        np.testing.assert_allclose(found[name], array, rtol=0.0, atol=largest, err_msg=name)
