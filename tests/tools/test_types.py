"""Lengths with a unit, read and written."""

import pytest

from soft_tendon_env.tools.types import is_length, length_text, read_length


@pytest.mark.cases(
    "text, metres", [("1mm", 1e-3), ("0.05 cm", 5e-4), ("2e-1mm", 2e-4), (" 3 m ", 3.0), ("50um", 5e-5), ("1.25mm", 1.25e-3)]
)
def test_lengths_are_read_and_what_is_written_reads_back(text, metres):
    assert is_length(text) and read_length(text) == pytest.approx(metres) == read_length(length_text(metres))


@pytest.mark.cases("text", ("1", "mm", "-1mm", "0mm", "1 inch", "nanmm", "1e999m", "standard", ""))
def test_what_is_no_length_is_refused(text):
    with pytest.raises(ValueError, match="should be a positive length with its unit"):
        read_length(text)
