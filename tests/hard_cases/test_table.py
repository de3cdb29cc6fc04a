"""The table in docs/hard_cases.md cannot rot."""

import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def table():
    spec = importlib.util.spec_from_file_location("hard_cases_table", Path(__file__).with_name("table.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_case_says_why_it_is_hard_and_what_is_expected(table):
    cases = table.cases()
    assert len(cases) > 20
    assert [case for case, text in cases.items() if text.count(table.EXPECTED) != 1 or "|" in text] == []


def test_the_committed_table_lists_exactly_the_cases(table):
    assert table.listed() == list(table.cases()), "run python tests/hard_cases/table.py"
