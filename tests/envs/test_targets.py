"""Target motions: the poses they say, twists that are their derivatives, shapes that the statics
can hold."""

import itertools
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import logm
from scipy.spatial.transform import Rotation

from soft_tendon_env import load_scene
from soft_tendon_env.envs import (
    TASKS,
    Options,
    ReachEnv,
    ShapeEnv,
    ShapeVectorEnv,
    TipPoseEnv,
    TipPoseVectorEnv,
)
from soft_tendon_env.envs.options import check_fit
from soft_tendon_env.envs.targets.file import FileCourse, TargetWarning
from soft_tendon_env.envs.targets.shipped import Circle, CircleCourse
from soft_tendon_env.envs.trajectories import BANK
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


def course_of(env, seed):
    """The target's motion of a fresh episode, and its tensions as a function of time."""
    env.reset(seed=seed)
    course = env.episodes.trajectories._course[0]
    return course, lambda times: course.tension(np.atleast_1d(times))[0]


def read(env, course, times):
    q, q_dot = course.coordinates(np.asarray(times, dtype=float))
    reading, good = env.episodes.arms.read_samples(q, q_dot)
    assert good.all()
    return reading, q


def twist_by_differences(poses, h):
    """Body twists (m, 6) of poses (m, 2, 4, 4), h before and h after: logarithms of the middle's
    change."""
    twists = [np.real(logm(np.linalg.solve(before, after))) / (2 * h) for before, after in poses]
    return np.array([[x[2, 1], x[0, 2], x[1, 0], *x[:3, 3]] for x in twists])


TIMES = np.array([0.3, 1.1, 2.4, 3.7])
H = 1e-4


def test_the_circle_is_the_paper_s():
    """Radius 0.25 m about (0.95, 0, 0), parallel to the y-z plane; the tip leans outward by 37.8
    degrees and does not roll."""
    course = CircleCourse(Circle())
    times = np.linspace(0.0, 4.0, 9)
    pose = course.sample(times).tip_pose
    R = pose[:, :3, :3]
    position = pose[:, :3, 3]
    x, y, z = position.T
    radius = 0.25
    np.testing.assert_allclose(x, 0.95)
    np.testing.assert_allclose(np.hypot(y, z), radius)
    # rotations
    gram = R.swapaxes(1, 2) @ R
    identities = np.tile(np.eye(3), (9, 1, 1))
    np.testing.assert_allclose(gram, identities, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    # the tip's axis
    lean = np.radians(37.8)
    outward = np.sin(lean) / radius
    axis_x, axis_y, axis_z = R[:, :, 0].T
    expected_axis_x = np.cos(lean)
    np.testing.assert_allclose(axis_x, expected_axis_x)
    np.testing.assert_allclose(axis_y, outward * y, atol=1e-15)
    np.testing.assert_allclose(axis_z, outward * z, atol=1e-15)
    # across to where it leans: the axis of the shortest turn stays
    axis = np.stack([np.zeros(9), -z, y], axis=1) / radius
    turned = np.einsum("mij,mj->mi", R, axis)
    np.testing.assert_allclose(turned, axis, atol=1e-15)
    np.testing.assert_allclose(pose[0], pose[-1], atol=1e-15)
    assert np.allclose(position[0], [0.95, 0.25, 0.0])


@pytest.mark.parametrize("target", ["random", "ramp", "hold"])
def test_twists_and_rates_are_derivatives(target, arm):
    env = ShapeEnv(**arm, target=target)
    course, _ = course_of(env, 1)
    reading, _ = read(env, course, TIMES)
    beside = [read(env, course, TIMES + h) for h in (-H, H)]
    poses = np.stack([part.tip_pose for part, _ in beside], axis=1)
    expected_tip_twist = twist_by_differences(poses, H)
    np.testing.assert_allclose(reading.tip_twist, expected_tip_twist, atol=1e-5)
    q_dot = course.coordinates(TIMES)[1]
    np.testing.assert_allclose(
        q_dot, (beside[1][1] - beside[0][1]) / (2 * H), atol=1e-5 * max(1.0, np.abs(q_dot).max())
    )


@pytest.mark.parametrize(
    "target",
    ["random", "ramp", "hold", {"type": "circle", "centre": [0.25, 0.0, 0.0], "radius": 0.1}],
    ids=str,
)
def test_what_the_environment_shows_is_the_target_now(target, same):
    """Poses along an episode, chunk after chunk, are those of the course at the steps' times;
    previews come true."""
    env = TipPoseEnv(**SMALL, target=target, preview=[0.1])
    course, _ = course_of(env, 2)
    times = 0.02 * np.arange(301)
    shown = []
    ahead = []
    for _ in times:
        shown.append(env.episodes.target.tip_pose[0, 0].copy())
        ahead.append(env.episodes.target.tip_pose[0, 1].copy())
        env.step(np.zeros(3))
    expected = (
        course.sample(times).tip_pose
        if isinstance(course, CircleCourse)
        else read(env, course, times)[0].tip_pose
    )
    np.testing.assert_array_equal(shown, expected)
    np.testing.assert_array_equal(ahead[:-5], shown[5:])


@pytest.mark.parametrize(
    "kind",
    [
        "three_tendon",
        "loaded",
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("explicit", "loads inside")),
    ],
)
@pytest.mark.parametrize("target", ["random", "ramp", "hold", "circle"], ids=str)
def test_a_target_is_one_function_of_time(target, kind, arms):
    """The same together, one by one, in any part and any order, far ahead and long before, and in a
    row of many."""
    arm = arms[kind]
    env = TipPoseEnv(**arm, target=target)
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    times = np.concatenate(
        [
            0.02 * np.arange(60),
            rng.uniform(0.0, 20.0, 60),
            [-1e-300, -3.3, -1e9, 1e9, 1e18, 1e300, -1e300],
        ]
    )
    together = env.target_at(times)
    assert all(np.isfinite(values).all() for values in together)
    order = rng.permutation(times.size)
    for part in (order, order[:31], np.array([5]), order[-2:], np.repeat(order[:3], 2)):
        for found, values in zip(env.target_at(times[part]), together, strict=True):
            np.testing.assert_allclose(found, values[part], rtol=1e-11, atol=1e-12)
    rows = TipPoseVectorEnv(6, threads=2, **arm, target=target)
    rows.reset(seed=0)
    for found, values in zip(rows.episodes.trajectories.at(3, times[order]), together, strict=True):
        np.testing.assert_allclose(found, values[order], rtol=1e-11, atol=1e-12)


DIFFICULT = [
    (TipPoseEnv, "hard", None, {"fraction": 0.6, "knot_period": 0.3}),
    (
        TipPoseEnv,
        "medium",
        {"type": "random", "knot_period": 2.0},
        {"fraction": 0.4, "knot_period": 2.0},
    ),
    (ShapeEnv, "easy", {"type": "random"}, {"fraction": 0.25, "knot_period": 1.0}),
    (ReachEnv, "hard", None, {"fraction": 0.6}),
    (
        TipPoseEnv,
        "hard",
        "circle",
        (
            "difficulty is 'hard', and the target 'circle' leaves neither fraction nor knot_period"
            " open"
        ),
    ),
    (
        TipPoseEnv,
        "hard",
        {"type": "hold", "tension": [1.0, 0.0, 0.0]},
        "the target 'hold' leaves neither",
    ),
    (TipPoseEnv, "hard", {"type": "steps", "fraction": 0.1}, "the target 'steps' leaves neither"),
    (
        TipPoseEnv,
        "hard",
        {"type": "either", "of": ["circle", {"type": "steps", "fraction": 0.1}]},
        "the target 'either' leaves neither",
    ),
    (TipPoseEnv, "hrad", None, "difficulty is 'hrad': it should be 'easy', 'medium' or 'hard'"),
]


@pytest.mark.parametrize(("kind", "difficulty", "target", "expected"), DIFFICULT)
def test_a_difficulty_sets_what_the_target_leaves_open(kind, difficulty, target, expected):
    if isinstance(expected, str):
        with pytest.raises(ConfigurationError, match=expected):
            kind(**SMALL, difficulty=difficulty, target=target)
        return
    env = kind(**SMALL, difficulty=difficulty, target=target)
    alike = kind(**SMALL, target={"type": env.task.target, **expected})
    np.testing.assert_array_equal(
        *(each.target_at([0.0, 1.0, 7.0]).tip_pose for each in (env, alike) if each.reset(seed=4))
    )
    env.set_target(
        "circle" if kind is TipPoseEnv else "hold"
    )  # of which it sets nothing, or what it sets of others


def test_a_difficulty_that_sets_nothing_of_a_tasks_own_target_is_refused():
    options = Options(**SMALL, difficulty="hard")
    scene = load_scene("three_tendon")
    check_fit(options, TASKS["TipPose"], scene)
    task = replace(TASKS["TipPose"], target="circle")
    with pytest.raises(ConfigurationError, match="the target 'circle' leaves neither"):
        check_fit(options, task, scene)


@pytest.mark.parametrize("limits", [None, [-2.0, 4.0], [1.0, 4.0]])
@pytest.mark.parametrize("target", ["random", "hold", "ramp"])
def test_drawn_tensions_lie_within_their_fraction_of_the_limits(target, limits):
    env = TipPoseEnv(**SMALL, target={"type": target, "fraction": 0.5}, tension_limits=limits)
    least, greatest = limits or (0.0, 5.0)
    middle = max(least, 0.0)
    for seed in range(5):
        u = course_of(env, seed)[1](np.linspace(0.0, 10.0, 201))
        assert (u >= middle + 0.5 * (least - middle) - 1e-12).all()
        assert (u <= middle + 0.5 * (greatest - middle) + 1e-12).all()
        assert target != "random" or np.ptp(u, axis=0).min() > 0.1


def shape_errors(env, course, tension, times, on_path=True):
    """Distances [m] of the target's tip from where the tensions would hold it at rest, over the
    rod's length: where a slowly loaded arm goes or, where tensions beside those of rest lead
    elsewhere, next to the target."""
    reading, q = read(env, course, times)
    rest = [
        static_equilibrium(env.episodes.model, u, None if on_path else near)
        for u, near in zip(tension(times), q, strict=True)
    ]
    assert all(found.converged and found.stable for found in rest)
    apart = reading.tip_pose[:, :3, 3] - np.array([found.tip_pose[:3, 3] for found in rest])
    return np.linalg.norm(apart, axis=1) / env.episodes.model.length


LOADED = {
    "paper": {
        "scene": {
            "scene": "paper",
            "effects.gravity.acceleration": [0.0, 0.0, -9.81],
            "effects.tip_load.force": [0.0, 0.5, 0.0],
        }
    },
    "redundant": {
        "scene": {
            "scene": "four_tendon",
            "effects.gravity.acceleration": [9.81, 0.0, 0.0],
            "effects.tip_load.mass": 0.05,
        }
    },
}
"""Arms beside those of conftest.py whose targets the statics find: one hangs out from the side, one
hangs down."""


@pytest.mark.parametrize(
    ("target", "kind"),
    [
        *(("random", kind) for kind in ("three_tendon", "loaded", "explicit")),
        *(pytest.param("random", kind, marks=pytest.mark.slow) for kind in LOADED),
        ("ramp", "loaded"),
        ("ramp", "redundant"),
        ("hold", "explicit"),
    ],
)
def test_targets_are_static_shapes_at_knots_and_nearly_so_between(target, kind, arms):
    """Between knots at most 1e-4 of the length."""
    env = TipPoseEnv(**{**arms, **LOADED}[kind], target=target)
    worst = 0.0
    for seed in range(3):
        course, tension = course_of(env, seed)
        knots = course.tension.knots
        assert shape_errors(env, course, tension, knots).max() < 1e-8
        between = np.linspace(0.0, knots[-1], 8 * (knots.size - 1) + 1)
        worst = max(worst, shape_errors(env, course, tension, between).max())
    assert worst < 1e-4


UNHELD = {
    "three_tendon": ({"scene": "three_tendon"}, [500.0, 0.0, 0.0], "tendon 0 at arc length"),
    "pushed": ({"scene": "three_tendon"}, [0.0, -1e6, 0.0], "tendon 1 at arc length"),
    "absurd": ({"scene": "paper"}, [1e300, *[0.0] * 9], "% of the load"),
    "redundant": ({"scene": "four_tendon"}, [0.0, 0.0, 5e3, 0.0], "tendon"),
    "loaded": (None, [500.0, 0.0, 0.0], "% of the load"),
    "explicit": (None, [5e4, 0.0, 0.0], "% of the load"),
}
"""Options (None: those of conftest.py), tensions that the arm cannot hold, and what the message
says of the limit."""


@pytest.mark.parametrize(
    ("kind", "target"), [(TipPoseEnv, "hold"), (ReachEnv, "hold"), (ShapeVectorEnv, "ramp")]
)
@pytest.mark.parametrize("where", UNHELD)
def test_given_tensions_that_nothing_balances_are_refused(where, target, kind, arms):
    """When the environment is made: with what was given, the tendon, and the part of the load that
    is reached."""
    options, tension, limit = UNHELD[where]
    options = options or arms[where]
    with pytest.raises(ConfigurationError) as caught:
        kind(**options, target={"type": target, "tension": tension})
    message = str(caught.value)
    assert message.startswith("environment: target.tension is [")
    assert "\n" not in message
    assert "it should be tensions that the arm can hold, not [" in message
    assert limit in message


@pytest.mark.parametrize(
    ("target", "where"),
    [
        pytest.param(
            target,
            where,
            marks=[pytest.mark.slow] if (target, where) == ("random", "loaded") else [],
        )
        for target, places in (
            ("random", ("three_tendon", "redundant", "loaded")),
            ("hold", ("pushed",)),
            ("ramp", ("explicit",)),
        )
        for where in places
    ],
)
def test_drawn_tensions_are_drawn_in_to_what_the_arm_can_hold(where, target, arms, same):
    """Limits far beyond it, both ways: every target is a shape that its tensions hold, is none at
    rest, and is the same for a seed."""
    options = UNHELD[where][0] or arms[where]
    env = TipPoseEnv(**options, target=target, tension_limits=[-1e5, 1e5])
    shown = []
    for seed in (0, 1, 0):
        course, tension = course_of(env, seed)
        times = np.linspace(0.0, max(course.tension.knots[-1], 1.0), 23)
        assert shape_errors(env, course, tension, times, on_path=False).max() < 1e-4
        moved = (
            env.target_at(times).tip_pose[:, :3, 3] - env.episodes.arms.reading.tip_pose[0, :3, 3]
        )
        assert np.linalg.norm(moved, axis=1).max() > 1e-3 * env.model.length
        shown.append(list(env.target_at(times)))
    assert same(shown[0], shown[2])
    assert not same(shown[0], shown[1])


HANGING = {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]}


def test_motions_under_loads_come_from_a_bank_whatever_was_drawn_before(same):
    """By the seed alone, for one arm and for rows; begun at any control period; bounded in
    number."""
    target = {"type": "random", "period": 2.0, "knot_period": 0.5}
    options = {"scene": HANGING, "fidelity": "fast", "target": target}
    env = TipPoseEnv(**options)
    other = TipPoseEnv(**options)
    rows = TipPoseVectorEnv(**options)
    times = 0.02 * np.arange(100)
    seen = {}
    for seed in (3, 8, 1):
        env.reset(seed=seed)
        seen[seed] = env.target_at(times).tip_pose
    for seed in (1, 3):
        other.reset(seed=seed)
        rows.reset(seed=seed)
        for found in (other.target_at(times), rows.episodes.trajectories.at(0, times)):
            np.testing.assert_allclose(found.tip_pose, seen[seed], atol=1e-12)
    for seed in range(40):
        env.reset(seed=seed)
    assert len(env.episodes._targets.draws._bank) <= BANK
    env.reset(seed=0, options={"target": {**target, "fraction": 0.5}})  # a bank of its own
    assert len({key for key, _ in env.episodes._targets.draws._bank}) == 2
    again = pickle.loads(pickle.dumps(env))
    assert same(again.reset()[0], env.reset()[0])


PATH = [
    "time,x,y,z,qw,qx,qy,qz",
    "0.5,0.28,0,0.05,1,0,0,0",
    "1,0.25,0.1,0.05,0.8,0,0.6,0",
    "2,0.2,0.1,0,0,0.6,0,0.8",
]


def test_a_file_of_poses_is_followed_and_held_at_its_ends(tmp_path):
    (tmp_path / "path.csv").write_text("\n".join(PATH))
    env = TipPoseEnv(**SMALL, target={"type": "file", "path": str(tmp_path / "path.csv")})
    course = course_of(env, 0)[0]
    times = np.array([0.0, 0.5, 1.0, 2.0, 3.0])
    found = course.sample(times)
    between = course.sample(np.array([0.6, 1.3, 1.9]))
    np.testing.assert_allclose(
        found.tip_pose[[0, 1, 4], :3, 3],
        [[0.28, 0.0, 0.05], [0.28, 0.0, 0.05], [0.2, 0.1, 0.0]],
        atol=1e-12,
    )
    np.testing.assert_allclose(
        found.tip_pose[2, :3, :3], [[0.28, 0, 0.96], [0, 1, 0], [-0.96, 0, 0.28]], atol=1e-12
    )
    assert not found.tip_twist[[0, 4]].any()
    beside = [course.sample(np.array([0.6, 1.3, 1.9]) + h).tip_pose for h in (-H, H)]
    np.testing.assert_allclose(
        between.tip_twist, twist_by_differences(np.stack(beside, axis=1), H), atol=1e-6
    )


def file_of(path, rows):
    """Target of rows: time, x, y, z and the angle [rad] of a turn about an axis (3,)."""
    lines = [PATH[0]]
    for time, place, angle, axis in rows:
        half = 0.5 * angle
        vector = np.sin(half) * np.array(axis)
        turn = [np.cos(half), *vector]
        numbers = [time, *place, *turn]
        lines.append(",".join(map(str, numbers)))
    path.write_text("\n".join(lines))
    return {"type": "file", "path": str(path)}


# axes of the world
X = (1.0, 0.0, 0.0)
Y = (0.0, 1.0, 0.0)
STEP = [
    (0.0, (0.29, 0.0, 0.0), 0.0, X),
    (2.0, (0.28, 0.01, 0.0), 0.1, X),
    (2.03, (0.2, 0.15, -0.05), 1.2, X),
    (4.0, (0.2, 0.15, -0.05), 1.2, X),
    (4.01, (0.25, 0.1, 0.0), 0.3, X),
    (9.0, (0.25, 0.1, 0.02), -0.4, X),
]


def test_between_two_rows_a_target_stays_between_them(tmp_path):
    """Also where a step stands beside long ways, between which a spline would overshoot."""
    course = FileCourse(file_of(tmp_path / "step.csv", STEP)["path"])
    for before, after in itertools.pairwise(STEP):
        time_before, position_before, angle_before, _ = before
        time_after, position_after, angle_after, _ = after
        times = np.linspace(time_before, time_after, 200)
        pose = course.sample(times).tip_pose
        position = pose[:, :3, 3]
        least = np.minimum(position_before, position_after)
        greatest = np.maximum(position_before, position_after)
        assert (position >= least - 1e-12).all()
        assert (position <= greatest + 1e-12).all()
        # about the x axis alone
        z = pose[:, 2, 1]
        y = pose[:, 1, 1]
        turn = np.arctan2(z, y)
        np.testing.assert_allclose(pose[:, 0, 0], 1.0, atol=1e-12)
        least_turn, greatest_turn = sorted([angle_before, angle_after])
        assert (turn >= least_turn - 1e-9).all()
        assert (turn <= greatest_turn + 1e-9).all()
        # on the shortest way: never back
        direction = np.sign(angle_after - angle_before)
        assert (np.diff(turn) * direction >= -1e-12).all()


def test_a_path_is_smooth_and_goes_through_its_rows(tmp_path):
    rows = [
        (0.0, (0.29, 0.0, 0.0), 0.0, X),
        (0.4, (0.27, 0.05, 0.01), 0.5, X),
        (1.0, (0.24, 0.07, 0.05), 0.9, X),
        (1.3, (0.2, 0.1, 0.05), 0.4, Y),
        (2.0, (0.25, 0.1, 0.0), -0.8, Y),
    ]
    course = FileCourse(file_of(tmp_path / "smooth.csv", rows)["path"])
    times = np.array([row[0] for row in rows])
    at_rows = course.sample(times)
    np.testing.assert_allclose(at_rows.tip_pose[:, :3, 3], [row[1] for row in rows], atol=1e-12)
    for pose, (_, _, angle, axis) in zip(at_rows.tip_pose, rows, strict=True):
        rotation_vector = angle * np.array(axis)
        expected = Rotation.from_rotvec(rotation_vector).as_matrix()
        rotation = pose[:3, :3]
        np.testing.assert_allclose(rotation, expected, atol=1e-12)
    inside = np.array([0.1, 0.39, 0.41, 0.9, 1.1, 1.29, 1.7])
    beside = [course.sample(inside + h).tip_pose for h in (-H, H)]
    np.testing.assert_allclose(
        course.sample(inside).tip_twist,
        twist_by_differences(np.stack(beside, axis=1), H),
        atol=1e-5,
    )
    # velocities have no jumps, nor has the rate of turn about one axis
    step = 1e-9
    before, after = (course.sample(times[1:2] + h).tip_twist for h in (-step, step))
    np.testing.assert_allclose(before, after, atol=1e-5)
    assert before[0, 0] > 0.1
    # where the axis turns away the tip turns no more, and at both ends all rests
    angular = course.sample(times[3:4]).tip_twist[:, :3]
    np.testing.assert_allclose(angular, 0.0, atol=1e-12)
    samples_at_ends = course.sample(times[[0, -1]])
    np.testing.assert_allclose(samples_at_ends.tip_twist, 0.0, atol=1e-12)


def test_a_turn_of_two_rows_is_a_smooth_step(tmp_path):
    first = (1.0, (0.29, 0.0, 0.0), 0.0, Y)
    second = (3.0, (0.2, 0.1, 0.0), 0.8, Y)
    rows = [first, second]
    course = FileCourse(file_of(tmp_path / "two.csv", rows)["path"])
    samples = course.sample(np.array([0.0, 1.5, 2.0, 5.0]))
    shares = [0.0, 0.25**2 * (3.0 - 0.5), 0.5, 1.0]
    expected = 0.1 * np.array(shares)
    np.testing.assert_allclose(samples.tip_pose[:, 1, 3], expected, atol=1e-12)
    np.testing.assert_allclose(
        samples.tip_pose[:, 0, 2], np.sin(0.8 * np.array(shares)), atol=1e-12
    )


def test_poses_out_of_reach_are_told_once(tmp_path):
    rows = [
        (0.0, (0.29, 0.0, 0.0), 0.0, X),
        (1.0, (0.3, 0.3, 0.0), 0.0, X),
        (2.0, (0.0, 0.35, 0.1), 0.0, X),
    ]
    target = file_of(tmp_path / "far.csv", rows)
    with pytest.warns(
        TargetWarning, match="has 2 of 3 poses out of reach of an arm of 0.3 m: row 2"
    ):
        TipPoseEnv(**SMALL, target=target)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        TipPoseEnv(**SMALL, target=target)
        TipPoseEnv(**SMALL, target=file_of(tmp_path / "near.csv", [rows[0], (3.0, *rows[0][1:])]))


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("1,250,100,50,1,0,0,0", "a pose 250 m from the base: it should lie within ±0.6 m"),
        ("0.5,0,0,0,1,0,0,0", "times that grow"),
        ("1,0,0,,1,0,0,0", "rows of numbers"),
        ("1,0,0,0,1,1,0,0", "has a quaternion of length 1 ± 0.41 in row 2"),
        (None, "has no column 'time'"),
    ],
)
def test_files_without_poses_are_refused(tmp_path, row, said):
    (tmp_path / "path.csv").write_text("\n".join([*PATH[:2], row] if row else PATH[1:]))
    with pytest.raises(ConfigurationError, match=said.replace("(", r"\(")):
        TipPoseEnv(**SMALL, target={"type": "file", "path": str(tmp_path / "path.csv")})


EITHER = {
    "type": "either",
    "of": ["hold", {"type": "circles", "radius": [0.1, 0.2], "distance": [0.7, 0.9]}],
}


def test_every_episode_draws_one_of_several_targets():
    """As often as another; circles within their ranges, at every seed the same."""
    env = TipPoseEnv(**SMALL, target=EITHER)
    kinds = []
    found = []
    for seed in range(40):
        course, _ = course_of(env, seed)
        kinds.append(isinstance(course, CircleCourse))
        if kinds[-1]:
            found.append(
                [
                    course.radius / 0.3,
                    course.centre[0] / 0.3,
                    course.circle.tilt,
                    course.circle.period,
                ]
            )  # the rod has 0.3 m
    assert 10 < sum(kinds) < 30
    rows = [[0.1, 0.7, 0.0, 2.0], [0.2, 0.9, 45.0, 8.0]]
    least, greatest = np.array(rows)
    assert ((least <= found) & (found <= greatest)).all()
    widths = np.ptp(found, axis=0)
    half = 0.5 * (greatest - least)
    assert (widths > half).all()
    assert len(
        course_of(TipPoseEnv(**SMALL, target=EITHER), 39)[0].sample(TIMES).tip_pose
        if kinds[-1]
        else TIMES
    ) == len(TIMES)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ({"type": "either", "of": []}, r"target\.of"),
        ({"type": "either", "of": ["random", "orbit"]}, r"target\.of\[1\]\.type is 'orbit'"),
        (
            {"type": "either", "of": [{"type": "random", "knot_period": [0.5, 3.0]}]},
            r"knot_period is \[0\.5, 3\.0\]: it should",
        ),
        (
            {"type": "either", "of": [{"type": "hold", "position": [0.2, 0.0, 0.1]}]},
            r"target\.position is a position alone: TipPose needs",
        ),
        (
            {"type": "circles", "radius": [0.3, 0.1]},
            r"target\.radius.* should be a number greater than 0",
        ),
        ({"type": "circles", "tilt": [0.0, 100.0]}, r"target\.tilt"),
        (
            {"type": "circles", "tilt": [45.0, 0.0]},
            r"target\.tilt is .* should be \(least, greatest\), least before greatest",
        ),
    ],
)
def test_targets_that_cannot_be_drawn_are_refused(target, said):
    with pytest.raises(ConfigurationError, match=said):
        TipPoseEnv(**SMALL, target=target)
