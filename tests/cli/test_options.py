"""Options that follow from a configuration class, and what overrides what."""

from typing import Any

import pytest
from pydantic import Field

from soft_tendon_env.cli.options import Parser
from soft_tendon_env.tools.configuration import Configuration


class Row(Configuration):
    """A table, which has no option."""

    value: int


class Example(Configuration):
    """Class of a command.

    Attributes:
        policy: a required argument.
        seeds: several numbers.
        draw: draw a picture.
        delay: a number, or nothing.
        options: options of the environment.
        rows: tables of a file.
    """

    policy: str
    seeds: tuple[int, ...] = (1, 2)
    draw: bool = True
    delay: float | None = None
    options: dict[str, Any] = Field(default={})
    rows: tuple[Row, ...] = ()


FILE = {"seeds": [7], "delay": 2.0, "rows": [{"value": 3}], "options": {"fidelity": "fast", "randomize": {"payload": 0.1}}}


def read(*arguments, file=()):
    return Parser("example", Example).read([*arguments], lambda given: dict(file))


def test_defaults_are_overridden_by_the_file_and_that_by_options():
    assert read("far") == Example(policy="far")
    assert read("far", file=FILE) == Example(policy="far", **FILE)
    told = ("--seeds", "4", "--seeds", "5", "6", "--no-draw", "--delay", "1", "--scene", "paper", "--set", "randomize.latency=0.1")
    found = read("far", *told, file=FILE)
    assert (found.seeds, found.draw, found.delay, found.rows) == ((4, 5, 6), False, 1.0, (Row(value=3),))
    assert found.options == {"fidelity": "fast", "scene": "paper", "randomize": {"payload": 0.1, "latency": 0.1}}
    assert FILE["options"]["randomize"] == {"payload": 0.1}, "as it was"


def test_every_mistake_has_its_line(capsys):
    with pytest.raises(SystemExit) as exit:
        read("far", "--seeds", "1", "x", "--delay", "no")
    said = capsys.readouterr().err.splitlines()
    assert exit.value.code == 2 and all(line.startswith("soft-tendon example: error: --") for line in said)
    assert "--seeds[1] is 'x': it should be a valid integer" in said[0] and "--delay is 'no': it should be a valid number" in said[1]


def test_help_has_defaults_and_names_of_values(capsys):
    with pytest.raises(SystemExit):
        read("--help")
    printed = " ".join(capsys.readouterr().out.split())
    assert "Class of a command. positional arguments: policy a required argument options:" in printed
    assert "--seeds N [N ...] several numbers (default: 1 2)" in printed and "--no-draw do not draw a picture" in printed
    assert "--delay NUMBER a number, or nothing" in printed and "--options JSON" in printed and "rows" not in printed
