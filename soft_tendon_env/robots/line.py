"""Thread that makes a robot's calls, so that one that never returns holds up neither the control loop nor the watchdog."""

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from time import perf_counter
from typing import Any, NamedTuple


class Call(NamedTuple):
    """A call that was asked for: its name in messages, the function, and where its result, or what it raised, goes."""

    name: str
    function: Callable[[], Any]
    answer: "SimpleQueue[tuple[Any, BaseException | None]]"


class Line:
    """Calls of a robot, one after another, in a thread of their own.

    Python cannot end a call that hangs. It is left behind with its thread, a daemon that does not keep the process from ending, and another
    thread makes the next calls. late: called in the thread that was left behind, where its call returns after all.
    """

    def __init__(self, late: Callable[[], object]) -> None:
        self._late = late
        self._busy: tuple[Call, float] | None = None  # and since when
        self._begin()

    def ask(self, limit: float, name: str, function: Callable[[], Any]) -> Any:
        """Result of a call, after those before it. Raises what it raises, TimeoutError where there is none after `limit` [s]."""
        call, calls = Call(name, function, SimpleQueue()), self._calls
        calls.put(call)
        try:
            found, error = call.answer.get(timeout=limit)
        except Empty:
            busy, late = self._busy, TimeoutError(f"{self.hanging(0.0) or name} does not return")
            if calls is self._calls:
                self._begin()
                if busy is not None:
                    busy[0].answer.put((None, late))  # whoever waits for that goes on
            raise late from None
        if error is not None:
            raise error
        return found

    def hanging(self, limit: float) -> str:
        """Name of a call that has gone on for longer than `limit` [s]; "": none."""
        busy = self._busy
        return busy[0].name if busy is not None and perf_counter() - busy[1] > limit else ""

    def end(self) -> None:
        """Ends the thread."""
        self._calls.put(None)

    def _begin(self) -> None:
        self._calls: SimpleQueue[Call | None] = SimpleQueue()
        threading.Thread(target=self._serve, args=(self._calls,), name="robot", daemon=True).start()

    def _serve(self, calls: "SimpleQueue[Call | None]") -> None:
        while (call := calls.get()) is not None:
            self._busy = call, perf_counter()
            answer: tuple[Any, BaseException | None]
            try:
                answer = call.function(), None
            except BaseException as error:  # KeyboardInterrupt too: whoever asked gets it
                answer = None, error
            if calls is not self._calls:
                self._late()
                return
            self._busy = None
            call.answer.put(answer)
