"""Safe commands: limits of size and rate, checks of what is measured, and a watchdog by which the tendons go slack, whatever ends a run.

docs/how_to/robots.md says who notices what. All ends in the hands of the watchdog, a thread of its own: the command goes to slack evenly
within RAMP. Whoever stops the robot, as signals do (signals.py), tells it by a queue, which nothing can interrupt, and waits. Calls that
never return are left behind (line.py). Where writing fails it is tried again for TRYING, and once more by every later `stop`; motors should
have a watchdog of their own for a port that is lost, see dynamixel.py.
"""

import atexit
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from time import perf_counter
from typing import Any, NoReturn

import numpy as np

from soft_tendon_env.robots.clock import Clock, RealClock
from soft_tendon_env.robots.line import Line
from soft_tendon_env.robots.protocol import Measurement, Robot, checked_measurement
from soft_tendon_env.robots.reach import Reach
from soft_tendon_env.robots.signals import SIGNALS
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.messages import UserError, first_line, say_once
from soft_tendon_env.tools.types import Array

RAMP = 0.03
"""Time [s] in which tendons go slack: sudden enough to be safe, and not a blow."""
RAMP_STEPS = 6
TRYING = 1.0
"""Time [s] for which slack is tried where it cannot be sent; a port that comes back does so within less."""
HANGING = 0.1
"""Time [s] that a call may take on the way to slack, and no less than a period; later it is left behind."""
LONGEST = 5.0
"""Time [s] after which a call that the watchdog does not judge hangs: of simulated arms, and `close`."""
LOOKS = 4
"""How often a period the watchdog looks."""
ROUNDING = 0.1
"""Share of the range of commands by which motors may round beyond its ends."""


class RobotStopped(UserError):
    """Raised by whatever would go on with a robot that was stopped; says why it was."""


@dataclass
class Stop:
    """Course of an emergency stop, or of the end of a run.

    cause: why; slack: whether the last command, which lets the tendons go, was sent; seconds: from the cause to then [s]; time [s] since
    the cause and command (n_a,) of what was sent on the way; failures: what the robot raised meanwhile, and calls that did not return.
    """

    cause: str
    slack: bool = False
    seconds: float = 0.0
    time: list[float] = field(default_factory=list)
    command: list[list[float]] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)


class SafeRobot:
    """Robot behind limits and a watchdog.

    Args:
        robot: see Robot.
        limits: (n_a, 2) of commands.
        sensors: number of strain sensors; where there are none, strains that the robot senses are left out.
        reach: of the tip, and period of control.
        rate: greatest change of a command in a second; None: any.
        patience: periods without a new reading, or behind the deadlines, after which the arm is let go.
        dry: read alone, and send nothing.
    """

    def __init__(self, robot: Robot, limits: Array, sensors: int, reach: Reach, rate: float | None, patience: int, dry: bool) -> None:
        self.robot, self.dry = robot, dry
        self.slack = np.zeros(len(limits)) if robot.command_unit == "N" else limits[:, 0].copy()  # no tension, or all that can be let out
        self.senses = tuple(name for name in robot.senses if sensors or not name.startswith("strain"))
        self.clock: Clock = getattr(robot, "clock", None) or RealClock()
        self._limits, self._sensors, self._reach = limits, sensors, reach
        self._most = np.inf if rate is None else rate * reach.period
        self._patience, self._look = patience * reach.period, reach.period / LOOKS
        self._hanging = max(HANGING, reach.period) if self.clock.real else TRYING
        self._closed = False
        self.stopped: Stop | None = Stop("it has not begun", slack=True)
        self._sent, self._fresh, self._began = self.slack.copy(), 0.0, 0.0
        self._newest: Measurement | None = None
        self._older = 0.0  # [s] by which measurements since the newest were older at most
        self._line = Line(self._slacken_late)
        self._told: SimpleQueue[tuple[str, SimpleQueue[None]]] = SimpleQueue()  # causes, and whom to answer
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()
        atexit.register(self.stop, "the interpreter ended")

    def begin(self) -> None:
        """Begins, or begins again after a stop, with slack tendons: from now on the watchdog looks."""
        self.stop("it begins again")
        SIGNALS.hold(self.tell)
        self._newest, self._older, self._fresh = None, 0.0, self.clock.now()
        self.stopped = None

    def read(self) -> Measurement:
        """The newest measurement. Raises RobotStopped, also after a reading that fails, that cannot be, or is as old as the watchdog's
        patience."""
        self._refuse()
        try:
            given = self._line.ask(LONGEST, "read", self.robot.read)
            found, newest = checked_measurement(given, self.senses, self.slack.size, self._sensors), self._newest
            if newest is None or found.time > newest.time:
                last = found if newest is None else newest
                if found.tip_pose is not None and last.tip_pose is not None:
                    own = self.clock.now() - self._fresh + self._reach.period  # [s], also where the robot counts otherwise
                    self._reach.check(found.tip_pose[:3, 3], last.tip_pose[:3, 3], min(found.time - last.time, own))
                self._newest, self._older, self._fresh = found, 0.0, self.clock.now()
            else:
                self._older = max(self._older, newest.time - found.time)
        except Exception as error:
            self.fail(f"reading failed: {first_line(error)}", error)
        if cause := self._too_old():
            self.stop(cause)
        self._refuse()
        assert self._newest is not None
        return self._newest

    def write(self, command: Array) -> Array:
        """Sends a command (n_a,) within limits and rate; returns what was sent. Raises RobotStopped, also where it cannot be sent."""
        self._refuse()
        if not np.isfinite(command).all():
            self.fail(f"the command was {command.tolist()}")
        least, greatest = self._limits.T
        wanted = np.clip(command, np.minimum(least, self._sent), greatest)  # from slack, which may lie beneath, it rises evenly
        held = np.clip(wanted, self._sent - self._most, self._sent + self._most)
        try:
            found = self._known(self._line.ask(LONGEST, "write", lambda: self._send(held, self.stopped is None)))
        except Exception as error:
            self.fail(f"writing failed: {first_line(error)}", error)
        self._refuse()
        return found

    def look_at_lateness(self, late: float) -> None:
        """Stops where a period begins so late [s] that the loop does not catch up any more. Raises RobotStopped."""
        if late > self._patience:
            self.fail(f"the loop is {1e3 * late:.0f} ms behind its deadlines")

    def tell(self, cause: str) -> "SimpleQueue[None]":
        """Has the watchdog let the tendons go, at any moment of any thread; the queue that is returned gets an entry when it has."""
        done: SimpleQueue[None] = SimpleQueue()
        self._told.put((cause, done))
        return done

    def stop(self, cause: str) -> Stop:
        """Lets the tendons go slack, and waits until they are, or cannot be. The first cause counts; later calls wait, and try again."""
        if not self._closed:
            with suppress(Empty):
                self.tell(cause).get(timeout=2.0 * TRYING + 3.0 * self._hanging)
        return self.stopped or Stop(cause)

    def close(self) -> Stop:
        """Stops, and lets go of the robot, once; where that fails, as on a port that is lost, it stands among the failures."""
        done = self.stop("the run ended")
        if not self._closed:
            try:
                self._line.ask(LONGEST, "close", self.robot.close)
            except Exception as error:
                done.failures.append(first_line(error))
            self._closed = True
            self._line.end()
            atexit.unregister(self.stop)
            SIGNALS.drop(self.tell)
        return done

    def _watch(self) -> None:
        """The watchdog: looks at the newest measurement's age, and lets the tendons go when it is told to, until the robot is closed."""
        while not self._closed:
            done = None
            try:
                cause, done = self._told.get(timeout=self._look)
            except Empty:
                cause = self._too_old() if self.clock.real else ""
            if cause and self.stopped is None:
                self._go_slack(cause)
            elif done is not None and self.stopped is not None and not self.stopped.slack:
                self._try(self.stopped, self.slack)
            if done is not None:
                done.put(None)

    def _go_slack(self, cause: str) -> None:
        """The ramp, and the last command again as long as it fails. Steps are left out where the robot takes longer for one."""
        self._began, first, step, k = self.clock.now(), self._sent, RAMP / RAMP_STEPS, 0
        self.stopped = stop = Stop(cause)
        until = perf_counter() + TRYING + self._hanging
        while not stop.slack and self.clock.now() - self._began < TRYING and perf_counter() < until:
            k = max(k + 1, int((self.clock.now() - self._began) / step))
            share = min(k / RAMP_STEPS, 1.0)
            self._try(stop, (1.0 - share) * first + share * self.slack)
            if not stop.slack:
                self.clock.wait_until(self._began + k * step if k < 2 * RAMP_STEPS else self.clock.now() + RAMP)

    def _try(self, stop: Stop, command: Array) -> None:
        """Sends a command on the way to slack; what comes of it stands in the stop."""
        try:
            self._line.ask(self._hanging, "write", lambda: self._send(command))
        except BaseException as error:  # also those that are no Exception: there is nobody to raise them to
            stop.failures.append(first_line(error))
            stop.seconds = self.clock.now() - self._began
            return
        stop.seconds = self.clock.now() - self._began
        stop.time.append(stop.seconds)
        stop.command.append(command.tolist())
        stop.slack = bool((command == self.slack).all())

    def _send(self, command: Array, allowed: bool = True) -> Any:
        """Sends a command (n_a,), clipped to the limits and slack, in the line's thread; returns what `write` does."""
        if not allowed:
            return None
        held = np.clip(command, np.minimum(self._limits[:, 0], self.slack), self._limits[:, 1])
        found = None if self.dry else self.robot.write(held.copy())
        self._sent = held
        return found

    def _known(self, found: Any) -> Array:
        """Command that the motors have, of what `write` returned; where that can be none, as their steps or a load cell, what was sent."""
        if found is None:
            return self._sent.copy()
        given, (least, greatest) = checked_array("what write returns", found, self.slack.shape), self._limits.T
        slop = ROUNDING * (greatest - least)
        if ((given >= least - slop) & (given <= greatest + slop)).all():
            return given
        unit = self.robot.command_unit
        say_once(f"write of {type(self.robot).__name__} returns no command [{unit}]: it is beyond the limits, and what was sent counts")
        return self._sent.copy()

    def _slacken_late(self) -> None:
        """After a call that had been left behind: if it was a command, it came after slack."""
        if (stop := self.stopped) is not None:
            with suppress(Exception):
                self._send(self.slack)
                stop.slack = True

    def _too_old(self) -> str:
        """Cause of a stop where the newest measurement is too old; "": it is not."""
        age = self.clock.now() - self._fresh
        if self.stopped is not None or age <= self._patience:
            return ""
        hanging, older = self._line.hanging(self._reach.period), self._older
        why = f": {hanging} does not return" if hanging else f": times of measurements go back, by {older:.3g} s" if older else ""
        return f"no reading for {1e3 * age:.0f} ms{why}"

    def _refuse(self) -> None:
        if self.stopped is not None:
            self.fail(self.stopped.cause)

    def fail(self, cause: str, error: Exception | None = None) -> NoReturn:
        """Stops, and raises RobotStopped with the first cause."""
        raise RobotStopped(self.stop(cause).cause) from error
