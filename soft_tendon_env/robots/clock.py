"""Periods of a control loop by absolute deadlines, in real time or in that of a simulation, with statistics of their jitter."""

import threading
from time import perf_counter, sleep
from typing import NamedTuple

import numpy as np

SPIN = 5e-4  # [s] before a deadline at which sleeping ends: the scheduler wakes a process late by less, where it is idle


class Clock:
    """Monotonic clock of the machine. real: whether time goes on by itself."""

    real = True

    def now(self) -> float:
        """The time [s]."""
        return perf_counter()

    def wait_until(self, time: float) -> None:
        """Waits until a time [s]; returns at once where it is past."""
        while (left := time - perf_counter()) > 0.0:
            if left > SPIN:
                sleep(left - SPIN)


class SteppedClock(Clock):
    """Clock that stands still but while somebody waits: for simulations faster, or slower, than real time."""

    real = False

    def __init__(self) -> None:
        self._time, self._lock = 0.0, threading.Lock()

    def now(self) -> float:
        return self._time

    def wait_until(self, time: float) -> None:
        with self._lock:
            self._time = max(self._time, time)


class Timing(NamedTuple):
    """Statistics of the periods of a loop: how late each began after its deadline [s]."""

    periods: int
    overruns: int  # periods whose work ended after the next deadline
    p50: float  # [s] of lateness
    p99: float  # [s]
    worst: float  # [s]
    busy_p99: float  # [s] of work in a period, waiting left out

    def __str__(self) -> str:
        late = f"late by {1e3 * self.p50:.3f} ms (p50), {1e3 * self.p99:.3f} ms (p99), {1e3 * self.worst:.3f} ms (worst)"
        return f"{self.periods} periods, {self.overruns} overruns, {late}; {1e3 * self.busy_p99:.2f} ms of work (p99)"


class Pacer:
    """Absolute deadlines every `period` [s]. A period that is late does not move the next ones, so that errors do not add up: late ones
    are short, one after another, until the loop is on time again."""

    def __init__(self, clock: Clock, period: float) -> None:
        self.clock, self.period = clock, period
        self.start()

    def start(self) -> None:
        """The first period begins now."""
        self._first = self._began = self.clock.now()
        self.count, self._lateness, self._busy = 0, list[float](), list[float]()

    def wait(self) -> float:
        """Waits for the next deadline; returns by how much [s] it is missed."""
        self.count += 1
        self._busy.append(self.clock.now() - self._began)
        self.clock.wait_until(self._first + self.period * self.count)
        self._began = self.clock.now()
        self._lateness.append(self._began - self._first - self.period * self.count)
        return self._lateness[-1]

    @property
    def timing(self) -> Timing:
        """Statistics since `start`; zeros before the first period is over."""
        late, busy = (np.array(values or [0.0]) for values in (self._lateness, self._busy))
        overruns = int((np.concatenate([[0.0], late[:-1]]) + busy > self.period).sum())
        p50, p99 = np.percentile(late, [50, 99])
        return Timing(self.count, overruns, float(p50), float(p99), float(late.max()), float(np.percentile(busy, 99)))
