"""Clock of a control loop, real or stepped, and absolute deadlines with statistics of lateness."""

import threading
from time import perf_counter, sleep
from typing import NamedTuple

import numpy as np

SPIN = 5e-4
"""Time [s] before a deadline at which sleeping ends: the scheduler wakes a process late by less,
where it is idle."""


class Clock:
    """Monotonic clock.

    real: that of the machine; else it stands still but while somebody waits, for simulations at any
    speed.
    """

    def __init__(self, real: bool = True) -> None:
        self.real = real
        # until when each thread has waited: no lock, which an interrupt might leave shut
        self._times = {0: 0.0}

    def now(self) -> float:
        """The time [s]."""
        if self.real:
            return perf_counter()
        return max(self._times.values())

    def wait_until(self, time: float) -> None:
        """Waits until a time [s]; returns at once where it is past."""
        if not self.real:
            if time > self.now():
                self._times[threading.get_ident()] = time
            return
        remaining = time - perf_counter()
        while remaining > 0.0:
            if remaining > SPIN:  # and spins from there on
                sleep(remaining - SPIN)
            remaining = time - perf_counter()


class Timing(NamedTuple):
    """Statistics of the periods of a loop: how late each began after its deadline [s]."""

    periods: int  # that the loop ran
    overruns: int  # periods whose work ended after the next deadline
    p50: float  # [s] of lateness
    p99: float  # [s]
    worst: float  # [s]

    def __str__(self) -> str:
        late = (
            f"late by {1e3 * self.p50:.3f} ms (p50), {1e3 * self.p99:.3f} ms (p99),"
            f" {1e3 * self.worst:.3f} ms (worst)"
        )
        return f"{self.periods} periods, {self.overruns} overruns, {late}"


class Pacer:
    """Absolute deadlines every `period` [s] from now on.

    A late period does not move the next ones: the loop catches up by short ones.
    """

    def __init__(self, clock: Clock, period: float) -> None:
        self.clock = clock
        self.period = period
        self._first = clock.now()
        self.count = 0
        self._overruns = 0
        self._lateness = list[float]()

    def wait(self) -> float:
        """Waits for the next deadline; returns by how much [s] it is missed."""
        self.count += 1
        elapsed = self.period * self.count
        deadline = self._first + elapsed
        if self.clock.now() > deadline:
            self._overruns += 1
        self.clock.wait_until(deadline)
        lateness = self.clock.now() - deadline
        self._lateness.append(lateness)
        return lateness

    @property
    def timing(self) -> Timing:
        """Statistics until now; zeros before the first period is over."""
        lateness = self._lateness or [0.0]
        percentiles = np.percentile(lateness, [50, 99, 100])
        p50, p99, worst = percentiles.tolist()
        return Timing(
            periods=self.count,
            overruns=self._overruns,
            p50=p50,
            p99=p99,
            worst=worst,
        )
