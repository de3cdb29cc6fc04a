"""Rest of an arm: speed of its tip over the last seconds, told from the noise of whatever measures it."""

import numpy as np
import scipy.fft

from soft_tendon_env.model.model import Model
from soft_tendon_env.model.step_control import slowest_vibration
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array, NotNegative, Positive

WINDOW = 2.0
"""Least time [s] over which the speed is measured: at 50 Hz and with noise of 2 mm, it shows a drift of 1.5 mm/s."""
READINGS = 20
"""Least number of readings of which the speed is measured."""
WOBBLE = 0.15
"""Time [s] whose way at the greatest speed of rest is the greatest spread of rest: of fast small motion, as filtered sensors show it."""
STANDS_OUT = 33.0
"""Power of a mode over the median of all, from which on it is motion: one of 10,000 modes of white noise has as much."""


class Rest(Configuration):
    """Greatest speed of an arm at rest, and the longest time for which it is waited for.

    Attributes:
        speed: of the tip, root mean square over the window, as a share of the arm's length per second. At 0.005 a tip that stays within
            0.075 % of the length, root mean square, is at rest too.
        wait: time [s] under the first command.
    """

    speed: Positive = 0.005
    wait: NotNegative = 60.0


REST = Rest()
"""Rest unless a user says otherwise."""


def window_of(model: Model) -> float:
    """Time [s] over which the speed is measured: at least half the slowest natural period, since a swing stands still where it turns."""
    return max(WINDOW, np.pi / slowest_vibration(model))


def motion_of(position: Array, period: float) -> tuple[float, float]:
    """Speed [m/s], and distance from the mean [m], root mean square, of a point measured at positions (m, 3) [m] one period [s] apart.

    Differences of noisy samples are mostly noise: 1 mm at 50 Hz makes 70 mm/s. So the motion is that of the cosine modes that stand out of
    the noise, whose power is about the same in all modes.
    """
    power = scipy.fft.dct(position, axis=0, norm="ortho")[1:] ** 2 / len(position)
    power = np.sum(power, axis=1, where=power > STANDS_OUT * np.median(power, axis=0))
    rate = np.pi * np.arange(1, len(position)) / (len(position) * period)
    return float(np.sqrt(np.sum(rate**2 * power))), float(np.sqrt(np.sum(power)))
