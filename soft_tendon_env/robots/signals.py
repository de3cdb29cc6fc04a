"""Signals that end or suspend a process, while robots may pull: each is told to the robots, which let go, and then acts as Ctrl-C does.

A handler may run between any two instructions, so that raising there could cut short whatever lets the tendons go. Telling cannot; and only
the first signal raises KeyboardInterrupt: those within PATIENCE after it, and while a run is wound up, are told alone. Signals that are
ignored, as SIGHUP under `nohup` and SIGINT in the background of a shell, stay ignored, and handlers that others have set stay.
"""

import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from types import FrameType
from typing import Any

ENDS = ("INT", "TERM", "HUP", "QUIT", "TSTP", "TTIN", "TTOU", "ALRM", "USR1", "USR2", "XCPU", "VTALRM", "PROF", "POLL", "PWR", "BREAK")
"""Signals whose default is the end, or a halt, of the process; those that the operating system has."""
PATIENCE = 3.0
"""Time [s] after a KeyboardInterrupt in which further signals are told alone: letting go takes less."""
Teller = Callable[[str], object]


class Signals:
    """Handlers of the process, as long as somebody wants to be told. Only the main thread can set them: elsewhere nothing happens."""

    def __init__(self) -> None:
        self._told, self._before = list[Teller](), dict[int, Any]()
        self._quiet_until = -math.inf

    def hold(self, tell: Teller) -> None:
        """From now on `tell` is called with the cause; it should do no more than to note it."""
        if not _in_main_thread() or tell in self._told:
            return
        if not self._told:
            self._quiet_until = -math.inf
        self._told.append(tell)
        for number in (getattr(signal, f"SIG{name}") for name in ENDS if hasattr(signal, f"SIG{name}")):
            if (handler := signal.getsignal(number)) in (signal.SIG_DFL, signal.default_int_handler):
                self._before[number] = handler
                signal.signal(number, self._handle)

    def drop(self, tell: Teller) -> None:
        """Tell it no more; the handlers of before come back after the last one."""
        if not _in_main_thread() or tell not in self._told:
            return
        self._told.remove(tell)
        if not self._told:
            for number, handler in self._before.items():
                signal.signal(number, handler)
            self._before.clear()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Context in which signals raise KeyboardInterrupt within `acting`, else, or where that was held up, at its end."""
        causes = list[str]()
        self.hold(causes.append)
        self._quieten(math.inf)
        try:
            yield
        finally:
            self.drop(causes.append)
        if causes:
            raise KeyboardInterrupt(causes[0])

    @contextmanager
    def acting(self) -> Iterator[None]:
        """Context, within `held`, in which signals raise KeyboardInterrupt at once."""
        self._quieten(-math.inf)
        try:
            yield
        finally:
            self._quieten(math.inf)

    def _quieten(self, until: float) -> None:
        if _in_main_thread():
            self._quiet_until = until

    def _handle(self, number: int, frame: FrameType | None) -> None:
        cause = f"interrupted by {signal.Signals(number).name}{' (Ctrl-C)' if number == signal.SIGINT else ''}"
        for tell in self._told:
            tell(cause)
        if perf_counter() >= self._quiet_until:
            self._quiet_until = perf_counter() + PATIENCE
            raise KeyboardInterrupt(cause)


SIGNALS = Signals()
"""Those of this process."""


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
