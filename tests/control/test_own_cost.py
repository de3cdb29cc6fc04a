"""Objectives of a user's own cost: errors and gradients against differences, obstacles kept clear
of, weights, and mistakes in words."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import (
    Avoidance,
    ControllerInput,
    Effort,
    LinearError,
    Posture,
    Reference,
    Shape,
    Smoothness,
    TipDirection,
    TipPose,
    TipPosition,
)
from soft_tendon_env.control.catalogue import controllers_of
from soft_tendon_env.control.own_cost import own_cost
from soft_tendon_env.control.predictive import Predictive, Tuning
from soft_tendon_env.control.rigid_motions import moved_pose
from soft_tendon_env.policies import (
    load_policy,
    make_policy,
    observation_options,
    policy_options,
)

PERIOD = 0.02
CLEARANCE = 0.005
SMALL = {"scene": "three_tendon", "fidelity": "fast"}
EVERYTHING = ("tip_pose", "tip_position", "q")


class Curl:
    """An objective of a user's own: all coordinates are to be zero."""

    def __init__(self, model, weight=1.0):
        self.weight = weight

    def linear_error(self, posture):
        return LinearError(-self.weight * posture.q, self.weight * np.eye(posture.q.size))

    def seen_from(self, model_pose, reference, measured_pose):
        return reference


@pytest.fixture(scope="module")
def model(build):
    return build("three_tendon")


def ball_at(position, radius=0.02, **motion):
    return {"type": "sphere", "radius": radius, "position": tuple(position), **motion}


def in_the_way(model, weight=10.0, q=None):
    """Avoidance of a ball whose surface the tip touches at coordinates q, or at rest."""
    q = np.zeros(model.coordinate_count) if q is None else q
    tip = model.tip_pose(q)[:3, 3]
    radius = float(model.discretisation.radius(np.array([model.length]))[0])
    ball = ball_at(tip + np.array([0.0, 0.02 + radius, 0.0]))
    return Avoidance(model, [ball], CLEARANCE, weight)


OBJECTIVES = {
    "pose": lambda model, weight: TipPose(0.1 * model.length, weight),
    "position": lambda model, weight: TipPosition(weight),
    "direction": lambda model, weight: TipDirection(weight=0.1 * weight),
    "own direction": lambda model, weight: TipDirection((1.0, 0.4, -0.2), 0.1 * weight),
    "shape": Shape,
    "avoidance": in_the_way,
    "own": Curl,
}


def posture_at(model, q, reference, time=0.0):
    terms = model.terms(q, 0.0 * q)
    return Posture(q, terms.tip_pose, terms.tip_jacobian, reference, 0.0, time)


def reference_at(model, q):
    pose = model.tip_pose(q)
    return Reference(np.zeros(1), pose[None], pose[None, :3, 3], q[None])


@pytest.mark.parametrize("kind", OBJECTIVES)
def test_the_gradient_of_the_square_is_that_of_differences(model, random_state, kind):
    """Of half the squared error along every coordinate; of a pose near its target, whose logarithm
    weighs angles and ways together."""
    objective = OBJECTIVES[kind](model, 2.0)
    q = 0.2 * random_state(model, 0)[0]
    share = 1e-3 if kind == "pose" else 1.0
    reference = reference_at(model, q + share * random_state(model, 1)[0])

    def half_square(q):
        error = objective.linear_error(posture_at(model, q, reference)).error
        return 0.5 * error @ error

    linear = objective.linear_error(posture_at(model, q, reference))
    assert np.linalg.norm(linear.error) > 0.0
    gradient = -linear.jacobian.T @ linear.error
    steps = 1e-4 * np.diag(model.coordinate_scale())
    slopes = [
        (half_square(q + step) - half_square(q - step)) / (2.0 * step.sum()) for step in steps
    ]
    tolerance = 5e-3 if kind == "pose" else 1e-5
    largest_slope = np.abs(slopes).max()
    np.testing.assert_allclose(gradient, slopes, atol=tolerance * largest_slope)


@pytest.mark.parametrize("kind", OBJECTIVES)
def test_weights_multiply_error_and_jacobian(model, random_state, kind):
    make_objective = OBJECTIVES[kind]
    q, _ = random_state(model, 0)
    goal, _ = random_state(model, 1)
    posture = posture_at(model, 0.2 * q, reference_at(model, goal))
    single = make_objective(model, 1.0).linear_error(posture)
    triple = make_objective(model, 3.0).linear_error(posture)
    expected_error = 3.0 * single.error
    np.testing.assert_allclose(triple.error, expected_error, rtol=1e-12)
    expected_jacobian = 3.0 * single.jacobian
    np.testing.assert_allclose(triple.jacobian, expected_jacobian, rtol=1e-12)


@pytest.mark.parametrize("kind", ["pose", "position", "shape"])
def test_objectives_of_feedback_are_those_of_plans(model, random_state, kind):
    """The same errors and Jacobians serve both."""
    objective = OBJECTIVES[kind](model, 1.0)
    q = random_state(model, 0)[0]
    reference = reference_at(model, random_state(model, 1)[0])
    posture = posture_at(model, q, reference)
    linear = objective.linear_error(posture)
    np.testing.assert_array_equal(
        linear.error, objective.error(q, posture.tip_pose, reference, 0.0)
    )
    expected_jacobian = objective.jacobian(posture.tip_jacobian)
    np.testing.assert_array_equal(linear.jacobian, expected_jacobian)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.5, np.pi])
def test_a_direction_is_off_by_its_angle_whatever_the_roll(model, angle):
    q = np.zeros(model.coordinate_count)
    rest = posture_at(model, q, reference_at(model, q))
    x, y, _ = rest.tip_pose[:3, :3].T
    direction = np.cos(angle) * x + np.sin(angle) * y
    objective = TipDirection(tuple(direction), 1.0)
    roll = np.array([0.7, 0.0, 0.0, 0.0, 0.0, 0.0])
    rolled = moved_pose(rest.tip_pose, roll)
    for pose in (rest.tip_pose, rolled):
        posture = rest._replace(tip_pose=pose)
        linear = objective.linear_error(posture)
        angle_off = np.linalg.norm(linear.error)
        assert angle_off == pytest.approx(angle, abs=1e-12)


def test_gaps_are_distances_between_surfaces(model):
    """Beside the straight arm's middle, and of a ball that moves."""
    q = np.zeros(model.coordinate_count)
    half = np.array([0.5 * model.length])
    (middle,) = model.backbone_at(q, half)
    (radius,) = model.discretisation.radius(half)
    place = middle[:3, 3]
    aside = middle[:3, 1]
    velocity = 0.01 * aside
    ball = ball_at(place + 0.05 * aside, velocity=tuple(velocity))
    avoidance = Avoidance(model, [ball], CLEARANCE)
    # samples lie within a radius of the nearest place
    assert avoidance.gaps(q)[0] == pytest.approx(0.05 - 0.02 - radius, abs=1e-4)
    assert avoidance.gaps(q, 1.0)[0] == pytest.approx(0.06 - 0.02 - radius, abs=1e-4)


def test_what_keeps_clear_costs_nothing(model):
    q = np.zeros(model.coordinate_count)
    away = Avoidance(model, [ball_at((0.0, 1.0, 0.0))], CLEARANCE)
    linear = away.linear_error(posture_at(model, q, reference_at(model, q)))
    assert not linear.error.any()
    assert not linear.jacobian.any()


def test_predictive_control_keeps_its_clearance(model, limits_of, holding, drive):
    """A target behind the surface of a ball: with the objective the arm stops before it, and uses
    little of the clearance on the way there; without, it goes in."""
    target = holding(model, [2.5, 0.0, 0.0])
    tip = target.tip_position[0]
    away = tip - model.tip_pose(np.zeros(model.coordinate_count))[:3, 3]
    depth = 0.015
    place = tip + (0.02 + 0.01 - depth) * away / np.linalg.norm(away)
    avoidance = Avoidance(model, [ball_at(place)], CLEARANCE)
    least = {}
    for name, objectives in (
        ("careful", (TipPosition(), avoidance)),
        ("careless", (TipPosition(),)),
    ):
        controller = Predictive(model, limits_of(model), PERIOD, objectives)
        motion = drive(controller, model, target, 50)
        gaps = [avoidance.gaps(q)[0] for q in motion.q]
        least[name] = min(gaps)
        if name == "careful":
            assert gaps[-1] > 0.95 * CLEARANCE
    assert least["careful"] > 0.8 * CLEARANCE
    assert least["careless"] < -0.5 * depth


def test_one_objective_alone_or_in_a_list_is_the_same_cost(model, limits_of, holding):
    target = holding(model, [2.5, 0.0, 1.0])
    q = np.zeros(model.coordinate_count)
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q, tip_pose, np.zeros(3), target)
    limits = limits_of(model)
    objective = TipPosition()
    alone = Predictive(model, limits, PERIOD, objective).act(now)
    listed = Predictive(model, limits, PERIOD, [objective]).act(now)
    np.testing.assert_array_equal(alone.tension, listed.tension)
    twice = Predictive(model, limits, PERIOD, [objective, TipPosition()]).act(now)
    np.testing.assert_allclose(alone.tension, twice.tension, atol=1e-6)


def test_effort_and_smoothness_of_a_list_are_those_of_the_tuning(model, limits_of, holding):
    entry = controllers_of("Reach")["predictive"]
    cost = own_cost([TipPosition(), Effort(0.1), Smoothness(1.5)], model, EVERYTHING)
    controller = entry.with_cost(cost).make(model, limits_of(model), PERIOD)
    same = Predictive(
        model, limits_of(model), PERIOD, TipPosition(), Tuning(effort=0.1, smoothness=1.5)
    )
    q = np.zeros(model.coordinate_count)
    target = holding(model, [2.5, 0.0, 1.0])
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q, tip_pose, np.zeros(3), target)
    np.testing.assert_array_equal(controller.act(now).tension, same.act(now).tension)


def own_policy(name, task, **options):
    """A function of objectives that makes a policy, by its name."""
    env = gym.make(f"TendonRod-{task}-v0", **policy_options(name, task, {**SMALL, **options}))
    return env, partial(load_policy, name, env)


@pytest.mark.parametrize("name", ["predictive", "filtered:predictive"])
def test_own_objectives_change_what_policies_do(name):
    """One that holds the arm straight leaves the target; also behind an estimator."""
    env, policy = own_policy(name, "TipPose")
    bent = {}
    for weight in (1e-3, 1e3):
        acting = policy([TipPosition(), partial(Curl, weight=weight)])
        observation, _ = env.reset(seed=0)
        state = None
        for _ in range(20):
            action, state = acting.predict(observation, state)
            observation, *_ = env.step(action)
        bent[weight] = np.linalg.norm(env.unwrapped.state.q)
    assert bent[1e3] < 0.1 * bent[1e-3]


def wrong_shape(model):
    curl = Curl(model)
    curl.linear_error = lambda posture: LinearError(posture.q, posture.q)
    return curl


def not_finite(model):
    return Curl(model, np.nan)


@pytest.mark.parametrize(
    ("objectives", "error", "text"),
    [
        ("position", TypeError, "should be a list"),
        (["position"], TypeError, r"objectives\[0\] is 'position': it should be TipPose, TipPos"),
        ([TipPosition(), int], TypeError, r"objectives\[1\].*makes no objective of a model alone"),
        ([lambda model: 3.0], TypeError, r"objectives\[0\] makes 3.0: it should be TipPose"),
        ([], ValueError, "should have an error besides Effort and Smoothness"),
        ([Effort(0.1)], ValueError, "should have an error besides Effort and Smoothness"),
        ([Effort(0.1), Effort(0.2)], ValueError, r"objectives\[1\] is a second Effort"),
        ([TipPose()], ValueError, "follows the target's tip_pose: .* tells tip_position alone"),
        ([Shape], ValueError, "follows the target's q: .* tells tip_position alone"),
        ([wrong_shape], ValueError, r"has the shapes .*it should be LinearError\(error \(k,\)"),
        ([not_finite], ValueError, "it should be finite"),
    ],
)
def test_wrong_objectives_say_what_is_allowed(model, objectives, error, text):
    with pytest.raises(error, match=text):
        own_cost(objectives, model, ("tip_position",))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: TipPosition(0.0), "weight should be a number, at least 1e-09, not 0.0"),
        (lambda: TipPose(weight=-1.0), "weight should be"),
        (lambda: Effort(0.0), "weight should be"),
        (lambda: Smoothness(-1.0), "weight should be a number, at least 0"),
        (lambda: TipDirection((0.0, 0.0, 0.0)), r"direction is \(0, 0, 0\)"),
    ],
)
def test_wrong_weights_and_directions_are_refused(make, text):
    with pytest.raises(ValueError, match=text):
        make()


def test_controllers_without_objectives_name_those_that_have_some():
    env = gym.make("TendonRod-Reach-v0", **SMALL, **observation_options("tracking", "Reach"))
    with pytest.raises(ValueError, match=r"of Reach predictive, robust_predictive, long_horizon_p"):
        make_policy("tracking", env, objectives=[TipPosition()])
    agent = gym.make("TendonRod-Reach-v0", **policy_options("dagger", "Reach", {}))
    with pytest.raises(ValueError, match="'dagger': predictive controllers alone may have some"):
        load_policy("dagger", agent, objectives=[TipPosition()])
