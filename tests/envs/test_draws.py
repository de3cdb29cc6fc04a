"""What episodes draw stays in its ranges and reaches their ends; noise by its chunks; seeds,
difficulties, places of sensors and bounds of goals by their rules."""

from types import SimpleNamespace

import numpy as np
import pytest

from soft_tendon_env import load_scene
from soft_tendon_env.control.protocol import SensorNoise
from soft_tendon_env.envs import ReachEnv, TipPoseVectorEnv
from soft_tendon_env.envs.contacts import deepest, why_inside
from soft_tendon_env.envs.observation import CHANGE, History, stress_free_strain
from soft_tendon_env.envs.options import Options, at_difficulty, row_seeds
from soft_tendon_env.envs.randomization import CHUNK, Sensors, drawn_in_rows
from soft_tendon_env.envs.targets.shipped import Either, Random, Steps
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
RANGES = {
    "stiffness": (0.8, 1.2),
    "damping": (0.5, 1.5),
    "payload": (0.0, 0.01),
    "segments.0.poisson_ratio": (0.3, 0.49),
}


@pytest.fixture(scope="module")
def drawn_rows():
    """Sixty rows of arms that differ, and the numbers of each."""
    env = TipPoseVectorEnv(60, threads=1, **SMALL, randomize=RANGES)
    env.reset(seed=0)
    scenes = [env.episodes.arms.model_of(row).scene for row in range(60)]
    usual = load_scene("three_tendon").segments[0]
    numbers = {
        "stiffness": [scene.segments[0].young_modulus / usual.young_modulus for scene in scenes],
        "damping": [scene.segments[0].damping / usual.damping for scene in scenes],
        "payload": [scene.effects.tip_load.mass for scene in scenes],
        "segments.0.poisson_ratio": [scene.segments[0].poisson_ratio for scene in scenes],
    }
    return env, {name: np.array(values) for name, values in numbers.items()}


@pytest.mark.parametrize("name", RANGES)
def test_numbers_of_arms_reach_their_ranges_and_do_not_pass_them(drawn_rows, name):
    _, numbers = drawn_rows
    least, greatest = RANGES[name]
    values = numbers[name]
    assert values.min() >= least - 1e-12
    assert values.max() <= greatest + 1e-12
    assert np.ptp(values) > 0.8 * (greatest - least)


def test_shares_are_from_the_least_to_the_greatest(drawn_rows):
    """In the order of the keys."""
    env, numbers = drawn_rows
    shares = env.episodes.drawn_shares()
    ranges = {
        name: (values - RANGES[name][0]) / np.ptp(RANGES[name]) for name, values in numbers.items()
    }
    in_order = ["payload", "damping", "stiffness", "segments.0.poisson_ratio"]
    for column, name in enumerate(in_order):
        np.testing.assert_allclose(shares[:, column], ranges[name], atol=1e-9, err_msg=name)


def test_numbers_are_drawn_one_without_the_other(drawn_rows):
    _, numbers = drawn_rows
    correlations = np.corrcoef(list(numbers.values()))
    others = correlations[~np.eye(4, dtype=bool)]
    assert np.abs(others).max() < 0.4


def test_drawn_numbers_of_some_rows_have_masks():
    """As Gymnasium has infos of many rows; nothing where nothing is drawn."""
    first = {"a": 1.0, "b": np.array([2.0, 3.0])}
    second = {"a": 4.0}
    infos = [{"drawn": first}, {"drawn": second}]
    table = drawn_in_rows(infos, np.array([2, 0]), 4)
    np.testing.assert_array_equal(table["_drawn"], [True, False, True, False])
    drawn = table["drawn"]
    np.testing.assert_array_equal(drawn["a"], [4.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(drawn["_a"], [True, False, True, False])
    np.testing.assert_array_equal(drawn["b"], [[0, 0], [0, 0], [2, 3], [0, 0]])
    np.testing.assert_array_equal(drawn["_b"], [False, False, True, False])
    assert drawn_in_rows([{}, {}], np.array([0, 1]), 2) == {}


def reading_of(rows):
    """A reading of still arms, of three tendons and two strain sensors."""
    return SimpleNamespace(
        tip_pose=np.tile(np.eye(4), (rows, 1, 1)),
        tendon_length=np.zeros((rows, 3)),
        strain=np.zeros((rows, 2, 6)),
        strain_rate=np.zeros((rows, 2, 6)),
    )


def test_noise_goes_on_from_chunk_to_chunk_and_follows_from_its_seed():
    """Of an episode, whatever rows are beside it, also beyond what is drawn at a time."""
    noise = SensorNoise(position=0.1, length=0.2)

    def lengths(rows, row):
        sensors = Sensors(noise, rows, 3, 2, omit=0.0)
        for each in range(rows):
            sensors.begin(each, 7 if each == row else each)
        step_count = np.zeros(rows, dtype=np.int64)
        members = np.arange(rows)
        seen = []
        for step in range(CHUNK + 40):
            step_count[:] = step
            measured = sensors.measured(reading_of(rows), step_count, members)
            seen.append(measured.tendon_length[row])
        return np.array(seen)

    alone = lengths(1, 0)
    np.testing.assert_array_equal(lengths(3, 1), alone)
    assert len(np.unique(alone)) == alone.size
    assert alone.std() == pytest.approx(0.2, rel=0.15)
    np.testing.assert_allclose(
        alone[0], 0.2 * np.random.default_rng(7).standard_normal((CHUNK, 33))[0, 6:9]
    )


def test_rows_that_stand_keep_their_noise():
    sensors = Sensors(SensorNoise(position=0.1), 2, 3, 2, omit=0.0)
    for row in range(2):
        sensors.begin(row, row)
    counts = np.zeros(2, dtype=np.int64)
    members = np.arange(2)
    first = sensors.measured(reading_of(2), counts, members).tip_pose
    counts[1] = 1
    second_row = np.array([1])
    second = sensors.measured(reading_of(2), counts, second_row).tip_pose
    np.testing.assert_array_equal(first[0], second[0])
    assert (first[1, :3, 3] != second[1, :3, 3]).all()


@pytest.mark.parametrize(("omit", "share"), [(0.0, 0.0), (0.3, 0.3), (1.0, 1.0)])
def test_noise_is_left_out_as_often_as_is_said(omit, share):
    sensors = Sensors(SensorNoise(position=0.1), 400, 3, 0, omit=omit)
    for row in range(400):
        sensors.begin(row, row)
    reading = reading_of(400)
    reading.strain, reading.strain_rate = np.zeros((2, 400, 0, 6))
    counts = np.zeros(400, dtype=np.int64)
    measured = sensors.measured(reading, counts, np.arange(400))
    is_same = measured.tip_pose == np.eye(4)
    is_exact = is_same.all(axis=(1, 2))
    assert is_exact.mean() == pytest.approx(share, abs=0.07)


def test_a_history_is_the_past_less_the_present():
    """In a tenth of the units, of the columns that it keeps, the latest first; it begins as if it
    had always been so."""
    history = History(2, 2, np.array([0, 2]))
    counts = np.zeros(2, dtype=np.int64)
    places = np.arange(24.0, dtype=np.float32).reshape(4, 2, 3)
    seen = places**2
    history.keep(seen[0], counts, np.array([0, 1]))
    np.testing.assert_array_equal(history.changes, 0.0)
    for step in (1, 2):
        counts[:] = step
        history.keep(seen[step], counts, np.array([0, 1]))
    frames = np.stack([seen[1], seen[0]], axis=1)
    past = frames[:, :, [0, 2]]
    present = seen[2][:, None, [0, 2]]
    expected = (past - present) / CHANGE
    expected_changes = expected.reshape(2, 4)
    np.testing.assert_allclose(history.changes, expected_changes, rtol=1e-6)
    counts[0] = 0
    history.keep(seen[3], counts, np.array([0]))
    np.testing.assert_array_equal(history.changes[0], 0.0)
    expected_row = expected.reshape(2, 4)[1]
    np.testing.assert_allclose(history.changes[1], expected_row, rtol=1e-6)
    history.correct(seen[1], counts, 1)
    np.testing.assert_allclose(
        history.changes[1, :2], (seen[1] - seen[1])[1, [0, 2]] / CHANGE, atol=1e-6
    )
    history.correct(seen[2], counts, 0)
    expected_frames = np.tile(seen[2][0, [0, 2]], (3, 1))
    np.testing.assert_array_equal(history.frames[0], expected_frames)


def test_stress_free_strains_are_those_of_the_segments():
    changes = {"segments.0.curvature": [0.5, -2.0, 3.0]}
    scene = load_scene("three_tendon").replace(changes)
    strains = stress_free_strain(scene, np.array([0.0, 0.3]))
    expected = np.tile([0.5, -2.0, 3.0, 1.0, 0.0, 0.0], (2, 1))
    np.testing.assert_array_equal(strains, expected)


def test_seeds_of_rows_follow_one_another_or_are_listed():
    assert row_seeds(None, 2) == [None, None]
    assert row_seeds(5, 3) == [5, 6, 7]
    assert row_seeds([3, None, 8], 3) == [3, None, 8]
    with pytest.raises(ValueError, match="an int or a list of 3, not of 2"):
        row_seeds([1, 2], 3)
    with pytest.raises(ValueError, match=r"seed\[1\]"):
        row_seeds([0, -1], 2)
    with pytest.raises(TypeError, match="seed"):
        row_seeds(0.5, 2)


@pytest.mark.parametrize(
    ("difficulty", "fraction", "knot_period"),
    [("easy", 0.25, 1.0), ("medium", 0.4, 0.6), ("hard", 0.6, 0.3)],
)
def test_difficulties_set_what_is_left_open(difficulty, fraction, knot_period):
    """Also of targets of which one is drawn."""
    motion = at_difficulty(Random(), difficulty)
    assert (motion.fraction, motion.knot_period) == (fraction, knot_period)
    given = at_difficulty(Random(fraction=0.1, period=8.0), difficulty)
    assert (given.fraction, given.knot_period, given.period) == (0.1, knot_period, 8.0)
    either = at_difficulty(Either(of=(Random(), Steps(fraction=0.3))), difficulty)
    assert [part.fraction for part in either.of] == [fraction, 0.3]
    assert at_difficulty(either, None) is either


def test_sensors_are_in_the_middle_of_equal_parts():
    scene = load_scene("three_tendon")
    places = Options(sensors=3).sensor_places(scene)
    np.testing.assert_allclose(places, [0.05, 0.15, 0.25])
    np.testing.assert_array_equal(Options(sensors=(0.1, 0.3)).sensor_places(scene), [0.1, 0.3])


def test_goals_lie_within_two_lengths_of_where_the_base_may_be():
    """Clipped to that; within a hundredth of the length they are reached."""
    scene = {"scene": "three_tendon", "base.position": [0.0, -0.2, 0.1]}
    drawn = {"base.position": [(-0.1, 0.1), (-0.5, 0.0), 0.0]}
    for randomize, away in (({}, 0.2), (drawn, 0.5)):
        env = ReachEnv(scene=scene, fidelity="fast", randomize=randomize)
        expected_goal_bound = 2.0 * 0.3 + away
        assert env.episodes.goal_bound == pytest.approx(expected_goal_bound)
    assert env.episodes.threshold == pytest.approx(0.003)
    positions = np.array([[9.0, -9.0, 0.1]])
    goal = env.episodes._goal(positions)
    np.testing.assert_allclose(goal, [[1.1, -1.1, 0.1]], rtol=1e-6)
    assert Options(threshold=0.02).threshold_of(5.0) == 0.02


BALLS = [
    {"type": "sphere", "position": [0.2, 0.0, 0.1], "radius": 0.04},
    {
        "type": "sphere",
        "position": [0.1, 0.0, 0.05],
        "radius": 0.03,
        "amplitude": [0.0, 0.1, 0.0],
        "frequency": 1.0,
    },
]


def test_the_deepest_ball_is_that_with_the_greatest_overlap(build):
    """Of balls of the arm and obstacles, or of those alone that stand."""
    changes = {"effects.contact.obstacles": BALLS, "quadrature.intervals": 4}
    model = build("three_tendon", changes)
    count = model.scene.effects.contact.sample_places(model.discretisation).size

    def poses_with(first, second):
        """Balls of 10 mm far away, but for the first two."""
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, :3, 3] = 9.0
        poses[0, :3, 3] = first
        poses[1, :3, 3] = second
        return poses

    contact = model.scene.effects.contact

    def deepest_of(poses, **standing):
        return deepest(contact, contact.gaps(model.discretisation, poses), **standing)

    depth = deepest_of(poses_with([0.1, 0.0, 0.0], [0.2, 0.0, 0.06]))
    # overlaps: 0.01 + 0.04 - 0.141, 0.01 + 0.04 - 0.04 and 0.01 + 0.03 - 0.05, ...
    assert depth.depth == pytest.approx(0.01)
    assert (depth.sample, depth.name) == (1, "effects.contact.obstacles[0], a sphere")
    near_moving = poses_with([0.1, 0.0, 0.03], [0.3, 0.0, 0.0])
    assert deepest_of(near_moving).depth == pytest.approx(0.01 + 0.03 - 0.02)
    standing = deepest_of(near_moving, standing=True)
    assert standing.name.startswith("effects.contact.obstacles[0]")
    assert standing.depth < 0.0
    assert why_inside(model, np.zeros(3)) == ""
    assert why_inside(build("three_tendon"), np.zeros(3)) == ""


def test_arms_that_cannot_be_are_told_by_their_numbers():
    with pytest.raises(ConfigurationError, match=r"randomize\.segments.*density.*can draw"):
        TipPoseVectorEnv(2, **SMALL, randomize={"density": (-0.5, 1.0)})
