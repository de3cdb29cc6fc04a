"""Courses of targets by their formulas: splines, ramps, circles, steps, poses out of reach."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from soft_tendon_env.control.rigid_motions import pose_error
from soft_tendon_env.envs import TipPoseEnv
from soft_tendon_env.envs.targets import drawn, statics
from soft_tendon_env.envs.targets.shipped import (
    Circle,
    CircleCourse,
    ClosedSpline,
    FixedPose,
    Hold,
    Rise,
    Stepped,
)
from soft_tendon_env.envs.targets.statics import (
    MARGIN,
    EquilibriumPath,
    NoEquilibrium,
    StaticCourse,
    Tensions,
)
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
H = 1e-5
POINTS = np.random.default_rng(0).uniform(0.0, 5.0, (6, 3))


def rates_by_differences(tensions, times):
    later = tensions(times + H)[0]
    earlier = tensions(times - H)[0]
    return (later - earlier) / (2.0 * H)


def test_the_closed_spline_is_the_uniform_cubic_b_spline_of_its_points():
    """A knot is where the point that comes second counts most; after a period it begins anew."""
    spline = ClosedSpline(POINTS, period=2.4)
    times = np.linspace(0.0, 2.399, 41)
    knots = 0.4 * np.arange(-3.0, 11.0)
    twice = np.concatenate([POINTS, POINTS])
    around = twice[: knots.size - 4]
    expected = BSpline(knots, around, 3)(times)
    tension, rate = spline(times)
    np.testing.assert_allclose(tension, expected, atol=1e-12)
    later = spline(times + 4.8)[0]
    np.testing.assert_allclose(later, tension, atol=1e-12)
    expected_knots = 0.4 * np.arange(7.0)
    np.testing.assert_allclose(spline.knots, expected_knots)
    inner = times + 0.013
    np.testing.assert_allclose(spline(inner)[1], rates_by_differences(spline, inner), atol=1e-6)


def test_a_ramp_rises_smoothly_from_start_to_end_and_stays():
    """10 x^3 - 15 x^4 + 6 x^5: rates and their rates vanish at both ends."""
    start = np.array([1.0, 0.0])
    end = np.array([3.0, -4.0])
    rise = Rise(start, end, duration=2.0)
    times = np.array([-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0])
    x = np.clip(times / 2.0, 0.0, 1.0)[:, None]
    first_terms = 10 * x**3 - 15 * x**4
    share = first_terms + 6 * x**5
    tension, rate = rise(times)
    expected = start + share * (end - start)
    np.testing.assert_allclose(tension, expected)
    expected_rate = rates_by_differences(rise, times)
    np.testing.assert_allclose(rate, expected_rate, atol=1e-6)
    near_ends = np.array([-1e-3, 1e-3, 1.999, 2.001])
    _, rates_near_ends = rise(near_ends)
    assert np.abs(rates_near_ends).max() < 1e-4
    np.testing.assert_allclose(rise.knots[[0, -1]], [0.0, 2.0])


def test_tensions_by_themselves_stay():
    times = np.array([-1.0, 0.0, 9.0])
    tension, rate = Tensions(POINTS[:1])(times)
    expected = np.tile(POINTS[0], (3, 1))
    np.testing.assert_array_equal(tension, expected)
    np.testing.assert_array_equal(rate, 0.0)


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize("tilt", [0.0, 30.0, -50.0])
def test_circles_are_about_the_axis_of_the_base(moved, tilt):
    """A quarter of the length wide, 0.95 of it away; the tip's axis leans outward; twists are those
    of the poses."""
    base = np.eye(4)
    if moved:
        rotation = Rotation.from_euler("xyz", [0.3, -0.8, 1.1])
        base[:3, :3] = rotation.as_matrix()
        base[:3, 3] = [1.0, -2.0, 0.5]
    course = CircleCourse(Circle(tilt=tilt, period=3.0), length=0.4, base=base)
    times = np.array([0.0, 0.4, 1.7, 2.9])
    samples = course.sample(times)
    in_base = np.linalg.inv(base) @ samples.tip_pose
    angle = 2.0 * np.pi * times / 3.0
    zero = 0 * angle
    cosine = np.cos(angle)
    sine = np.sin(angle)
    outward = np.stack([zero, cosine, sine], axis=1)
    along = np.array([1.0, 0.0, 0.0])
    circle = 0.38 * along + 0.1 * outward
    np.testing.assert_allclose(in_base[:, :3, 3], circle, atol=1e-12)
    lean = np.radians(tilt)
    upright = np.cos(lean) * along
    outwards = np.sin(lean) * outward
    leaning = upright + outwards
    np.testing.assert_allclose(in_base[:, :3, 0], leaning, atol=1e-12)
    later = course.sample(times + H).tip_pose
    earlier = course.sample(times - H).tip_pose
    for k in range(times.size):
        way = pose_error(earlier[k], later[k])
        twist = way / (2.0 * H)
        np.testing.assert_allclose(samples.tip_twist[k], twist, atol=1e-7)
    next_round = course.sample(times + 3.0).tip_pose
    np.testing.assert_allclose(next_round, samples.tip_pose, atol=1e-12)


def test_circles_have_the_radius_and_centre_that_are_given():
    course = CircleCourse(Circle(radius=0.07, centre=(1.0, 2.0, 3.0)), length=0.4)
    samples = course.sample(np.array([0.0, 1.0]))
    positions = samples.tip_pose[:, :3, 3]
    np.testing.assert_allclose(positions, [[1.0, 2.07, 3.0], [1.0, 2.0, 3.07]], atol=1e-12)


def test_steps_are_held_one_after_another_and_over_again():
    """At a border the next begins, also where times are whole periods up to round-off."""
    shapes = np.arange(6.0).reshape(3, 2)
    course = Stepped(shapes, duration=0.5)
    times = np.array([0.0, 0.49, 0.5 - 1e-12, 0.5, 1.2, 1.5, 1.9, 3.0])
    q, q_dot = course.coordinates(times)
    expected = shapes[[0, 0, 1, 1, 2, 0, 0, 0]]
    np.testing.assert_array_equal(q, expected)
    np.testing.assert_array_equal(q_dot, 0.0)


def test_a_pose_that_stays_has_no_twist():
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    samples = FixedPose(pose).sample(np.array([0.0, 5.0]))
    np.testing.assert_array_equal(samples.tip_pose, [pose, pose])
    np.testing.assert_array_equal(samples.tip_twist, 0.0)


@pytest.mark.parametrize("beyond", [1.2, 2.0])
def test_targets_out_of_reach_are_as_far_from_the_base_as_is_said(beyond):
    """In the direction of a pose that can be held, with its orientation."""
    scene = {"scene": "three_tendon", "base.position": [0.5, 0.0, -0.2]}
    target = {"type": "out_of_reach", "beyond": beyond}
    arm = {"scene": scene, "fidelity": "fast"}
    env = TipPoseEnv(**arm, target=target)
    held = TipPoseEnv(**arm, target="hold")
    poses = []
    for each in (env, held):
        each.reset(seed=3)
        poses.append(each.target_at([0.0, 4.0]).tip_pose)
    far, near = (pose[0] for pose in poses)
    np.testing.assert_array_equal(poses[0][0], poses[0][1])
    np.testing.assert_allclose(far[:3, :3], near[:3, :3], atol=1e-9)
    far_way = far[:3, 3] - [0.5, 0.0, -0.2]
    near_way = near[:3, 3] - [0.5, 0.0, -0.2]
    assert np.linalg.norm(far_way) == pytest.approx(0.3 * beyond)
    product = 0.3 * beyond * np.linalg.norm(near_way)
    assert far_way @ near_way == pytest.approx(product)


MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
SHEARED = np.eye(4)
SHEARED[0, 1] = 1e-3
PROJECTIVE = np.eye(4)
PROJECTIVE[3, 0] = 0.1
FAR_AWAY = np.eye(4)
FAR_AWAY[0, 3] = -2e6


@pytest.mark.parametrize("pose", [MIRROR, SHEARED, PROJECTIVE, FAR_AWAY], ids=str)
def test_matrices_that_are_no_poses_are_refused(pose):
    with pytest.raises(ConfigurationError, match="should be a homogeneous matrix"):
        Hold(pose=pose.tolist())


def test_a_position_alone_has_the_axes_of_the_world():
    pose = Hold(position=(0.1, 0.2, 0.3)).given_pose
    np.testing.assert_array_equal(pose[:3, 3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(pose[:3, :3], np.eye(3))
    assert Hold(tension=(1.0, 0.0, 0.0)).given_pose is None


def test_numbers_are_drawn_from_all_of_their_range():
    generator = np.random.default_rng(0)
    assert drawn(0.3, generator) == 0.3
    numbers = [drawn((0.2, 0.6), generator) for _ in range(200)]
    assert min(numbers) == pytest.approx(0.2, abs=0.02)
    assert max(numbers) == pytest.approx(0.6, abs=0.02)
    assert 0.2 <= min(numbers) <= max(numbers) <= 0.6


@pytest.mark.parametrize(("knot_period", "count"), [(1.0, 10), (0.7, 14), (2.5, 4)])
def test_random_motions_have_a_point_every_knot_period(knot_period, count):
    """A little less or more, so that it is a whole number of them."""
    env = TipPoseEnv(**SMALL, target={"type": "random", "knot_period": knot_period})
    env.reset(seed=0)
    tension = env.episodes.trajectories._course[0].tension
    assert tension.points.shape == (count, 3)
    assert tension.period == 10.0


def test_a_drawn_motion_is_refused_where_the_section_gives_way_at_one_of_its_knots():
    """However firm it is at all others."""
    env = TipPoseEnv(**SMALL)
    setting = env.episodes.starts.setting
    points = np.ones((6, 3))
    gentle = ClosedSpline(points, period=2.4)
    StaticCourse(setting, gentle, MARGIN)
    strong_points = points.copy()
    strong_points[2, 0] = 1e4
    strong = ClosedSpline(strong_points, period=2.4)
    with pytest.raises(NoEquilibrium, match="about to give way"):
        StaticCourse(setting, strong, MARGIN)


HEAVY = {"scene": "three_tendon", "effects.gravity.acceleration": [0.0, 0.0, -9.81]}


def test_equilibria_far_from_where_they_are_expected_are_reached_by_halves(monkeypatch):
    """Of the change of tensions, as often as need be; the shape is that at rest."""
    monkeypatch.setattr(statics, "NEAR", 0.02)
    monkeypatch.setattr(statics, "CLOSE", 0.0)
    setting = TipPoseEnv(scene=HEAVY, fidelity="fast").episodes.starts.setting
    aim = np.array([2.0, 0.0, 1.0])
    shares = []
    with setting.model.workspace() as work:
        path = EquilibriumPath(setting, work)
        move = path._move

        def recorded(tension, shorter=8):
            share = tension[0] / aim[0]
            shares.append(share)
            expected_tension = shares[-1] * aim
            np.testing.assert_allclose(tension, expected_tension)
            return move(tension, shorter)

        monkeypatch.setattr(path, "_move", recorded)
        (q,) = path.follow(aim[None])
    rest = static_equilibrium(setting.model, aim)
    tip_pose = setting.model.tip_pose(q)
    np.testing.assert_allclose(tip_pose, rest.tip_pose, atol=1e-6)
    # whole, half, and halves of what is left
    assert shares[:2] == [1.0, 0.5]
    assert len(shares) > 2
    assert max(shares) == 1.0
    numerators = 256.0 * np.array(shares)
    expected_numerators = np.round(numerators)
    np.testing.assert_array_equal(numerators, expected_numerators)
