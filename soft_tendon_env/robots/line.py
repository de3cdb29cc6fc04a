"""Thread that makes a robot's calls, so that one that never returns holds up neither the control loop nor the watchdog."""

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from time import perf_counter
from typing import Any

Answer = SimpleQueue[tuple[Any, BaseException | None]]
"""Queue for the result of a call, or for what it raised."""
Calls = SimpleQueue[tuple[str, Callable[[], Any], Answer] | None]
"""Calls by their names in messages; None: no more."""


class Line:
    """Calls of a robot, one after another, in a thread of their own.

    Python cannot end a call that hangs. It is left behind with its thread, a daemon that does not keep the process from ending, and another
    thread makes the next calls. late: called in the thread that was left behind, where its call returns after all.
    """

    def __init__(self, late: Callable[[], object]) -> None:
        self._late = late
        self._busy: tuple[str, Answer, float] | None = None  # the call that goes on, since when
        self._begin()

    def ask(self, limit: float, name: str, function: Callable[[], Any]) -> Any:
        """Result of a call, after those before it. Raises what it raises, TimeoutError where there is none after `limit` [s], of which the
        call that goes on has used up to 0.7."""
        answer, calls, busy = Answer(), self._calls, self._busy
        used = 0.0 if busy is None else perf_counter() - busy[2]
        calls.put((name, function, answer))
        try:
            found, error = answer.get(timeout=max(limit - used, 0.3 * limit))
        except Empty:
            busy, late = self._busy, TimeoutError(f"{self.hanging(0.0) or name} does not return")
            if calls is self._calls:
                self._begin()
                if busy is not None:
                    busy[1].put((None, late))  # whoever waits for that goes on
            raise late from None
        if error is not None:
            raise error
        return found

    def hanging(self, limit: float) -> str:
        """Name of a call that has gone on for longer than `limit` [s]; "": none."""
        busy = self._busy
        return busy[0] if busy is not None and perf_counter() - busy[2] > limit else ""

    def end(self) -> None:
        """Ends the thread."""
        self._calls.put(None)

    def _begin(self) -> None:
        self._calls = Calls()
        threading.Thread(target=self._serve, args=(self._calls,), name="robot", daemon=True).start()

    def _serve(self, calls: Calls) -> None:
        while (call := calls.get()) is not None:
            name, function, answer = call
            self._busy = name, answer, perf_counter()
            found, raised = None, None
            try:
                found = function()
            except BaseException as error:  # KeyboardInterrupt too: whoever asked gets it
                raised = error
            if calls is not self._calls:
                self._late()
                return
            self._busy = None
            answer.put((found, raised))
