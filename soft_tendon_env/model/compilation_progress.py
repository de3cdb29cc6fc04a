"""Time that a compilation still takes: lines on stderr, while a first use compiles all kernels."""

import time
from collections.abc import Callable
from typing import Any

from numba import config
from numba.core import event

from soft_tendon_env.compiler.kept_code import cache_folder, is_of_package
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.messages import naming, say_once

KERNELS = 262
"""Kernels that the first step of an environment needs, if none is kept: as counted on `paper` and
`three_tendon` in TipPose and `two_segment_six` in Shape, without effects."""

ADDED = {"contact": 77, "tendon_friction": 50}
"""Kernels that an effect adds, as counted in `paper_among_obstacles` and `three_tendon`. Of several
effects the most counts, for they share most of these kernels."""

ADDED_BY_OTHERS = 25
"""Kernels that gravity adds, and about as many as any other effect: gravity and a fluid add 29."""

GROWTH = 1.25
"""Exponent of the share of kernels in the share of time, for the larger kernels come later: fitted
to these compilations, whose CPU time to go it tells to 40 % from 50 kernels on."""

FIRST_LINE = 10.0
"""Time [s] of compilation after which the first line comes."""

NEXT_LINE = 1.5
"""Factor of that time from a line to the next: a compilation of five minutes has nine lines."""


class CompilationProgress(event.Listener):
    """Counts the kernels that numba compiles, and says how long the others will take.

    Only while no kernel was kept before: how many are missing is not known otherwise.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._scene = ""  # its name
        self._kernels = KERNELS  # in all
        self._clock = clock
        self._is_first: bool | None = None  # None: nothing was compiled yet
        self._done = 0
        self._open = 0  # kernels under way: each waits for those that it calls
        self._began = 0.0  # when the outermost of them began
        self._spent = 0.0  # on the outermost ones before it
        self._next_line = FIRST_LINE  # time spent at which it comes

    def concerns(self, scene: Scene) -> None:
        """Names the scene whose kernels are compiled from now on, and counts them."""
        self._scene = scene.name
        added = [ADDED.get(name, ADDED_BY_OTHERS) for name in scene.effects.chosen()]
        self._kernels = KERNELS + max(added, default=0)

    def silence(self) -> None:
        """Say nothing in this process."""
        self._is_first = False

    def on_start(self, event: Any) -> None:
        """A kernel is compiled, perhaps for another one."""
        if not _is_kernel(event):
            return
        if self._is_first is None:
            self._is_first = not _any_kept()
        if self._open == 0:
            self._began = self._clock()
        self._open += 1

    def on_end(self, event: Any) -> None:
        """A kernel is done: say how long the others will take, if it is time for a line."""
        if not _is_kernel(event):
            return
        self._open -= 1
        self._done += 1
        spent = self._spent + self._clock() - self._began
        if self._open == 0:
            self._spent = spent
        if self._is_first and self._done < self._kernels and spent >= self._next_line:
            self._next_line = NEXT_LINE * spent
            share = (self._done / self._kernels) ** GROWTH
            to_go = spent / share - spent
            with naming(f"scene {self._scene!r}"):
                say_once(
                    f"{self._done} of about {self._kernels} kernels compiled,"
                    f" about {to_go:.0f} s to go until an environment's first step"
                )


def _is_kernel(event: Any) -> bool:
    """Whether an event of numba is about a function of the package."""
    # a loop that numba lifts out of a function of users has none
    function = getattr(event.data["dispatcher"], "py_func", None)
    return function is not None and is_of_package(function)


def _any_kept() -> bool:
    """Whether there is machine code of an earlier compilation."""
    folder = cache_folder()
    return folder is not None and any(folder.glob("*.json"))


PROGRESS = CompilationProgress()
"""Progress of all compilation in this process."""

if not config.DISABLE_JIT:
    event.register("numba:compile", PROGRESS)
