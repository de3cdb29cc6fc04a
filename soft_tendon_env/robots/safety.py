"""Safe commands: limits of size and rate, and a watchdog by which the tendons go slack, whatever ends a run.

    no reading for some periods, a policy that hangs       the watchdog, a thread of its own, or the next reading
    a loop that is some periods behind its deadlines       the next period
    an exception of the robot (a lost port) or the policy  where it is raised
    Ctrl-C, the end of the run                             `close`

All end in `stop`: the command goes to slack evenly within RAMP, in a thread that Ctrl-C does not reach. Where writing fails it is tried
again until that time has passed twice; motors should have a watchdog of their own for a port that is lost, see dynamixel.py.
"""

import threading
from dataclasses import dataclass, field

import numpy as np

from soft_tendon_env.robots.clock import Clock, RealClock
from soft_tendon_env.robots.protocol import Measurement, Robot, checked_measurement
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.messages import UserError, first_line
from soft_tendon_env.tools.types import Array

RAMP = 0.03
"""Time [s] in which tendons go slack: sudden enough to be safe, and not a blow."""
RAMP_STEPS = 6
LOOKS = 4
"""How often a period the watchdog looks."""


class RobotStopped(UserError):
    """Raised by whatever would go on with a robot that was stopped; says why it was."""


@dataclass
class Stop:
    """Course of an emergency stop, or of the end of a run.

    cause: why; slack: whether the last command, which lets the tendons go, was sent; seconds: from the cause to then [s]; time [s] since
    the cause and command (n_a,) of what was sent on the way; failures: what the robot raised meanwhile.
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
        period: of control [s].
        rate: greatest change of a command in a second; None: any.
        patience: periods without a new reading, or behind the deadlines, after which the arm is let go.
        dry: read alone, and send nothing.
    """

    def __init__(self, robot: Robot, limits: Array, sensors: int, period: float, rate: float | None, patience: int, dry: bool) -> None:
        self.robot, self.dry, self.slack = robot, dry, slack_command(robot, limits)
        self.senses = tuple(name for name in robot.senses if sensors or not name.startswith("strain"))
        self.clock: Clock = getattr(robot, "clock", None) or RealClock()
        self._limits, self._sensors = limits, sensors
        self._most = np.inf if rate is None else rate * period
        self._patience, self._look = patience * period, period / LOOKS
        self._io, self._state, self._over = threading.Lock(), threading.Lock(), threading.Event()
        self._ramp: threading.Thread | None = None
        self._closed = False
        self.stopped: Stop | None = Stop("it has not begun", slack=True)
        self._sent, self._fresh, self._measured = self.slack.copy(), 0.0, -np.inf

    def begin(self) -> None:
        """Begins, or begins again after a stop, with slack tendons: from now on the watchdog looks."""
        self.stop("it begins again")
        with self._state:
            self.stopped, self._ramp, self._over = None, None, threading.Event()
            self._sent, self._fresh = self.slack.copy(), self.clock.now()
        if self.clock.real:
            threading.Thread(target=self._watch, args=(self._over,), name="watchdog", daemon=True).start()

    def read(self) -> Measurement:
        """The newest measurement. Raises RobotStopped, also after a reading that fails or is as old as the watchdog's patience."""
        self._refuse()
        try:
            with self._io:
                given = self.robot.read()
            found = checked_measurement(given, self.senses, self.slack.size, self._sensors)
        except Exception as error:
            self._fail(f"reading failed: {first_line(error)}", error)
        if found.time != self._measured:
            self._measured, self._fresh = found.time, self.clock.now()
        self._look_at_age()
        self._refuse()
        return found

    def write(self, command: Array) -> Array:
        """Sends a command (n_a,) within limits and rate; returns what was sent. Raises RobotStopped, also where it cannot be sent."""
        self._refuse()
        if not np.isfinite(command).all():
            self._fail(f"the command was {command.tolist()}", None)
        held = np.clip(np.clip(command, *self._limits.T), self._sent - self._most, self._sent + self._most)
        try:
            self._sent = self._send(held)
            if self.stopped is not None:  # meanwhile: what came last should be slack
                self.stop(self.stopped.cause)
                self._sent = self._send(self.slack)
        except Exception as error:
            self._fail(f"writing failed: {first_line(error)}", error)
        self._refuse()
        return self._sent.copy()

    def look_at_lateness(self, late: float) -> None:
        """Stops where a period begins so late [s] that the loop does not catch up any more. Raises RobotStopped."""
        if late > self._patience:
            self._fail(f"the loop is {1e3 * late:.0f} ms behind its deadlines", None)

    def stop(self, cause: str) -> Stop:
        """Lets the tendons go slack, and waits until they are. The first cause counts; later calls wait too."""
        with self._state:
            if self.stopped is None:
                self.stopped = Stop(cause)
                self._over.set()
                self._ramp = threading.Thread(target=self._go_slack, args=(self.stopped, self.clock.now()), name="slack")
                self._ramp.start()
            found, ramp = self.stopped, self._ramp
        if ramp is not None:
            ramp.join()
        return found

    def close(self) -> Stop:
        """Stops, and lets go of the robot, once; where that fails, as on a port that is lost, it stands among the failures."""
        done = self.stop("the run ended")
        if not self._closed:
            self._closed = True
            try:
                self.robot.close()
            except Exception as error:
                done.failures.append(first_line(error))
        return done

    def _go_slack(self, stop: Stop, began: float) -> None:
        """The ramp, and the last command again as long as it fails."""
        first = self._sent
        for k in range(1, 2 * RAMP_STEPS + 1):
            share = min(k / RAMP_STEPS, 1.0)
            try:
                self._sent = self._send(first + share * (self.slack - first), RAMP / RAMP_STEPS)
                stop.slack = share == 1.0
            except Exception as error:
                stop.failures.append(first_line(error))
            stop.seconds = self.clock.now() - began
            stop.time.append(stop.seconds)
            stop.command.append(self._sent.tolist())
            if stop.slack:
                return
            self.clock.wait_until(began + k * RAMP / RAMP_STEPS)

    def _send(self, command: Array, patience: float = -1.0) -> Array:
        """Sends a command, after waiting so long [s] for a reading or a writing that hangs; -1: until it is over."""
        if self.dry:
            return command
        alone = self._io.acquire(timeout=patience)
        try:
            return checked_array("what write returns", self.robot.write(command.copy()), command.shape)
        finally:
            if alone:
                self._io.release()

    def _watch(self, over: threading.Event) -> None:
        """The watchdog, until the robot is stopped."""
        while not over.wait(self._look):
            self._look_at_age()

    def _look_at_age(self) -> None:
        """Stops where the newest measurement is too old."""
        age = self.clock.now() - self._fresh
        if age > self._patience and self.stopped is None:
            self.stop(f"no reading for {1e3 * age:.0f} ms")

    def _refuse(self) -> None:
        if self.stopped is not None:
            self.stop(self.stopped.cause)
            raise RobotStopped(self.stopped.cause)

    def _fail(self, cause: str, error: Exception | None) -> None:
        raise RobotStopped(self.stop(cause).cause) from error


def slack_command(robot: Robot, limits: Array) -> Array:
    """Command (n_a,) at which no tendon pulls: no tension, or all that an actuator can let out, the least of its limits (n_a, 2)."""
    return np.zeros(len(limits)) if robot.command_unit == "N" else limits[:, 0].copy()
