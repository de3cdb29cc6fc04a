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

    def __str__(self) -> str:
        late = f"late by {1e3 * self.p50:.3f} ms (p50), {1e3 * self.p99:.3f} ms (p99), {1e3 * self.worst:.3f} ms (worst)"
        return f"{self.periods} periods, {self.overruns} overruns, {late}"


class Pacer:
    """Absolute deadlines every `period` [s]. A late period does not move the next ones: the loop catches up by short ones."""

    def __init__(self, clock: Clock, period: float) -> None:
        self.clock, self.period = clock, period
        self.start()

    def start(self) -> None:
        """The first period begins now."""
        self._first = self.clock.now()
        self.count, self._overruns, self._lateness = 0, 0, list[float]()

    def wait(self) -> float:
        """Waits for the next deadline; returns by how much [s] it is missed."""
        self.count += 1
        deadline = self._first + self.period * self.count
        self._overruns += self.clock.now() > deadline
        self.clock.wait_until(deadline)
        self._lateness.append(self.clock.now() - deadline)
        return self._lateness[-1]

    @property
    def timing(self) -> Timing:
        """Statistics since `start`; zeros before the first period is over."""
        late = np.array(self._lateness or [0.0])
        p50, p99 = np.percentile(late, [50, 99])
        return Timing(self.count, self._overruns, float(p50), float(p99), float(late.max()))
