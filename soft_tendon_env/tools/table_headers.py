"""Headers of several lines, as trackers export them: names over columns X, Y, Z, and units."""

from collections import Counter
from collections.abc import Sequence

UNIT_NAMES = {
    "m": ("m", "meter", "meters", "metre", "metres"),
    "cm": ("cm", "centimeters", "centimetres"),
    "mm": ("mm", "millimeters", "millimetres"),
    "N": ("n", "newton", "newtons"),
    "mN": ("mn",),
    "kg": ("kg",),
    "g": ("g",),
    "s": ("s", "sec", "seconds"),
    "ms": ("ms", "milliseconds"),
    "us": ("us", "microseconds"),
    "ns": ("ns", "nanoseconds"),
}
"""Units, and how files write them, in small letters."""
NAME = "name"
"""Cell of Motive at the beginning of the line that has the names."""
POSITION = "position"
"""Cell of Motive over coordinates of a place, which is left out of their names."""
LENGTH_UNITS = "length units"
"""Cell of Motive before the unit of all lengths."""


def column_names(header: Sequence[str], above: Sequence[Sequence[str]]) -> list[str]:
    """Names of columns: those that a header repeats, such as X, Y, Z, after a name above them.

    Args:
        header: cells of the last line.
        above: cells of the lines over it, from the top. A name stands over the first of its
            columns, or over all.

    Returns:
        As many names, all different: those that no line above tells apart are numbered, `NAME.0`,
        `NAME.1`, ...
    """
    count = Counter(header)
    is_repeated = [bool(name) and count[name] > 1 for name in header]
    if not any(is_repeated):
        return [*header]
    by_nearness = [_filled(line, is_repeated) for line in reversed(above)]
    named = []
    for line in by_nearness:
        first_cells = [cell.casefold() for cell in line[:2]]
        if NAME in first_cells:
            named.append(line)
    # of a rigid body, Position and Rotation are the nearest line, beneath that of the names
    candidates = [[line] for line in named or by_nearness]
    pairs = [[line, by_nearness[0]] for line in named or by_nearness[1:]]
    candidates += pairs
    for chosen in candidates:
        names = list[str]()
        for i, name in enumerate(header):
            if is_repeated[i]:
                parts = [line[i] for line in chosen]
            else:
                parts = []
            # without a label of its own a column is none of a name
            words = (part for part in parts if part.casefold() != POSITION)
            label = " ".join(words)
            if all(parts) and label:
                label_and_name = f"{label} {name}"
            else:
                label_and_name = name
            names.append(label_and_name)
        repeated_names = [names[i] for i, repeated in enumerate(is_repeated) if repeated]
        is_labelled = all(name not in header for name in repeated_names)
        if is_labelled and len({*repeated_names}) == len(repeated_names):
            return names
    return _numbered(header, is_repeated)


def _numbered(header: Sequence[str], is_repeated: Sequence[bool]) -> list[str]:
    """Names of columns, of which repeated ones are `NAME.0`, `NAME.1`, ... by their order."""
    times = Counter[str]()
    names = list[str]()
    for name, repeated in zip(header, is_repeated, strict=True):
        if repeated:
            numbered = f"{name}.{times[name]}"
        else:
            numbered = name
        names.append(numbered)
        times[name] += 1
    return names


def _filled(line: Sequence[str], is_repeated: Sequence[bool]) -> list[str]:
    """Cells of a line over the columns: an empty one over a repeated column is the one before."""
    filled = list[str]()
    for i, repeated in enumerate(is_repeated):
        if i < len(line):
            cell = line[i]
        else:
            cell = ""
        if repeated and not cell and filled:
            cell = filled[-1]
        filled.append(cell)
    return filled


def unit_of(text: str) -> str:
    """Unit that a file writes, as this package does.

    Args:
        text: a cell, such as `Millimeters` or `[mm]`.

    Returns:
        A key of `UNIT_NAMES`; empty for another text.
    """
    for unit, names in UNIT_NAMES.items():
        if text.strip("[]() ").casefold() in names:
            return unit
    return ""


def length_unit(above: Sequence[Sequence[str]]) -> str:
    """Unit of all lengths that a line above the header gives.

    Args:
        above: cells of the lines over the header.

    Returns:
        A key of `UNIT_NAMES`; empty without one.
    """
    for line in above:
        for key, text in zip(line, line[1:], strict=False):
            if key.casefold() == LENGTH_UNITS:
                return unit_of(text)
    return ""
