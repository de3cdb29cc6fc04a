"""Progress bars of long calls: on a terminal as tqdm draws them, in files and pipes a few lines."""

import math
import sys
from typing import Any

from tqdm import tqdm

from soft_tendon_env.tools.messages import QUIET

MOST_LINES = 10
"""Lines that a bar prints at most where there is no terminal."""

LINE = "{desc}: {percentage:.0f} %, {remaining_s:.0f} s to go"
"""Layout of these lines, see `bar_format` of tqdm."""

SHORTEST_DELAY = 1e-9
"""Time [s] that must have passed before anything is printed: it leaves out tqdm's line for 0 %."""


class ProgressLines(tqdm):
    """Progress as lines of text, for streams in which a bar cannot be drawn anew."""

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Print the state as a line.

        False: nothing is left on the stream to be cleared.
        """
        if msg is None:
            print(self, file=self.fp, flush=True)
        return False


def progress_bar(
    total: float, label: str | None, unit: str, layout: str | None = None
) -> "tqdm[Any]":
    """Makes a progress bar on stderr, to be closed by its user, who calls `update`.

    Args:
        total: number of units that are to be done.
        label: name of what is done; None: there is no bar.
        unit: name of a part of it.
        layout: tqdm's `bar_format` on a terminal, by default its usual one.

    Returns:
        tqdm's bar on a terminal; elsewhere MOST_LINES lines at most, with percentage and seconds to
        go; nothing under SOFT_TENDON_ENV_QUIET=1.
    """
    shared: dict[str, Any] = {
        "total": total,
        "desc": label,
        "unit": unit,
        "leave": False,
        "disable": QUIET or label is None,
    }
    if sys.stderr is not None and sys.stderr.isatty():
        return tqdm(**shared, bar_format=layout)
    return ProgressLines(
        **shared,
        bar_format=LINE,
        delay=SHORTEST_DELAY,
        miniters=total / MOST_LINES,
        mininterval=0.0,
        maxinterval=math.inf,  # otherwise tqdm prints more often where units take long
    )
