"""From actions to tensions, and commands on their way: elastic tendons, actuators that lag and are
late, friction, states in mid-delay."""

import numpy as np
import pytest

from soft_tendon_env.envs import TipPoseEnv
from soft_tendon_env.envs.actuation import ActionScale, Actuation
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.model.statics import commanded_equilibrium
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
LIMITS = np.array([-0.002, 0.012])  # [m]


def tension_after(env, *actions):
    env.reset(seed=0)
    for action in actions:
        env.step(action)
    return env.episodes.tension[0]


def test_tensions_go_from_limit_to_limit():
    env = TipPoseEnv(**SMALL, action="tension")
    np.testing.assert_array_equal(tension_after(env, [-1.0, 0.0, 1.0]), [0.0, 2.5, 5.0])
    np.testing.assert_array_equal(tension_after(env, [-7.0, 0.5, 7.0]), [0.0, 3.75, 5.0])  # clipped
    env = TipPoseEnv(**SMALL, action="tension", tension_limits=[-1.0, 3.0])
    np.testing.assert_allclose(tension_after(env, [-1.0, 0.0, 1.0]), [-1.0, 1.0, 3.0])


@pytest.mark.parametrize(
    ("limits", "start"),
    [([0.0, 5.0], 0.0), ([-2.0, 5.0], 0.0), ([1.0, 5.0], 1.0), ([-5.0, -1.0], -1.0)],
)
@pytest.mark.parametrize("action", ["tension", "increment"])
def test_episodes_begin_at_rest_under_the_tension_nearest_to_zero(limits, start, action):
    env = TipPoseEnv(
        **SMALL, tension_limits=limits, action=action, observation=["last_action", "rates"]
    )
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(env.episodes.tension[0], start)
    begun = env.episodes.arms.reading.tip_pose[0].copy()
    if action == "increment":
        still = np.zeros(3)
    else:
        still = observation[:3].astype(float)
    assert action == "increment" or np.allclose(
        limits[0] + 0.5 * np.ptp(limits) * (still + 1.0), start, atol=1e-6
    )
    assert not observation[env.episodes.layout.slices["rates"]].any()
    for _ in range(5):
        env.step(still)
    np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], begun, atol=1e-7)


def test_increments_add_up_within_their_rate_and_the_limits():
    env = TipPoseEnv(**SMALL, tension_rate=50.0)  # 1 N a step
    np.testing.assert_allclose(tension_after(env, [1.0, 0.5, -1.0]), [1.0, 0.5, 0.0])
    np.testing.assert_allclose(
        tension_after(env, [1.0, 0.5, -1.0], [1.0, 0.5, 1.0]), [2.0, 1.0, 1.0]
    )  # no wind-up at the limit
    actions = [[9.0, 0.1, 0.0]] * 7
    np.testing.assert_allclose(tension_after(env, *actions), [5.0, 0.7, 0.0])
    ups = [[1.0] * 3] * 9
    np.testing.assert_allclose(tension_after(env, *ups, [-1.0] * 3), 4.0)
    np.testing.assert_array_equal(tension_after(env), 0.0)


def test_an_action_that_is_held_leads_to_the_equilibrium_of_its_displacements():
    springs = {
        "scene": "three_tendon",
        "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": LIMITS.tolist()},
    }
    env = TipPoseEnv(scene=springs, fidelity="fast", action="tension")
    env.reset(seed=0)
    action = np.array([0.5, -1.0, -1.0])
    for _ in range(1000):
        env.step(action)
    found, tension = commanded_equilibrium(
        env.model, LIMITS[0] + 0.5 * np.ptp(LIMITS) * (action + 1.0)
    )
    np.testing.assert_allclose(env.episodes.arms.reading.tip_pose[0], found.tip_pose, atol=1e-6)
    np.testing.assert_allclose(env.episodes.tension[0], tension, atol=1e-3)
    assert tension.max() > 0.5, "one is slack"
    assert tension.min() == 0.0, "one is slack"


LEAST = np.array([-1.0, 0.0, 2.0])  # [N]
GREATEST = np.array([3.0, 5.0, 4.0])  # [N]
BEFORE = np.array([0.0, 1.0, 3.0])


def test_actions_of_tensions_are_shares_of_their_range_and_back():
    scale = ActionScale(LEAST, GREATEST, None)
    action = np.array([-1.0, 0.5, 0.0])
    command = scale.command(action, BEFORE)
    np.testing.assert_allclose(command, [-1.0, 3.75, 3.0])
    np.testing.assert_allclose(scale.action(command, BEFORE), action, atol=1e-15)
    beyond_range = scale.action(np.array([-9.0, 9.0, 3.5]), BEFORE)
    np.testing.assert_array_equal(beyond_range, [-1, 1, 0.5])
    # actions beyond [-1, 1] ask for more than commands that are sent
    beyond = np.array([-2.0, 2.0, 0.0])
    np.testing.assert_allclose(scale.wanted(beyond, BEFORE), [-3.0, 7.5, 3.0])
    np.testing.assert_allclose(scale.command(beyond, BEFORE), [-1.0, 5.0, 3.0])


def test_actions_of_increments_are_changes_within_the_limits_and_back():
    increments = np.array([0.5, 2.0, 1.0])
    scale = ActionScale(LEAST, GREATEST, increments)
    action = np.array([-1.0, 0.5, 1.0])
    command = scale.command(action, BEFORE)
    np.testing.assert_allclose(command, [-0.5, 2.0, 4.0])
    action_back = scale.action(command, BEFORE)
    np.testing.assert_allclose(action_back, action)
    far_command = np.array([3.0, 1.0, 2.0])
    clipped_action = scale.action(far_command, BEFORE)
    np.testing.assert_array_equal(clipped_action, [1.0, 0.0, -1.0])
    beyond = np.array([-3.0, 0.0, 1.5])
    np.testing.assert_allclose(scale.wanted(beyond, BEFORE), [-1.5, 1.0, 4.5])
    np.testing.assert_allclose(scale.command(beyond, BEFORE), [-1.0, 1.0, 4.0])


def test_commands_change_no_faster_than_the_actuators_let_them():
    """Whatever is asked for, within the limits too; increments within the rate are as they were."""
    most = np.array([0.25, 0.5, 3.0])
    scale = ActionScale(LEAST, GREATEST, None, most)
    highest = scale.command(np.ones(3), BEFORE)
    np.testing.assert_allclose(highest, [0.25, 1.5, 4.0])
    lowest = scale.command(-np.ones(3), BEFORE)
    np.testing.assert_allclose(lowest, [-0.25, 0.5, 2.0])
    near_command = np.array([0.1, 0.8, 3.5])
    near = scale.action(near_command, BEFORE)
    np.testing.assert_allclose(scale.command(near, BEFORE), near_command)
    increment = np.array([0.25, 0.3, 0.1])
    limited = ActionScale(LEAST, GREATEST, increment, most)
    free = ActionScale(LEAST, GREATEST, increment)
    for action in (np.ones(3), -np.ones(3), np.array([0.3, -0.7, 0.1])):
        expected = free.command(action, BEFORE)
        np.testing.assert_array_equal(limited.command(action, BEFORE), expected)


def actuation(rows=2, action="tension", share=1.0, limits=None, **randomize):
    """Rows of actuators of three tendons, at a control period of 20 ms in four steps."""
    options = Options(scene="three_tendon", action=action, randomize=Randomization(**randomize))
    if limits is None:
        limits = np.stack([LEAST, GREATEST], axis=1)
    greatest_share = share * np.ones(3)
    return Actuation(options, limits, BEFORE, greatest_share, rows, 4)


def test_increments_are_those_of_the_rate_over_a_period():
    """100 N/s over 20 ms, as a share of a range of another unit."""
    assert actuation(action="increment", share=0.25).actions.increment == pytest.approx([0.5] * 3)
    assert actuation(action="tension").actions.increment is None


def test_drawn_actuators_err_within_their_ranges_and_are_told():
    ranges = {"tension_gain": (0.8, 1.2), "tension_offset": (-0.4, 0.2), "latency": (0.01, 0.05)}
    rows = 60
    actuators = actuation(rows, share=0.5, **ranges)
    assert actuators.imperfect
    for row in range(rows):
        actuators.begin(row, np.random.default_rng(row), BEFORE)
    for name, (least, greatest) in ranges.items():
        drawn_values = [actuators.drawn(row)[name] for row in range(rows)]
        values = np.array(drawn_values)
        assert values.min() >= least
        assert values.max() <= greatest
        assert np.ptp(values) > 0.8 * (greatest - least)
    shares = actuators.shares()
    assert shares.shape == (rows, 7)
    told = actuators.drawn(5)
    gain_share = (told["tension_gain"] - 0.8) / 0.4
    offset_share = (told["tension_offset"] + 0.4) / 0.6
    expected = [*gain_share, *offset_share]
    latency_share = (told["latency"] - 0.01) / 0.04
    np.testing.assert_allclose(shares[5], [*expected, latency_share])
    command = np.array([1.0, 2.0, 3.0])
    acting = actuators.acting(command, 5)
    np.testing.assert_allclose(
        acting, told["tension_gain"] * command + 0.5 * told["tension_offset"]
    )
    np.testing.assert_allclose(actuators.commanded(acting, 5), command)


def test_what_is_exact_has_nothing_to_tell():
    actuators = actuation()
    actuators.begin(0, np.random.default_rng(0), BEFORE)
    assert not actuators.imperfect
    assert actuators.drawn(0) == {}
    assert actuators.shares().shape == (2, 0)
    np.testing.assert_array_equal(actuators.sent(0), BEFORE[None])
    assert actuators.delay(0) == 0.0


def test_tendons_that_only_pull_go_slack():
    """Others push down to their least command."""
    actuators = actuation(tension_offset=-5.0)
    actuators.begin(0, np.random.default_rng(0), BEFORE)
    np.testing.assert_array_equal(actuators.acting(np.array([0.0, 1.0, 3.0]), 0), [-1.0, 0.0, 0.0])
    no_action = np.zeros((2, 3))
    members = np.array([0, 1])
    acting, _ = actuators.apply(no_action, members)
    expected = np.tile([-1.0, 0.0, 0.0], (4, 1))
    np.testing.assert_array_equal(acting[0], expected)


@pytest.mark.parametrize(
    ("latency", "parts"),
    [(0.0075, (0.0075, 0.0125)), (0.02, (0.0, 0.02)), (0.047, (0.007, 0.013))],
)
def test_late_commands_take_over_within_a_period(latency, parts):
    """Those of rows that go on: the others keep theirs."""
    actuators = actuation(latency=latency)
    for row in range(2):
        actuators.begin(row, np.random.default_rng(row), BEFORE)
    assert actuators.delay(0) == pytest.approx(latency)
    history = [BEFORE] * 4
    for action in (0.5, -0.5, 0.25, 1.0):
        actions = np.full((2, 3), action)
        members = np.array([1])
        acting, durations = actuators.apply(actions, members)
        np.testing.assert_allclose(durations[1], parts, atol=1e-12)
        way = 0.5 * (GREATEST - LEAST) * (action + 1.0)
        history.append(LEAST + way)
        periods_late = int(latency / 0.02 + 1e-9)
        newest = len(history) - 1 - periods_late
        expected = [history[newest - 1], history[newest]]
        np.testing.assert_allclose(acting[1], expected)
        np.testing.assert_array_equal(acting[0], [BEFORE, BEFORE])
        np.testing.assert_allclose(actuators.sent(1)[-1], history[-1])
    np.testing.assert_array_equal(actuators.command[0], BEFORE)
    np.testing.assert_allclose(actuators.command[1], GREATEST)
    actuators.begin(1, np.random.default_rng(1), BEFORE)
    assert (actuators.sent(1) == BEFORE).all()


def test_commands_that_are_too_late_are_refused():
    actuation(latency=20.0)
    with pytest.raises(ConfigurationError, match="at most 1000 control periods, 20 s"):
        actuation(latency=20.5)


MEMORY = {"effects.viscoelastic_memory.branches": [{"modulus": 0.4, "relaxation_time": 0.05}]}
LAG = {"effects.actuators.time_constant": 0.03}


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({}, None),
        (LAG, None),
        (MEMORY, "viscoelastic_memory"),
        ({**LAG, **MEMORY}, "viscoelastic_memory"),
    ],
    ids=["none", "of commands", "of the motion", "of both"],
)
def test_states_that_follow_the_motion_have_no_adjoint(build, changes, refused):
    """Those that commands go through have one; what is refused is named."""
    model = build("three_tendon", changes)
    arms = Arms(model, 1, 0.02, np.zeros(0), np.zeros(0))
    if refused is None:
        arms.check_adjoint()
        return
    with pytest.raises(ValueError, match=f"effects.{refused} has internal states"):
        arms.check_adjoint()
