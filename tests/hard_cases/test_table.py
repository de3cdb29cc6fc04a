"""The tables docs/appendix/hard_cases.md and .csv cannot rot."""

import table


def test_every_case_says_why_it_is_hard_and_what_is_expected():
    cases = table.cases()
    assert len(cases) > 20
    assert [
        case for case, text in cases.items() if text.count(table.EXPECTED) != 1 or "|" in text
    ] == []


def test_the_committed_table_lists_exactly_the_cases():
    assert table.listed() == list(table.cases()), "run python tests/hard_cases/table.py"
    assert table.SHOWN.keys() <= table.cases().keys(), "run python tests/hard_cases/table.py"
