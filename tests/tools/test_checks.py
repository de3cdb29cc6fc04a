"""Argument validation: what passes comes out as float64 of its own, what does not is named."""

import numpy as np
import pytest

from soft_tendon_env.tools.checks import checked_array, checked_count, checked_number


@pytest.mark.cases("value", ([1, 2, 3], (1.0, 2.0, 3.0), np.array([1, 2, 3], dtype=np.int8), range(1, 4)))
def test_numbers_of_any_kind_become_float64(value):
    found = checked_array("q", value, (3,))
    assert found.dtype == np.float64 and found.flags.c_contiguous and found.tolist() == [1.0, 2.0, 3.0]


def test_the_result_is_a_copy_and_contiguous():
    given = np.arange(12.0).reshape(3, 4).T
    found = checked_array("table", given, (None, 3))
    found[0, 0] = 99.0
    assert found.flags.c_contiguous and found.shape == (4, 3) and given[0, 0] == 0.0


def test_numbers_become_floats_and_counts_of_numpy_are_taken():
    assert type(checked_number("step", np.float32(2), 0.0, "a positive number")) is float and checked_count("points", np.int32(3), 1) == 3


@pytest.mark.cases(
    "check, value, allowed, error, message",
    [
        (checked_array, [1.0, 2.0], [(3,)], ValueError, r"q should have shape \(3,\), not \(2,\)"),
        (checked_array, [1.0], [(None, 2)], ValueError, r"q should have shape \(any, 2\), not \(1,\)"),
        (checked_array, [[1.0], [2.0, 3.0]], [(2,)], ValueError, r"q should have shape \(2,\), but its rows are not alike"),
        (checked_array, [0.0, np.nan, np.nan], [(3,)], ValueError, r"q should be finite, but q\[1\] is nan"),
        (checked_array, [[0.0, 1.0], [0.0, -np.inf]], [(2, 2)], ValueError, r"q should be finite, but q\[1, 1\] is -inf"),
        (checked_array, ["1"], [(1,)], TypeError, r"q should be an array of numbers of shape \(1,\), not list of <U1"),
        (checked_array, [True], [(1,)], TypeError, r"q should be an array of numbers of shape \(1,\), not list of bool"),
        (checked_array, None, [(2,)], TypeError, r"q should be an array of numbers of shape \(2,\), not NoneType of object"),
        (checked_number, -1.0, [0.0, "at least 0"], ValueError, "q should be at least 0, not -1.0"),
        (checked_number, np.nan, [0.0, "at least 0"], ValueError, "q should be at least 0, not nan"),
        (checked_number, "1", [0.0, "at least 0"], TypeError, "q should be at least 0, not str"),
        (checked_number, True, [0.0, "at least 0"], TypeError, "q should be at least 0, not bool"),
        (checked_count, 0, [1], ValueError, "q should be a whole number of at least 1, not 0"),
        (checked_count, 2.0, [1], TypeError, "q should be a whole number of at least 1, not float"),
        (checked_count, True, [1], TypeError, "q should be a whole number of at least 1, not bool"),
    ],
)
def test_what_is_refused(check, value, allowed, error, message):
    with pytest.raises(error, match=f"^{message}$"):
        check("q", value, *allowed)
