"""Model-predictive control: its plan improves what the simulation does, within bounds, and
disturbances are found.

Controllers whose models have effects predict what happens, and turn tensions into the commands of
elastic tendons.
"""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env import Simulation
from soft_tendon_env.control import ControllerInput, InputError, Reference, predictive
from soft_tendon_env.control.dynamics import implicit_inertia
from soft_tendon_env.control.force_errors import ForceError, TendonFriction
from soft_tendon_env.control.objectives import LinearError, Shape, TipPose, TipPosition
from soft_tendon_env.control.predictive import DEFAULT, Plan, Predictive, Tuning
from soft_tendon_env.control.protocol import LaggingActuators
from soft_tendon_env.evaluation import evaluate, summarise
from soft_tendon_env.policies import make_policy, observation_options

PERIOD = 0.02
OBJECTIVES = {
    "pose": lambda model: TipPose(0.1 * model.length),
    "position": lambda model: TipPosition(),
    "shape": Shape,
}
WIDE = np.tile([-100.0, 100.0], (10, 1))
LATE = {
    "a disturbance": {
        "effects.disturbance.loads": [
            {"at": 0.3, "force": [0.0, 0.05, 0.02], "signal": {"type": "sine", "frequency": 1.5}}
        ]
    },
    "a moving base": {
        "effects.moving_base": {
            "amplitude": [0.0, 0.02, 0.01],
            "angular_amplitude": 0.1,
            "frequency": 1.5,
        }
    },
    "memory": {"effects.viscoelastic_memory.branches": [{"modulus": 1.0, "relaxation_time": 0.3}]},
}
CABLES = {
    "scene": "three_tendon",
    "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [-0.03, 0.05]},
}


@pytest.fixture(scope="module")
def model(build):
    return build("paper")


def near(model, holding, seed):
    """At rest near a target, both held by tensions."""
    rng = np.random.default_rng(seed)
    tension = rng.uniform(5.0, 20.0, 10)
    q = model.rest_coordinates(tension)
    target = holding(model, tension + rng.uniform(-4.0, 4.0, 10))
    tip_pose = model.tip_pose(q)
    return ControllerInput(q, np.zeros(10), tip_pose, tension, target)


def loads_that_bend(model, angle):
    """Loads that a filter has found, which bend the arm by an angle [rad]."""
    n = model.coordinate_count
    rest = np.zeros(n)
    stiffness = model.terms(rest, rest).stiffness
    shape = np.linspace(-1.0, 2.0, n)
    energy = shape @ stiffness @ shape
    force = angle * np.sqrt(model.bending_energy / energy) * (stiffness @ shape)
    nothing = np.zeros((n, n))
    none = np.zeros(model.tendon_count)
    friction = TendonFriction(none, np.zeros((n, model.tendon_count)))
    return ForceError(force, nothing, nothing, nothing, none, friction)


def predicted_cost(model, objective, now, plan, settling_time=DEFAULT.settling_time):
    """Half the squared errors at the ends of the periods, each less what may be left of the present
    one, by the simulation."""

    def error(q, k):
        tip_pose = model.tip_pose(q)
        return objective.error(q, tip_pose, now.reference, k * PERIOD)

    simulation = Simulation(model)
    simulation.reset(now.q, now.q_dot)
    present = error(now.q, 0)
    cost = 0.0
    for k, tension in enumerate(plan, 1):
        simulation.step(tension, PERIOD)
        left = error(simulation.state.q, k) - np.exp(-4.0 * k * PERIOD / settling_time) * present
        cost += 0.5 * left @ left
    return cost


class LateShape(Shape):
    """A shape whose error counts the more the later it is: once now, twice a period later."""

    def error(self, q, tip_pose, reference, time):
        weight = 1.0 + time / PERIOD
        error = super().error(q, tip_pose, reference, time)
        return weight * error

    def linear_error(self, posture):
        error, jacobian = super().linear_error(posture)
        weight = 1.0 + posture.ahead / PERIOD
        return LinearError(error, weight * jacobian)


SLOPES = {**OBJECTIVES, "shape": LateShape}


# late errors tell whether every slope is that of its own time
@pytest.mark.parametrize(
    "kind",
    ["shape", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("pose", "position"))],
)
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2))]
)
def test_the_plan_improves_along_the_slope_of_the_simulation(model, kind, holding, seed):
    """The Jacobians of a rollout are not those of the simulation: the slopes agree within a tenth.
    The inputs may err."""
    now = near(model, holding, seed)
    objective = SLOPES[kind](model)
    controller = Predictive(model, WIDE, PERIOD, objective)
    simulation = Simulation(model)
    plan = np.tile(now.tension, (controller.horizon, 1))
    error = InputError(
        1.0 + 0.2 * seed * np.cos(np.arange(10.0)), 0.5 * seed * np.sin(np.arange(10.0))
    )
    simulation.reset(now.q, now.q_dot)
    _, gradient = controller._program(
        simulation.rollout(error.gain * plan + error.offset, PERIOD), error.gain, now
    )
    apart = 0.05
    slope = []
    for unit in np.eye(plan.size):
        aside = apart * unit.reshape(plan.shape)
        costs = [
            predicted_cost(model, objective, now, error.gain * (plan + sign * aside) + error.offset)
            for sign in (1.0, -1.0)
        ]
        slope.append((costs[0] - costs[1]) / (2.0 * apart))
    off = np.linalg.norm(gradient - slope) / np.linalg.norm(slope)
    assert off < 0.1


@pytest.mark.parametrize("kind", OBJECTIVES)
def test_the_plan_that_is_remembered_is_better_than_holding_on(model, kind, holding):
    now = near(model, holding, 0)
    objective = OBJECTIVES[kind](model)
    better = Predictive(model, WIDE, PERIOD, objective).act(now).memory.tension
    held = np.tile(now.tension, (len(better), 1))
    before = predicted_cost(model, objective, now, held)
    after = predicted_cost(model, objective, now, better)
    assert after < 0.7 * before


@pytest.mark.parametrize(("hold", "has_begun"), [(1, False), (3, False), (1, True)])
def test_the_plan_is_the_least_of_errors_efforts_and_changes(model, holding, hold, has_begun):
    """Of the linearised errors, the squares of the tensions and those of their changes from the
    last tensions on, by their weights; measured by what a tension does to the task. Also where the
    plan before changes from period to period."""
    now = near(model, holding, 1)
    tuning = Tuning(horizon=4, hold=hold, effort=0.1, smoothness=0.3)
    controller = Predictive(model, WIDE, PERIOD, TipPosition(), tuning)
    simulation = Simulation(model)
    simulation.reset(now.q, now.q_dot)
    plan = np.tile(now.tension, (4, 1))
    memory = None
    if has_begun:
        waves = np.sin(np.arange(40.0))
        planned = plan + waves.reshape(4, 10)
        no_response = np.zeros((10, 10))
        memory = Plan(planned, np.zeros(40), np.zeros(10), no_response, None, None)
        plan = controller._continued(now.tension, memory)
    rollout = simulation.rollout(plan, hold * PERIOD)
    hessian, gradient = controller._program(rollout, np.ones(10), now)
    unit = np.trace(hessian) / plan.size
    better = controller.act(now, memory).memory.tension

    def cost(tensions):
        step = (tensions - plan).ravel()
        changes = np.diff(tensions, axis=0, prepend=now.tension[None])
        weighted = 0.1**2 * np.sum(tensions**2) + 0.3**2 * np.sum(changes**2)
        return 0.5 * step @ hessian @ step + gradient @ step + 0.5 * unit * weighted

    rng = np.random.default_rng(0)
    least = cost(better)
    for size in (1e-3, 0.1):
        for _ in range(10):
            aside = size * rng.normal(size=plan.shape)
            # a least of a quadratic: both sides cost more, by as much
            more = cost(better + aside) - least
            less = cost(better - aside) - least
            assert more == pytest.approx(less, rel=1e-3)
            assert more > 0.0


def test_bounds_hold_for_the_whole_plan(model, holding, drive):
    limits = np.tile([2.0, 9.0], (10, 1))
    target = holding(model, np.linspace(-10.0, 20.0, 10))
    controller = Predictive(model, limits, PERIOD, Shape(model))
    motion = drive(controller, model, target, 20)
    plan = motion.memory.tension
    assert plan.shape == (controller.horizon, 10)
    assert plan.min() == pytest.approx(2.0)
    assert plan.max() == pytest.approx(9.0)
    assert 0.0 < motion.reports[-1]["limited"] <= 1.0


@pytest.mark.parametrize("hold", [1, 3])
def test_plans_change_no_faster_than_the_actuators(model, holding, hold):
    """By the change of a period at first, and of an interval from one to the next; both are
    reached, on the way to a target that is far."""
    target = holding(model, np.linspace(0.0, 25.0, 10))
    q = model.rest_coordinates(np.full(10, 10.0))
    most = np.linspace(0.2, 0.6, 10)
    now = ControllerInput(
        q, 0.0 * q, model.tip_pose(q), np.full(10, 10.0), target, greatest_change=most
    )
    tuning = Tuning(horizon=4, hold=hold)
    decision = Predictive(model, WIDE, PERIOD, Shape(model), tuning).act(now)
    plan = np.vstack([now.tension, decision.memory.tension])
    changes = np.abs(np.diff(plan, axis=0))
    allowed = np.stack([most, *(3 * [hold * most])])
    assert (changes <= allowed * (1.0 + 1e-6)).all()
    assert decision.report["singular"] == 0.0
    assert np.isclose(changes, allowed, rtol=1e-6).sum() > 10


def test_a_limit_that_is_never_reached_changes_no_plan(model, holding):
    now = near(model, holding, 0)
    free = Predictive(model, WIDE, PERIOD, TipPosition()).act(now)
    loose = now._replace(greatest_change=np.full(10, 1e3))
    limited = Predictive(model, WIDE, PERIOD, TipPosition()).act(loose)
    np.testing.assert_allclose(limited.tension, free.tension, atol=1e-7)


@pytest.mark.parametrize(
    ("surprise", "spread", "factor"),
    [
        (0.5, 0.0, 1.0),
        (1.0, 0.0, 1.0),
        (1.5, 0.0, 6.0),
        (1.0, 0.01, 3.0),
        (2.0, 0.02, 55.0),
        (9.0, 0.0, 11.0),
    ],
)
def test_a_plan_is_smoother_where_an_estimator_doubts(model, holding, surprise, spread, factor):
    """Where innovations surprise it, or the timing is uncertain: as with so much more weight."""
    now = near(model, holding, 2)
    tuning = DEFAULT._replace(smoothness=factor * DEFAULT.smoothness)
    expected = Predictive(model, WIDE, PERIOD, TipPosition(), tuning).act(now)
    doubted = now._replace(surprise=surprise, timing_spread=spread)
    decision = Predictive(model, WIDE, PERIOD, TipPosition()).act(doubted)
    np.testing.assert_allclose(decision.memory.tension, expected.memory.tension, rtol=1e-9)


@pytest.mark.parametrize(
    ("bending", "change", "hold", "factor"),
    [
        (0.0, None, 1, 1.0),
        (0.5, None, 1, 2.5),
        (3.0, None, 1, 4.0),
        (1.0, 20.0, 1, 1.3),
        (1.0, 20.0, 2, 1.6),
        (1.0, 1e3, 1, 4.0),
    ],
)
def test_a_plan_that_may_jump_is_smoother_under_loads(
    model, holding, monkeypatch, bending, change, hold, factor
):
    """The more they bend the arm, up to a radian, and the larger a share of the widest range
    tensions may change by in an interval."""
    loaded = near(model, holding, 2)._replace(force_error=loads_that_bend(model, bending))
    if change is not None:
        changes = np.full(10, change)
        changes[6] = 0.5 * change
        loaded = loaded._replace(greatest_change=changes)
    limits = WIDE.copy()
    limits[3] = [0.0, 30.0]
    tuning = DEFAULT._replace(hold=hold)
    decision = Predictive(model, limits, PERIOD, TipPosition(), tuning).act(loaded)
    monkeypatch.setattr(predictive, "LOADED", 0.0)
    smoother = tuning._replace(smoothness=factor * DEFAULT.smoothness)
    expected = Predictive(model, limits, PERIOD, TipPosition(), smoother).act(loaded)
    np.testing.assert_allclose(decision.memory.tension, expected.memory.tension, rtol=1e-9)


@pytest.mark.parametrize("hold", [1, 2])
@pytest.mark.parametrize(
    ("bending", "size"),
    [(0.0, 0.5), (1.0, 0.0), (1.0, 0.05), (0.1, 0.5), (1.0, 0.3), (2.0, 0.3), (2.0, 1.0)],
)
def test_under_loads_far_errors_fall_at_a_constant_speed(
    build, limits_of, holding, bending, size, hold
):
    """At that of near ones, which fall exponentially; the less loads bend the arm, the farther
    these reach. Sizes are shares of the length."""
    model = build("three_tendon")
    limits = limits_of(model)
    controller = Predictive(model, limits, PERIOD, TipPosition(), DEFAULT._replace(hold=hold))
    rest = np.zeros(model.coordinate_count)
    none = np.zeros(model.tendon_count)
    target = holding(model, none)
    now = ControllerInput(rest, rest, model.tip_pose(rest), none, target)
    now = now._replace(force_error=loads_that_bend(model, bending))
    shares = controller._shares_left(size * model.length, now)

    greatest_near = np.inf
    if bending:
        greatest_near = 0.075 / bending
    rate = 4.0 / DEFAULT.settling_time
    first = max(size, 1e-9)
    left = first
    steps = 1000
    expected = []
    for _ in range(controller.horizon):
        for _ in range(steps):
            left -= rate * min(left, greatest_near) * hold * PERIOD / steps
        expected.append(left / first)
    np.testing.assert_allclose(shares, expected, rtol=0.03)


def test_plans_to_far_targets_are_slower_under_loads_whatever_objectives_weigh(
    model, holding, monkeypatch
):
    loaded = near(model, holding, 2)._replace(force_error=loads_that_bend(model, 1.0))
    away = loaded.reference.tip_position + np.array([0.0, 0.3, 0.2])
    far = loaded._replace(reference=loaded.reference._replace(tip_position=away))
    sizes = []
    shares_left = Predictive._shares_left

    def watched(controller, size, now):
        sizes.append(size)
        return shares_left(controller, size, now)

    monkeypatch.setattr(Predictive, "_shares_left", watched)

    def planned(now, weight=1.0):
        return Predictive(model, WIDE, PERIOD, TipPosition(weight)).act(now).memory.tension

    slow, weighted = planned(far), planned(far, 10.0)
    np.testing.assert_allclose(slow, weighted, rtol=1e-6, atol=1e-6)
    distance = np.linalg.norm(away - far.tip_pose[:3, 3])
    np.testing.assert_allclose(sizes, distance, rtol=1e-9)
    monkeypatch.setattr(predictive, "FAR", 1e9)
    bold = planned(far)
    # by how much the first tensions change
    assert np.ptp(slow[0] - far.tension) < 0.9 * np.ptp(bold[0] - far.tension)


@pytest.mark.parametrize(
    ("hold", "expected"),
    [(1, [1.0, 2.0, 2.0]), (2, [0.5, 1.5, 2.0]), (4, [0.25, 1.25, 2.0])],
)
def test_a_plan_goes_on_by_a_period_a_period(model, hold, expected):
    """Where its intervals last two, tensions are half those of the next interval; its end is held
    on."""
    tuning = Tuning(horizon=3, hold=hold)
    controller = Predictive(model, WIDE, PERIOD, TipPosition(), tuning)
    alike = np.ones(10)
    tension = np.outer([0.0, 1.0, 2.0], alike)
    multipliers = np.zeros(30)
    response = np.zeros((10, 10))
    memory = Plan(tension, multipliers, 0.0 * alike, response, None, None)
    continued = controller._continued(alike, memory)
    expected_continued = np.outer(expected, alike)
    np.testing.assert_allclose(continued, expected_continued)
    assert tuning.looks_ahead == 3 * hold + 1


def test_displaced_measurements_are_followed(model, holding):
    """The same tensions as for a target that is displaced the other way."""
    now = near(model, holding, 1)
    step = np.array([0.01, -0.02, 0.03])
    measured = now.tip_pose.copy()
    measured[:3, 3] += step
    position = now.reference.tip_position - step
    moved = Reference(now.reference.ahead, tip_position=position)
    controller = Predictive(model, WIDE, PERIOD, TipPosition())
    beside = controller.act(now._replace(tip_pose=measured)).tension
    of_moved = controller.act(now._replace(reference=moved)).tension
    np.testing.assert_allclose(beside, of_moved, rtol=1e-9)
    assert np.abs(beside - controller.act(now).tension).max() > 0.1


def test_the_observer_takes_a_share_of_what_tensions_explain(model, random_state):
    """Rates that a constant tension too many would have made: of that tension the share."""
    q, q_dot = random_state(model, 0)
    controller = Predictive(model, WIDE, PERIOD, TipPosition(), Tuning(observer=0.4))
    inertia = implicit_inertia(model.terms(q, 0.0 * q), PERIOD)
    rng = np.random.default_rng(0)
    actuation = rng.normal(size=(10, 10))
    response = np.linalg.solve(inertia, actuation)
    before, unknown = rng.normal(size=(2, 10))
    memory = Plan(np.zeros((6, 10)), np.zeros(60), before, response, q_dot, None)
    reference = Reference(np.zeros(1))
    rates = q_dot + response @ unknown
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, rates, tip_pose, np.zeros(10), reference)
    disturbance = controller._observe(memory, now)
    expected_disturbance = before + 0.4 * unknown
    np.testing.assert_allclose(disturbance, expected_disturbance, rtol=1e-6)
    unpredicted = memory._replace(rates=None)
    kept = controller._observe(unpredicted, now)
    np.testing.assert_array_equal(kept, before)


@pytest.mark.parametrize("hold", [1, 2])
def test_what_a_period_s_tension_does_is_remembered(model, holding, hold):
    """Against differences of the simulation, whatever an interval of the plan lasts."""
    now = near(model, holding, 2)
    simulation = Simulation(model)
    ends = []
    for sign in (1.0, -1.0):
        simulation.reset(now.q, now.q_dot)
        simulation.step(now.tension + sign * np.eye(10)[3], PERIOD)
        ends.append(simulation.state.q_dot)
    slope = (ends[0] - ends[1]) / 2.0
    controller = Predictive(model, WIDE, PERIOD, TipPosition(), Tuning(hold=hold))
    response = controller.act(now).memory.response[:, 3]
    distance = np.linalg.norm(response - slope)
    assert distance < 0.15 * np.linalg.norm(slope)


@pytest.mark.parametrize("hold", [1, 2])
def test_actuators_that_lag_are_allowed_for_in_what_is_predicted(model, holding, hold):
    """For a period, whatever an interval of the plan lasts."""
    acting = np.linspace(5.0, 12.0, 10)
    now = near(model, holding, 2)._replace(actuators=LaggingActuators(0.04, acting))
    controller = Predictive(model, WIDE, PERIOD, TipPosition(), Tuning(hold=hold))
    decision = controller.act(now)
    asked = decision.memory.tension[0]
    left = 2.0 * -np.expm1(-0.5)  # of the mean, by what acts when the period begins
    simulation = Simulation(model)
    simulation.reset(now.q, now.q_dot)
    simulation.step(asked + left * (acting - asked), PERIOD)
    np.testing.assert_allclose(decision.memory.rates, simulation.state.q_dot, rtol=1e-6, atol=1e-9)


def test_an_observer_finds_nothing_in_a_quick_arm_at_rest(build, holding, drive, limits_of):
    """Of intervals as long as half of its vibration: what a period does is no half of what they
    do, and an observer that took it for that swung up from round-off."""
    model = build("catheter")
    controller = Predictive(model, limits_of(model), PERIOD, TipPosition(), Tuning(hold=2))
    motion = drive(controller, model, holding(model, [5.0, 2.5, 0.0, 0.0]), 150)
    assert max(report["disturbance"] for report in motion.reports) < 1e-9
    np.testing.assert_allclose(motion.tension[-1], motion.tension[-50], atol=1e-3)


def test_predictive_control_that_is_told_of_the_inputs_needs_no_observer(model, holding, drive):
    """Also where gain and offset pass the limits; a wrong word leaves an error."""
    error = InputError(1.0 + 0.2 * np.cos(np.arange(10.0)), 1.5 * np.sin(np.arange(10.0)))
    nothing = InputError(np.ones(10), np.zeros(10))
    target = holding(model, 12.0 + 4.0 * np.sin(np.arange(10.0)))
    off = []
    for told in (error, nothing):
        controller = Predictive(model, WIDE, PERIOD, TipPose(0.1))
        controller.act = lambda now, memory, act=controller.act, told=told: act(
            now._replace(input_error=told), memory
        )
        motion = drive(
            controller, model, target, 50, act=lambda tension: error.gain * tension + error.offset
        )
        off.append(np.linalg.norm(motion.tip[-1, :3, 3] - target.tip_position[0]))
    assert off[0] < 1e-4
    assert off[1] > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("hold", [1, 2])
def test_constant_disturbances_are_found_and_allowed_for(model, holding, drive, hold):
    """Two newtons too many in every tendon: found, and the target is held all the same."""
    target = holding(model, 12.0 + 3.0 * np.sin(np.arange(10.0)))
    off = {}
    for observer in (0.25, 0.0):
        controller = Predictive(
            model, WIDE, PERIOD, TipPose(0.1 * model.length), Tuning(observer=observer, hold=hold)
        )
        motion = drive(controller, model, target, 150, act=lambda tension: tension + 2.0)
        off[observer] = (
            np.linalg.norm(motion.tip[-1, :3, 3] - target.tip_position[0]) / model.length
        )
        found = motion.memory.disturbance
        np.testing.assert_allclose(found, 2.0 if observer else 0.0, atol=0.1)
        largest = np.abs(found).max()
        assert motion.reports[-1]["disturbance"] == largest
    assert off[0.25] < 1e-3


@pytest.mark.parametrize("kind", LATE)
def test_what_is_predicted_is_what_happens(build, kind):
    """Rates and internal states of the next period, by a controller that has followed the arm from
    the beginning to a target."""
    changes = {"quadrature.intervals": 6, **LATE[kind]}
    model = build("three_tendon", changes)
    simulation, controller = (
        Simulation(model),
        Predictive(model, np.tile([0.0, 5.0], (3, 1)), PERIOD, TipPosition()),
    )
    target = simulation.tip_pose[None, :3, 3] + [-0.01, 0.03, 0.02]
    memory = None
    tension = np.zeros(3)
    for _ in range(25):
        state = simulation.state
        reference = Reference(np.zeros(1), tip_position=target)
        decision = controller.act(
            ControllerInput(
                state.q, state.q_dot, simulation.tip_pose, tension, reference, state.time
            ),
            memory,
        )
        memory = decision.memory
        tension = decision.tension
        simulation.step(
            tension + memory.disturbance, PERIOD
        )  # what the controller takes for granted
        np.testing.assert_allclose(
            memory.rates, simulation.state.q_dot, atol=1e-6 * np.abs(simulation.state.q_dot).max()
        )
        np.testing.assert_allclose(memory.effects, simulation.state.effects, atol=1e-9)
    assert np.abs(memory.disturbance).max() < 1e-3


@pytest.mark.parametrize(
    ("controller", "greatest"),
    [
        pytest.param("tracking", 5e-4, marks=pytest.mark.slow),
        ("predictive", 1e-3),
    ],
)
def test_controllers_of_tensions_move_elastic_tendons(controller, greatest):
    """Displacements are made of the tensions that they decide on: two episodes of 3 s, the first
    second left out."""
    options = observation_options(controller, "TipPose")
    env = gym.make(
        "TendonRod-TipPose-v0",
        scene=CABLES,
        fidelity="fast",
        max_episode_steps=150,
        target="random",
        **options,
    )
    assert (
        summarise(evaluate(make_policy(controller, env), env, [1, 2])).errors["position_error"].rms
        < greatest
    )
