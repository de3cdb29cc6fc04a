"""Argument validation of the public API: shape, type, finiteness and range.

Errors say what was passed and what is allowed.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Kind = TypeVar("Kind")


def checked_array(
    name: str, value: ArrayLike, shape: tuple[int | None, ...]
) -> NDArray[np.float64]:
    """A new contiguous float64 array of this shape (None: any length).

    Raises TypeError or ValueError naming `name`.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:  # NumPy's own does not say which argument
        raise ValueError(
            f"{name} should have shape {_shown_shape(shape)}, but its rows are not alike"
        ) from error
    if array.dtype.kind not in "fiu":
        kind = f"{type(value).__name__} of {array.dtype}"
        raise TypeError(
            f"{name} should be an array of numbers of shape {_shown_shape(shape)}, not {kind}"
        )
    if not _has_shape(array.shape, shape):
        raise ValueError(f"{name} should have shape {_shown_shape(shape)}, not {array.shape}")
    is_finite = np.isfinite(array)
    if not is_finite.all():
        first = np.argwhere(~is_finite)[0]
        place = tuple(int(i) for i in first)
        entry = f"{name}{list(place)} is {array[place]}"
        raise ValueError(f"{name} should be finite, but {entry}")
    return np.array(array, dtype=np.float64, order="C")


def _has_shape(sizes: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    if sizes == shape:  # the common case: this is called at every step of a simulation
        return True
    if len(sizes) != len(shape):
        return False
    for size, allowed in zip(sizes, shape, strict=True):
        if allowed is not None and size != allowed:
            return False
    return True


def _shown_shape(shape: tuple[int | None, ...]) -> str:
    sizes = tuple("any" if size is None else size for size in shape)
    return str(sizes).replace("'", "")


def checked_number(name: str, value: float, least: float, allowed: str) -> float:
    """A finite number of at least `least`; `allowed` says so in the error.

    Raises TypeError or ValueError.
    """
    # a bool is an int to Python
    is_bool = isinstance(value, bool)
    is_number = isinstance(value, int | float | np.integer | np.floating)
    if is_bool or not is_number:
        kind = type(value).__name__
        raise TypeError(f"{name} should be {allowed}, not {kind}")
    is_finite = np.isfinite(value)
    if not is_finite or value < least:
        raise ValueError(f"{name} should be {allowed}, not {value}")
    return float(value)


def checked_count(name: str, value: int, least: int) -> int:
    """A whole number of at least `least`.

    Raises TypeError or ValueError.
    """
    is_bool = isinstance(value, bool)
    if is_bool or not isinstance(value, int | np.integer):
        raise TypeError(
            f"{name} should be a whole number of at least {least}, not {type(value).__name__}"
        )
    if value < least:
        raise ValueError(f"{name} should be a whole number of at least {least}, not {value}")
    return int(value)


def checked_type(name: str, value: object, kind: type[Kind], hint: str) -> Kind:
    """The value, if it is an instance of `kind`; `hint` says in the error where one comes from.

    Raises TypeError.
    """
    if not isinstance(value, kind):
        given = type(value).__name__
        raise TypeError(f"{name} should be a {kind.__name__} ({hint}), not {given}")
    return value


def shown_numbers(values: NDArray[np.float64]) -> str:
    """An array (m,) as text for an error message, in one line: [500, 0, 0.1235]."""
    texts = (f"{value:.4g}" for value in values)
    listed = ", ".join(texts)
    return f"[{listed}]"
