"""Safe commands in time, and a watchdog that lets the tendons go.

It has absolute deadlines, limits of size and rate, and checks of what is measured.

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
RAMP = 0.03  # [s] in which tendons go slack, sudden enough to be safe and not a blow
RAMP_STEPS = 6  # commands on the way
# [s] for which slack is tried where it cannot be sent; a port that comes back does so within less
TRYING = 1.0
# [s] for which slack waits for another call of the robot; one that takes longer hangs
HANGING = 0.1
LOOKS = 0.25  # control periods from one look of the watchdog to the next
ROUNDING = 0.1  # share of the range of commands by which motors may round beyond its ends
# greatest distance of the tip from the base, in lengths of the arm: rubber stretches, trackers err
# by millimetres
STRETCH = 1.25
FINISHED = "the run ended"  # cause of the stop of a run that went on to its end
# of `kill`, a closed terminal, Ctrl-\ and Ctrl-Z, which act as Ctrl-C does
ENDS = ("SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP")


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
        return perf_counter() if self.real else max(self._times.values())

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
        deadline = self._first + self.period * self.count
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
        p50, p99, worst = np.percentile(lateness, [50, 99, 100]).tolist()
        return Timing(
            periods=self.count,
            overruns=self._overruns,
            p50=p50,
            p99=p99,
            worst=worst,
        )


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
    """Robot behind limits and a watchdog.

    Args:
        robot: to command.
        limits: (n_a, 2) of commands, in their unit.
        sensors: number of strain sensors that are observed.
        arm: position (3,) of its base and its length [m], infinite where the base moves.
        period: of control [s].
        rate: greatest change of a command in a second.
        patience: periods without a new reading, or behind the deadlines, after which the arm is let
            go.
    """

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
        self.robot = robot
        self._limits = limits
        self._sensors = sensors
        self.rate = rate
        self._base, length = arm
        self._reach = STRETCH * length
        # no tension, or all that can be let out
        is_tension = robot.command_unit == "N"
        self.slack = np.zeros(len(limits)) if is_tension else limits[:, 0].copy()
        # without sensors strains are not read
        unread = () if sensors else ("strain", "strain_rate")
        self.senses = tuple(name for name in robot.senses if name not in unread)
        self.clock: Clock = getattr(robot, "clock", None) or Clock()
        self._period = period
        self._patience = patience * period
        self._allowed = f": patience is {patience} control periods of {1e3 * period:g} ms"
        self.stopped: Stop | None = Stop("it has not begun", slack=True)
        self._sent = self.slack.copy()
        self._newest: Measurement | None = None
        self._fresh = 0.0  # [s] when the newest came
        self._closed = False
        self._lock = threading.Lock()  # of the robot's calls
        self._hangs = False  # whether one does not return
        # causes of stops that the watchdog is told, with what it sets when it is done
        self._orders = SimpleQueue[tuple[str, threading.Event]]()
        self._handlers = dict[int, Any]()  # of signals, to restore
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        atexit.register(self.stop, "the interpreter ended")

    def begin(self) -> None:
        """Begins, or begins again after a stop, with slack tendons.

        From now on the watchdog looks, and signals act as Ctrl-C.
        """
        self.stop("it begins again")
        if threading.current_thread() is threading.main_thread():
            for name in ENDS:
                number = getattr(signal, name, None)  # Windows has not all
                if number is None:
                    continue
                # others are ignored, as under nohup, or somebody handles them
                if signal.getsignal(number) is signal.SIG_DFL:
                    self._handlers[number] = signal.signal(number, signal.default_int_handler)
        self._newest = None
        self._fresh = self.clock.now()
        self.stopped = None

    def read(self, late: float = 0.0) -> Measurement:
        """Reads the newest measurement.

        Args:
            late: by how much [s] the period begins after its deadline.

        Returns:
            The measurement.

        Raises:
            RobotStopped: after a stop, also for a reading that fails, cannot be or is old.
        """
        self._refuse()
        if late > self._patience:
            self.fail(f"the loop is {1e3 * late:.0f} ms behind its deadlines{self._allowed}")
        try:
            reading = self._alone(self.robot.read, TRYING)
            measured = check_measurement(reading, self.senses, self.slack.size, self._sensors)
            if self._newest is None or measured.time > self._newest.time:
                self._check_reach(measured)
                self._newest = measured
                self._fresh = self.clock.now()
        except Exception as error:
            self.fail(f"reading failed: {first_line(error)}", error)
        self._refuse(self._too_old())
        assert self._newest is not None
        return self._newest

    def _check_reach(self, measured: Measurement) -> None:
        """Raises ValueError for a tip that is further from the base than the arm reaches."""
        if measured.tip_pose is None:
            return
        from_base = measured.tip_pose[:3, 3] - self._base
        distance = float(np.linalg.norm(from_base))
        if distance > self._reach:
            raise ValueError(
                f"measurement.tip_pose puts the tip {distance:.3g} m from the base, and the arm"
                f" reaches {self._reach:.3g} m: is it in m, in the scene's world frame?"
            )

    def write(self, command: Array) -> Array:
        """Sends a command within limits and rate.

        Args:
            command: (n_a,).

        Returns:
            What was sent (n_a,).

        Raises:
            RobotStopped: after a stop, also where the command cannot be sent.
        """
        self._refuse()
        least, greatest = self._limits.T
        most = self.rate * self._period
        try:
            asked = checked_array("command", command, self.slack.shape)
            # from slack, which may lie beneath the limits, it rises evenly
            within = np.clip(asked, np.minimum(least, self._sent), greatest)
            next_command = np.clip(within, self._sent - most, self._sent + most)
            answer = self._send(next_command)
            sent = None if answer is None else self._checked_answer(answer)
        except Exception as error:
            self.fail(f"writing failed: {first_line(error)}", error)
        if self.stopped is not None:  # while the call hung
            self._try(self.stopped, self.slack)
        self._refuse()
        return self._sent.copy() if sent is None else sent

    def _checked_answer(self, answer: Any) -> Array:
        """Command (n_a,) that a robot says it sent.

        Raises ValueError for one that cannot be.
        """
        sent = checked_array("what write returns", answer, self.slack.shape)
        least, greatest = self._limits.T
        margin = ROUNDING * (greatest - least)
        is_above = sent >= np.minimum(least, self.slack) - margin
        is_below = sent <= greatest + margin
        if not (is_above & is_below).all():
            raise ValueError(
                f"it returned {sent.tolist()}: it should be what was sent, in"
                f" {self.robot.command_unit}, or nothing"
            )
        return sent

    def fail(self, cause: str, error: Exception | None = None) -> NoReturn:
        """Stops, and raises RobotStopped with the first cause."""
        raise RobotStopped(self.stop(cause).cause) from error

    def stop(self, cause: str) -> Stop:
        """Lets the tendons go slack, and waits until they are, or cannot be.

        The first cause counts; later calls wait, and try again.
        """
        if not self._closed:
            done = threading.Event()
            self._orders.put((cause, done))
            done.wait(2.0 * (TRYING + HANGING))
        return self.stopped or Stop(cause)

    def close(self) -> None:
        """Stops, and lets go of the robot, once.

        Where that fails, as on a port that is lost, it stands among the failures.
        """
        course = self.stop(FINISHED)
        if not self._closed:
            try:
                self.robot.close()
            except Exception as error:
                course.failures.append(first_line(error))
            self._closed = True
            atexit.unregister(self.stop)
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def _watch(self) -> None:
        """Watches the newest measurement's age until the robot is closed.

        The watchdog lets the tendons go when it is told to.
        """
        while not self._closed:
            try:
                cause, done = self._orders.get(timeout=LOOKS * self._period)
            except Empty:
                # where time stands still, the loop itself looks as it reads
                cause = self._too_old() if self.clock.real else ""
                if cause:
                    self._go_slack(Stop(cause))
                continue
            if self.stopped is None:
                self._go_slack(Stop(cause))
            elif not self.stopped.slack:
                self._try(self.stopped, self.slack)
            done.set()

    def _go_slack(self, stop: Stop) -> None:
        """The ramp, and the last command again as long as it fails.

        Steps are left out where the robot takes longer for one.
        """
        self.stopped = stop
        first = self._sent
        step = RAMP / RAMP_STEPS  # [s]
        k = 0
        began = self.clock.now()
        give_up = perf_counter() + TRYING  # also where the clock stands still
        while not stop.slack and self.clock.now() - began < TRYING and perf_counter() < give_up:
            steps_due = int((self.clock.now() - began) / step)
            k = max(k + 1, steps_due)
            share = min(k / RAMP_STEPS, 1.0)
            command = (1.0 - share) * first + share * self.slack
            self._try(stop, command)
            stop.seconds = self.clock.now() - began
            if not stop.slack:
                # a robot that does not take it is told less often
                is_ramp = k < 2 * RAMP_STEPS
                next_time = began + k * step if is_ramp else self.clock.now() + RAMP
                self.clock.wait_until(next_time)

    def _try(self, stop: Stop, command: Array) -> None:
        """Sends a command on the way to slack; what comes of it stands in the stop."""
        try:
            self._send(command, slackens=True)
            stop.slack = bool((command == self.slack).all())
        except BaseException as error:
            # also those that are no Exception: there is nobody to raise them to
            stop.failures.append(first_line(error))

    def _send(self, command: Array, slackens: bool = False) -> Any:
        """Sends a command (n_a,); returns what `write` does.

        After a stop nothing but slack is sent.
        """

        def send() -> Any:
            if self.stopped is not None and not slackens:
                return None
            answer = self.robot.write(command.copy())
            self._sent = command
            return answer

        return self._alone(send, HANGING if slackens else TRYING)

    def _alone(self, call: Callable[[], Any], longest: float) -> Any:
        """Result of a call of the robot, after the one that goes on.

        It waits for that at most `longest` [s].
        """
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
        if self.stopped is not None or age <= self._patience:
            return ""
        return f"no reading for {1e3 * age:.0f} ms{self._allowed}"

    def _refuse(self, cause: str = "") -> None:
        """Raises RobotStopped after a stop, or for a cause of one."""
        if cause or self.stopped is not None:
            self.fail(cause)
