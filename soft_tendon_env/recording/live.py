"""Live view: episodes streamed to the Rerun viewer while they run.

They run no faster than their own clock; `render_mode="human"`.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium.error import Error

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.recording.rerun_stream import RerunStream
from soft_tendon_env.recording.wrappers import RowRecorder

PORT = 9876  # at which Rerun's viewers listen by default
# [s] that the viewer may take to open: one, or a few without a graphics processor
OPENS_WITHIN = 20.0
SETTLES = 0.5  # [s] in which a viewer that listens may still find that it can open no window
LOOKS_EVERY = 0.05  # [s] between looks at whether it has opened
PICTURE_PERIOD = 0.04  # [s] of wall-clock time between parts that are sent: 25 a second look smooth
LAG = 0.2  # [s] from which on a simulation that is late does not try to catch up with the clock
ROWS = 6  # of a vector environment that are shown, the first ones
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Variables of the environment of which one is set where windows can be opened, on Linux."""


class RerunViewer(RerunStream):
    """Rerun viewer on this machine that shows at once what is written.

    It is one that listens at `port`, else one that is opened.

    It stays open when this is closed. Raises gymnasium.error.Error where no window can be opened.
    """

    live = True

    def __init__(self, port: int) -> None:
        if not is_open(port):
            open_viewer(port)
        super().__init__("soft_tendon_env", "the viewer")
        self._open_recording().connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy")


class LiveRows:
    """Shows rows of running episodes in the viewer, no faster than their own clock.

    Closing the viewer's window does no harm.
    """

    def __init__(self, episodes: Episodes) -> None:
        """Raises gymnasium.error.Error where no viewer can be opened."""
        self._episodes = episodes
        self._viewer = RerunViewer(PORT)
        self._recorders = dict[int, RowRecorder]()
        self._due = -np.inf  # [s] of the clock, when the next step is to be shown
        for row in range(min(episodes.size, ROWS)):
            if episodes.size == 1:
                name = "arm"
            else:
                name = f"row_{row}"
            self._viewer.add_arm(name, episodes.model)
            self._recorders[row] = RowRecorder(self._viewer, name, episodes, row, PICTURE_PERIOD)

    def begin(self, members: Iterable[int]) -> None:
        """New episodes of the rows `members`."""
        for recorder in self._shown(members):
            recorder.begin()

    def step(self, members: Iterable[int]) -> None:
        """Sends where the rows `members` are after a step, and waits for the next one's time."""
        for recorder in self._shown(members):
            recorder.step()
        now = time.perf_counter()
        self._due += self._episodes.period
        if self._due < now - LAG:  # one that is late does not hurry afterwards
            self._due = now
        time.sleep(max(0.0, self._due - now))

    def frames(self) -> None:
        """Send what is at hand; there are no pictures to return."""
        for recorder in self._recorders.values():
            recorder.flush()

    def close(self) -> None:
        """Send what is at hand; the viewer stays open."""
        for recorder in self._recorders.values():
            recorder.finish()
        self._viewer.close()

    def _shown(self, members: Iterable[int]) -> Iterable[RowRecorder]:
        return [self._recorders[row] for row in members if row in self._recorders]


def is_open(port: int) -> bool:
    """True where something listens at this port of this machine."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("127.0.0.1", port)) == 0


def open_viewer(port: int) -> None:
    """Opens the Rerun viewer in a process of its own, and waits until it listens.

    No Ctrl-C reaches it. Raises gymnasium.error.Error.
    """
    is_linux = sys.platform.startswith("linux")
    has_display = any(os.environ.get(name) for name in DISPLAYS)
    if is_linux and not has_display:
        raise Error(
            f"the Rerun viewer needs a display, and none of {', '.join(DISPLAYS)} is set: use"
            ' render_mode="rgb_array" or RecordRollout, or start a viewer first (`rerun'
            " --headless`)"
        )
    # a process of its own group: Ctrl-C ends the simulation and leaves the viewer
    command = [
        sys.executable,
        "-m",
        "rerun_cli",
        "--port",
        str(port),
        "--bind",
        "127.0.0.1",
        "--expect-data-soon",
    ]
    quiet: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    environment = {**os.environ, "RERUN_APP_ONLY": "true"}  # no questions about analytics
    process = subprocess.Popen(command, env=environment, start_new_session=True, **quiet)
    # it listens before it finds out whether it can open a window
    end = time.monotonic() + OPENS_WITHIN
    while not is_open(port) and process.poll() is None and time.monotonic() < end:
        time.sleep(LOOKS_EVERY)
    time.sleep(SETTLES)
    has_ended = process.poll() is not None
    if has_ended or not is_open(port):
        raise Error("the Rerun viewer did not open; `rerun` in a terminal says why")
