"""Colours and markers of policies, by name: a policy looks the same in every picture and recording.

The kind of policy chooses the colour; learned ones are circles, model-based ones squares, those
behind a filter diamonds.
"""

import colorsys
import re
from collections.abc import Collection, Iterable
from typing import NamedTuple

RGB = tuple[int, int, int]
OTHERS: tuple[RGB, ...] = (
    (78, 154, 240),
    (242, 142, 43),
    (64, 184, 96),
    (240, 84, 120),
    (170, 120, 240),
    (222, 200, 60),
    (50, 190, 190),
    (200, 140, 110),
)
"""Colours of arms whose names say nothing of their policies, in their order of appearance: distinct
on black and on white."""
BLUE, ORANGE, GREEN, PINK, VIOLET, YELLOW, TEAL, BROWN = OTHERS
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
    "dagger": (190, 60, 200),
    "ppo": VIOLET,
    "sac": YELLOW,
    "tqc": (150, 160, 60),
    "apg": TEAL,
}
FILTERS = {"filtered": 0.8, "filter": 0.8, "adaptive": 0.6}
SIBLINGS = (1.0, 0.75, 1.25, 0.5, 1.45, 0.62)
"""Shares of the lightness: of policies behind a filter, and of those that are alike otherwise, such
as trainings by one algorithm."""
LIGHTEST = 0.92


class Style(NamedTuple):
    """Colour (0 to 255) and marker (Matplotlib's) of a policy."""

    colour: RGB
    marker: str

    @property
    def rgb(self) -> tuple[float, ...]:
        """The colour as Matplotlib takes it, 0 to 1."""
        return tuple(value / 255 for value in self.colour)


def style(policy: str, taken: Collection[Style] = ()) -> Style:
    """The style of a policy, by any of its names. Where others have `taken` its colour, another
    lightness of it; where its name says nothing, or no lightness is left, the next free colour."""
    words, colours, marker = (
        re.split(r"[^a-z0-9]+", policy.lower()),
        [other.colour for other in taken],
        "^",
    )
    kinds = {**MODEL_BASED, **LEARNED}
    if (kind := next((word for word in words if word in kinds), None)) is not None:
        share = next((FILTERS[word] for word in words if word in FILTERS), 1.0)
        marker = "o" if kind in LEARNED else "s" if share == 1.0 else "D"
        shades = (
            kinds[kind] if share * sibling == 1.0 else lighten(kinds[kind], share * sibling)
            for sibling in SIBLINGS
        )
        if (free := next((shade for shade in shades if shade not in colours), None)) is not None:
            return Style(free, marker)
    return Style(
        next((other for other in OTHERS if other not in colours), OTHERS[len(taken) % len(OTHERS)]),
        marker,
    )


def styles(policies: Iterable[str]) -> dict[str, Style]:
    """Styles of policies that are drawn together."""
    found = dict[str, Style]()
    for policy in policies:
        found[policy] = style(policy, found.values())
    return found


def lighten(colour: RGB, share: float) -> RGB:
    """A colour of another lightness, as a share of its own."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*(value / 255 for value in colour))
    red, green, blue = (
        round(255 * value)
        for value in colorsys.hls_to_rgb(hue, min(LIGHTEST, share * lightness), saturation)
    )
    return red, green, blue
