"""Drivers in a process of their own, which lets go where the program is silent or dies.

A program whose policy holds the interpreter, that was stopped or killed, can run no watchdog. The
driver, the last command and a watchdog live in another process here, in a session of its own, where
no signal of a terminal comes. Requests and answers are pickles over two pipes, numbered.
"""

import io
import itertools
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.robots.protocol import Measurement, Robot, Unit, check_robot
from soft_tendon_env.robots.signals import HOLDERS
from soft_tendon_env.robots.slack import HANGING, TRYING, Stop, Turns, let_go
from soft_tendon_env.tools.messages import first_line
from soft_tendon_env.tools.types import Array

SERVE = "from soft_tendon_env.robots.process import serve; serve()"
"""Program of the driver's process."""

LOOKS = 0.25
"""Share of the patience from one look of the driver's watchdog to the next."""

LONGEST_LOOK = 0.1
"""Time [s] from one look to the next at most, also while no patience is known."""

ANSWERS = 3.0 * TRYING
"""Time [s] that an answer may take: longer than any try of the driver's own."""
ENDING = 20.0
"""Time [s] that the process may take to end: that of an interpreter on a busy machine. The tendons
are slack before."""


class RobotLetGo(ConnectionError):
    """The driver's process has let the tendons go by itself; the message says why."""


class SteppedTime(ValueError):
    """A driver with a clock of its own, as of simulated arms, which real time does not concern."""


class Facts(NamedTuple):
    """Facts of a driver that its process tells as it begins."""

    command_unit: Unit
    senses: tuple[str, ...]
    is_stepped: bool  # whether it has a clock of its own


class RobotProcess:
    """Robot whose driver lives in a process of its own.

    That process has a watchdog: it lets the tendons go where no call comes for longer than the
    patience of the `RobotEnv`, and where this process ends, however it does.

    Args:
        make: class or function that makes the driver, of a module that can be imported.
        arguments: of it.
        options: keyword arguments of it.

    Raises:
        SteppedTime: for drivers with a clock of their own.
        TypeError: for what is no robot, or cannot be imported.
        Exception: what `make` raises.
    """

    def __init__(self, make: Callable[..., Robot], *arguments: Any, **options: Any) -> None:
        if make.__module__ == "__main__":
            raise TypeError(
                f"make is {make.__name__} of the program itself: put it into a module, which the"
                " driver's process can import"
            )
        self._waiting = dict[int, SimpleQueue[tuple[bool, Any]]]()  # for answers, by number
        self._numbers = itertools.count()
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,  # a request is one write, which no signal cuts
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests = self._process.stdin
        answers: Any = self._process.stdout  # raw, which a thread of its own reads
        reader = io.BufferedReader(answers)
        listener = threading.Thread(target=self._listen, args=(reader,), daemon=True)
        listener.start()
        try:
            # first where modules are found: what makes the driver may be in one of them
            self._ask("look_in", sys.path, longest=None)
            driver = partial(make, *arguments, **options)
            make_driver = pickle.dumps(driver)
            facts: Facts = self._ask("make", make_driver, longest=None)
            if facts.is_stepped:
                raise SteppedTime("a driver with a clock of its own needs no process")
        except BaseException:
            self._end()
            raise
        self.command_unit: Unit = facts.command_unit
        self.senses = facts.senses

    def watch(self, slack: Array, patience: float) -> None:
        """Begins, with slack tendons: from now on the driver's watchdog looks.

        Args:
            slack: command (n_a,) that lets the tendons go.
            patience: time [s] without a call after which they go slack.

        Raises:
            TimeoutError: where the driver's process gives no answer.
            ConnectionError: where it has ended.
        """
        self._ask("watch", slack, patience)

    def read(self) -> Measurement:
        """Reads the driver's newest measurement.

        Returns:
            The measurement.

        Raises:
            RobotLetGo: where the process has let the tendons go by itself.
            TimeoutError: where it gives no answer.
            ConnectionError: where it has ended.
            Exception: what the driver raises.
        """
        measured: Measurement = self._ask("read")
        return measured

    def write(self, command: Array) -> Array | None:
        """Sends a command.

        Args:
            command: (n_a,).

        Returns:
            What the driver returns: what was sent (n_a,), or None.

        Raises:
            RobotLetGo: where the process has let the tendons go by itself.
            TimeoutError: where it gives no answer.
            ConnectionError: where it has ended.
            Exception: what the driver raises.
        """
        sent: Array | None = self._ask("write", command)
        return sent

    def close(self) -> None:
        """Lets the tendons go, closes the driver and ends its process.

        Raises:
            TimeoutError: where it does not end.
            ConnectionError: where it had ended before.
            Exception: what the driver raises.
        """
        try:
            self._ask("close")
        finally:
            self._end()

    def _end(self) -> None:
        """Ends the process by closing its pipe. Raises TimeoutError where it goes on."""
        self._requests.close()
        try:
            self._process.wait(ENDING)
        except subprocess.TimeoutExpired:
            # it may be what lets the tendons go, and is not killed
            raise TimeoutError(f"the driver's process, {self._process.pid}, hangs") from None

    def _ask(self, name: str, *arguments: Any, longest: float | None = ANSWERS) -> Any:
        """Answer to a request, which takes at most `longest` [s]. Raises what it raises."""
        number = next(self._numbers)
        answers = SimpleQueue[tuple[bool, Any]]()
        self._waiting[number] = answers
        try:
            request = pickle.dumps((number, name, arguments))
            self._requests.write(request)
            is_value, value = answers.get(timeout=longest)
        except Empty:
            raise TimeoutError(f"the driver's process gives no answer to {name}") from None
        finally:
            # an answer that comes later is to nobody
            self._waiting.pop(number, None)
        if is_value:
            return value
        raise value

    def _listen(self, reader: BinaryIO) -> None:
        """Hands answers to who waits for them; in a thread that no signal interrupts."""
        while True:
            try:
                number, is_value, value = pickle.load(reader)
            except (EOFError, OSError, pickle.UnpicklingError):
                break
            answers = self._waiting.get(number)
            if answers is not None:
                answers.put((is_value, value))
        # the process has ended: whoever waits is told, and whoever asks cannot write
        for answers in [*self._waiting.values()]:
            answers.put((False, ConnectionError("the driver's process has ended")))
        reader.close()


class WatchedDriver:
    """Driver of a robot, its last command and its watchdog, in the driver's process.

    Args:
        robot: the driver.
        clock: by which it is silent.
    """

    def __init__(self, robot: Robot, clock: Clock) -> None:
        self.robot = robot
        self._clock = clock
        self._turns = Turns()
        self._stopping = threading.Lock()  # of the ramp
        self._slack = np.empty(0)
        self._sent = self._slack
        self.patience = np.inf  # [s]
        self._called = clock.now()  # [s] when the last call was answered
        self._is_letting_go = False
        self.stopped: Stop | None = Stop("the driver was not told to watch", slack=True)

    def watch(self, slack: Array, patience: float) -> None:
        """Begins with slack tendons; see RobotProcess."""
        self._slack = slack
        self._sent = slack
        self.patience = patience
        self._called = self._clock.now()
        self.stopped = None

    def read(self) -> Measurement:
        """The driver's newest measurement. Raises RobotLetGo, and what it raises."""
        self._refuse()
        measured: Measurement = self._turns.take(self.robot.read, TRYING)
        self._called = self._clock.now()
        return measured

    def write(self, command: Array) -> Array | None:
        """Sends a command (n_a,). Raises RobotLetGo after a stop, but for slack."""
        is_slack = np.array_equal(command, self._slack)
        if not is_slack:
            self._refuse()
        send = partial(self._send, command)
        sent: Array | None = self._turns.take(send, TRYING)
        self._called = self._clock.now()
        return sent

    def look(self) -> None:
        """Lets the tendons go where the program was silent for too long."""
        silence = self._clock.now() - self._called
        is_slack = np.array_equal(self._sent, self._slack)
        is_silent = silence > self.patience
        if is_silent and not is_slack:
            self.let_go(
                f"no call for {1e3 * silence:.0f} ms: patience is {1e3 * self.patience:g} ms"
            )

    def let_go(self, cause: str) -> None:
        """Lets the tendons go, and waits until they are slack, or cannot be."""
        with self._stopping:
            if self.stopped is None:
                self.stopped = Stop(cause)
            self._is_letting_go = True
            let_go(self._send_slack, self._sent, self._slack, self.stopped, self._clock)
            self._is_letting_go = False

    @property
    def is_letting_go(self) -> bool:
        """Whether the ramp to slack goes on."""
        return self._is_letting_go

    def order_stop(self, cause: str) -> None:
        """Nothing: the signal ends `serve`, which lets the tendons go."""

    def close(self) -> None:
        """Lets the tendons go, and closes the driver."""
        self.let_go("the program has ended")
        self.robot.close()

    def _send(self, command: Array) -> Array | None:
        sent = self.robot.write(command.copy())
        self._sent = command
        return sent

    def _send_slack(self, command: Array) -> None:
        """Sends a command on the way to slack, also while another call hangs."""
        send = partial(self._send, command)
        self._turns.take(send, HANGING)

    def _refuse(self) -> None:
        """Raises RobotLetGo after a stop."""
        if self.stopped is not None:
            raise RobotLetGo(f"the driver's process has let the tendons go: {self.stopped.cause}")


def serve() -> None:
    """Serves the requests on standard input, in the driver's process, until it ends."""
    requests, answers = _own_pipes()
    driver: WatchedDriver | None = None
    try:
        while True:
            number, name, arguments = pickle.load(requests)
            try:
                if name == "look_in":
                    sys.path[:] = arguments[0]
                    value = None
                elif name == "make":
                    driver, value = _made(*arguments)
                else:
                    value = getattr(driver, name)(*arguments)
                answer = pickle.dumps((number, True, value))
            except Exception as error:
                message = (number, False, _portable(error))
                answer = pickle.dumps(message)
            answers.write(answer)
            if name == "close":
                driver = None  # there is no second time
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # the program has ended, or somebody ends this process
    finally:
        if driver is not None:
            driver.close()


def _own_pipes() -> tuple[Any, Any]:
    """Pipes of requests and answers; what the driver prints goes to standard error."""
    requests = open(os.dup(0), "rb")  # noqa: SIM115 (until the process ends)
    answers = open(os.dup(1), "wb", buffering=0)  # noqa: SIM115 (until the process ends)
    os.dup2(2, 1)
    return requests, answers


def _made(pickled: bytes) -> tuple[WatchedDriver | None, Facts]:
    """The driver, watched from now on, and its facts; without one for a driver in stepped time."""
    robot = pickle.loads(pickled)()
    check_robot(robot)
    is_stepped = hasattr(robot, "clock")
    senses = tuple(robot.senses)
    facts = Facts(robot.command_unit, senses, is_stepped)
    if is_stepped:
        robot.close()
        return None, facts
    driver = WatchedDriver(robot, Clock())
    HOLDERS.add(driver)
    watcher = threading.Thread(target=_watch, args=(driver,), daemon=True)
    watcher.start()
    return driver, facts


def _watch(driver: WatchedDriver) -> None:
    """Watchdog: looks at a driver for as long as the process lives."""
    while True:
        pause = min(LOOKS * driver.patience, LONGEST_LOOK)
        time.sleep(pause)
        driver.look()


def _portable(error: Exception) -> Exception:
    """The error as it can be sent to the program: of another type where pickle cannot."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(first_line(error))
    return error
