"""Converged references: the error bar bounds the error, loads act at rest, refinement stops where it may."""

import numpy as np
import pytest

from soft_tendon_env.accuracy.reference import LEVELS, STATIONS, backbones, distances, full_physics, motion, reference_motions
from soft_tendon_env.accuracy.test_inputs import HOLD, motion_tensions
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene

SCENE = load_scene("three_tendon")


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
