"""Slack tendons: the ramp of commands that leads there, tried again as long as it fails.

Calls of a robot come one at a time here too.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.types import Array

RAMP = 0.03
"""Time [s] in which tendons go slack, sudden enough to be safe and not a blow."""

RAMP_STEPS = 6
"""Commands on the way to slack."""

TRYING = 1.0
"""Time [s] for which slack is tried where it cannot be sent; a port that comes back does so within
less."""

HANGING = 0.1
"""Time [s] for which slack waits for another call of the robot; one that takes longer hangs."""


@dataclass
class Stop:
    """Course of an emergency stop, or of the end of a run."""

    cause: str  # why it began, in words
    slack: bool = False  # whether the last command, which lets the tendons go, was sent
    seconds: float = 0.0  # from the cause to then [s]
    failures: list[str] = field(default_factory=list)  # what the robot raised meanwhile


class Turns:
    """Calls of a robot one at a time; one that hangs is not waited for."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._hangs = False  # whether a call does not return

    def take(self, call: Callable[[], Any], longest: float) -> Any:
        """Result of a call, which waits at most `longest` [s] for the one that goes on."""
        if self._hangs:
            timeout = 0.0
        else:
            timeout = longest
        is_free = self._lock.acquire(timeout=timeout)
        self._hangs = not is_free
        try:
            return call()
        finally:
            if is_free:
                self._lock.release()


def let_go(
    send: Callable[[Array], Any], first: Array, slack: Array, stop: Stop, clock: Clock
) -> None:
    """Ramps commands to slack, and sends the last one again as long as it fails.

    Steps are left out where the robot takes longer for one.

    Args:
        send: sends a command (n_a,).
        first: command (n_a,) that was sent last.
        slack: command (n_a,) that lets the tendons go.
        stop: course of the stop, which is written here.
        clock: of the robot.
    """
    step = RAMP / RAMP_STEPS  # [s]
    k = 0
    began = clock.now()
    give_up = perf_counter() + TRYING  # also where the clock stands still
    while not stop.slack and clock.now() - began < TRYING and perf_counter() < give_up:
        elapsed = clock.now() - began
        steps_due = int(elapsed / step)
        k = max(k + 1, steps_due)
        share = min(k / RAMP_STEPS, 1.0)
        old_part = (1.0 - share) * first
        command = old_part + share * slack
        send_on_the_way(send, command, slack, stop)
        stop.seconds = clock.now() - began
        if not stop.slack:
            # a robot that does not take it is told less often
            is_ramp = k < 2 * RAMP_STEPS
            if is_ramp:
                next_time = began + k * step
            else:
                next_time = clock.now() + RAMP
            clock.wait_until(next_time)


def send_on_the_way(send: Callable[[Array], Any], command: Array, slack: Array, stop: Stop) -> None:
    """Sends a command on the way to slack; what comes of it stands in the stop."""
    try:
        send(command)
        is_slack = (command == slack).all()
        stop.slack = bool(is_slack)
    except BaseException as error:
        # also those that are no Exception: there is nobody to raise them to
        stop.failures.append(first_line(error))
