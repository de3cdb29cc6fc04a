"""Periods of a control loop by absolute deadlines, in real time or in that of a simulation, with statistics of their jitter."""

import threading
from time import perf_counter, sleep
from typing import NamedTuple, Protocol

import numpy as np

SPIN = 5e-4
"""Time [s] before a deadline at which sleeping ends: the scheduler wakes a process late by less than that, where it is idle."""


class Clock(Protocol):
    """A clock [s]. real: whether time goes on by itself."""

    real: bool

    def now(self) -> float:
        """The time [s]."""

    def wait_until(self, time: float) -> None:
        """Waits until a time [s]; returns at once where it is past."""


class RealClock:
    """The monotonic clock of the machine."""

    real = True

    def now(self) -> float:
        return perf_counter()

    def wait_until(self, time: float) -> None:
        while (left := time - perf_counter()) > 0.0:
            if left > SPIN:
                sleep(left - SPIN)


class SteppedClock:
    """A clock that stands still but while somebody waits: for simulations faster, or slower, than real time."""

    real = False

    def __init__(self) -> None:
        self._time, self._lock = 0.0, threading.Lock()

    def now(self) -> float:
        return self._time

    def wait_until(self, time: float) -> None:
        with self._lock:
            self._time = max(self._time, time)


class Timing(NamedTuple):
    """Statistics of the periods of a loop: how late each began after its deadline [s], and how many deadlines were missed."""

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
        self._lateness, self._busy, self._overruns = list[float](), list[float](), 0

    @property
    def count(self) -> int:
        """Periods that are over."""
        return len(self._lateness)

    def wait(self) -> float:
        """Waits for the next deadline; returns by how much [s] it is missed."""
        deadline = self._first + self.period * (self.count + 1)
        now = self.clock.now()
        self._busy.append(now - self._began)
        self._overruns += now > deadline
        self.clock.wait_until(deadline)
        self._began = self.clock.now()
        self._lateness.append(self._began - deadline)
        return self._lateness[-1]

    @property
    def timing(self) -> Timing:
        """Statistics since `start`; zeros before the first period is over."""
        late, busy = (np.array(values or [0.0]) for values in (self._lateness, self._busy))
        p50, p99 = np.percentile(late, [50, 99])
        return Timing(self.count, self._overruns, float(p50), float(p99), float(late.max()), float(np.percentile(busy, 99)))
