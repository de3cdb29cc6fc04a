"""What a simulator offers to benchmarks/peers.py, and how its time is taken."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.scene.scene import Scene

Array = NDArray[np.float64]
HOLD = 0.02
"""Time [s] for which each row of tensions is held."""


class Motion(NamedTuple):
    """What came of a table of tensions."""

    # (rows + 1, 3) [m], at rest first, then at the end of each row; not finite where nothing came
    tip: Array
    cpu: float  # CPU seconds per simulated second
    told: str  # what the simulator said of trouble: an exception, a warning; "" if nothing
    restarted: bool = False  # whether it went back to its start by itself


Run = Callable[[Array], Motion]
"""Simulates a table of tensions (rows, n_a) [N], each row held for `HOLD`, from rest."""


class Setting(Protocol):
    """One way of simulating."""

    @property
    def label(self) -> str:
        """The setting in words, for the tables."""


class Simulator(Protocol):
    """A module of this folder."""

    NAME: str
    DISTRIBUTION: str  # its name in package indices
    SECONDS: float  # simulated at most, of each input
    HARD: Sequence[
        Setting
        # those tried under abrupt tensions too: one with steps of 10 ms, one that its users would
        # fall back on
    ]
    QUICK: Sequence[Setting]  # to try the benchmark

    @staticmethod
    def settings() -> Sequence[Setting]: ...

    @staticmethod
    def prepare(
        scene: Scene, setting: Setting
    ) -> Run | None: ...  # None: it has no model with this setting


def cpu_time(action: Callable[[], None]) -> float:
    """CPU seconds of the process for one call."""
    started = time.process_time()
    action()
    return time.process_time() - started
