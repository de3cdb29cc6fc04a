"""Bounds of what a tracker may measure of an arm's tip, and rest: its speed over the last seconds, told from the noise."""

import numpy as np
import scipy.fft

from soft_tendon_env.model.model import Model
from soft_tendon_env.model.step_control import slowest_vibration
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array, NotNegative, Positive

STRETCH = 1.25
"""Greatest distance of the tip from the base, in lengths of the arm: soft rubber stretches by some percent, trackers err by millimetres."""
UNITS = {"cm": 100.0, "mm": 1000.0}
"""Units in which trackers send positions, by how many there are in a metre."""
WINDOW = 2.0
"""Least time [s] over which the speed is measured: at 50 Hz and with noise of 2 mm, it shows a drift of 1.5 mm/s."""
WOBBLE = 0.15
"""Time [s] whose way at the greatest speed of rest is the greatest spread of rest: of fast small motion, as filtered sensors show it."""
STANDS_OUT = 33.0
"""Power of a mode over the median of all, from which on it is motion: one of 10,000 modes of white noise has as much."""


class Rest(Configuration):
    """Greatest speed of an arm at rest, and the longest time for which it is waited for.

    Attributes:
        speed: of the tip, root mean square over the window, as a share of the arm's length per second.
        wait: time [s] under the first command.
    """

    speed: Positive = 0.005
    wait: NotNegative = 60.0


def reach_of(model: Model) -> float:
    """Greatest distance [m] of an arm's tip from the origin; infinite where its base moves."""
    return np.inf if model.scene.effects.moving_base is not None else STRETCH * model.length


def check_tip(tip: Array, reach: float) -> None:
    """Raises ValueError for a measured tip (3,) beyond reach [m]."""
    if (far := float(np.linalg.norm(tip))) > reach:
        units = [name for name, factor in UNITS.items() if 0.1 * reach < far / factor <= reach]
        hint = f"it seems to be in {' or '.join(units)}" if units else "is it in the scene's world frame?"
        raise ValueError(f"measurement.tip_pose puts the tip {far:.3g} m from the base, and the arm reaches {reach:.3g} m: {hint}")


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
