"""Converged references and what is measured against them; test inputs: bands and the same seed
again."""

import numpy as np
import pytest

from soft_tendon_env.accuracy.input_motions import HOLD, MOTIONS, motion_tensions
from soft_tendon_env.accuracy.reference import distance, reference_motions, tip_path
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.reference_model import LEVELS, part_borders, reference_model
from soft_tendon_env.scene.file import load_scene

ARM = load_scene("three_tendon")
PAPER = load_scene("paper")
GREATEST = {"redrawn": 15.0, "increments": 20.0, "smooth": 20.0, "wild": 60.0, "step": 20.0}


def test_errors_are_distances_from_the_reference():
    """A motion that the model has not counts as infinitely far, one that full physics has not does
    not count."""
    tensions = motion_tensions(ARM, "redrawn", 1, 0.2)
    path = tip_path(reference_model(ARM, LEVELS[0], 1e-6), tensions)
    assert path.shape == (0.2 / HOLD + 1, 3)
    assert tip_path(reference_model(ARM, LEVELS[0]), tensions[0]).shape == (1, 3)
    assert distance(path, path + [0.0, 0.0018, 0.0024]) == pytest.approx(0.003)
    stuck = tip_path(
        model_on(ARM.replace({"integrator.max_halvings": 0}), 8), np.full_like(tensions, 1e5)
    )
    assert stuck is None
    assert distance(stuck, path) == np.inf
    assert np.isnan(distance(path, None))


def test_the_error_bar_bounds_the_error():
    curled = ARM.replace(
        {
            "segments.0.curvature": [0.0, 9.0, 15.0],
            "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        }
    )
    inputs = [motion_tensions(curled, "smooth", 0, 0.3), np.array([3.0, 0.0, 5.0])]
    rough = reference_motions(curled, inputs, 1e-3)
    fine = reference_motions(curled, inputs, 1e-6)
    assert LEVELS.index(rough.level) < LEVELS.index(fine.level)
    for before, after, bar in zip(rough.tips, fine.tips, rough.tip_errors, strict=True):
        assert 0.0 < np.linalg.norm(after - before, axis=1).max() <= bar


def test_parts_turn_once_at_most():
    changes = {"segments.0.curvature": [0.0, 0.0, 2.5 * 2.0 * np.pi / 0.3]}
    spring = ARM.replace(changes)
    np.testing.assert_allclose(part_borders(spring), [0.1, 0.2])
    assert part_borders(ARM) == []
    assert len(part_borders(ARM, 4)) == 3


@pytest.mark.parametrize("motion", MOTIONS)
def test_tensions_fill_their_band_and_are_those_of_their_seed(motion):
    tables = np.concatenate([motion_tensions(PAPER, motion, seed) for seed in range(20)])
    assert tables.shape == (20 * 2.0 / HOLD, 10)
    assert tables.min() >= 0.0
    assert 0.9 * GREATEST[motion] < tables.max() <= GREATEST[motion]
    third = motion_tensions(PAPER, motion, 3)
    again = motion_tensions(PAPER, motion, 3)
    fourth = motion_tensions(PAPER, motion, 4)
    np.testing.assert_array_equal(again, third)
    difference = np.abs(third - fourth)
    assert difference.max() > 1.0
