"""Reward terms, distances of goals and units of errors by their formulas; kernels of all rows."""

from typing import NamedTuple

import numpy as np
import pytest

from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.envs import ShapeEnv, TipPoseEnv
from soft_tendon_env.envs.kernels import TargetTable, closeness, economy, targets_ahead
from soft_tendon_env.envs.tracking import (
    ANGLE,
    BACKBONE,
    COORDINATES,
    GRADES,
    POSITION,
    TERMS,
    Reward,
    Term,
    error_unit,
    goal_distance,
    goal_reward,
    weights_of,
)
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.registry import register

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
AVAILABLE = {**TERMS, **POSITION.terms, **ANGLE.terms, "own": Term(lambda now: now.own)}
STRONGEST = np.array([5.0, 2.0, 10.0])


class Now(NamedTuple):
    """What terms look at, in two rows."""

    command: np.ndarray = np.array([[5.0, 1.0, 0.0], [-2.5, 9.0, 10.0]])
    action_change: np.ndarray = np.array([[2.0, -1.0, 0.0], [0.0, 0.0, 0.0]])
    own: np.ndarray = np.array([0.25, 0.75])


ERRORS = {"position_error": np.array([0.0, 0.03]), "angle_error": np.array([0.5, 2.0])}


def rewarded(weights, length=0.6):
    reward = Reward(weights_of(weights), AVAILABLE, STRONGEST, length)
    return reward.evaluate(ERRORS, Now())


def test_an_error_counts_half_at_its_scale():
    assert closeness(0.0, 0.3) == 1.0
    assert closeness(0.3, 0.3) == 0.5
    assert closeness(0.9, 0.3) == pytest.approx(0.1)


def test_positions_are_measured_by_the_rod_s_length_and_angles_by_half_a_radian():
    """A twentieth of the length, 0.03 m here, halves the term; graded terms are means over a tenth
    apart."""
    weights = {name: 1.0 for name in ("position", "angle", "graded_position")}
    terms, _ = rewarded(weights)
    np.testing.assert_allclose(terms["position"], [1.0, 0.5])
    np.testing.assert_allclose(terms["angle"], [0.5, 1.0 / 17.0])
    assert GRADES == (4.0, 0.4, 0.04)
    each = [1.0 / (1.0 + (1.0 / grade) ** 2) for grade in GRADES]
    expected = [1.0, np.mean(each)]
    np.testing.assert_allclose(terms["graded_position"], expected)
    every = (POSITION, ANGLE, BACKBONE, COORDINATES)
    assert [error.scale for error in every] == [0.05, 0.5, 0.05, 10.0]
    assert [error.of_length for error in every] == [True, False, True, False]


def test_effort_and_smoothness_are_one_less_mean_squares():
    """Of parts of the strongest commands, each 1 at most, and of the largest change."""
    terms, _ = rewarded({"effort": 1.0, "smoothness": 1.0})
    first = 1 - (1 + 0.25 + 0) / 3
    second = 1 - (0.25 + 1 + 1) / 3
    np.testing.assert_allclose(terms["effort"], [first, second])
    change = 1 - (1 + 0.25) / 3
    np.testing.assert_allclose(terms["smoothness"], [change, 1.0])
    tension = np.array([1.0, -3.0])
    limit = np.array([2.0, 3.0])
    assert economy(tension, limit) == pytest.approx(1 - 1.25 / 2)


def test_the_reward_is_the_mean_by_weight_of_terms_of_all_kinds():
    weights = {"own": 3.0, "position": {"weight": 2.0, "scale": [0.01, 0.03]}, "effort": 1.0}
    terms, reward = rewarded({**weights, "angle": 0.0})
    scaled = [1.0, (1.0 / 10.0 + 0.5) / 2.0]
    np.testing.assert_allclose(terms["position"], scaled)
    own = 3.0 * Now().own
    graded = 2.0 * np.array(scaled)
    expected = (own + graded + terms["effort"]) / 6.0
    np.testing.assert_allclose(reward, expected)
    alone, reward = rewarded({"own": 0.5})
    np.testing.assert_allclose(reward, Now().own)
    assert alone.keys() == {"own"}


@pytest.mark.parametrize("name", ["effort", "position", "graded_angle", "coordinates"])
def test_names_of_terms_that_are_there_are_taken(forgotten, name):
    def term(tracking):
        return tracking.distance

    with pytest.raises(ValueError, match=name):
        register("reward_term", name, term)


def test_every_weight_that_is_none_is_told():
    with pytest.raises(ConfigurationError) as error:
        weights_of({"a": -1.0, "b": {"scale": 0.0}, "c": 1.0, "d": "much"})
    keys = {problem.key[0] for problem in error.value.problems}
    assert keys == {"a", "b", "d"}
    weights = weights_of({"c": 2.0, "e": {"scale": [0.5, 1.0]}, "f": {"scale": 0.5}})
    assert [weight.weight for weight in weights.values()] == [2.0, 1.0, 1.0]
    scales = [weight.scale for weight in weights.values()]
    assert scales == [None, (0.5, 1.0), (0.5,)]


def test_goals_are_rewarded_by_their_distance():
    achieved_rows = [[0.3, 0.4, 0.0], [0.0, 0.0, 0.01], [0.0, 0.0, 0.0]]
    achieved = np.array(achieved_rows)
    desired_rows = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 2.0, 2.0]]
    desired = np.array(desired_rows)
    distance = goal_distance(achieved, desired)
    np.testing.assert_allclose(distance, [0.5, 0.01, 3.0])
    reward = goal_reward(achieved, desired, 0.01, dense=False)
    np.testing.assert_array_equal(reward, [0, 1, 0])
    dense = goal_reward(achieved, desired, 0.01, dense=True)
    for value, way in zip(dense, distance, strict=True):
        each = [1.0 / (1.0 + (way / (grade * 0.05)) ** 2) for grade in (4.0, 0.4, 0.04)]
        expected_value = np.mean(each)
        assert value == pytest.approx(expected_value)
    with pytest.raises(ValueError, match=r"the same shape \(..., 3\), not \(3, 3\) and \(3,\)"):
        goal_distance(achieved, desired[0])
    with pytest.raises(ValueError, match="the same shape"):
        goal_distance(achieved[:, :2], desired[:, :2])


@pytest.mark.parametrize(
    ("name", "heading", "text"),
    [
        ("position_error", "position [mm]", "12.3 mm"),
        ("backbone_error", "backbone [mm]", "12.3 mm"),
        ("angle_error", "angle [deg]", "0.705 deg"),
        ("coordinate_error", "coordinate", "0.0123"),
    ],
)
def test_errors_are_shown_in_their_units(name, heading, text):
    unit = error_unit(name)
    assert unit.heading == heading
    assert unit.text(0.0123) == text
    assert unit.label == name.replace("_", " ")


def test_shapes_are_compared_along_the_backbone():
    """Root mean square distance of twenty places, the tip the last; coordinates by their norm."""
    env = ShapeEnv(**SMALL)
    env.reset(seed=1)
    action = np.array([0.5, -0.5, 1.0])
    _, _, _, _, info = env.step(action)
    episodes = env.episodes
    model = env.model
    q = episodes.arms.rows.q[0]
    target = episodes.target.q[0, 0]
    places = model.length * np.arange(1, 21) / 20
    backbone = model.backbone_at(q, places)
    target_backbone = model.backbone_at(target, places)
    positions = backbone[:, :3, 3]
    target_positions = target_backbone[:, :3, 3]
    ways = positions - target_positions
    squares = np.sum(ways**2, axis=1)
    expected = np.sqrt(np.mean(squares))
    assert info["backbone_error"] == pytest.approx(expected, rel=1e-6)
    way = np.linalg.norm(q - target)
    assert info["coordinate_error"] == pytest.approx(way, rel=1e-9)


@pytest.mark.no_jit
def test_targets_are_read_at_their_steps_in_a_table_that_is_written_round():
    rng = np.random.default_rng(0)
    rows = 2
    room = 5
    shape = (rows * (room + 1), 6)
    twists = rng.uniform(-1.0, 1.0, shape)
    moved = [moved_pose(np.eye(4), twist) for twist in twists]
    every_pose = np.stack(moved)
    tips = every_pose[:rows]
    poses = every_pose[rows:].reshape(rows, room, 4, 4)
    others = rng.normal(size=(rows, room, 7))
    ahead = np.array([0, 1, 3])
    table = TargetTable(pose=poses, other=others, ahead=ahead)
    steps = np.array([4, 11])
    pose = np.empty((rows, 3, 4, 4))
    other = np.empty((rows, 3, 7))
    error = np.empty((rows, 3, 6))
    offset = np.empty((2, rows))
    targets_ahead(table, steps, tips, pose, other, error, offset)
    for row in range(rows):
        places = (steps[row] + ahead) % room
        expected_pose = poses[row, places]
        np.testing.assert_array_equal(pose[row], expected_pose)
        expected_other = others[row, places]
        np.testing.assert_array_equal(other[row], expected_other)
        for j, place in enumerate(places):
            expected = pose_error(tips[row], poses[row, place])
            np.testing.assert_allclose(error[row, j], expected, atol=1e-12)
        target = poses[row, places[0], :3, 3]
        tip = tips[row, :3, 3]
        way = target - tip
        distance = np.linalg.norm(way)
        assert offset[0, row] == pytest.approx(distance)
        distance_of_error = np.linalg.norm(error[row, 0, :3])
        assert offset[1, row] == pytest.approx(distance_of_error)


def test_targets_ahead_are_those_that_come():
    """Up to the longest preview, and not beyond."""
    env = TipPoseEnv(**SMALL, preview=[0.06])
    env.reset(seed=0)
    for _ in range(70):
        ahead = env.episodes.target_ahead(3)
        numbers = env.episodes.step_count[0] + np.arange(4)
        expected = env.target_at(0.02 * numbers)
        np.testing.assert_allclose(ahead.tip_pose[0], expected.tip_pose, atol=1e-12)
        np.testing.assert_allclose(ahead.tip_twist[0], expected.tip_twist, atol=1e-9)
        env.step(np.zeros(3))
    with pytest.raises(ValueError, match="the longest preview, 3 control periods, not for 4"):
        env.episodes.target_ahead(4)
