"""Control of shapes: the implicit law at any period, gains by the poles of the slowest mode,
feedforward."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.control.dynamics import implicit_step
from soft_tendon_env.control.shape_tracking import ShapeFeedforward, ShapeTracking

PERIOD = 0.02
HALFWAY = Reference(np.array([0.0, 2.0 * PERIOD]))
ARMS = {
    "full": ("paper", None),
    "redundant": ("four_tendon", None),
    "passive": ("paper_16dof", None),
}


def wide(model):
    """Limits that are never met."""
    return np.tile([-1e6, 1e6], (model.tendon_count, 1))


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize(("kp", "kd"), [(3.0, 0.2), (0.5, 2.0)])
def test_the_law_holds_at_the_end_of_the_period(build, random_state, arm, kp, kd):
    """u = q_a_bar + G_aa^-1 (..) (kd (q_bar_dot - q_dot) + kp (q_bar - q)), with q and q_dot those
    of the implicit step under u itself."""
    model = build(*ARMS[arm])
    q, q_dot = random_state(model, 0)
    goal = random_state(model, 1)[0]
    next_goal = random_state(model, 2)[0]
    reference = HALFWAY._replace(q=np.stack([goal, 2.0 * next_goal - goal]))
    controller = ShapeTracking(model, wide(model), PERIOD)
    controller.kp = kp
    controller.kd = kd
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q_dot, tip_pose, np.zeros(model.tendon_count), reference)
    output = controller.act(now)
    terms = model.terms(q, q_dot)
    step = implicit_step(terms, q_dot, PERIOD)
    next_q_dot = step.free + step.response @ output.tension
    next_q = q + PERIOD * next_q_dot
    units = np.eye(model.tendon_count)
    at_rest = np.stack([model.rest_coordinates(unit) for unit in units], axis=1)
    tensions = np.linalg.pinv(at_rest)
    stiffness_aa = tensions @ terms.stiffness @ tensions.T
    rate_error = (next_goal - goal) / PERIOD - next_q_dot
    push = terms.stiffness @ (kd * rate_error + kp * (next_goal - next_q))
    law = tensions @ next_goal + np.linalg.pinv(stiffness_aa) @ tensions @ push
    # of redundant tendons only the motion is determined
    motion = step.response @ output.tension
    law_motion = step.response @ law
    largest_law_motion = np.abs(law_motion).max()
    np.testing.assert_allclose(motion, law_motion, atol=1e-4 * largest_law_motion)
    assert output.report["singular"] == 0.0


def test_the_gains_are_about_the_paper_s_by_default(build):
    model = build("paper")
    controller = ShapeTracking(model, wide(model), PERIOD)
    assert controller.kp == pytest.approx(1000.0, rel=0.25)
    assert controller.kd == pytest.approx(100.0, rel=0.25)


@pytest.mark.parametrize(("settling_time", "damping"), [(0.4, 10.0), (0.3, 0.7)])
def test_gains_give_the_slowest_mode_its_settling_time_and_damping(build, settling_time, damping):
    """Poles of s^2 + (d + kd w^2) s + (1 + kp) w^2: the slowest at -4 / settling_time, the ratio as
    asked for."""
    model = build("paper")
    controller = ShapeTracking(
        model, wide(model), PERIOD, settling_time=settling_time, damping=damping
    )
    rest = np.zeros(model.coordinate_count)
    terms = model.terms(rest, rest)
    squares, modes = np.linalg.eig(np.linalg.solve(terms.mass, terms.stiffness))
    mode = modes[:, np.argmin(squares.real)].real
    mass = mode @ terms.mass @ mode
    own = mode @ terms.damping @ mode
    stiffness = mode @ terms.stiffness @ mode
    rate = (own + controller.kd * stiffness) / mass
    square = (1.0 + controller.kp) * stiffness / mass
    poles = np.roots([1.0, rate, square])
    expected = -4.0 / settling_time
    assert max(poles.real) == pytest.approx(expected, rel=1e-6)
    assert rate / (2.0 * np.sqrt(square)) == pytest.approx(damping, rel=1e-6)


def test_what_is_slower_than_the_arm_itself_asks_for_no_gains(build):
    model = build("paper")
    slow = ShapeTracking(model, wide(model), PERIOD, settling_time=100.0, damping=1.0)
    assert (slow.kp, slow.kd) == (0.0, 0.0)


@pytest.mark.parametrize("arm", ARMS)
def test_at_the_target_tensions_are_those_that_hold_it(build, holding, arm):
    """A little less where tendons are redundant: the least do."""
    model = build(*ARMS[arm])
    tension = 0.5 + 0.1 * np.arange(model.tendon_count)
    target = holding(model, tension)
    q = target.q[0]
    now = ControllerInput(q, 0.0 * q, target.tip_pose[0], tension, target)
    for kind in (ShapeTracking, ShapeFeedforward):
        output = kind(model, wide(model), PERIOD).act(now)
        at_rest = model.rest_coordinates(output.tension)
        largest = np.abs(q).max()
        np.testing.assert_allclose(at_rest, q, atol=1e-4 * largest)


def test_the_law_keeps_to_the_limits_by_the_nearest_motion(build, holding):
    """In the metric of the step, and not by cutting off: other tendons help."""
    model = build("four_tendon")
    limits = np.tile([0.0, 1.0], (4, 1))
    target = holding(model, [9.0, 0.0, 0.0, 0.0])
    q = np.zeros(model.coordinate_count)
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q, tip_pose, np.zeros(4), target)
    asked = ShapeTracking(model, wide(model), PERIOD).act(now).tension
    tension = ShapeTracking(model, limits, PERIOD).act(now).tension
    step = implicit_step(model.terms(q, q), q, PERIOD)

    def distance(other):
        off = other - asked
        return off @ step.metric @ off

    rng = np.random.default_rng(0)
    others = rng.uniform(0.0, 1.0, (200, 4))
    assert distance(tension) <= min(map(distance, others)) + 1e-6 * distance(np.zeros(4))


def test_feedforward_is_the_shape_s_tensions_within_limits(build, holding, random_state):
    """Whatever the arm does; a period ahead."""
    model = build("paper")
    tension = np.arange(10.0)
    start = holding(model, tension).q[0]
    end = holding(model, 3.0 * tension).q[0]
    reference = HALFWAY._replace(q=np.stack([start, end]))
    q, q_dot = random_state(model, 0)
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q_dot, tip_pose, np.zeros(10), reference)
    limits = np.tile([0.0, 15.0], (10, 1))
    controller = ShapeFeedforward(model, limits, PERIOD)
    output = controller.act(now)
    expected = np.minimum(2.0 * tension, 15.0)
    np.testing.assert_allclose(output.tension, expected, rtol=1e-9, atol=1e-9)
    # of 0, 16 and 18 N
    assert output.report["limited"] == pytest.approx(0.3)


@pytest.mark.parametrize("kind", [ShapeTracking, ShapeFeedforward])
def test_explicit_bases_are_refused(build, kind):
    modes = [{"strains": ["bend_y"], "order": 1, "span": "rod"}]
    changes = {"strain": {"type": "explicit", "modes": modes}}
    model = build("three_tendon", changes)
    with pytest.raises(ValueError, match="coordinates that are tensions"):
        kind(model, wide(model), PERIOD)
