"""Configurations: errors name the source, the key, the value and what is allowed; overrides by dotted keys."""

from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field

from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, override, parsed_changes, read_toml
from soft_tendon_env.tools.types import Positive, TimeStep


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

    sections: tuple[Annotated[Round | Square, Field(discriminator="type")], ...] = Field(min_length=1)
    name: str = "part"
    count: int = Field(default=3, ge=1)
    gains: tuple[float, float] = (1.0, 2.0)
    step: TimeStep = 0.1
    is_on: bool = True


ONE = {"sections": [{"type": "round", "radius": 1}]}


def test_numbers_arrays_and_paths_are_taken_as_they_come():
    part = Part.parse({**ONE, "gains": np.array([3, 4]), "count": np.int64(2)}, "arm.toml")
    assert repr(part) == "Part(sections=(Round(radius=1.0),), count=2, gains=(3.0, 4.0))"


@pytest.mark.cases(
    "changes, said",
    [
        ({"cont": 2}, "arm.toml: cont is an unknown key (given 2): did you mean 'count'? valid: count, gains, "),
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
        ({"sections.*.radius": 0.0}, "arm.toml: sections[0].radius is 0.0: it should be greater than 0"),
        ({"sections.0.type": "square"}, "arm.toml: sections[0].side is missing: it is required"),
        ({"sections.0.type": "squar"}, "arm.toml: sections[0].type is 'squar': did you mean 'square'? valid: round, square"),
        ({"sections.0": {"radius": 1}}, "arm.toml: sections[0].type is missing: it is required"),
        ({"sections.0": 5}, "arm.toml: sections[0] is 5: it should be a table"),
        ({"sections.1.radius": 1}, "sections.1.radius cannot be set: '1' is no position in sections; valid: 0 to 0"),
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
    assert parsed_changes(["a.b=[1, 2.5]", "c = fast", 'd="x=y"', "e=true"]) == {"a.b": [1, 2.5], "c": "fast", "d": "x=y", "e": True}


@pytest.mark.cases(
    "content, said", [(None, "cannot be read: No such file"), (b"a = ", "is not valid TOML"), (b"a = '\xff'", "is not valid TOML")]
)
def test_files_that_cannot_be_read_are_named(tmp_path, content, said):
    path = tmp_path / "arm.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"{path}: {said}"):
        read_toml(path)
