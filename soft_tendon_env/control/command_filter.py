"""Command filter of actuators: dead time and first-order lag of the commands that were sent.

A command c that is held over periods T arrives a latency L later, and the tension u follows it with
the time constant tau of a lag:

    tau u_dot(t) = c(t - L) - u(t)

So u, and its mean over any interval, is a weighted sum of the commands that were sent.
"""

from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.tools.types import Array

# share of a period by which a delay may differ from whole periods and still count as them
SAME = 1e-9
SETTLED = 5.0  # time constants, after which a lag has forgotten a command to 1 %
LEAST_LAG = 1e-6  # [s] below which a lag counts as none
STEP = 1e-4  # [s] of the differences by which weights are differentiated


class Timing(NamedTuple):
    """Dead time and lag of actuators, or arrays of them alike; None where they are not known."""

    latency: Any  # (...) [s]
    lag: Any  # (...) [s] time constant


def whole_periods(delay: float, period: float) -> tuple[int, float]:
    """Number of whole periods in a delay [s], and the rest [s]."""
    whole = int(delay / period + SAME)
    rest = delay - whole * period
    if rest <= SAME * period:
        rest = 0.0
    return whole, rest


def remembered_commands(latency: float, lag: float, period: float) -> int:
    """Number of commands that may still act, at the greatest latency and lag [s]."""
    whole, rest = whole_periods(latency + SETTLED * lag, period)
    return whole + (rest > 0.0) + 1


def mean_weights(
    timing: Timing, period: float, history: int, start: float | Array, duration: float
) -> Array:
    """Weights (..., history) of past commands in the mean tension of an interval.

    A step of the command that arrives at t_i adds the mean of its response over the interval,
    (G(b - t_i) - G(a - t_i)) / (b - a) with G(t) = t - tau (1 - exp(-t / tau)).

    Args:
        timing: latency and lag, of any shape that goes with that of `start`.
        period: [s] for which every command is held.
        history: number of commands, the newest last; it was sent a period ago.
        start: a [s] of the interval, from now, or those of several (...).
        duration: b - a [s]; 0 asks for the tension at that instant.

    Returns:
        The weights, which sum to 1: the eldest command stands for all before it.
    """
    # ages of the commands, the newest last: when the step of each arrives
    ages = period * np.arange(history, 0, -1)
    lags = np.asarray(timing.lag)
    latencies = np.asarray(timing.latency)
    starts = np.asarray(start)
    # a last axis for the commands
    lag = np.maximum(lags[..., None], LEAST_LAG)
    arrival = latencies[..., None] - ages
    since = starts[..., None] - arrival
    if duration > 0.0:
        before = _ramp_response(since, lag)
        after = _ramp_response(since + duration, lag)
        steps = (after - before) / duration
    else:
        since_arrival = np.maximum(since, 0.0)
        steps = -np.expm1(-since_arrival / lag)
    steps[..., 0] = 1.0  # the eldest has acted since long before
    weights = steps.copy()
    weights[..., :-1] -= steps[..., 1:]
    return weights


def weight_slopes(
    timing: Timing, period: float, history: int, start: float | Array, duration: float
) -> Timing:
    """Derivatives [1/s] of `mean_weights` by latency and by lag, by central differences."""

    def weights(displaced: Timing) -> Array:
        return mean_weights(displaced, period, history, start, duration)

    width = 2.0 * STEP
    later = timing._replace(latency=timing.latency + STEP)
    sooner = timing._replace(latency=timing.latency - STEP)
    by_latency = weights(later) - weights(sooner)
    # a lag may be none: its difference is one-sided
    slower = timing._replace(lag=timing.lag + width)
    by_lag = weights(slower) - weights(timing)
    return Timing(by_latency / width, by_lag / width)


def lagged_plan(lag: float, interval: float, intervals: int) -> tuple[Array, Array]:
    """Mean tensions of intervals by commands that are held over them: A (N, N) and b (N,).

    Means are A c + b u, with the tension u that acts when the first command arrives. Over an
    interval u decays towards its command by s = exp(-h / tau), and its mean differs from the
    command by the share tau (1 - s) / h.
    """
    lag = max(lag, LEAST_LAG)
    kept = np.exp(-interval / lag)
    reached = 1.0 - kept
    share = lag * reached / interval
    powers = kept ** np.arange(intervals)
    by_start = share * powers
    by_command = (1.0 - share) * np.eye(intervals)
    # the command of an interval is reached to 1 - s by its end, and forgotten after it
    later = share * reached * powers
    for k in range(1, intervals):
        earlier = later[:k]
        by_command[k, :k] = earlier[::-1]
    return by_command, by_start


def _ramp_response(time: Array, lag: Array) -> Array:
    """Integral G [s] of the step response of a lag up to times after the step."""
    after = np.maximum(time, 0.0)
    return after + lag * np.expm1(-after / lag)
