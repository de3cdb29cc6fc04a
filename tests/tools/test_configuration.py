"""Configurations, lengths, tables and arguments: errors name the source, the key, the value and
what is allowed."""

from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field

from soft_tendon_env.tools.checks import checked_array, checked_count, checked_number
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    override,
    parsed_changes,
    read_toml,
)
from soft_tendon_env.tools.tables import read_table
from soft_tendon_env.tools.types import Positive, TimeStep, is_length, length_text, read_length

ONE = {"sections": [{"type": "round", "radius": 1}]}


class Round(Configuration):
    """A section by its radius."""

    type: Literal["round"] = "round"
    radius: Positive


class Square(Configuration):
    """A section by its side."""

    type: Literal["square"] = "square"
    side: Positive


class Part(Configuration):
    """A part."""

    sections: tuple[Annotated[Round | Square, Field(discriminator="type")], ...] = Field(
        min_length=1
    )
    name: str = "part"
    count: int = Field(default=3, ge=1)
    gains: tuple[float, float] = (1.0, 2.0)
    step: TimeStep = 0.1
    is_on: bool = True


def test_numbers_arrays_and_paths_are_taken_as_they_come():
    part = Part.parse({**ONE, "gains": np.array([3, 4]), "count": np.int64(2)}, "arm.toml")
    assert repr(part) == "Part(sections=(Round(radius=1.0),), count=2, gains=(3.0, 4.0))"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"cont": 2},
            (
                "arm.toml: cont is an unknown key (given 2): did you mean 'count'? valid: count,"
                " gains, "
            ),
        ),
        ({"count": 0}, "arm.toml: count is 0: it should be greater than or equal to 1"),
        ({"count": 2.0}, "arm.toml: count is 2.0: it should be a valid integer"),
        ({"name": 3}, "arm.toml: name is 3: it should be a valid string"),
        ({"is_on": 1}, "arm.toml: is_on is 1: it should be true or false"),
        ({"gains": [1.0, "2"]}, "arm.toml: gains[1] is '2': it should be a valid number"),
        ({"gains": [1.0, float("nan")]}, "arm.toml: gains[1] is nan: it should be a finite number"),
        ({"gains": 1.0}, "arm.toml: gains is 1.0: it should be a valid array"),
        ({"gains[0]": True}, "arm.toml: gains[0] is True: it should be a valid number"),
        ({"step": 1e-9}, "arm.toml: step is 1e-09: it should be 1e-07 to 1e+20 s"),
        ({"sections": []}, "arm.toml: sections is []: it should have at least 1 item"),
        (
            {"sections.*.radius": 0.0},
            "arm.toml: sections[0].radius is 0.0: it should be greater than 0",
        ),
        ({"sections.0.type": "square"}, "arm.toml: sections[0].side is missing: it is required"),
        (
            {"sections.0.type": "squar"},
            "arm.toml: sections[0].type is 'squar': did you mean 'square'? valid: round, square",
        ),
        ({"sections.0": {"radius": 1}}, "arm.toml: sections[0].type is missing: it is required"),
        ({"sections.0": 5}, "arm.toml: sections[0] is 5: it should be a table"),
        (
            {"sections.1.radius": 1},
            "sections.1.radius cannot be set: '1' is no position in sections; valid: 0 to 0",
        ),
        ({"name.first": 1}, "name.first cannot be set: name is 'part', not a table"),
    ],
)
def test_what_is_refused(changes, said):
    table = Part(**ONE).model_dump(mode="json")
    with pytest.raises(ConfigurationError) as caught:
        override(table, changes)
        Part.parse(table, "arm.toml")
    assert said in str(caught.value)


def test_changes_are_values_of_toml_or_texts():
    assert parsed_changes(["a.b=[1, 2.5]", "c = fast", 'd="x=y"', "e=true"]) == {
        "a.b": [1, 2.5],
        "c": "fast",
        "d": "x=y",
        "e": True,
    }
    override(table := {"a": {"b": 1}}, parsed_changes(['a."b.c"=2']))
    assert table == {"a": {"b": 1, "b.c": 2}}


@pytest.mark.parametrize("text", [5000 * "[" + 5000 * "]", "{a" + 5000 * ".a" + " = 1}"])
def test_changes_that_are_nested_too_deep_are_refused(text):
    with pytest.raises(ValueError, match="--set tendons nests arrays or tables too deep"):
        parsed_changes([f"tendons={text}"])
    nested = 20 * "[" + "1" + 20 * "]"
    assert parsed_changes([f"a={nested}"])["a"] != nested


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file"),
        (b"a = ", "is not valid TOML"),
        (b"a = " + 5000 * b"[" + 5000 * b"]", "nests arrays or tables too deep to be read"),
        (b"a" + 5000 * b".a" + b" = 1", "nests arrays or tables too deep to be read"),
        (b"a = '\xff'", "is not valid TOML: .*start"),
    ],
)
def test_files_that_cannot_be_read_are_named(tmp_path, content, said):
    path = tmp_path / "arm.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"{path}: {said}"):
        read_toml(path)


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("1mm", 1e-3),
        ("0.05 cm", 5e-4),
        ("2e-1mm", 2e-4),
        (" 3 m ", 3.0),
        ("50um", 5e-5),
        ("1.25mm", 1.25e-3),
    ],
)
def test_lengths_are_read_and_what_is_written_reads_back(text, metres):
    assert is_length(text)
    assert read_length(text) == pytest.approx(metres) == read_length(length_text(metres))


@pytest.mark.parametrize(
    "text", ["1", "mm", "-1mm", "0mm", "1 inch", "nanmm", "1e999m", "standard", ""]
)
def test_what_is_no_length_is_refused(text):
    with pytest.raises(ValueError, match="should be a positive length with its unit"):
        read_length(text)


@pytest.mark.parametrize(
    "text", ["a,b\n1,2\n", "# made by us\n\na; b\n1; 2\n#\n", "a\tb\n1\t2\n\t\n"]
)
def test_dialects(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    table = read_table(path)
    where, header, ((row, cells),), units = table
    assert not units
    assert header == ["a", "b"]
    assert cells == ["1", "2"]
    assert table.numbers([("b", 0.001)]) == [[0.002]]
    line = (
        text.splitlines().index(next(line for line in text.splitlines() if line.startswith("a")))
        + 1
    )
    assert where.startswith(f"{path}, line {line} ")
    assert row == f"{path}, line {line + 1}"


@pytest.mark.parametrize(
    ("text", "said"),
    [("a,b\n1\n", "line 2: there are 1 cells"), ('a,b\n1,2\n"1,2\n', "line 3 cannot be read")],
)
def test_tables_that_cannot_be_read_are_refused(tmp_path, text, said):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ValueError, match=said):
        read_table(tmp_path / "table.csv")


@pytest.mark.parametrize(
    "value", [[1, 2, 3], (1.0, 2.0, 3.0), np.array([1, 2, 3], dtype=np.int8), range(1, 4)]
)
def test_numbers_of_any_kind_become_float64(value):
    found = checked_array("q", value, (3,))
    assert found.dtype == np.float64
    assert found.flags.c_contiguous
    assert found.tolist() == [1.0, 2.0, 3.0]


def test_the_result_is_a_copy_and_contiguous():
    given = np.arange(12.0).reshape(3, 4).T
    found = checked_array("table", given, (None, 3))
    found[0, 0] = 99.0
    assert found.flags.c_contiguous
    assert found.shape == (4, 3)
    assert given[0, 0] == 0.0


def test_numbers_become_floats_and_counts_of_numpy_are_taken():
    assert type(checked_number("step", np.float32(2), 0.0, "a positive number")) is float
    assert checked_count("points", np.int32(3), 1) == 3


@pytest.mark.parametrize(
    ("check", "value", "allowed", "error", "message"),
    [
        (checked_array, [1.0, 2.0], [(3,)], ValueError, r"q should have shape \(3,\), not \(2,\)"),
        (
            checked_array,
            [1.0],
            [(None, 2)],
            ValueError,
            r"q should have shape \(any, 2\), not \(1,\)",
        ),
        (
            checked_array,
            [[1.0], [2.0, 3.0]],
            [(2,)],
            ValueError,
            r"q should have shape \(2,\), but its rows are not alike",
        ),
        (
            checked_array,
            [0.0, np.nan, np.nan],
            [(3,)],
            ValueError,
            r"q should be finite, but q\[1\] is nan",
        ),
        (
            checked_array,
            [[0.0, 1.0], [0.0, -np.inf]],
            [(2, 2)],
            ValueError,
            r"q should be finite, but q\[1, 1\] is -inf",
        ),
        (
            checked_array,
            ["1"],
            [(1,)],
            TypeError,
            r"q should be an array of numbers of shape \(1,\), not list of <U1",
        ),
        (
            checked_array,
            [True],
            [(1,)],
            TypeError,
            r"q should be an array of numbers of shape \(1,\), not list of bool",
        ),
        (
            checked_array,
            None,
            [(2,)],
            TypeError,
            r"q should be an array of numbers of shape \(2,\), not NoneType of object",
        ),
        (checked_number, -1.0, [0.0, "at least 0"], ValueError, "q should be at least 0, not -1.0"),
        (
            checked_number,
            np.nan,
            [0.0, "at least 0"],
            ValueError,
            "q should be at least 0, not nan",
        ),
        (checked_number, "1", [0.0, "at least 0"], TypeError, "q should be at least 0, not str"),
        (checked_number, True, [0.0, "at least 0"], TypeError, "q should be at least 0, not bool"),
        (checked_count, 0, [1], ValueError, "q should be a whole number of at least 1, not 0"),
        (checked_count, 2.0, [1], TypeError, "q should be a whole number of at least 1, not float"),
        (checked_count, True, [1], TypeError, "q should be a whole number of at least 1, not bool"),
    ],
)
def test_arguments_that_are_refused(check, value, allowed, error, message):
    with pytest.raises(error, match=f"^{message}$"):
        check("q", value, *allowed)
