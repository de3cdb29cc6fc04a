"""The registry: kinds, names that are taken, decorators, and what things lack."""

import importlib
from typing import Literal

import pytest

from soft_tendon_env import register
from soft_tendon_env.tools import registry
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError
from soft_tendon_env.tools.registry import KINDS, Registry, TableRegistry, temporary_registrations


class Shape(Configuration):
    """A base with a method that classes have to write."""

    def area(self) -> float:
        raise NotImplementedError


@pytest.fixture
def numbers(monkeypatch):
    """A registry of numbers, which are doubled."""
    monkeypatch.setattr(registry, "_registries", {**registry._registries})
    monkeypatch.setattr(registry, "KINDS", {**KINDS, "number": registry.__name__})

    def double(name, thing, *, share=1.0):
        if thing < 0:
            raise ValueError(f"the number {name!r} is negative")
        return 2 * thing * share

    return Registry("number", double)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_a_registry_with_what_ships(kind):
    importlib.import_module(KINDS[kind])
    table = registry._registries[kind]
    assert table.kind == kind
    assert len(table)
    for name in table:
        assert table.module_of(name).startswith("soft_tendon_env.")


def test_things_are_registered_by_a_call_or_a_decorator(numbers):
    assert register("number", "four", 2) == 4
    assert register("number", "five", share=0.5)(5) == 5
    assert dict(numbers) == {"four": 4, "five": 5}
    assert numbers.module_of("four") == __name__


def test_the_same_module_replaces_and_another_does_not(numbers):
    register("number", "four", 2)
    register("number", "four", 3)
    assert numbers["four"] == 6
    with pytest.raises(ValueError, match=f"'four' of the number of other is taken, by {__name__}"):
        numbers.add("four", 7, "other")
    assert numbers["four"] == 6


def test_what_is_refused_leaves_the_registry_as_it_was(numbers):
    register("number", "four", 2)
    with pytest.raises(ValueError, match="the number 'four' is negative"):
        register("number", "four", -1)
    assert numbers["four"] == 4


@pytest.mark.parametrize(
    ("arguments", "details", "message"),
    [
        (("numbers", "x", 1), {}, "kind is 'numbers': did you mean 'number'"),
        (("number", "", 1), {}, "the name of a number should be a text, not ''"),
        (("number", 3, 1), {}, "the name of a number should be a text, not 3"),
        (("number", "x", 1), {"shares": 2}, "no argument 'shares': did you mean 'share'"),
    ],
)
def test_mistakes_are_named(numbers, arguments, details, message):
    with pytest.raises((TypeError, ValueError), match=message):
        register(*arguments, **details)


def test_a_detail_without_a_default_is_asked_for(numbers):
    def entry(name, thing, *, task):
        return task

    Registry("number", entry)
    with pytest.raises(TypeError, match="needs task="):
        register("number", "x", 1)


def test_followers_get_what_is_there_and_what_comes(numbers):
    register("number", "four", 2)
    seen = []
    numbers.follow(lambda name, entry: seen.append((name, entry)))
    register("number", "six", 3)
    assert seen == [("four", 4), ("six", 6)]


def test_registrations_may_be_temporary(numbers):
    register("number", "four", 2)
    with temporary_registrations():
        register("number", "four", 3)
        register("number", "eight", 4)
    assert dict(numbers) == {"four": 4}


def test_tables_become_what_their_type_names(monkeypatch):
    monkeypatch.setattr(registry, "_registries", {**registry._registries})
    shapes = TableRegistry("section", Shape)

    class Square(Shape):
        type: Literal["square"] = "square"
        side: float

    shapes.add("square", Square, __name__)
    square = shapes.parse({"type": "square", "side": 2.0})
    assert square == Square(side=2.0)
    assert shapes.parse(square) is square
    with pytest.raises(ConfigurationError, match="type is missing"):
        shapes.parse({"side": 2.0})
    with pytest.raises(
        ConfigurationError, match="type is 'sqare': did you mean 'square'.*--import"
    ):
        shapes.parse({"type": "sqare"})
    with pytest.raises(TypeError, match="'round' should be a subclass of .*Shape, not 3"):
        shapes.add("round", 3, __name__)
    with pytest.raises(ValueError, match="'round' lacks its name in tables"):
        shapes.add("round", Square, __name__)
