"""How pytest runs the tests: one thread each, whole mechanisms first, and tables of small cases as one test."""

import inspect
import itertools
import os

import pytest

# As many processes test as there are cores; further threads of linear algebra only wait for one another.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

FIRST = ("hard_cases", "effects", "model", "envs", "control", "mechanics")
"""Folders of whole mechanisms: what fails there matters most."""


def pytest_collection_modifyitems(items):
    """Folders of whole mechanisms first, then the others as they are."""
    items.sort(key=lambda item: next((place for place, folder in enumerate(FIRST) if folder in item.path.parts), len(FIRST)))


def pytest_generate_tests(metafunc):
    """The names of a table are arguments of its test, which `pytest_pyfunc_call` fills in row by row."""
    for table in metafunc.definition.iter_markers("cases"):
        names, rows = _table(table)
        metafunc.parametrize(names, [pytest.param(*[None] * len(names), id=f"{len(rows)} cases")])


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Runs every row of a test's tables, or every pair of rows of two, and fails with all that failed."""
    tables = [_table(table) for table in pyfuncitem.iter_markers("cases")]
    if not tables:
        return None
    failures = []
    given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.obj).parameters}
    for rows in itertools.product(*(rows for _, rows in tables)):
        case = {name: value for (names, _), row in zip(tables, rows, strict=True) for name, value in zip(names, row.values, strict=True)}
        try:
            pyfuncitem.obj(**given | case)
        except (Exception, pytest.fail.Exception, pytest.skip.Exception) as failure:  # a row that skips would hide those after it
            label = " ".join(["case", *(row.id for row in rows if row.id)])
            failures.append(f"{label}: {case}\n{pyfuncitem.repr_failure(pytest.ExceptionInfo.from_exception(failure))}")
    if failures:
        pytest.fail("\n\n".join(failures), pytrace=False)
    return True


def _table(marker):
    """Names and rows of `@pytest.mark.cases("a, b", [(1, 2), (3, 4)])`; of one name, rows are its values."""
    text, rows = marker.args
    names = [name.strip() for name in text.split(",")]
    rows = [row if hasattr(row, "marks") else pytest.param(*row if len(names) > 1 else [row]) for row in rows]
    assert rows and not any(row.marks for row in rows), f"cases of {text}: there should be some, and none with marks of its own"
    return names, rows
