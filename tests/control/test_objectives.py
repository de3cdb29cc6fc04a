"""Objectives against differences: of errors in the coordinates, of targets in time; targets moved
to where a wrong model sees them."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.control.catalogue import tip_pose_objective
from soft_tendon_env.control.objectives import Shape, TipDirection, TipPose, TipPosition
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose, pose_error

PERIOD = 0.02
KINDS = {
    "pose": lambda model: TipPose(0.1 * model.length),
    "position": lambda model: TipPosition(),
    "shape": Shape,
}
DISPLACEMENT = np.array([0.1, -0.2, 0.15, 0.01, 0.02, -0.01])


@pytest.fixture(scope="module")
def model(build):
    return build("three_tendon")


@pytest.fixture
def objective(model, request):
    return KINDS[request.param](model)


of_every_kind = pytest.mark.parametrize("objective", KINDS, indirect=True)


def target_through(model, path, ahead=(0.0,)):
    """The target that goes through coordinates path (m, n)."""
    poses = np.stack([model.tip_pose(q) for q in path])
    return Reference(np.array(ahead), poses, poses[:, :3, 3], np.array(path))


def aim_from(model, objective, target, q, q_dot=None, time=0.0, period=PERIOD):
    """The aim of an objective for an arm that is measured where the model says."""
    q_dot = np.zeros_like(q) if q_dot is None else q_dot
    terms = model.terms(q, q_dot)
    now = ControllerInput(q, q_dot, terms.tip_pose, np.zeros(model.tendon_count), target)
    return objective.aim(now, terms, time, period)


@of_every_kind
def test_errors_vanish_at_the_target_alone(model, random_state, objective):
    q, _ = random_state(model, 0)
    other, _ = random_state(model, 1)
    here = target_through(model, [q])
    elsewhere = target_through(model, [other])
    aim = aim_from(model, objective, here, q)
    np.testing.assert_allclose(aim.error, 0.0, atol=1e-12)
    np.testing.assert_allclose(aim.velocity, 0.0, atol=1e-12)
    away = aim_from(model, objective, elsewhere, q)
    assert np.linalg.norm(away.error) > 0.01 * model.length


@of_every_kind
def test_the_error_is_that_of_the_aim(model, random_state, objective):
    """At the target's instant that is asked for."""
    q, _ = random_state(model, 0)
    first, _ = random_state(model, 1)
    second, _ = random_state(model, 2)
    target = target_through(model, [first, second], (0.0, 0.1))
    for time in (0.0, 0.04, 0.1):
        tip_pose = model.tip_pose(q)
        error = objective.error(q, tip_pose, target, time)
        aim = aim_from(model, objective, target, q, time=time)
        np.testing.assert_allclose(aim.error, error, atol=1e-14)


@of_every_kind
def test_the_jacobian_is_the_fall_of_the_error_near_the_target(model, random_state, objective):
    """error(q + dq) = -jacobian dq to first order: what is left falls with the square of dq."""
    q = random_state(model, 0)[0]
    other = random_state(model, 1)[0]
    target = target_through(model, [q])
    jacobian = aim_from(model, objective, target, q).jacobian
    same = objective.jacobian(model.terms(q, 0.0 * q).tip_jacobian)
    np.testing.assert_array_equal(jacobian, same)
    left = []
    for size in (1e-2, 1e-3):
        step = size * (other - q)
        error = objective.error(q + step, model.tip_pose(q + step), target, 0.0)
        left.append(np.linalg.norm(error + jacobian @ step) / np.linalg.norm(error))
    assert left[0] < 0.1
    assert left[1] < 0.15 * left[0] + 1e-9


def velocity_of_target(model, objective, target, q):
    """The velocity of the target as the objective has it, seen from the tip at coordinates q."""
    return aim_from(model, objective, target, q).velocity


@pytest.mark.parametrize("objective", ["pose", "position"], indirect=True)
def test_the_bias_is_the_acceleration_that_no_coordinate_makes(model, random_state, objective):
    """The change of J q_dot at constant q_dot less that of the target's velocity; a position is
    seen in the tip's frame, which turns, and its velocity changes in space."""
    q, q_dot = random_state(model, 2)
    goal = random_state(model, 3)[0]
    next_goal = random_state(model, 4)[0]
    share = 1e-6 / PERIOD
    slow = goal + share * (next_goal - goal)
    target = target_through(model, [goal, slow], (0.0, PERIOD))
    h = 1e-6

    def gap(time):
        """How fast the arm goes towards where the target goes."""
        at_time = q + time * q_dot
        terms = model.terms(at_time, q_dot)
        velocity = objective.jacobian(terms.tip_jacobian) @ q_dot
        target_velocity = velocity_of_target(model, objective, target, at_time)
        if isinstance(objective, TipPosition):
            into_world = terms.tip_pose[:3, :3]
            return into_world @ (velocity - target_velocity)
        return velocity - target_velocity

    difference = (gap(h) - gap(-h)) / (2.0 * h)
    if isinstance(objective, TipPosition):
        difference = model.tip_pose(q)[:3, :3].T @ difference
    bias = aim_from(model, objective, target, q, q_dot).bias
    largest_difference = np.abs(difference).max()
    np.testing.assert_allclose(bias, difference, atol=1e-4 * largest_difference)


def test_shapes_have_no_bias(model, random_state):
    """Their Jacobian is constant."""
    q, q_dot = random_state(model, 2)
    aim = aim_from(model, Shape(model), target_through(model, [q]), q, q_dot)
    np.testing.assert_array_equal(aim.bias, 0.0)


@of_every_kind
@pytest.mark.parametrize("time", [0.0, 0.02, 0.025])
def test_the_velocity_is_the_target_s(model, objective, time):
    """Seen from an arm that stands at the target, it is how fast the error grows; between instants
    too."""
    path = [model.rest_coordinates([1.0 + 0.3 * i, 0.1 * i, 0.4]) for i in range(4)]
    target = target_through(model, path, (0.0, 0.02, 0.04, 0.06))
    between = time / 0.02 * (path[1] - path[0])
    q = path[0] + between
    h = 1e-3
    now = aim_from(model, objective, target, q, time=time)
    moment_later = time + h
    later = aim_from(model, objective, target, q, time=moment_later)
    short = aim_from(model, objective, target, q, time=time, period=h)
    speed = np.linalg.norm(short.velocity)
    assert np.linalg.norm(now.error) < 1e-3
    assert speed > 0.01
    growth = (later.error - now.error) / h
    np.testing.assert_allclose(growth, short.velocity, atol=2e-3 * speed)
    np.testing.assert_allclose(now.velocity, short.velocity, atol=0.05 * speed)


def test_the_velocity_of_a_pose_is_its_twist_in_the_frame_of_the_tip(model, random_state):
    """However far the tip is from it."""
    q = random_state(model, 0)[0]
    tip_pose = model.tip_pose(q)
    twist = np.array([0.3, -1.0, 0.5, 0.1, 0.2, -0.3])
    way_to_start = np.array([0.5, 1.0, -0.7, 0.1, 0.2, 0.1])
    start = moved_pose(tip_pose, way_to_start)
    end = moved_pose(start, PERIOD * twist)
    times = np.array([0.0, PERIOD])
    poses = np.stack([start, end])
    target = Reference(times, poses)
    radian = 0.03
    velocity = aim_from(model, TipPose(radian), target, q).velocity
    units = np.repeat([radian, 1.0], 3)
    start_from_tip = inverse_pose(tip_pose) @ start
    in_frame_of_tip = adjoint(start_from_tip) @ twist
    np.testing.assert_allclose(velocity / units, in_frame_of_tip, atol=1e-10)


def test_the_velocity_of_a_shape_is_the_same_from_everywhere(model, random_state):
    objective = Shape(model)
    start, _ = random_state(model, 0)
    end, _ = random_state(model, 1)
    q, _ = random_state(model, 2)
    target = target_through(model, [start, end], (0.0, PERIOD))
    away = aim_from(model, objective, target, q)
    at_start = aim_from(model, objective, target, start)
    np.testing.assert_allclose(away.velocity, at_start.velocity, rtol=1e-9)
    rates = (end - start) / PERIOD
    expected_velocity = away.jacobian @ rates
    np.testing.assert_allclose(away.velocity, expected_velocity, rtol=1e-9)


def test_a_radian_is_worth_a_tenth_of_the_rod(model):
    twist = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    tip_pose = np.eye(4)
    turned = moved_pose(tip_pose, twist)
    target = Reference(np.zeros(1), turned[None])
    objective = tip_pose_objective(model)
    error = objective.error(np.zeros(3), tip_pose, target, 0.0)
    expected = 0.03 * model.length
    assert np.linalg.norm(error) == pytest.approx(expected)


def test_positions_are_those_of_poses_where_these_are_told(model, random_state):
    goal = model.tip_pose(random_state(model, 1)[0])
    of_pose = Reference(np.zeros(1), goal[None])
    of_position = Reference(np.zeros(1), tip_position=goal[None, :3, 3])
    q, _ = random_state(model, 0)
    tip_pose = model.tip_pose(q)
    way = goal[:3, 3] - tip_pose[:3, 3]
    for target in (of_pose, of_position):
        error = TipPosition().error(q, tip_pose, target, 0.0)
        np.testing.assert_allclose(tip_pose[:3, :3] @ error, way)


def test_a_model_sees_the_pose_displaced_as_its_tip_is(model, random_state):
    """A model that reaches what it sees has the arm at the target; the errors are one motion in two
    frames."""
    objective = TipPose()
    q, _ = random_state(model, 0)
    tip_pose = model.tip_pose(q)
    next_q, _ = random_state(model, 1)
    goal = model.tip_pose(next_q)
    measured = moved_pose(tip_pose, DISPLACEMENT)
    target = Reference(np.zeros(1), goal[None])
    seen = objective.seen_from(tip_pose, target, measured).tip_pose[0]
    np.testing.assert_allclose(moved_pose(seen, DISPLACEMENT), goal, atol=1e-12)
    frame = adjoint(inverse_pose(tip_pose) @ measured)
    of_arm = frame @ pose_error(measured, goal)
    np.testing.assert_allclose(pose_error(tip_pose, seen), of_arm, atol=1e-12)


@pytest.mark.parametrize("told", ["pose", "position"])
def test_a_model_sees_the_position_displaced_as_its_tip_is(model, random_state, told):
    q = random_state(model, 0)[0]
    tip_pose = model.tip_pose(q)
    goal = model.tip_pose(random_state(model, 1)[0])
    measured = moved_pose(tip_pose, np.array([0.0, 0.0, 0.0, 0.01, 0.02, -0.01]))
    target = Reference(np.zeros(1), tip_position=goal[None, :3, 3])
    if told == "pose":
        target = Reference(np.zeros(1), goal[None])
    of_arm = TipPosition().error(q, measured, target, 0.0)
    seen = TipPosition().seen_from(tip_pose, target, measured)
    of_model = TipPosition().error(q, tip_pose, seen, 0.0)
    np.testing.assert_allclose(of_model, of_arm, atol=1e-14)


def test_a_model_sees_the_direction_of_a_target_displaced_but_not_one_of_the_world(
    model, random_state
):
    """A model that reaches what it sees has the arm in the target's direction."""
    tip_pose = model.tip_pose(random_state(model, 0)[0])
    target = target_through(model, [random_state(model, 1)[0]])
    measured = moved_pose(tip_pose, DISPLACEMENT)
    seen = TipDirection().seen_from(tip_pose, target, measured)
    arm = moved_pose(seen.tip_pose[0], DISPLACEMENT)
    np.testing.assert_allclose(arm, target.tip_pose[0], atol=1e-12)
    of_world = TipDirection((1.0, 0.4, -0.2))
    assert of_world.seen_from(tip_pose, target, measured) is target


@pytest.mark.parametrize("objective", ["pose", "position"], indirect=True)
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_target_that_is_moved_back_leaves_its_share_of_the_error(
    model, random_state, objective, share
):
    """Of the error of the pose that it is moved to, at the instant that is asked for; at all others
    it is moved by as much."""
    nearest, _ = random_state(model, 0)
    first, _ = random_state(model, 1)
    second, _ = random_state(model, 2)
    target = target_through(model, [first, second], (0.0, 0.1))
    pose = model.tip_pose(nearest)
    moved = objective.moved_back(target, pose, 0.1, share)
    before = objective.error(nearest, pose, target, 0.1)
    after = objective.error(nearest, pose, moved, 0.1)
    expected_after = (1.0 - share) * before
    np.testing.assert_allclose(after, expected_after, atol=1e-12)
    steps = [pose_error(a, b) for a, b in zip(target.tip_pose, moved.tip_pose, strict=True)]
    if isinstance(objective, TipPosition):
        steps = moved.tip_position - target.tip_position
    np.testing.assert_allclose(steps[0], steps[1], atol=1e-12)


def test_shapes_stay_where_they_are(model, random_state):
    target = target_through(model, [random_state(model, 0)[0]])
    pose = model.tip_pose(random_state(model, 1)[0])
    assert Shape(model).moved_back(target, pose, 0.0, 0.5) is target
    assert Shape(model).seen_from(pose, target, target.tip_pose[0]) is target


def test_bending_by_an_angle_counts_as_half_of_the_length_times_the_angle(model):
    """A pull and two pushes that sum to nothing bend the straight arm evenly."""
    q = 1e-3 * np.array([1.0, -0.5, -0.5])
    target = Reference(np.zeros(1), q=q[None])
    straight = np.eye(4)
    error = Shape(model).error(np.zeros(3), straight, target, 0.0)
    tip_pose = model.tip_pose(q)
    way = pose_error(straight, tip_pose)
    angle = np.linalg.norm(way[:3])
    expected = 0.5 * model.length * angle
    assert np.linalg.norm(error) == pytest.approx(expected, rel=1e-4)
