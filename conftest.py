"""How pytest runs the tests: with one thread of linear algebra each, and whole mechanisms first."""

import gc
import os
import signal

# As many processes test as there are cores; further threads of linear algebra only wait for one
# another.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A shell lets what it starts in the background ignore the signal; some tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)

FIRST = ("hard_cases", "effects", "model", "envs", "control", "mechanics")
"""Folders of whole mechanisms: what fails there matters most."""


def pytest_collection_modifyitems(items):
    """Folders of whole mechanisms first, then the others as they are."""

    def place_of(item):
        places = [place for place, folder in enumerate(FIRST) if folder in item.path.parts]
        return places[0] if places else len(FIRST)

    items.sort(key=place_of)


def pytest_collection_finish():
    """The garbage collector does not visit what was collected and imported: that stays."""
    gc.freeze()
