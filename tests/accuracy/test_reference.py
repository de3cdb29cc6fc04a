"""Converged references: the error bar bounds the error, loads act at rest, refinement stops where it may.

Test inputs: bands of the tensions' range, how often they change, the same seed again.
"""

import numpy as np
import pytest

from soft_tendon_env.accuracy.reference import LEVELS, STATIONS, backbones, distances, full_physics, motion, reference_motions
from soft_tendon_env.accuracy.test_inputs import HOLD, MOTIONS, motion_tensions
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene

SCENE = load_scene("three_tendon")
PAPER = load_scene("paper")
GREATEST = {"redrawn": 15.0, "increments": 20.0, "smooth": 20.0, "wild": 60.0, "step": 20.0, "noisy": 24.0, "pulses": 20.0}


def test_the_error_bar_bounds_the_error():
    inputs = [motion_tensions(SCENE, kind, 0, 0.5) for kind in ("redrawn", "smooth")]
    rough, fine = (reference_motions(SCENE, inputs, tolerance) for tolerance in (1e-3, 1e-8))
    assert LEVELS.index(rough.level) < LEVELS.index(fine.level)
    for before, after, tip, along in zip(rough.backbones, fine.backbones, rough.tip_errors, rough.backbone_errors, strict=True):
        assert before.shape == (0.5 / HOLD + 1, STATIONS, 3)
        apart = distances(before, after)
        assert 0.0 < apart[0] <= 1.05 * tip and apart[1] <= 1.05 * along
    assert max(fine.tip_errors) < 1e-6


def test_a_loaded_arm_begins_at_rest():
    scene = SCENE.replace({"effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    model = full_physics(scene, LEVELS[0])
    q = motion(model, np.zeros((5, 3)))
    rest = static_equilibrium(model, np.zeros(3)).tip_pose[:3, 3]
    assert np.abs(backbones(model, q)[:, -1] - rest).max() < 1e-6
    assert np.linalg.norm(rest - [0.3, 0.0, 0.0]) > 0.05


def test_rigid_strains_stay_rigid_and_cuts_add_fields():
    scene = SCENE.replace({"strain": {"type": "statics_based", "strains": ["bend_y", "bend_z"]}})
    counts = [full_physics(scene, LEVELS[0]._replace(order=2, cuts=cuts)).coordinate_count for cuts in (1, 2)]
    assert counts == [6, 12]


def test_motions_that_full_physics_has_not_are_none():
    assert motion(full_physics(SCENE, LEVELS[0]), np.full((3, 3), 1e7)) is None


def test_distances_of_tip_and_backbone():
    found, other = np.zeros((4, STATIONS, 3)), np.zeros((4, STATIONS, 3))
    other[1, -1] = [3e-3, 4e-3, 0.0]
    other[2, 0] = [0.0, 0.0, 7e-3]
    assert distances(found, other) == pytest.approx((5e-3, 7e-3))


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
