"""Command filter: the tensions that late and lagging actuators make of what was sent."""

import numpy as np
import pytest

from soft_tendon_env.control.command_filter import (
    Timing,
    lagged_plan,
    mean_weights,
    remembered_commands,
    weight_slopes,
    whole_periods,
)

PERIOD = 0.02
HISTORY = 12
CASES = [(0.0, 0.0), (0.0, 0.015), (0.033, 0.0), (0.02, 0.01), (0.047, 0.03)]


@pytest.mark.parametrize(
    ("delay", "whole", "rest"),
    [
        (0.0, 0, 0.0),
        (0.005, 0, 0.005),
        (0.02, 1, 0.0),
        (0.05, 2, 0.01),
        (3 * 0.02, 3, 0.0),  # 0.06 / 0.02 is less than 3 in floating point
        (0.07, 3, 0.01),
        (0.02 * (1.0 - 1e-12), 1, 0.0),
        (0.02 * (1.0 + 1e-12), 1, 0.0),
    ],
)
def test_delays_are_whole_periods_and_a_rest(delay, whole, rest):
    periods, seconds = whole_periods(delay, PERIOD)
    assert periods == whole
    assert seconds == pytest.approx(rest, abs=1e-12)
    assert seconds >= 0.0
    if rest == 0.0:
        assert seconds == 0.0


def filtered(commands, latency, lag, times, steps=20_000):
    """The tension at times from now, by many explicit steps of tau u_dot = c(t - L) - u."""
    begin = -len(commands) * PERIOD
    grid = np.linspace(begin, times[-1], steps)
    step = grid[1] - grid[0]
    index = np.floor((grid - latency - begin) / PERIOD + 1e-9).astype(int)
    arrived = commands[np.clip(index, 0, len(commands) - 1)]
    if lag == 0.0:
        return np.interp(times, grid, arrived)
    tension = np.empty_like(arrived)
    tension[0] = commands[0]
    kept = np.exp(-step / lag)
    for k in range(1, steps):
        tension[k] = arrived[k - 1] + (tension[k - 1] - arrived[k - 1]) * kept
    return np.interp(times, grid, tension)


@pytest.mark.parametrize(("latency", "lag"), CASES)
def test_means_are_those_of_the_differential_equation(latency, lag):
    """Of the last period, and of a part of the next one; and the tension now."""
    rng = np.random.default_rng(0)
    commands = rng.uniform(0.0, 5.0, HISTORY)
    timing = Timing(latency, lag)
    middles = (np.arange(400) + 0.5) / 400
    for start, duration in ((-PERIOD, PERIOD), (0.003, 0.008)):
        weights = mean_weights(timing, PERIOD, HISTORY, start, duration)
        times = start + duration * middles
        expected = filtered(commands, latency, lag, times).mean()
        assert weights @ commands == pytest.approx(expected, abs=0.02)
        assert weights.sum() == pytest.approx(1.0)
    if lag > 0.0:
        now = mean_weights(timing, PERIOD, HISTORY, 0.0, 0.0)
        expected = filtered(commands, latency, lag, np.array([0.0]))[0]
        assert now @ commands == pytest.approx(expected, abs=0.02)


def test_weights_of_many_timings_are_those_of_each():
    latency, lag = np.array(CASES).T
    together = mean_weights(Timing(latency, lag), PERIOD, HISTORY, -PERIOD, PERIOD)
    for row, case in zip(together, CASES, strict=True):
        np.testing.assert_array_equal(
            row, mean_weights(Timing(*case), PERIOD, HISTORY, -PERIOD, PERIOD)
        )


def test_without_lag_a_late_command_takes_over_within_the_period():
    weights = mean_weights(Timing(0.025, 0.0), PERIOD, 4, -PERIOD, PERIOD)
    np.testing.assert_allclose(weights, [0.0, 0.25, 0.75, 0.0], atol=1e-4)


def test_slopes_are_differences():
    timing = Timing(0.027, 0.02)
    arguments = PERIOD, HISTORY, -PERIOD, PERIOD
    slopes = weight_slopes(timing, *arguments)
    step = 1e-5
    for name in ("latency", "lag"):
        more = timing._replace(**{name: getattr(timing, name) + step})
        less = timing._replace(**{name: getattr(timing, name) - step})
        change = mean_weights(more, *arguments) - mean_weights(less, *arguments)
        np.testing.assert_allclose(getattr(slopes, name), change / (2.0 * step), atol=0.15)


@pytest.mark.parametrize("lag", [0.0, 0.005, 0.03])
def test_plans_are_filtered_like_commands_that_were_sent(lag):
    """The next intervals of a plan, seen from their end, are commands of the past."""
    plan = np.array([3.0, 1.0, 4.0, 1.0])
    now = 2.0
    by_plan, by_start = lagged_plan(lag, PERIOD, 4)
    means = by_plan @ plan + by_start * now
    sent = np.concatenate([[now], plan])
    for k in range(4):
        start = (k - 4) * PERIOD
        weights = mean_weights(Timing(0.0, lag), PERIOD, 5, start, PERIOD)
        assert means[k] == pytest.approx(weights @ sent, abs=1e-3)


@pytest.mark.parametrize(
    ("latency", "lag", "count"), [(0.0, 0.0, 1), (0.01, 0.0, 2), (0.02, 0.0, 2), (0.05, 0.01, 6)]
)
def test_commands_are_remembered_for_as_long_as_they_may_act(latency, lag, count):
    assert remembered_commands(latency, lag, PERIOD) == count
