"""Signals that end or stop a process: every arm that holds tendons lets them go first.

This module alone installs handlers of robots. It counts the arms: the first takes the signals, and
the last gives them back.
"""

import os
import signal
import threading
from types import FrameType
from typing import Any, NoReturn, Protocol

UNCATCHABLE = ("SIGKILL", "SIGSTOP")
"""Signals that no program can catch."""

MACHINE_FAULTS = ("SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL")
"""Faults of machine code: a handler would return to the instruction that failed, over and over."""

HARMLESS = ("SIGCHLD", "SIGCLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO")
"""Signals that neither end nor stop a process unless it asks for that."""

NOT_TAKEN = (*UNCATCHABLE, *MACHINE_FAULTS, *HARMLESS)


class Holder(Protocol):
    """An arm whose tendons may be pulled."""

    @property
    def is_letting_go(self) -> bool:
        """Whether a stop was ordered and is not over."""

    def order_stop(self, cause: str) -> Any:
        """Has another thread let the tendons go, and does not wait for it."""


def ending_signals() -> list[int]:
    """Signals that end or stop a process by default, and that a program can catch."""
    left_out = set()
    for name in NOT_TAKEN:
        left_out.add(getattr(signal, name, None))  # no system has all
    numbers = (number for number in signal.valid_signals() if number not in left_out)
    return sorted(numbers)


def name_of(number: int) -> str:
    """Name of a signal; of those of real time most have a number alone."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


class Holders:
    """The arms of this process that hold tendons, and the signals that they share."""

    def __init__(self) -> None:
        self._arms = list[Holder]()
        self._before = dict[int, Any]()  # handlers by signal, to restore

    def add(self, arm: Holder) -> None:
        """Counts an arm, once, and takes the signals.

        It does so in the main thread alone: Python sets no handlers in others.
        """
        if arm not in self._arms:
            self._arms.append(arm)
        if threading.current_thread() is not threading.main_thread():
            return
        for number in ending_signals():
            handler = signal.getsignal(number)
            # others are ignored, as under nohup, or somebody handles them
            is_default = handler is signal.SIG_DFL
            if is_default or handler is signal.default_int_handler:
                self._before[number] = signal.signal(number, self._take)

    def remove(self, arm: Holder) -> None:
        """Counts an arm no more; the last one gives the signals back."""
        if arm in self._arms:
            self._arms.remove(arm)
        if not self._arms and threading.current_thread() is threading.main_thread():
            self._restore()

    def forget(self) -> None:
        """Counts no arm, in a process that was forked: the arms are its parent's."""
        self._arms.clear()

    def _restore(self) -> None:
        """Gives back the signals that nobody else has taken meanwhile."""
        for number, handler in self._before.items():
            if signal.getsignal(number) == self._take:
                signal.signal(number, handler)
        self._before.clear()

    def _take(self, number: int, frame: FrameType | None) -> None:
        """Handler: has all tendons let go, and raises KeyboardInterrupt, as Ctrl-C does."""
        if not self._arms:
            # the last arm was closed by another thread, which can restore no handler
            self._restore()
            signal.raise_signal(number)
            return
        is_any_letting_go = any(arm.is_letting_go for arm in self._arms)
        if is_any_letting_go:
            return  # a second Ctrl-C does not interrupt what lets the tendons go
        self._interrupt(f"interrupted by {name_of(number)}")

    def _interrupt(self, cause: str) -> NoReturn:
        """Orders every arm to stop before anybody can catch the exception."""
        for arm in self._arms:
            arm.order_stop(cause)
        raise KeyboardInterrupt(cause)


HOLDERS = Holders()
"""The arms of this process."""

if hasattr(os, "register_at_fork"):  # Windows has no forks
    os.register_at_fork(after_in_child=HOLDERS.forget)
