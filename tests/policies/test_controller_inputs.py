"""What a controller is told of an observation: poses, targets and memories by their formulas; how
far ahead it should be told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env.control import controllers_of
from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.rigid_motions import moved_pose
from soft_tendon_env.policies.arm_observer import believed_arm, greatest_timing
from soft_tendon_env.policies.controller_policy import _periods_ahead, _target_coordinates
from soft_tendon_env.policies.estimators import ESTIMATORS
from soft_tendon_env.policies.observed_poses import target_poses, tip_poses
from soft_tendon_env.policies.protocol import memories_of

POSITIONS = np.array([[0.1, 0.2, 0.3], [-0.1, 0.0, 0.2]])
ROTATIONS = Rotation.from_euler("xyz", [[0.3, -0.8, 1.1], [2.0, 0.1, -0.4]]).as_matrix()


def observed(rotations):
    """First two columns side by side, as the group `tip_rotation` has them."""
    columns = np.concatenate([rotations[:, :, 0], rotations[:, :, 1]], axis=1)
    return {"tip_position": POSITIONS, "tip_rotation": columns}


def test_poses_are_those_of_position_and_two_columns():
    poses = tip_poses(observed(ROTATIONS))
    np.testing.assert_allclose(poses[:, :3, :3], ROTATIONS, atol=1e-12)
    np.testing.assert_array_equal(poses[:, :3, 3], POSITIONS)
    expected_poses = [[0, 0, 0, 1]] * 2
    np.testing.assert_array_equal(poses[:, 3], expected_poses)


def test_rounded_columns_are_made_orthonormal_again():
    """The first keeps its direction, the second turns in their plane."""
    rng = np.random.default_rng(0)
    errors = rng.normal(0.0, 1e-3, (2, 3, 3))
    rounded = ROTATIONS + errors
    poses = tip_poses(observed(rounded))
    for pose, (x, y, _) in zip(poses, rounded.swapaxes(1, 2), strict=True):
        R = pose[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        expected_axis = x / np.linalg.norm(x)
        np.testing.assert_allclose(R[:, 0], expected_axis, atol=1e-12)
        volume = np.cross(x, y) @ R[:, 1]
        assert volume == pytest.approx(0.0, abs=1e-12)


def test_targets_are_poses_from_the_tip_on_now_and_ahead():
    poses = tip_poses(observed(ROTATIONS))
    rng = np.random.default_rng(1)
    errors = rng.uniform(-1.0, 1.0, (2, 3, 6))
    values = {"target_error": errors[:, 0], "preview": errors[:, 1:].reshape(2, 12)}
    targets = target_poses(values, poses)
    assert targets.shape == (2, 3, 4, 4)
    for row in range(2):
        for k in range(3):
            expected = moved_pose(poses[row], errors[row, k])
            np.testing.assert_allclose(targets[row, k], expected, atol=1e-12)
    (alone,) = target_poses({"target_error": errors[:1, 0]}, poses[:1])
    np.testing.assert_allclose(alone, targets[0, :1], atol=1e-12)
    assert target_poses({}, poses) is None


def test_coordinates_of_targets_are_ways_from_the_arm_or_stand_by_themselves():
    q = np.array([1.0, 2.0])
    way = np.array([0.5, -0.5])
    ahead = np.array([0.1, 0.2, 0.3, 0.4])
    groups = {"coordinates": q, "target_coordinates": way}
    np.testing.assert_array_equal(_target_coordinates(groups, 1), [[1.5, 1.5]])
    groups["coordinate_preview"] = ahead
    expected = [[1.5, 1.5], [1.1, 2.2], [1.3, 2.4]]
    np.testing.assert_allclose(_target_coordinates(groups, 3), expected)
    wanted = {"wanted_coordinates": np.arange(6.0)}
    np.testing.assert_array_equal(_target_coordinates(wanted, 3), np.arange(6.0).reshape(3, 2))
    assert _target_coordinates({"coordinates": q}, 3) is None


def test_rows_that_begin_have_no_memory():
    assert memories_of(2, None, None) == [None, None]
    assert memories_of(2, ("a", "b"), None) == ["a", "b"]
    assert memories_of(2, ("a", "b"), np.array([True, False])) == [None, "b"]


@pytest.mark.parametrize(
    ("latency", "estimator", "periods"),
    [
        (None, None, 2),
        (0.0, None, 2),
        (0.02, None, 3),
        (0.03, None, 4),
        (0.0, "kalman", 2),
        (0.03, "kalman", 4),
        (None, "kalman", 6),  # up to 80 ms
    ],
)
def test_targets_are_told_for_as_long_as_commands_are_late(latency, estimator, periods):
    """Two periods of feedback, and as many as commands may be late, begun ones too."""
    entry = controllers_of("TipPose")["tracking"]
    found = None if estimator is None else ESTIMATORS[estimator]
    greatest = greatest_timing(Timing(latency, None), found)
    assert _periods_ahead(entry, greatest.latency, 0.02) == periods


def test_controllers_believe_in_tensions_that_arrive_at_once(build):
    """The delay of the actuators is told apart; without one the model is the arm's."""
    late = build("three_tendon", {"effects.actuators.delay": 0.03})
    model, known = believed_arm(late)
    assert known == (0.03, 0.0)
    assert model.scene.effects.actuators.delay == 0.0
    assert model.scene.segments == late.scene.segments
    prompt = build("three_tendon")
    assert believed_arm(prompt) == (prompt, (None, None))
