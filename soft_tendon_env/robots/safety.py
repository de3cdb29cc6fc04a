"""Safe commands in time: absolute deadlines, limits of size and rate, checks of what is measured,
and a watchdog that lets the tendons go.

The watchdog is a thread of its own that no signal reaches: the command goes to slack evenly within
RAMP, also while another call of the robot hangs. Where writing fails it is tried again for TRYING,
and once more by every later `stop`.
"""

import atexit
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from time import perf_counter, sleep
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.robots.protocol import Measurement, Robot, check_measurement
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.messages import UserError, first_line
from soft_tendon_env.tools.types import Array, Triple

# [s] before a deadline at which sleeping ends: the scheduler wakes a process late by less, where it
# is idle
SPIN = 5e-4
RAMP, RAMP_STEPS = (
    0.03,
    6,
    # [s] in which tendons go slack, sudden enough to be safe and not a blow, and the commands on
    # the way
)
# [s] for which slack is tried where it cannot be sent; a port that comes back does so within less
TRYING = 1.0
HANGING = (
    0.1  # [s] for which slack waits for another call of the robot; one that takes longer hangs
)
ROUNDING = 0.1  # share of the range of commands by which motors may round beyond its ends
# greatest distance of the tip from the base, in lengths of the arm: rubber stretches, trackers err
# by millimetres
STRETCH = 1.25
FINISHED = "the run ended"  # cause of the stop of a run that went on to its end
ENDS = (
    "SIGTERM",
    "SIGHUP",
    "SIGQUIT",
    "SIGTSTP",
)  # of `kill`, a closed terminal, Ctrl-\ and Ctrl-Z, which act as Ctrl-C does


class Clock:
    """Monotonic clock. real: that of the machine; else it stands still but while somebody waits,
    for simulations at any speed."""

    def __init__(self, real: bool = True) -> None:
        self.real, self._times = (
            real,
            {0: 0.0},
        )  # until when each thread has waited: no lock, which an interrupt might leave shut

    def now(self) -> float:
        """The time [s]."""
        return perf_counter() if self.real else max(self._times.values())

    def wait_until(self, time: float) -> None:
        """Waits until a time [s]; returns at once where it is past."""
        if not self.real and time > self.now():
            self._times[threading.get_ident()] = time
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
        late = (
            f"late by {1e3 * self.p50:.3f} ms (p50), {1e3 * self.p99:.3f} ms (p99),"
            f" {1e3 * self.worst:.3f} ms (worst)"
        )
        return f"{self.periods} periods, {self.overruns} overruns, {late}"


class Pacer:
    """Absolute deadlines every `period` [s] from now on. A late period does not move the next ones:
    the loop catches up by short ones."""

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


class RobotStopped(UserError):
    """Raised by calls to a robot that was stopped; the message says why."""


@dataclass
class Stop:
    """Course of an emergency stop, or of the end of a run."""

    cause: str
    slack: bool = False  # whether the last command, which lets the tendons go, was sent
    seconds: float = 0.0  # from the cause to then [s]
    failures: list[str] = field(default_factory=list)  # what the robot raised meanwhile


class SafeRobot:
    """Robot behind limits (n_a, 2) of commands and a watchdog. arm: position (3,) of its base and
    its length [m], infinite where the base moves; rate: greatest change of a command in a second;
    patience: periods without a new reading, or behind the deadlines, after which the arm is let
    go."""

    def __init__(
        self,
        robot: Robot,
        limits: Array,
        sensors: int,
        arm: tuple[Triple, float],
        period: float,
        rate: float,
        patience: int,
    ) -> None:
        self.robot, self._limits, self._sensors, self.rate = robot, limits, sensors, rate
        self._base, self._reach = arm[0], STRETCH * arm[1]
        self.slack = (
            np.zeros(len(limits)) if robot.command_unit == "N" else limits[:, 0].copy()
        )  # no tension, or all that can be let out
        self.senses = tuple(
            name for name in robot.senses if sensors or not name.startswith("strain")
        )
        self.clock: Clock = getattr(robot, "clock", None) or Clock()
        self._period, self._patience = period, patience * period
        self._allowed = f": patience is {patience} control periods of {1e3 * period:g} ms"
        self.stopped: Stop | None = Stop("it has not begun", slack=True)
        self._sent, self._fresh, self._closed = self.slack.copy(), 0.0, False
        self._newest: Measurement | None = None
        self._lock, self._hangs = (
            threading.Lock(),
            False,
        )  # of the robot's calls, and whether one does not return
        self._told, self._handlers = SimpleQueue[tuple[str, threading.Event]](), dict[int, Any]()
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        atexit.register(self.stop, "the interpreter ended")

    def begin(self) -> None:
        """Begins, or begins again after a stop, with slack tendons: from now on the watchdog looks,
        and signals act as Ctrl-C."""
        self.stop("it begins again")
        if threading.current_thread() is threading.main_thread():
            for number in (getattr(signal, name) for name in ENDS if hasattr(signal, name)):
                if (
                    signal.getsignal(number) is signal.SIG_DFL
                ):  # else it is ignored, as under nohup, or somebody handles it
                    self._handlers[number] = signal.signal(number, signal.default_int_handler)
        self._newest, self._fresh, self.stopped = None, self.clock.now(), None

    def read(self, late: float = 0.0) -> Measurement:
        """The newest measurement, in a period that begins late [s]. Raises RobotStopped, also after
        one that fails, cannot be or is old."""
        self._refuse()
        if late > self._patience:
            self.fail(f"the loop is {1e3 * late:.0f} ms behind its deadlines{self._allowed}")
        try:
            found = check_measurement(
                self._alone(self.robot.read, TRYING), self.senses, self.slack.size, self._sensors
            )
            if self._newest is None or found.time > self._newest.time:
                if (
                    found.tip_pose is not None
                    and (far := float(np.linalg.norm(found.tip_pose[:3, 3] - self._base)))
                    > self._reach
                ):
                    text = (
                        f"the tip {far:.3g} m from the base, and the arm reaches"
                        f" {self._reach:.3g} m"
                    )
                    raise ValueError(
                        f"measurement.tip_pose puts {text}: is it in m, in the scene's world frame?"
                    )
                self._newest, self._fresh = found, self.clock.now()
        except Exception as error:
            self.fail(f"reading failed: {first_line(error)}", error)
        self._refuse(self._too_old())
        assert self._newest is not None
        return self._newest

    def write(self, command: Array) -> Array:
        """Sends a command (n_a,) within limits and rate; returns what was sent. Raises
        RobotStopped, also where it cannot be sent."""
        self._refuse()
        (least, greatest), most = self._limits.T, self.rate * self._period
        try:
            # from slack, which may lie beneath the limits, it rises evenly
            wanted = np.clip(
                checked_array("command", command, self.slack.shape),
                np.minimum(least, self._sent),
                greatest,
            )
            found = self._send(np.clip(wanted, self._sent - most, self._sent + most))
            if found is not None:
                found, slop = (
                    checked_array("what write returns", found, self.slack.shape),
                    ROUNDING * (greatest - least),
                )
                if not (
                    (found >= np.minimum(least, self.slack) - slop) & (found <= greatest + slop)
                ).all():
                    raise ValueError(
                        f"it returned {found.tolist()}: it should be what was sent, in"
                        f" {self.robot.command_unit}, or nothing"
                    )
        except Exception as error:
            self.fail(f"writing failed: {first_line(error)}", error)
        if self.stopped is not None:  # while the call hung
            self._try(self.stopped, self.slack)
        self._refuse()
        return self._sent.copy() if found is None else found

    def fail(self, cause: str, error: Exception | None = None) -> NoReturn:
        """Stops, and raises RobotStopped with the first cause."""
        raise RobotStopped(self.stop(cause).cause) from error

    def stop(self, cause: str) -> Stop:
        """Lets the tendons go slack, and waits until they are, or cannot be. The first cause
        counts; later calls wait, and try again."""
        if not self._closed:
            done = threading.Event()
            self._told.put((cause, done))
            done.wait(2.0 * (TRYING + HANGING))
        return self.stopped or Stop(cause)

    def close(self) -> None:
        """Stops, and lets go of the robot, once; where that fails, as on a port that is lost, it
        stands among the failures."""
        done = self.stop(FINISHED)
        if not self._closed:
            try:
                self.robot.close()
            except Exception as error:
                done.failures.append(first_line(error))
            self._closed = True
            atexit.unregister(self.stop)
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def _watch(self) -> None:
        """The watchdog: looks at the newest measurement's age, and lets the tendons go when it is
        told to, until the robot is closed."""
        while not self._closed:
            try:
                cause, done = self._told.get(timeout=0.25 * self._period)
            except Empty:
                if self.clock.real and (cause := self._too_old()):
                    self._go_slack(Stop(cause))
                continue
            if self.stopped is None:
                self._go_slack(Stop(cause))
            elif not self.stopped.slack:
                self._try(self.stopped, self.slack)
            done.set()

    def _go_slack(self, stop: Stop) -> None:
        """The ramp, and the last command again as long as it fails. Steps are left out where the
        robot takes longer for one."""
        self.stopped, first, step, k = stop, self._sent, RAMP / RAMP_STEPS, 0
        began, until = self.clock.now(), perf_counter() + TRYING
        while not stop.slack and self.clock.now() - began < TRYING and perf_counter() < until:
            k = max(k + 1, int((self.clock.now() - began) / step))
            share = min(k / RAMP_STEPS, 1.0)
            self._try(stop, (1.0 - share) * first + share * self.slack)
            stop.seconds = self.clock.now() - began
            if not stop.slack:
                self.clock.wait_until(
                    began + k * step if k < 2 * RAMP_STEPS else self.clock.now() + RAMP
                )

    def _try(self, stop: Stop, command: Array) -> None:
        """Sends a command on the way to slack; what comes of it stands in the stop."""
        try:
            self._send(command, slackens=True)
            stop.slack = bool((command == self.slack).all())
        except (
            BaseException
        ) as error:  # also those that are no Exception: there is nobody to raise them to
            stop.failures.append(first_line(error))

    def _send(self, command: Array, slackens: bool = False) -> Any:
        """Sends a command (n_a,); returns what `write` does. After a stop nothing but slack is
        sent."""

        def send() -> Any:
            if self.stopped is not None and not slackens:
                return None
            found = self.robot.write(command.copy())
            self._sent = command
            return found

        return self._alone(send, HANGING if slackens else TRYING)

    def _alone(self, call: Callable[[], Any], longest: float) -> Any:
        """Result of a call of the robot, after the one that goes on, for which it waits at most
        `longest` [s]."""
        is_free = self._lock.acquire(timeout=0.0 if self._hangs else longest)
        self._hangs = not is_free
        try:
            return call()
        finally:
            if is_free:
                self._lock.release()

    def _too_old(self) -> str:
        """Cause of a stop where the newest measurement is too old; "": it is not."""
        age = self.clock.now() - self._fresh
        return (
            ""
            if self.stopped is not None or age <= self._patience
            else f"no reading for {1e3 * age:.0f} ms{self._allowed}"
        )

    def _refuse(self, cause: str = "") -> None:
        """Raises RobotStopped after a stop, or for a cause of one."""
        if cause or self.stopped is not None:
            self.fail(cause)
