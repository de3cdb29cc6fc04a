"""Tables of small cases: every row is tried, and those that fail are named together."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TRIED = [(1, 2), (2, 1), (3, 4), (4, 3), (5, 5)]
SCRIPT = """
import pytest

@pytest.mark.cases("a, b", [(1, 2), (2, 1), (3, 4), pytest.param(4, 3, id="back")])
def test_order(a, b, tmp_path):
    assert a < b and tmp_path.is_dir()

@pytest.mark.cases("text", ["7", "x", "8"])
@pytest.mark.parametrize("base", [10])
def test_numbers(text, base):
    with pytest.raises(ValueError):
        int(text, base)

@pytest.mark.cases("a", [0, 1])
@pytest.mark.cases("b", [0, 1, 2])
def test_pairs(a, b):
    if a == b:
        pytest.skip("which would hide the others")
"""


@pytest.mark.cases("a", [1, 2])
@pytest.mark.cases("b, c", TRIED)
def test_every_pair_of_rows_is_tried(a, b, c, record_property, request):
    record_property("case", (a, b, c))
    done = [value for _, value in request.node.user_properties]
    assert done == [(i, *row) for row in TRIED for i in (1, 2)][: len(done)]
    if (a, b, c) == (2, 5, 5):
        assert len(done) == 10


def test_all_failures_are_named_and_none_hides_another(tmp_path):
    shutil.copy(Path(__file__).parents[1] / "conftest.py", tmp_path)
    (tmp_path / "test_some.py").write_text(SCRIPT)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = cases\n")
    alone = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rN"]  # their closing summary would repeat them
    done = subprocess.run(command, cwd=tmp_path, env=alone, capture_output=True, text=True)
    assert "3 failed" in done.stdout and "test_order[4 cases]" in done.stdout
    named = ["case: {'a': 2, 'b': 1}", "case back: {'a': 4, 'b': 3}", "case: {'text': '7'}", "case: {'text': '8'}"]
    named += ["case: {'b': 0, 'a': 0}", "case: {'b': 1, 'a': 1}"]
    assert [line for line in done.stdout.splitlines() if line.startswith("case")] == named
