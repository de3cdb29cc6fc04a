"""Test inputs: bands of the tensions' range, how often they change, the same seed again."""

import numpy as np
import pytest

from soft_tendon_env.accuracy.test_inputs import HOLD, MOTIONS, motion_tensions
from soft_tendon_env.scene.file import load_scene

PAPER = load_scene("paper")
GREATEST = {"redrawn": 15.0, "increments": 20.0, "smooth": 20.0, "wild": 60.0, "step": 20.0, "noisy": 24.0, "pulses": 20.0}


@pytest.mark.parametrize("motion", MOTIONS)
def test_tensions_fill_their_band_and_are_those_of_their_seed(motion):
    tables = np.concatenate([motion_tensions(PAPER, motion, seed) for seed in range(20)])
    assert tables.shape == (20 * 2.0 / HOLD, 10)
    assert tables.min() >= 0.0 and 0.9 * GREATEST[motion] < tables.max() <= GREATEST[motion]
    np.testing.assert_array_equal(motion_tensions(PAPER, motion, 3), motion_tensions(PAPER, motion, 3))
    assert np.abs(motion_tensions(PAPER, motion, 3) - motion_tensions(PAPER, motion, 4)).max() > 1.0


def test_how_tensions_change_from_row_to_row():
    change = {motion: np.abs(np.diff(motion_tensions(PAPER, motion, 0), axis=0)).max(axis=1) for motion in MOTIONS}
    assert (np.flatnonzero(change["redrawn"]) % 5 == 4).all() and np.count_nonzero(change["redrawn"]) == 19
    assert 1.5 < change["increments"].max() <= 2.0
    assert 0.5 < change["smooth"].max() <= 20.0 * np.pi * 0.88 * HOLD
    assert change["wild"].min() > 10.0 and not change["step"].any()
    assert change["noisy"].min() > 1.0 and 0.5 < np.mean(change["pulses"] == 0.0) < 0.9


def test_tendons_that_push_do_so_in_proportion_and_begin_slack():
    scene = PAPER.replace({"tendons.0.tension_limits": [-6.0, 60.0], "tendons.1.tension_limits": [5.0, 60.0]})
    walk = motion_tensions(scene, "increments", 0)
    wild = np.concatenate([motion_tensions(scene, "wild", seed) for seed in range(20)])
    assert np.abs(walk[0, 0]) <= 2.2 and -2.0 <= walk[:, 0].min() and walk[0, 1] <= 5.0 + 55.0 / 30.0
    assert -6.0 <= wild[:, 0].min() < -5.5 and 59.0 < wild[:, 0].max() <= 60.0
    assert 5.0 <= wild[:, 1].min() < 6.0
