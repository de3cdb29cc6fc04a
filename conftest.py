"""How pytest runs the tests: one thread each, whole mechanisms first, tables of small cases as one
test, and a second for each test."""

import contextlib
import inspect
import itertools
import os
import signal
import sys
import threading
import time

import pytest

# As many processes test as there are cores; further threads of linear algebra only wait for one
# another.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(
    signal.SIGINT, signal.default_int_handler
)  # a shell lets what it starts in the background ignore it

import numba  # noqa: E402

from soft_tendon_env.accuracy import candidates, trial  # noqa: E402
from soft_tendon_env.compiler import compilation  # noqa: E402

BUDGET = 1.0
"""CPU time [s] of its process that a test may take which is not marked slow, less that for kernels
and trials that are made in it."""
# times as long that it may take beside other processes on the same cores, and on slower ones
BUSY = 2.0
MANY = 50  # modules; a test that imports so many for the first time is not judged
FIRST = ("hard_cases", "effects", "model", "envs", "control", "mechanics")
"""Folders of whole mechanisms: what fails there matters most."""


class FirstUse:
    """CPU time [s] that a process has spent on loading and compiling kernels, or on trials of
    arms."""

    def __init__(self, first_use):
        self.seconds, self._first_use, self._thread = 0.0, first_use, threading.local()

    @contextlib.contextmanager
    def first_use(self):
        """Context in which a kernel is loaded, or compiled, or an arm is tried: kernels within
        others are part of these."""
        inside, self._thread.inside, started = (
            getattr(self._thread, "inside", False),
            True,
            time.process_time(),
        )
        try:
            with self._first_use():
                yield
        finally:
            self._thread.inside = inside
            self.seconds += 0.0 if inside else time.process_time() - started


KERNELS, TRIALS = FirstUse(compilation._first_use), FirstUse(contextlib.nullcontext)
compilation._first_use = KERNELS.first_use


def search(scene, asked, made=trial.search):
    """A trial of an arm, whose time is counted; with interpreted kernels, for which it takes
    minutes, a few moments that nobody tried."""
    moments = {
        **candidates.bare_rod(scene),
        "passive": [{"strains": [scene.strain.free[0]], "order": 1, "span": "rod"}],
    }
    if numba.config.DISABLE_JIT:
        return trial.Choice(
            moments,
            {"least": asked.least},
            {"tolerance": asked.tolerance * trial.rod_length(scene)},
            0,
            0.0,
        )
    kernels = KERNELS.seconds
    with TRIALS.first_use():
        found = made(scene, asked)
    TRIALS.seconds -= KERNELS.seconds - kernels
    return found


trial.search = search


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Fails a test that takes longer than BUDGET once its kernels are there."""
    modules, kept, started = len(sys.modules), KERNELS.seconds + TRIALS.seconds, time.process_time()
    result = yield
    spent = time.process_time() - started - (KERNELS.seconds + TRIALS.seconds - kept)
    is_slow = item.get_closest_marker("slow") is not None
    if log := os.environ.get("TEST_TIMES"):
        with open(log, "a") as file:
            file.write(
                f"{spent:.2f} {len(sys.modules) - modules} {item.nodeid} trials"
                f" {TRIALS.seconds:.2f}\n"
            )
    if (
        spent > BUSY * BUDGET
        and not is_slow
        and len(sys.modules) - modules < MANY
        and not numba.config.DISABLE_JIT
    ):
        pytest.fail(
            f"it took {spent:.2f} s of CPU, kernels and trials aside: a test takes at most"
            f" {BUDGET:g} s, or is marked slow",
            pytrace=False,
        )
    return result


def pytest_collection_modifyitems(items):
    """Folders of whole mechanisms first, then the others as they are."""
    items.sort(
        key=lambda item: next(
            (place for place, folder in enumerate(FIRST) if folder in item.path.parts), len(FIRST)
        )
    )


def pytest_generate_tests(metafunc):
    """The names of a table are arguments of its test, which `pytest_pyfunc_call` fills in row by
    row."""
    for table in metafunc.definition.iter_markers("cases"):
        names, rows = _table(table)
        metafunc.parametrize(names, [pytest.param(*[None] * len(names), id=f"{len(rows)} cases")])


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Runs every row of a test's tables, or every pair of rows of two, and fails with all that
    failed."""
    tables = [_table(table) for table in pyfuncitem.iter_markers("cases")]
    if not tables:
        return None
    failures = []
    given = {
        name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.obj).parameters
    }
    for rows in itertools.product(*(rows for _, rows in tables)):
        case = {
            name: value
            for (names, _), row in zip(tables, rows, strict=True)
            for name, value in zip(names, row.values, strict=True)
        }
        try:
            pyfuncitem.obj(**given | case)
        except (
            Exception,
            pytest.fail.Exception,
            pytest.skip.Exception,
        ) as failure:  # a row that skips would hide those after it
            label = " ".join(["case", *(row.id for row in rows if row.id)])
            failures.append(
                f"{label}:"
                f" {case}\n{pyfuncitem.repr_failure(pytest.ExceptionInfo.from_exception(failure))}"
            )
    if failures:
        pytest.fail("\n\n".join(failures), pytrace=False)
    return True


def _table(marker):
    """Names and rows of `@pytest.mark.cases("a, b", [(1, 2), (3, 4)])`; of one name, rows are its
    values."""
    text, rows = marker.args
    names = [name.strip() for name in text.split(",")]
    rows = [
        row if hasattr(row, "marks") else pytest.param(*row if len(names) > 1 else [row])
        for row in rows
    ]
    assert rows and not any(row.marks for row in rows), (
        f"cases of {text}: there should be some, and none with marks of its own"
    )
    return names, rows
