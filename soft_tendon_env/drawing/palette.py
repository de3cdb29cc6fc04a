"""Colours and markers of policies, by name: a policy looks the same in every picture and recording.

The kind of policy chooses the colour; learned ones are circles, model-based ones squares, those
behind a filter diamonds.
"""

import colorsys
import re
from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

RGB = tuple[int, int, int]
BLUE: RGB = (78, 154, 240)
ORANGE: RGB = (242, 142, 43)
GREEN: RGB = (64, 184, 96)
PINK: RGB = (240, 84, 120)
VIOLET: RGB = (170, 120, 240)
YELLOW: RGB = (222, 200, 60)
TEAL: RGB = (50, 190, 190)
BROWN: RGB = (200, 140, 110)
MAGENTA: RGB = (190, 60, 200)
OLIVE: RGB = (150, 160, 60)

OTHERS: tuple[RGB, ...] = (BLUE, ORANGE, GREEN, PINK, VIOLET, YELLOW, TEAL, BROWN)
"""Colours of arms whose names say nothing of their policies, in their order of appearance: distinct
on black and on white."""
MODEL_BASED = {
    "paper": BLUE,
    "printed": BLUE,
    "feedforward": BROWN,
    "tracking": ORANGE,
    "predictive": GREEN,
    "mpc": GREEN,
}
LEARNED = {
    "agent": PINK,
    "dagger": MAGENTA,
    "ppo": VIOLET,
    "sac": YELLOW,
    "tqc": OLIVE,
    "apg": TEAL,
}
FILTERS = {"filtered": 0.8, "filter": 0.8}
"""Shares of the lightness, of policies behind a filter."""
SIBLINGS = (1.0, 0.75, 1.25, 0.5, 1.45, 0.62)
"""Shares of the lightness, of policies that are alike otherwise, such as trainings by one
algorithm."""
LIGHTEST = 0.92  # lightness that no colour exceeds, of 1 for white

CIRCLE = "o"  # Matplotlib's markers
SQUARE = "s"
DIAMOND = "D"
TRIANGLE = "^"  # of a name that says nothing


class Style(NamedTuple):
    """Colour (0 to 255) and marker (Matplotlib's) of a policy."""

    colour: RGB
    marker: str

    @property
    def rgb(self) -> tuple[float, ...]:
        """The colour as Matplotlib takes it, 0 to 1."""
        shares = (value / 255 for value in self.colour)
        return tuple(shares)


def style(policy: str, taken: Collection[Style] = ()) -> Style:
    """The style of a policy, by any of its names.

    Where others have `taken` its colour, another lightness of it; where its name says nothing, or
    no lightness is left, the next free colour.
    """
    words = re.split(r"[^a-z0-9]+", policy.lower())
    kinds = [word for word in words if word in MODEL_BASED or word in LEARNED]
    filters = [FILTERS[word] for word in words if word in FILTERS]
    kind = None
    if kinds:
        kind = kinds[0]
    share = 1.0
    if filters:
        share = filters[0]
    marker = _marker(kind, share)
    taken_colours = [other.colour for other in taken]
    colours = [*OTHERS]
    if kind is not None:
        shades = _shades(kind, share)
        colours = [*shades, *OTHERS]
    for colour in colours:
        if colour not in taken_colours:
            return Style(colour, marker)
    # none is free: they begin again
    turn = len(taken) % len(OTHERS)
    return Style(OTHERS[turn], marker)


def styles(policies: Iterable[str]) -> dict[str, Style]:
    """Styles of policies that are drawn together."""
    by_policy = dict[str, Style]()
    for policy in policies:
        by_policy[policy] = style(policy, by_policy.values())
    return by_policy


def lighten(colour: RGB, share: float) -> RGB:
    """A colour of another lightness, as a share of its own."""
    shares = [value / 255 for value in colour]
    hue, lightness, saturation = colorsys.rgb_to_hls(*shares)
    lighter = min(LIGHTEST, share * lightness)
    lighter_shares = colorsys.hls_to_rgb(hue, lighter, saturation)
    red, green, blue = [round(255 * value) for value in lighter_shares]
    return red, green, blue


def _marker(kind: str | None, share: float) -> str:
    """Marker of a kind of policy, whose filter, if it has one, takes a share of its lightness."""
    if kind is None:
        return TRIANGLE
    if kind in LEARNED:
        return CIRCLE
    if share == 1.0:
        return SQUARE
    return DIAMOND


def _shades(kind: str, share: float) -> Iterator[RGB]:
    """Colours of a kind of policy at a share of its lightness.

    They are in the order in which they are taken.
    """
    if kind in LEARNED:
        colour = LEARNED[kind]
    else:
        colour = MODEL_BASED[kind]
    for sibling in SIBLINGS:
        lightness = share * sibling
        # no lightness is changed by way of HLS that need not be: its numbers are rounded
        if lightness == 1.0:
            shade = colour
        else:
            shade = lighten(colour, lightness)
        yield shade
