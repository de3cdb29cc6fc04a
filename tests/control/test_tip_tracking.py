"""Tracking of tips and shapes: the paper's laws at short periods, errors that fall as the gains say
at long ones."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, InputError, Reference, tip_tracking
from soft_tendon_env.control.dynamics import implicit_step
from soft_tendon_env.control.objectives import TipPose, TipPosition
from soft_tendon_env.control.paper_laws import (
    Gains,
    TipPoseTarget,
    accelerating_tension,
    energy_left_inverse,
    tip_pose_tension,
)
from soft_tendon_env.control.rigid_motions import adjoint, inverse_pose, moved_pose
from soft_tendon_env.control.shape_tracking import ShapeTracking
from soft_tendon_env.control.tip_tracking import TipMemory, TipTracking

PERIOD = 0.02
WIDE = np.tile([-100.0, 100.0], (10, 1))
SETTLING = 0.2
HELD = 12.0 + 4.0 * np.sin(np.arange(10.0))
TWIST = np.array([8.0, -6.0, 4.0, 1.0, -2.0, 1.5])
PAPER_GAINS = Gains(400.0, 40.0)  # of a double pole at -4 / SETTLING
PASSIVE = {
    "strain.passive": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}]
}
INSIDE = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.include_loads": True}
ARMS = {
    "full": ("paper", None),
    "passive": ("three_tendon", PASSIVE),
    "redundant": ("four_tendon", None),
    "loads inside": ("three_tendon", {**PASSIVE, **INSIDE}),
}


@pytest.fixture(scope="module")
def model(build):
    return build("paper")


@pytest.fixture
def near(model, holding):
    """A target and the tensions that hold it, as a governor tells them."""
    return holding(model, HELD)._replace(tension=HELD)


def pose_law(terms, q_dot, pose, twist):
    return tip_pose_tension(terms, q_dot, TipPoseTarget(pose, twist, np.zeros(6)), PAPER_GAINS)


def position_law(terms, q_dot, pose, twist):
    """(39) for the position alone, whose error in space obeys e_ddot + kd e_dot + kp e = 0."""
    angular, linear = np.split(terms.tip_jacobian @ q_dot, 2)
    R = terms.tip_pose[:3, :3]
    r = terms.tip_pose[:3, 3]
    r_ddot = PAPER_GAINS.kd * (pose[:3, :3] @ twist[3:] - R @ linear) + PAPER_GAINS.kp * (
        pose[:3, 3] - r
    )
    return accelerating_tension(
        terms, q_dot, slice(3, 6), R.T @ r_ddot - np.cross(angular, linear), energy_left_inverse
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "moves", [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], ids=["still", "as the tip", "otherwise"]
)
@pytest.mark.parametrize(
    ("objective", "law"),
    [(TipPose(0.1), pose_law), (TipPosition(), position_law)],
    ids=["pose", "position"],
)
def test_short_periods_give_the_paper_s_law(
    model, random_state, monkeypatch, objective, law, moves, seed
):
    """(39) in the limit, when nothing but the task counts, for targets that stand still, move as
    the tip does or with a twist of their own, whose derivative is taken in the frame of the tip,
    which moves: what is left falls with the period."""
    monkeypatch.setattr(tip_tracking, "FREE", 1e-5)
    q, q_dot = random_state(model, seed)
    terms = model.terms(q, q_dot)
    pose = moved_pose(terms.tip_pose, np.array([0.1, -0.2, 0.1, 0.02, 0.03, -0.02]))
    twist = (
        moves[0] * (adjoint(inverse_pose(pose) @ terms.tip_pose) @ terms.tip_jacobian @ q_dot)
        + moves[1] * TWIST
    )
    if isinstance(objective, TipPosition):
        twist[:3] = 0.0  # a straight way
    expected = law(terms, q_dot, pose, twist)
    off = []
    for period in (1e-5, 1e-6, 1e-7):
        poses = np.stack([moved_pose(pose, k * period * twist) for k in range(3)])
        now = ControllerInput(
            q,
            q_dot,
            terms.tip_pose,
            np.zeros(10),
            Reference(period * np.arange(3.0), poses, poses[:, :3, 3]),
        )
        found = (
            TipTracking(
                model, np.tile([-1e6, 1e6], (10, 1)), period, objective, settling_time=SETTLING
            )
            .act(now)
            .tension
        )
        off.append(np.linalg.norm(found - expected) / np.linalg.norm(expected))
    assert off[0] < 0.1
    assert off[1] < 0.15 * off[0] + 1e-4
    assert off[2] < 2e-3


@pytest.mark.parametrize("objective", [TipPose(0.1), TipPosition()], ids=["pose", "position"])
@pytest.mark.parametrize("settling_time", [0.2, 0.4])
def test_errors_fall_as_the_gains_say(model, near, drive, objective, settling_time):
    """To 2 % within about the settling time: a double pole takes 1.46 of it, and limits some
    periods."""
    controller = TipTracking(model, WIDE, PERIOD, objective, settling_time=settling_time)
    motion = drive(controller, model, near, 100)
    tip_position = motion.tip[:, :3, 3]
    away = np.linalg.norm(tip_position - near.tip_position[0], axis=1)
    at_first = away[0]
    at_last = away[-1]
    (unsettled,) = np.nonzero(away > 0.02 * at_first)
    periods = 1 + unsettled[-1]
    took = PERIOD * periods
    longest = 1.46 * settling_time + 3.0 * PERIOD
    assert at_first > 0.05 * model.length
    assert at_last < 1e-4 * model.length
    assert 0.5 * settling_time < took < longest


def controller_input(model, random_state, period):
    """In motion, towards a target in motion, and the target's rates."""
    q, q_dot = random_state(model, 0)
    goal, rates = random_state(model, 1)
    path = np.stack([goal, goal + period * rates])
    return ControllerInput(
        q,
        q_dot,
        model.tip_pose(q),
        np.zeros(model.tendon_count),
        Reference(np.array([0.0, period]), q=path),
    ), rates


@pytest.mark.parametrize("arm", ARMS)
def test_short_periods_give_the_paper_s_law_of_shapes(build, arm, random_state):
    """u = q_a_bar + B^+ G (kd (q_bar_dot - q_dot) + kp (q_bar - q)), up to what a period changes:
    in its tenth a tenth."""
    shaped = build(*ARMS[arm])
    off = []
    wide = np.tile([-1e6, 1e6], (shaped.tendon_count, 1))
    for period in (1e-8, 1e-9):
        now, rates = controller_input(shaped, random_state, period)
        controller = ShapeTracking(shaped, wide, period, settling_time=0.2, damping=1.0)
        held = np.stack(
            [shaped.rest_coordinates(unit) for unit in np.eye(shaped.tendon_count)], axis=1
        )
        push = controller.kd * (rates - now.q_dot) + controller.kp * (now.reference.q[0] - now.q)
        terms = shaped.terms(now.q, now.q_dot)
        law = (
            np.linalg.pinv(held) @ now.reference.q[0]
            + energy_left_inverse(terms) @ terms.stiffness @ push
        )
        forces = terms.actuation @ np.stack(
            [controller.act(now).tension, law], axis=1
        )  # of redundant tendons only these are determined
        off.append(np.abs(forces[:, 0] - forces[:, 1]).max() / np.abs(forces[:, 1]).max())
    assert off[0] < 1e-3
    assert off[1] < 0.11 * off[0]


@pytest.mark.parametrize(("settling_time", "damping"), [(0.4, 10.0), (0.2, 1.0)])
def test_the_loop_is_stable_and_settles_at_twenty_milliseconds(
    build, drive, holding, settling_time, damping
):
    """The paper's gains (0.4 s, 10) too, within limits."""
    model = build("paper")
    controller = ShapeTracking(
        model, np.tile([0.0, 60.0], (10, 1)), 0.02, settling_time=settling_time, damping=damping
    )
    target = holding(model, [20.0, 5.0, 2.0, 2.0, 2.0, 10.0, 2.0, 2.0, 2.0, 2.0])
    motion = drive(controller, model, target, 150)
    off = np.linalg.norm(motion.tip[:, :3, 3] - target.tip_position[0], axis=1)
    took = 0.02 * np.flatnonzero(off > 0.02 * off[0])[-1]
    assert off[0] > 0.05 * model.length
    assert off[-10:].max() < 1e-3 * model.length
    assert took < 2.5 * settling_time


ERROR = InputError(1.0 + 0.2 * np.cos(np.arange(10.0)), 1.5 * np.sin(np.arange(10.0)))
INTEGRAL = 1e-4 * np.array([3.0, -2.0, 1.0, 4.0, -1.0, 2.0])


@pytest.fixture
def moving(model, random_state):
    """An arm in motion, beside what its model says, and a target in motion, faster in the second
    period than in the first."""
    q, q_dot = random_state(model, 0)
    target_q, _ = random_state(model, 1)
    start = model.tip_pose(target_q)
    way = PERIOD * TWIST
    second = moved_pose(start, way)
    third = moved_pose(second, 1.5 * way)
    poses = np.stack([start, second, third])
    times = PERIOD * np.arange(3.0)
    reference = Reference(times, poses, poses[:, :3, 3])
    displacement = np.array([0.02, -0.01, 0.03, 0.002, 0.001, -0.001])
    tip_pose = model.tip_pose(q)
    measured = moved_pose(tip_pose, displacement)
    tension = np.zeros(10)
    return ControllerInput(q, q_dot, measured, tension, reference)


@pytest.mark.parametrize("objective", [TipPose(0.1), TipPosition()], ids=["pose", "position"])
@pytest.mark.parametrize("integral_time", [None, 0.5])
@pytest.mark.parametrize("error", [None, ERROR], ids=["exact", "erring"])
def test_the_law_holds_over_the_period(model, moving, monkeypatch, objective, integral_time, error):
    """The velocity at its end is the present one, what the gains ask for, and what the target's
    velocity gains: its mean over this period and the next differ by a period's acceleration."""
    monkeypatch.setattr(tip_tracking, "FREE", 1e-7)
    limits = np.tile([-1e9, 1e9], (10, 1))
    tracking = TipTracking(
        model, limits, PERIOD, objective, settling_time=0.3, integral_time=integral_time
    )
    terms = model.terms(moving.q, moving.q_dot)
    aim = objective.aim(moving, terms, 0.0, PERIOD)
    later = objective.aim(moving, terms, PERIOD, PERIOD)
    integral = INTEGRAL[: aim.error.size]
    output = tracking.act(moving._replace(input_error=error), TipMemory(integral, np.zeros(10)))
    acting = output.tension
    if error is not None:
        acting = error.gain * acting + error.offset
    step = implicit_step(terms, moving.q_dot, PERIOD)
    velocity = aim.jacobian @ (step.free + step.response @ acting) + PERIOD * aim.bias
    acceleration = (later.velocity - aim.velocity) / PERIOD
    # the mean over a period is the velocity in its middle: at present, that of the period before
    target_velocity = aim.velocity - PERIOD * acceleration
    present = aim.jacobian @ moving.q_dot
    gains = tracking.gains
    feedback = gains.kp * aim.error + gains.kd * (target_velocity - present) + gains.ki * integral
    expected = present + PERIOD * (acceleration + feedback)
    largest = np.abs(expected - present).max()
    np.testing.assert_allclose(velocity, expected, atol=1e-4 * largest)
    assert output.report["singular"] == 0.0
    # nothing is refused: the integral is that of the error
    np.testing.assert_allclose(
        output.memory.integral, integral + PERIOD * aim.error, atol=1e-5 * np.abs(integral).max()
    )


def test_the_integral_waits_for_what_limits_refuse(model, near):
    """Where nothing of what is asked for can be done, it moves by less than the error, in the loop
    that the gains close."""
    q = np.zeros(10)
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q, tip_pose, np.zeros(10), near)
    integrals = {}
    for greatest in (1e6, 0.01):
        limits = np.tile([-greatest, greatest], (10, 1))
        tracking = TipTracking(model, limits, PERIOD, TipPose(0.1), integral_time=0.5)
        memory = None
        for _ in range(50):
            memory = tracking.act(now, memory).memory
        integrals[greatest] = memory.integral
    error = TipPose(0.1).error(q, now.tip_pose, near, 0.0)
    expected_integral = 50 * PERIOD * error
    np.testing.assert_allclose(integrals[1e6], expected_integral, rtol=0.05, atol=1e-4)
    assert np.linalg.norm(integrals[0.01]) < 0.3 * np.linalg.norm(integrals[1e6])


def test_the_integral_removes_what_weak_tendons_leave(model, near, drive):
    """Tensions that arrive at nine tenths."""
    away = {}
    for integral_time in (None, 0.5):
        controller = TipTracking(model, WIDE, PERIOD, TipPose(0.1), integral_time=integral_time)
        motion = drive(controller, model, near, 250, act=lambda tension: 0.9 * tension)
        away[integral_time] = np.linalg.norm(motion.tip[-1, :3, 3] - near.tip_position[0])
    assert away[None] > 1e-2 * model.length
    assert away[0.5] < 0.01 * away[None]


def test_a_task_with_more_directions_than_tendons_is_singular(build, holding):
    """Its integral grows in the directions alone in which tensions move the tip."""
    arm = build("three_tendon")
    target = holding(arm, np.array([1.0, 0.5, 0.2]))
    goal = holding(arm, np.array([1.2, 0.4, 0.3]))
    still = np.zeros(3)
    slack = np.zeros(3)
    now = ControllerInput(target.q[0], still, target.tip_pose[0], slack, goal)
    limits = np.tile([-1e6, 1e6], (3, 1))
    pose = TipPose(0.03)
    outputs = []
    for objective in (pose, TipPosition()):
        controller = TipTracking(arm, limits, PERIOD, objective, integral_time=1.0)
        outputs.append(controller.act(now))
    of_pose, of_position = outputs
    assert of_pose.report["singular"] == 1.0
    assert of_position.report["singular"] == 0.0
    terms = arm.terms(now.q, now.q_dot)
    jacobian = pose.aim(now, terms, 0.0, PERIOD).jacobian
    response = implicit_step(terms, now.q_dot, PERIOD).response
    directions, _, _ = np.linalg.svd(jacobian @ response)
    open_ways = directions[:, :3]
    closed_ways = directions[:, 3:]
    integral = of_pose.memory.integral
    np.testing.assert_allclose(closed_ways.T @ integral, 0.0, atol=1e-9)
    assert np.linalg.norm(open_ways.T @ integral) > 0.0


@pytest.mark.parametrize("error", [None, ERROR], ids=["exact", "erring"])
def test_known_static_tensions_are_kept_at_the_target(model, near, error):
    """Nothing to do: what holds the target goes on, by commands that arrive as it."""
    now = ControllerInput(near.q[0], np.zeros(10), near.tip_pose[0], HELD, near, input_error=error)
    tension = TipTracking(model, WIDE, PERIOD, TipPose(0.1)).act(now).tension
    if error is not None:
        tension = error.gain * tension + error.offset
    np.testing.assert_allclose(tension, HELD, rtol=1e-6)


def test_tracking_that_is_told_of_the_inputs_needs_no_integral(model, near, drive):
    off = {}
    for told in (ERROR, None):
        tracking = TipTracking(model, WIDE, PERIOD, TipPose(0.1))
        tracking.act = lambda now, memory, act=tracking.act, told=told: act(
            now._replace(input_error=told), memory
        )
        motion = drive(
            tracking, model, near, 50, act=lambda tension: ERROR.gain * tension + ERROR.offset
        )
        off[told is None] = np.linalg.norm(motion.tip[-1, :3, 3] - near.tip_position[0])
    assert off[False] < 0.02 * off[True]
