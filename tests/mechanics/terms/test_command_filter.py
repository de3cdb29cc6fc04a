"""The filter of commands against closed forms of lag and limited rate, and against a plain list of
commands on their way."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from soft_tendon_env.mechanics.effects import DIRECT
from soft_tendon_env.mechanics.terms.command_filter import (
    HAS_ROOM,
    IS_FULL,
    LAGS,
    NEVER,
    SETTLED,
    Arrival,
    command_at,
    filter_state,
    follow,
    lag_response,
    lag_slopes,
    limited_time,
    receive,
    rest_filter,
    settling_time,
)
from soft_tendon_env.mechanics.workspace import sizes_of, zeros

pytestmark = pytest.mark.no_jit

PATHS = {
    "lag": DIRECT.replaced(lags=1, time_constant=0.05),
    "rate": DIRECT.replaced(lags=1, rate_limit=20.0),
    "both": DIRECT.replaced(lags=1, time_constant=0.05, rate_limit=20.0),
}
U = 1.0
SMALL = 1.4
LARGE = 4.0
"""A tension, and commands near it, at which the rate stays below its limit, and far from it."""


def exact(path, u, c, time):
    """The solution of u_dot = clip((c - u) / tau, -r, r)."""
    if time == 0.0:
        return u
    away = abs(c - u)
    sign = np.sign(c - u)
    if path.time_constant:
        slow = path.rate_limit * path.time_constant
    else:
        slow = 0.0
    corner = max(away - slow, 0.0) / path.rate_limit
    if time <= corner:
        return u + sign * path.rate_limit * time
    rest = min(away, slow)
    if path.time_constant:
        left = math.exp(-(time - corner) / path.time_constant)
    else:
        left = 0.0
    return c - sign * rest * left


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("command", [SMALL, LARGE, -SMALL, -LARGE, U])
@pytest.mark.parametrize("time", [0.0, 0.003, 0.06, 0.12, 0.5])
def test_the_response_is_the_solution_of_the_lag(name, command, time):
    """In one step or in two."""
    path = PATHS[name]
    whole = lag_response(path, U, command, time)
    expected_whole = exact(path, U, command, time)
    assert whole == pytest.approx(expected_whole, rel=1e-12)
    half = lag_response(path, U, command, 0.4 * time)
    assert lag_response(path, half, command, 0.6 * time) == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("command", [SMALL, LARGE, -LARGE])
@pytest.mark.parametrize("time", [0.03, 0.11, 0.4])
def test_slopes_are_those_of_the_response_and_of_its_mean(name, command, time):
    path = PATHS[name]
    h = 1e-6
    left, mean = lag_slopes(path, command - U, time)

    def mean_from(u):
        corner = limited_time(path, command - u, time)[0]
        return quad(
            lambda t: lag_response(path, u, command, t), 0.0, time, points=[corner], epsabs=1e-13
        )[0]

    ahead = lag_response(path, U + h, command, time)
    behind = lag_response(path, U - h, command, time)
    expected_left = (ahead - behind) / (2 * h)
    assert left == pytest.approx(expected_left, abs=1e-8)
    change = mean_from(U + h) - mean_from(U - h)
    slope = change / (2 * h * time)
    assert mean == pytest.approx(slope, abs=1e-6)
    assert lag_slopes(DIRECT, 1.0, 0.1) == (1.0, 0.0)


def test_steps_end_at_the_next_kink_of_a_tension():
    """The end of a limited rate; time constants while it lags; nothing where it has arrived."""
    path = PATHS["both"].replaced(finest=1e-3)
    slow = 20.0 * 0.05
    begin = np.array([0.0, 0.0])
    end = np.array([3.0, 5.0])
    far = settling_time(path, begin, end)
    expected_far = (3.0 - slow) / 20.0
    assert far == pytest.approx(expected_far)
    begin_near = np.array([0.0, 5.0])
    end_near = np.array([0.9, 5.0])
    lagging = settling_time(path, begin_near, end_near)
    assert lagging == pytest.approx(LAGS * 0.05)
    near = 5.0 * SETTLED
    almost = np.array([5.0 - 0.99 * near])
    assert settling_time(path, np.array([5.0]), almost) == math.inf
    beyond = np.array([5.0 - 1.01 * near])
    assert settling_time(path, np.array([5.0]), beyond) < math.inf
    target = np.array([slow + 1e-6])
    just_beyond = settling_time(path, np.array([0.0]), target)
    assert just_beyond == 1e-3


DELAY = 0.05
PERIOD = 0.02


@pytest.fixture
def delayed(build):
    """Effects of actuators with a delay of two and a half steps of 20 ms, a state at rest under a
    command, and where what arrives is written."""
    changes = {"quadrature.intervals": 2, "effects.actuators.delay": DELAY}
    arm = build("three_tendon", changes).arm
    state = arm.effects.state.copy()
    rest_filter(arm.effects, np.full(3, 9.0), state)
    return arm.effects, state, zeros(Arrival, sizes_of(arm))


def test_commands_act_a_delay_after_they_were_given(delayed):
    """And the next step ends where another one arrives: against a list of all of them."""
    effects, state, arrival = delayed
    rng = np.random.default_rng(0)
    commands = rng.uniform(0.0, 5.0, (12, 3))
    commands[5] = commands[4]  # what repeats the one before it ends no step
    commands[7] = commands[6]
    given = [(-math.inf, np.full(3, 9.0))]
    for k, command in enumerate(commands):
        time = k * PERIOD
        given.append((time + DELAY, command))
        for part in (0.0, 0.3, 0.5, 0.9):
            now = time + part * PERIOD
            receive(effects, command, part == 0.0, now, state, arrival)
            assert arrival.queue[0] == HAS_ROOM
            arrived_commands = [c for arrived, c in given if arrived <= now + 1e-9]
            acting = arrived_commands[-1]
            np.testing.assert_array_equal(arrival.command, acting)
            changes = [
                arrived
                for (arrived, c), (_, before) in zip(given[1:], given, strict=False)
                if arrived > now + 1e-9 and (c != before).any()
            ]
            expected = min(changes, default=math.inf)
            assert arrival.until[0] == pytest.approx(expected, abs=1e-12)


def test_more_commands_than_there_is_room_for_are_told(delayed):
    """Those that repeat the one before them give way first."""
    effects, state, arrival = delayed
    _, table = filter_state(effects, state, 3)
    room = len(table) - 1
    assert room == math.ceil(DELAY / PERIOD) + 1
    for k in range(3):
        first = np.full(3, 1.0)
        receive(effects, first, True, 1e-3 * k, state, arrival)
    for k in range(room - 1):
        command = np.full(3, 2.0 + k)
        time = 0.01 + 1e-3 * k
        receive(effects, command, True, time, state, arrival)
        assert arrival.queue[0] == HAS_ROOM
    later = 2.0 + np.arange(room - 1)
    np.testing.assert_array_equal(table[1:, 1], [1.0, *later])
    receive(effects, np.full(3, 7.0), True, 0.02, state, arrival)
    assert arrival.queue[0] == IS_FULL


def test_what_has_arrived_leaves_the_table_in_order(delayed):
    effects, state, arrival = delayed
    _, table = filter_state(effects, state, 3)
    for k in range(3):
        command = np.full(3, 1.0 + k)
        receive(effects, command, True, 0.01 * k, state, arrival)
    times = 0.01 * np.arange(3)
    np.testing.assert_allclose(table[1:4, 0], DELAY + times)
    receive(effects, np.zeros(3), False, DELAY + 0.011, state, arrival)
    np.testing.assert_array_equal(arrival.command, 2.0)
    assert table[1, 0] == pytest.approx(DELAY + 0.02)
    assert (table[2:, 0] == NEVER).all()


def test_a_lag_follows_what_has_arrived(build):
    actuators = {"time_constant": 0.05, "rate_limit": 20.0}
    changes = {"quadrature.intervals": 2, "effects.actuators": actuators}
    arm = build("three_tendon", changes).arm
    state = arm.effects.state.copy()
    out = np.empty(3)
    rest_filter(arm.effects, np.array([1.0, 2.0, 3.0]), state)
    np.testing.assert_array_equal(state[:3], [1.0, 2.0, 3.0])
    path = arm.effects.transmission
    target = np.array([4.0, 2.0, 2.8])
    acting = command_at(arm.effects, target, state, 0.1, out).copy()
    pairs = zip([1.0, 2.0, 3.0], target, strict=True)
    expected = [exact(path, u, c, 0.1) for u, c in pairs]
    np.testing.assert_allclose(acting, expected, rtol=1e-12)
    follow(arm.effects, target, 0.1, state)
    np.testing.assert_array_equal(state[:3], acting)
