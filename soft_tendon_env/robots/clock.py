"""Periods of a control loop by absolute deadlines, in real time or in that of a simulation, with statistics of their jitter."""

import threading
from time import perf_counter, sleep
from typing import NamedTuple

import numpy as np

SPIN = 5e-4  # [s] before a deadline at which sleeping ends: the scheduler wakes a process late by less, where it is idle


class Clock:
    """Monotonic clock. real: that of the machine; else it stands still but while somebody waits, for simulations at any speed."""

    def __init__(self, real: bool = True) -> None:
        self.real, self._time, self._lock = real, 0.0, threading.Lock()

    def now(self) -> float:
        """The time [s]."""
        return perf_counter() if self.real else self._time

    def wait_until(self, time: float) -> None:
        """Waits until a time [s]; returns at once where it is past."""
        with self._lock:
            self._time = max(self._time, time)
        while self.real and (left := time - perf_counter()) > 0.0:
            if left > SPIN:
                sleep(left - SPIN)


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
    """Absolute deadlines every `period` [s] from now on. A late period does not move the next ones: the loop catches up by short ones."""

    def __init__(self, clock: Clock, period: float) -> None:
        self.clock, self.period, self._first = clock, period, clock.now()
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
        """Statistics until now; zeros before the first period is over."""
        p50, p99, worst = np.percentile(self._lateness or [0.0], [50, 99, 100]).tolist()
        return Timing(self.count, self._overruns, p50, p99, worst)
