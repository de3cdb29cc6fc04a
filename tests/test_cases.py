"""Tables of small cases: every row is tried, and those that fail are named together."""

import pytest

TRIED = [(1, 2), (2, 1), (3, 4), (4, 3), (5, 5)]


@pytest.mark.cases("a", [1, 2])
@pytest.mark.cases("b, c", TRIED)
def test_every_pair_of_rows_is_tried(a, b, c, record_property, request):
    record_property("case", (a, b, c))
    done = [value for name, value in request.node.user_properties if name == "case"]
    assert done == [(i, *row) for row in TRIED for i in (1, 2)][: len(done)]
    if (a, b, c) == (2, 5, 5):
        assert len(done) == 10


@pytest.mark.xfail(strict=True, raises=pytest.fail.Exception)
@pytest.mark.cases("a, b", [(1, 2), (2, 1)])
def test_a_row_that_fails_fails_the_table(a, b):
    assert a < b
