"""Tables from files of arrays: .mat of MATLAB up to version 7, and .npz of NumPy.

A vector is a column of its own name. An array of several columns has `NAME_0`, `NAME_1`, ..., and
three of them are `NAME_x`, `NAME_y`, `NAME_z` too. Fields of a structure are `STRUCTURE.FIELD`.
"""

import itertools
import zipfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ARRAY_FILES = (".mat", ".npz")
"""Endings of files of arrays."""
HDF5 = b"\x89HDF"
"""Beginning of a .mat file of version 7.3, which has this mark here or after 512 bytes."""
KINDS = "biufSU"
"""Kinds of arrays (`dtype.kind`) that have numbers or text."""


def read_arrays(path: Path) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Columns of a file of arrays as text.

    Args:
        path: of a .mat or .npz file.

    Returns:
        Names of the columns, and where each row stands, with its cells. Rows are the number that
        most arrays have in common; arrays without that length are left out.

    Raises:
        FileNotFoundError: for a file that is missing.
        ValueError: for one that cannot be read, or has no columns.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if path.suffix.lower() == ".mat":
        load = _matlab_arrays
    else:
        load = _numpy_arrays
    loaded = load(path)
    arrays = {name: array for name, array in loaded.items() if array.dtype.kind in KINDS}
    row_count = _row_count(arrays)
    if row_count == 0:
        raise ValueError(f"{path} has no arrays of numbers: it should have a row for each sample")
    columns = dict[str, NDArray[Any]]()
    for name, array in arrays.items():
        columns |= _columns(name, array, row_count)
    texts = list[list[str]]()
    for column in columns.values():
        column_texts = [_text(value) for value in column.tolist()]
        texts.append(column_texts)
    rows = list[tuple[str, list[str]]]()
    for i, cells in enumerate(zip(*texts, strict=True)):
        where = f"{path}, row {i + 1}"
        rows.append((where, [*cells]))
    return [*columns], rows


def _row_count(arrays: Mapping[str, NDArray[Any]]) -> int:
    """Length that most arrays have a side of, of several the greatest; 0 without arrays."""
    times = Counter[int]()
    for array in arrays.values():
        lengths = {*array.shape} - {1}
        times.update(lengths)
    most = max(times.values(), default=0)
    most_frequent = (length for length in times if times[length] == most)
    return max(most_frequent, default=0)


def _text(value: Any) -> str:
    """A number or text of an array as a cell, without a loss of digits."""
    if isinstance(value, str):
        return value.strip()
    return repr(value)


def _columns(name: str, array: NDArray[Any], row_count: int) -> dict[str, NDArray[Any]]:
    """Columns of an array by their names; none where no side is as long as there are rows."""
    squeezed = np.atleast_1d(np.squeeze(array))
    if row_count not in squeezed.shape:
        return {}
    # MATLAB has rows of samples as often as columns
    row_axis = squeezed.shape.index(row_count)
    by_row = np.moveaxis(squeezed, row_axis, 0)
    if by_row.ndim == 1:
        return {name: by_row}
    columns = dict[str, NDArray[Any]]()
    ranges = map(range, by_row.shape[1:])
    for index in itertools.product(*ranges):
        place: tuple[Any, ...] = (slice(None), *index)
        column = by_row[place]
        numbers = [str(i) for i in index]
        own_name = "_".join([name, *numbers])
        columns[own_name] = column
        if by_row.shape[-1] == 3:
            axis = "xyz"[index[-1]]
            parts = [name, *numbers[:-1], axis]
            name_by_axis = "_".join(parts)
            columns[name_by_axis] = column
    return columns


def _numpy_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of an .npz file. Raises ValueError."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}
    except (OSError, ValueError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"{path} cannot be read as .npz of arrays of numbers: {type(error).__name__}"
        ) from error


def _matlab_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of a .mat file, also those of structures. Raises ValueError."""
    # here: it takes longer to import than all else that most files need
    from scipy.io import loadmat

    start = path.read_bytes()[:520]
    starts = (start[:4], start[512:516])
    if HDF5 in starts:
        raise ValueError(f"{path} is a .mat file of version 7.3: save it with save(..., '-v7')")
    try:
        variables = loadmat(path, simplify_cells=True)
    except Exception as error:  # of many kinds, by what the bytes seem to be
        message = f"{path} cannot be read as .mat: {type(error).__name__}"
        raise ValueError(message) from error
    return _flat(variables, "")


def _flat(variables: Mapping[str, Any], prefix: str) -> dict[str, NDArray[Any]]:
    """Arrays by names, of structures with the names of their fields behind a point."""
    arrays = dict[str, NDArray[Any]]()
    for name, value in variables.items():
        if name.startswith("__"):  # of the file itself
            continue
        if isinstance(value, Mapping):
            arrays |= _flat(value, f"{prefix}{name}.")
        else:
            array = np.asarray(value)
            # a cell array of names has objects
            has_objects = array.dtype == object
            is_text = has_objects and all(isinstance(cell, str) for cell in array.flat)
            if is_text:
                arrays[prefix + name] = array.astype(str)
            else:
                arrays[prefix + name] = array
    return arrays
