"""Arrays and numbers at the door: what passes comes out as float64 of its own, what does not is named."""

import numpy as np
import pytest

from soft_tendon_env.tools.checks import checked_array, checked_count, checked_number, dimensions


@pytest.mark.parametrize(
    "value", ([1, 2, 3], (1.0, 2.0, 3.0), np.array([1, 2, 3], dtype=np.int8), np.array([1, 2, 3], dtype=np.float32), range(1, 4))
)
def test_numbers_of_any_kind_become_float64(value):
    found = checked_array("q", value, (3,))
    assert found.dtype == np.float64 and found.flags.c_contiguous
    np.testing.assert_array_equal(found, [1.0, 2.0, 3.0])


def test_the_result_is_a_copy_and_contiguous():
    given = np.arange(12.0).reshape(3, 4).T
    found = checked_array("table", given, (None, 3))
    assert found.flags.c_contiguous and found.shape == (4, 3)
    found[0, 0] = 99.0
    assert given[0, 0] == 0.0


@pytest.mark.parametrize("shape", ((0,), (5,)))
def test_none_allows_any_length(shape):
    assert checked_array("q", np.zeros(shape), (None,)).shape == shape


@pytest.mark.cases(
    "value, shape, error, message",
    [
        ([1.0, 2.0], (3,), ValueError, r"^q should have shape \(3,\), not \(2,\)$"),
        (1.0, (3,), ValueError, r"^q should have shape \(3,\), not \(\)$"),
        ([[1.0, 2.0]], (2,), ValueError, r"^q should have shape \(2,\), not \(1, 2\)$"),
        ([1.0], (None, 2), ValueError, r"^q should have shape \(any, 2\), not \(1,\)$"),
        ([[1.0], [2.0, 3.0]], (2,), ValueError, r"^q should have shape \(2,\), but its rows are not alike$"),
        ([0.0, np.nan, np.nan], (3,), ValueError, r"^q should be finite, but q\[1\] is nan$"),
        ([[0.0, 1.0], [0.0, -np.inf]], (2, 2), ValueError, r"^q should be finite, but q\[1, 1\] is -inf$"),
        (["1"], (1,), TypeError, r"^q should be an array of numbers of shape \(1,\), not list of <U1$"),
        ([True], (1,), TypeError, r"^q should be an array of numbers of shape \(1,\), not list of bool$"),
        (np.array([1j]), (1,), TypeError, r"^q should be an array of numbers of shape \(1,\), not ndarray of complex128$"),
        (None, (2,), TypeError, r"^q should be an array of numbers of shape \(2,\), not NoneType of object$"),
    ],
)
def test_bad_arrays(value, shape, error, message):
    with pytest.raises(error, match=message):
        checked_array("q", value, shape)


@pytest.mark.parametrize(("value", "count"), [(1.0, 0), ([1.0], 1), (np.zeros((2, 0)), 2), (None, 0), ([[1.0], [2.0, 3.0]], None)])
def test_dimensions(value, count):
    assert dimensions(value) == count


@pytest.mark.parametrize("value", (2, 2.0, np.float32(2), np.int64(2)))
def test_numbers_become_floats(value):
    found = checked_number("step", value, 0.0, "a positive number")
    assert type(found) is float and found == 2.0


@pytest.mark.cases(
    "value, error, message",
    [
        (-1.0, ValueError, "^step should be at least 0, not -1.0$"),
        (np.nan, ValueError, "^step should be at least 0, not nan$"),
        (np.inf, ValueError, "^step should be at least 0, not inf$"),
        ("1", TypeError, "^step should be at least 0, not str$"),
        (True, TypeError, "^step should be at least 0, not bool$"),
        ([1.0], TypeError, "^step should be at least 0, not list$"),
    ],
)
def test_bad_numbers(value, error, message):
    with pytest.raises(error, match=message):
        checked_number("step", value, 0.0, "at least 0")


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (0, ValueError, "^points should be a whole number of at least 1, not 0$"),
        (2.0, TypeError, "^points should be a whole number of at least 1, not float$"),
        (True, TypeError, "^points should be a whole number of at least 1, not bool$"),
    ],
)
def test_counts(value, error, message):
    assert checked_count("points", np.int32(3), 1) == 3
    with pytest.raises(error, match=message):
        checked_count("points", value, 1)
