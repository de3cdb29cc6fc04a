"""Passive fields from snapshots: what they are made of, how accurate the arm is with them, the same
again, none of phantom tensions."""

import itertools
import warnings

import numpy as np
import pytest

from soft_tendon_env.accuracy import proper_orthogonal_fields
from soft_tendon_env.accuracy.input_motions import USUAL
from soft_tendon_env.accuracy.proper_orthogonal_fields import make_passive_fields
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.simulation import simulate
from soft_tendon_env.model.tension_limits import TensionLimitWarning
from soft_tendon_env.scene.file import SHIPPED, load_scene, scene_names
from soft_tendon_env.scene.passive_fields import SUFFIX

ARM = load_scene("three_tendon")
WITH_FIELDS = [name for name in scene_names() if (SHIPPED / f"{name}{SUFFIX}").exists()]


@pytest.fixture(scope="module")
def quick():
    """Few and short, made twice."""
    patch = pytest.MonkeyPatch()
    patch.setattr(proper_orthogonal_fields, "RUNS", 2)
    patch.setattr(proper_orthogonal_fields, "TESTS", 1)
    patch.setattr(proper_orthogonal_fields, "COUNTS", (0, 3, 6))
    yield [make_passive_fields(ARM) for _ in range(2)]
    patch.undo()


@pytest.mark.slow
def test_fields_made_twice_are_the_same_to_round_off(quick):
    first, second = quick
    assert (
        np.abs(first.coefficients - second.coefficients).max()
        <= 1e-9 * np.abs(first.coefficients).max()
    )
    np.testing.assert_allclose(first.singular_values, second.singular_values, rtol=1e-9, atol=1e-12)
    assert first.digest == second.digest
    assert first.errors == second.errors


@pytest.mark.slow
def test_errors_fall_with_the_number_of_fields(quick):
    fields, _ = quick
    for kind in USUAL:
        none, some, more = fields.errors[kind]
        assert more < 0.1 * none
        assert some < 0.2 * none
    assert fields.needed(1e9, USUAL) == 0
    assert fields.needed(0.0, USUAL) is None
    largest = max(fields.errors[kind][1] for kind in USUAL)
    assert fields.needed(largest, USUAL) == 3


@pytest.mark.parametrize("name", WITH_FIELDS)
def test_abrupt_loads_make_no_phantom_tensions(name):
    """The greatest tension, and 2.5 times that, at once on one, two and all tendons, at steps of 10
    and 20 ms."""
    scene = load_scene(name).replace(
        {"strain": {"type": "statics_based", "passive": {"type": "snapshots", "fields": 9}}}
    )
    greatest = np.array([tendon.tension_limits[1] for tendon in scene.tendons])
    for step, factor, pulled in itertools.product((0.01, 0.02), (1.0, 2.5), (1, 2, greatest.size)):
        changes = {"integrator": {"step": step}}
        model = model_on(scene.replace(changes), 6)
        is_pulled = np.arange(greatest.size) < pulled
        tension = factor * greatest * is_pulled
        with warnings.catch_warnings(action="ignore", category=TensionLimitWarning):
            q = simulate(model, tension, 1.0, step).q
        law = model.arm.strain.law
        phantoms = np.array([law.tensions(sample) for sample in q])
        phantom = np.abs(phantoms).max()
        assert phantom < 1.6 * tension.max(), (step, factor, pulled)
