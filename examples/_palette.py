"""Few colours for pictures of few: plain areas keep theirs exactly, and thin lines keep their
hue."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

COLOURS = 240  # an image with a palette has at most 256
FREQUENT = 80  # of them, as they are; the others stand for all that there are


def with_palette(frames: Sequence[np.ndarray]) -> list[Image.Image]:
    """Frames (height, width, 3) as images that share a palette."""
    found, counts = np.unique(
        np.concatenate(frames[::10]).reshape(-1, 3), axis=0, return_counts=True
    )
    frequent = found[np.argsort(-counts)[:FREQUENT]]
    others = (
        Image.fromarray(found[None])
        .quantize(COLOURS - len(frequent), Image.Quantize.MAXCOVERAGE)
        .getpalette()
    )
    palette = Image.new("P", (1, 1))
    palette.putpalette(
        np.concatenate([frequent, np.reshape(others, (-1, 3))])[:COLOURS].astype(np.uint8).tobytes()
    )
    return [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
