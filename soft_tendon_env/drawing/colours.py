"""Colours of tendons by tension, of arms among several, and of the series of one arm."""

import colorsys

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

PULLS = -1.0, 0.0, 0.12, 0.4, 1.0
PULL_COLORS = np.array([[160, 90, 255], [105, 108, 118], [255, 225, 90], [255, 150, 40], [255, 40, 30]])
"""RGB at these shares of the largest tension that the actuator gives, from pushing over slack to pulling; as frames have them."""

ARM_COLORS = (
    (78, 154, 240),
    (242, 142, 43),
    (64, 184, 96),
    (240, 84, 120),
    (170, 120, 240),
    (222, 200, 60),
    (50, 190, 190),
    (200, 140, 110),
)
"""RGB of the first arm, the second, ...: distinct on black and on white."""

SHADES = 0.45, 1.3
"""Lightness of the first and the last series of one arm, relative to the arm's."""


def tension_colors(model: Model, tension: Array) -> NDArray[np.uint32]:
    """0xRRGGBBAA (samples, n_a) for tensions (samples, n_a) [N], by their share of the largest that each actuator gives."""
    largest = np.abs([tendon.tension_limits for tendon in model.scene.tendons]).max(axis=1)
    red, green, blue = (np.interp(tension / largest, PULLS, channel).astype(np.uint32) for channel in PULL_COLORS.T)
    return red << 24 | green << 16 | blue << 8 | np.uint32(255)


def arm_color(number: int) -> tuple[int, int, int]:
    """RGB of the arm of this number, 0, 1, ..., in space and in plots."""
    return ARM_COLORS[number % len(ARM_COLORS)]


def shades(color: tuple[int, int, int], count: int) -> list[tuple[int, int, int]]:
    """Series of one arm: its colour (RGB), from dark to light."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*(value / 255 for value in color))
    return [_rgb(hue, min(0.92, lightness * share), saturation) for share in np.linspace(*SHADES, count)]


def hues(count: int) -> list[tuple[int, int, int]]:
    """Colours (RGB) around the circle of hues, for distinct series."""
    return [_rgb(k / count, 0.62 if k % 2 else 0.50, 0.75) for k in range(count)]


def _rgb(hue: float, lightness: float, saturation: float) -> tuple[int, int, int]:
    red, green, blue = (round(255 * value) for value in colorsys.hls_to_rgb(hue, lightness, saturation))
    return red, green, blue
