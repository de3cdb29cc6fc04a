"""Safe commands in time, and a watchdog that lets the tendons go.

It has limits of size and rate, and checks of what is measured.

The watchdog is a thread of its own that no signal reaches: the command goes to slack evenly within
slack.RAMP, also while another call of the robot hangs. Where writing fails it is tried again for
TRYING, and once more by every later `stop`. A program that hangs as a whole, or dies, stops this
thread too: see process.py.
"""

import atexit
import threading
import warnings
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.robots.freshness import Freshness
from soft_tendon_env.robots.protocol import (
    Measurement,
    Robot,
    check_measurement,
    read_fields,
)
from soft_tendon_env.robots.signals import HOLDERS
from soft_tendon_env.robots.slack import (
    HANGING,
    TRYING,
    Stop,
    Turns,
    let_go,
    send_on_the_way,
)
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.messages import UserError, first_line
from soft_tendon_env.tools.types import Array, Triple

LOOKS = 0.25
"""Control periods from one look of the watchdog to the next."""

ROUNDING = 0.1
"""Share of the range of commands by which motors may round beyond its ends."""

STRETCH = 1.25
"""Greatest distance of the tip from the base, in lengths of the arm: rubber stretches, trackers err
by millimetres."""

NOISY = 0.1
"""Share of the arm's length by which two measurements of a tip at rest may differ: six standard
deviations of a tracker whose noise is 1 % of it."""

MOST_JUMPS = 2
"""Jumps in a row that end a run: one alone may be a marker that was taken for another."""

FINISHED = "the run ended"
"""Cause of the stop of a run that went on to its end."""


class RobotStopped(UserError):
    """Raised by calls to a robot that was stopped; the message says why."""


class MeasurementWarning(UserWarning):
    """A measurement that no arm can have made was left out."""


class ArmBounds(NamedTuple):
    """Bounds of what can be measured of an arm."""

    base: Triple  # position of its base [m]
    length: float  # [m], infinite where the base moves
    top_speed: float  # greatest speed of its tip [m/s]


class SafeRobot:
    """Robot behind limits and a watchdog.

    Args:
        robot: to command.
        limits: (n_a, 2) of commands, in their unit.
        sensors: number of strain sensors that are observed.
        arm: bounds of what can be measured.
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
        arm: ArmBounds,
        period: float,
        rate: float,
        patience: int,
    ) -> None:
        self.robot = robot
        self._limits = limits
        self._sensors = sensors
        self.rate = rate
        self._arm = arm
        # no tension, or all that can be let out
        is_tension = robot.command_unit == "N"
        if is_tension:
            self.slack = np.zeros(len(limits))
        else:
            self.slack = limits[:, 0].copy()
        self.senses = read_fields(robot, sensors)
        own_clock = getattr(robot, "clock", None)
        self.clock: Clock = own_clock or Clock()
        self._period = period
        self._patience = patience * period
        self._allowed = f": patience is {patience} control periods of {1e3 * period:g} ms"
        self.stopped: Stop | None = Stop("it has not begun", slack=True)
        self._sent = self.slack.copy()
        self._sent_at = -np.inf  # [s] when the call that sent it returned
        self._readings = Freshness(self.clock)
        self._jumps = 0  # poses in a row that were too far from the one before
        self._closed = False
        self._turns = Turns()
        # causes of stops that the watchdog is told, with what it sets when it is done
        self._orders = SimpleQueue[tuple[str, threading.Event]]()
        self._newest_order = threading.Event()
        self._newest_order.set()  # nothing was ordered
        watchdog = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        watchdog.start()
        atexit.register(self.stop, "the interpreter ended")
        HOLDERS.add(self)

    def begin(self) -> None:
        """Begins, or begins again after a stop, with slack tendons.

        From now on the watchdog looks, and signals act as Ctrl-C.

        Raises:
            RobotStopped: where a driver with a watchdog of its own does not begin.
        """
        self.stop("it begins again")
        HOLDERS.add(self)  # signals that could not be taken in another thread
        self._readings.begin()
        self._jumps = 0
        self._sent_at = -np.inf  # the tendons have been slack
        self.stopped = None
        watch = getattr(self.robot, "watch", None)
        if watch is not None:
            try:
                slack = self.slack.copy()
                guard = partial(watch, slack, self._patience)
                self._turns.take(guard, TRYING)
            except Exception as error:
                self.fail(f"the robot's own watchdog failed: {first_line(error)}", error)

    def read(self, late: float = 0.0) -> Measurement:
        """Reads the newest measurement.

        Args:
            late: by how much [s] the period begins after its deadline.

        Returns:
            The measurement.

        Raises:
            RobotStopped: after a stop, also for a reading that fails, cannot be or is old.

        Warns:
            MeasurementWarning: for a pose that is too far from the last one.
        """
        self._refuse()
        if late > self._patience:
            cause = f"the loop is {1e3 * late:.0f} ms behind its deadlines{self._allowed}"
            self.fail(cause)
        try:
            reading = self._turns.take(self.robot.read, TRYING)
            measured = check_measurement(reading, self.senses, self.slack.size, self._sensors)
            takes_pose = self._readings.is_new_pose(measured)
            if takes_pose and measured.tip_pose is not None:
                self._check_reach(measured.tip_pose)
                takes_pose = not self._has_jumped(measured.tip_pose)
            self._readings.take(measured, takes_pose)
        except Exception as error:
            self.fail(f"reading failed: {first_line(error)}", error)
        self._refuse(self._too_old())
        newest = self._readings.newest
        assert newest is not None
        return newest

    def _check_reach(self, pose: Array) -> None:
        """Raises ValueError for a tip that is further from the base than the arm reaches."""
        position = pose[:3, 3]
        from_base = position - self._arm.base
        distance = float(np.linalg.norm(from_base))
        reach = STRETCH * self._arm.length
        if distance > reach:
            raise ValueError(
                f"measurement.tip_pose puts the tip {distance:.3g} m from the base, and the arm"
                f" reaches {reach:.3g} m: is it in m, in the scene's world frame?"
            )

    def _has_jumped(self, pose: Array) -> bool:
        """Whether a tip is farther from where it was than it can have moved.

        Raises ValueError for MOST_JUMPS in a row, and warns of one before.
        """
        newest = self._readings.newest
        if newest is None or newest.tip_pose is None:
            return False
        newest_position = newest.tip_pose[:3, 3]
        difference = pose[:3, 3] - newest_position
        distance = float(np.linalg.norm(difference))
        # after a late period the next one is short, and the pose as old as ever
        duration = max(self._readings.age_of_pose, self._period)
        by_noise = NOISY * self._arm.length
        by_motion = self._arm.top_speed * duration
        farthest = by_noise + by_motion
        if distance <= farthest:
            self._jumps = 0
            return False
        self._jumps += 1
        text = (
            f"measurement.tip_pose jumps by {distance:.3g} m within {1e3 * duration:.0f} ms, in"
            f" which the tip moves by {farthest:.3g} m at most: did the tracker take another"
            " marker for the tip?"
        )
        if self._jumps == MOST_JUMPS:
            raise ValueError(f"{text} It is the second time in a row")
        warnings.warn(f"{text} This pose is left out", MeasurementWarning, stacklevel=2)
        return True

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
        # time that has passed, so that a late period and the short ones after it change no more
        # than the rate; at most a period, so that a pause leads to no jump
        since_sent = self.clock.now() - self._sent_at
        elapsed = min(since_sent, self._period)
        is_limited = np.isfinite(self.rate)
        if is_limited:
            most = self.rate * elapsed
        else:
            most = np.inf
        try:
            asked = checked_array("command", command, self.slack.shape)
            # from slack, which may lie beneath the limits, it rises evenly
            lowest = np.minimum(least, self._sent)
            within = np.clip(asked, lowest, greatest)
            lower = self._sent - most
            upper = self._sent + most
            next_command = np.clip(within, lower, upper)
            answer = self._send(next_command)
            self._sent_at = self.clock.now()
            if answer is None:
                sent = None
            else:
                sent = self._checked_answer(answer)
        except Exception as error:
            self.fail(f"writing failed: {first_line(error)}", error)
        if self.stopped is not None:  # while the call hung
            send_on_the_way(self._send_slack, self.slack, self.slack, self.stopped)
        self._refuse()
        if sent is None:
            return self._sent.copy()
        return sent

    def _checked_answer(self, answer: Any) -> Array:
        """Command (n_a,) that a robot says it sent.

        Raises ValueError for one that cannot be.
        """
        sent = checked_array("what write returns", answer, self.slack.shape)
        least, greatest = self._limits.T
        margin = ROUNDING * (greatest - least)
        lower = np.minimum(least, self.slack)
        floor = lower - margin
        is_above = sent >= floor
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
            done = self.order_stop(cause)
            done.wait(2.0 * (TRYING + HANGING))
        return self.stopped or Stop(cause)

    def order_stop(self, cause: str) -> threading.Event:
        """Has the watchdog let the tendons go; returns what is set when it has.

        It waits for nothing, so that handlers of signals may call it.
        """
        done = threading.Event()
        self._newest_order = done
        self._orders.put((cause, done))
        return done

    @property
    def is_letting_go(self) -> bool:
        """Whether a stop was ordered and is not over."""
        return not (self._newest_order.is_set() or self._closed)

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
            HOLDERS.remove(self)

    def _watch(self) -> None:
        """Watches the newest measurement's age until the robot is closed.

        The watchdog lets the tendons go when it is told to.
        """
        while not self._closed:
            try:
                timeout = LOOKS * self._period
                cause, done = self._orders.get(timeout=timeout)
            except Empty:
                # where time stands still, the loop itself looks as it reads
                if self.clock.real:
                    cause = self._too_old()
                else:
                    cause = ""
                if cause:
                    self._go_slack(Stop(cause))
                continue
            if self.stopped is None:
                self._go_slack(Stop(cause))
            elif not self.stopped.slack:
                send_on_the_way(self._send_slack, self.slack, self.slack, self.stopped)
            done.set()

    def _go_slack(self, stop: Stop) -> None:
        """Begins a stop, after which nothing else is sent, and goes through with it."""
        self.stopped = stop
        let_go(self._send_slack, self._sent, self.slack, stop, self.clock)

    def _send(self, command: Array) -> Any:
        """Sends a command (n_a,), unless the robot was stopped; returns what `write` does."""

        def send() -> Any:
            if self.stopped is not None:
                return None
            answer = self.robot.write(command.copy())
            self._sent = command
            return answer

        return self._turns.take(send, TRYING)

    def _send_slack(self, command: Array) -> None:
        """Sends a command (n_a,) on the way to slack, also while another call hangs."""

        def send() -> None:
            self.robot.write(command.copy())
            self._sent = command

        self._turns.take(send, HANGING)

    def _too_old(self) -> str:
        """Cause of a stop where the newest measurement is too old; "": it is not."""
        age = self._readings.age
        if self.stopped is not None or age <= self._patience:
            return ""
        return f"no reading for {1e3 * age:.0f} ms{self._allowed}"

    def _refuse(self, cause: str = "") -> None:
        """Raises RobotStopped after a stop, or for a cause of one."""
        if cause or self.stopped is not None:
            self.fail(cause)
