"""Tables of small cases: every row is tried, and those that fail are named together."""

import pytest

TRIED = list[tuple[int, int]]()


@pytest.mark.cases("a", [1, 2])
@pytest.mark.cases("b", [3, 4, 5])
def test_every_pair_of_rows_is_tried(a, b):
    TRIED.append((b, a))
    assert sorted({*TRIED}) == TRIED and (len(TRIED) == 6 or (a, b) != (2, 5))


@pytest.mark.xfail(strict=True, raises=pytest.fail.Exception)
@pytest.mark.cases("a, b", [(1, 2), (2, 1)])
def test_a_row_that_fails_fails_the_table(a, b):
    assert a < b
