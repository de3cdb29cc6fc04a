"""Adjoint of the filter of commands against differences of its run."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.filter_adjoint import begin_filter, filter_adjoint, make_filter_memory
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.mechanics.terms.command_filter import lag_response, receive, rest_filter

PERIOD = 0.02
FILTERS = {
    "lag": {"time_constant": 0.03},
    "lag and rate": {"time_constant": 0.01, "rate_limit": 60.0},
    "rate": {"rate_limit": 60.0},
    "delay within a part": {"delay": 0.013},
    "delay of parts": {"delay": 0.05, "time_constant": 0.03},
    "all": {"delay": 0.007, "time_constant": 0.02, "rate_limit": 80.0},
}


def numbers_of(state):
    """Which of the internal state are numbers of tendons, of commands that there are."""
    waiting = np.repeat(state[3:].reshape(-1, 4)[:, :1] < 1e20, 4, axis=1)
    waiting[:, 0] = False
    return np.append(np.ones(3, dtype=bool), waiting.ravel())


@pytest.mark.parametrize("name", FILTERS)
def test_filter_adjoint_is_that_of_differences(name, build):
    arm = build("three_tendon", {"quadrature.intervals": 4, "effects.actuators": FILTERS[name]}).arm
    effects, memory, scratch, rng = arm.effects, make_filter_memory(arm), make_scratch(arm, 2), np.random.default_rng(0)
    start, times = effects.state.copy(), np.array([0.0, PERIOD])
    rest_filter(effects, rng.uniform(1.0, 4.0, 3), start)
    for _ in range(4):  # commands are on their way, and tensions lag
        begin_filter(effects, start, rng.uniform(1.0, 4.0, 3), times, True, scratch, memory)
        start, times = memory.state.copy(), times + PERIOD
    command = rng.uniform(1.0, 4.0, 3)
    begin_filter(effects, start, command, times, True, scratch, memory)
    of_means, of_state = rng.normal(size=(2, 3)), np.where(numbers_of(memory.state), rng.normal(size=start.size), 0.0)

    def run(start, command, count=200):
        """What the cotangents belong to, mean commands in the halves and the internal state at the end, in many steps."""
        state, mean, acting, until, step = start.copy(), np.zeros((2, 3)), np.zeros(3), np.zeros(1), PERIOD / count
        for k in range(count):
            receive(effects, command, k == 0, times[0] + k * step, state, acting, until)
            now = acting.copy()
            for i in range(3 if effects.transmission.lags else 0):
                now[i] = lag_response(effects.transmission, state[i], acting[i], 0.5 * step)
                state[i] = lag_response(effects.transmission, state[i], acting[i], step)
            mean[2 * k // count] += now / (count / 2)
        receive(effects, command, False, times[1], state, acting, until)
        return (of_means * mean).sum() + (of_state * state).sum()

    memory.force[:] = of_means
    found, by_command, move = of_state.copy(), np.zeros(3), 1e-5
    filter_adjoint(effects, start, times, True, found, by_command, memory)
    along = [(start, command + way) for way in move * np.eye(3)], [(start, command - way) for way in move * np.eye(3)]
    expected = [(run(*ahead) - run(*behind)) / (2.0 * move) for ahead, behind in zip(*along, strict=True)]
    np.testing.assert_allclose(by_command, expected, atol=5e-3)
    for i in np.flatnonzero(numbers_of(start)):
        way = move * np.eye(start.size)[i]
        assert found[i] == pytest.approx((run(start + way, command) - run(start - way, command)) / (2.0 * move), abs=5e-3)
