"""Registry of all that users add by one call, `register`: effects, tasks, controllers, the KINDS.

A kind has a `Registry` in the module that defines it: a mapping of its entries by name, those that
ship and those of users alike. It checks what it is given, so that what a thing lacks is told where
it is registered.
"""

import importlib
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    not_registered,
    shown,
)

KINDS: Mapping[str, str] = {
    "algorithm": "soft_tendon_env.policies.algorithms",
    "command": "soft_tendon_env.cli.main",
    "condition": "soft_tendon_env.evaluation.conditions",
    "controller": "soft_tendon_env.control.catalogue",
    "effect": "soft_tendon_env.effects",
    "estimator": "soft_tendon_env.policies.estimators",
    "metric": "soft_tendon_env.evaluation.metrics",
    "observation_group": "soft_tendon_env.envs.observation",
    "reward_term": "soft_tendon_env.envs.tracking",
    "routing": "soft_tendon_env.scene.routing",
    "section": "soft_tendon_env.scene.sections",
    "strain": "soft_tendon_env.scene.strain",
    "taper": "soft_tendon_env.scene.routing",
    "target": "soft_tendon_env.envs.targets",
    "task": "soft_tendon_env.envs",
}
"""Kinds of what can be registered, and the module that has the registry of each, which is imported
when the first of the kind is registered."""

Entry = TypeVar("Entry")

_registries: "dict[str, Registry[Any]]" = {}
"""Registries by their kinds, of the modules that are imported."""


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Registry of one kind: its entries by name, in the order in which they were registered.

    Attributes:
        kind: one of KINDS.
    """

    def __init__(self, kind: str, make_entry: Callable[..., Entry]) -> None:
        """Make the registry of a kind.

        Args:
            kind: one of KINDS.
            make_entry: the entry of a name and a thing, and of the kind's own keyword arguments.
                It raises ValueError or TypeError that says what the thing lacks.
        """
        self.kind = kind
        self._make_entry = make_entry
        self._entries: dict[str, Entry] = {}
        self._modules: dict[str, str] = {}  # that registered them, by their names
        self._followers: list[Callable[[str, Entry], None]] = []
        _registries[kind] = self

    def __getitem__(self, name: str) -> Entry:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def module_of(self, name: str) -> str:
        """Name of the module that registered an entry."""
        return self._modules[name]

    def follow(self, action: Callable[[str, Entry], None]) -> None:
        """Call an action with the name and the entry of all that is there, and that comes."""
        for name, entry in self._entries.items():
            action(name, entry)
        self._followers.append(action)

    def add(self, name: str, thing: Any, module: str, **details: Any) -> Entry:
        """Add a thing, see `register`.

        Args:
            name: of the entry.
            thing: what the entry is made of.
            module: name of the module that registers it.
            details: the kind's own keyword arguments.

        Returns:
            The entry.

        Raises:
            ValueError: the name is taken by another module, or the thing does not do.
            TypeError: the thing or a detail is of the wrong type, or unknown.
        """
        if not isinstance(name, str) or not name:
            message = f"the name of a {self.kind} should be a text, not {shown(name)}"
            raise TypeError(message)
        owner = self._modules.get(name, module)
        if owner != module:
            raise ValueError(
                f"the name {name!r} of the {self.kind} of {module} is taken, by {owner}: choose"
                " another name"
            )
        self._check_details(details)
        entry = self._make_entry(name, thing, **details)
        self._entries[name] = entry
        self._modules[name] = module
        for action in self._followers:
            action(name, entry)
        return entry

    def _check_details(self, details: Mapping[str, Any]) -> None:
        """Raises TypeError for a keyword argument that the kind does not have, or that lacks."""
        parameters = inspect.signature(self._make_entry).parameters.values()
        own = [parameter for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
        valid = [parameter.name for parameter in own]
        for key in details:
            if key not in valid:
                raise TypeError(
                    f"register({self.kind!r}, ...) has no argument {key!r}: {not_among(key, valid)}"
                )
        for parameter in own:
            is_required = parameter.default is parameter.empty
            if is_required and parameter.name not in details:
                message = f"register({self.kind!r}, ...) needs {parameter.name}=..."
                raise TypeError(message)


Table = TypeVar("Table", bound=Configuration)


class TableRegistry(Registry[type[Table]]):
    """Registry of configuration classes, of which a table of a file names one by its `type`."""

    def __init__(self, kind: str, *bases: type) -> None:
        """Make the registry of a kind; bases: of which every class has one."""
        super().__init__(kind, self._checked)
        self._bases = bases

    def _checked(self, name: str, thing: Any) -> type[Table]:
        """The class itself. Raises TypeError, ValueError where it lacks something."""
        check_class(self.kind, name, thing, *self._bases)
        field = thing.model_fields.get("type")
        if field is None or field.default != name:
            raise ValueError(
                f"the {self.kind} {name!r} lacks its name in tables, the field"
                f' type: Literal["{name}"] = "{name}"'
            )
        return thing

    def parse(self, value: Any) -> Any:
        """The configuration of a table with a `type`; what is no table as it is.

        Raises:
            ConfigurationError: the type is missing or unknown, or the table does not fit it.
        """
        if not isinstance(value, Mapping):
            return value
        if "type" not in value:
            raise ConfigurationError([Problem(("type",), "is missing: it is required")])
        name = value["type"]
        if not isinstance(name, str) or name not in self:
            hint = not_registered(str(name), self)
            text = f"is {shown(name)}: {hint}"
            raise ConfigurationError([Problem(("type",), text)])
        return self[name](**value)


def check_class(kind: str, name: str, thing: Any, *bases: type) -> None:
    """Check what is registered as a class of its own.

    Args:
        kind: of the registry, for messages.
        name: under which it is registered.
        thing: to check.
        bases: of which it should have one.

    Raises:
        TypeError: it is no subclass of a base, or lacks methods that the base leaves open.
    """
    is_class = isinstance(thing, type)
    if not is_class or not issubclass(thing, bases):
        names = (f"{base.__module__}.{base.__qualname__}" for base in bases)
        valid = " or ".join(names)
        raise TypeError(f"the {kind} {name!r} should be a subclass of {valid}, not {shown(thing)}")
    if inspect.isabstract(thing):
        open_methods: frozenset[str] = getattr(thing, "__abstractmethods__", frozenset())
        methods = ", ".join(sorted(open_methods))
        raise TypeError(f"the {kind} {name!r}, {thing.__qualname__}, lacks {methods}")


def register(kind: str, name: str, thing: Any = None, **details: Any) -> Any:
    """Register something of your own by a name that scenes, options and commands can use.

    `@register("effect", "drag")` decorates a class or function, `register("metric", "peak",
    Metric(...))` takes an object. Modules that do so are found by `--import`, or by the entry
    point group `soft_tendon_env` of an installed package. Registering a name again from the same
    module replaces it, as in a notebook.

    Args:
        kind: one of KINDS: "effect", "section", "routing", "task", ...
        name: of the thing; of classes with a `type` the same as that.
        thing: class, function or object; None: the returned decorator takes it.
        details: what the kind needs besides, such as `task="Reach"` of a controller.

    Returns:
        The entry of the registry; without a thing, a decorator that returns what it decorates.

    Raises:
        ValueError: the kind is unknown, the name is taken by another module, or the thing lacks
            something.
        TypeError: the thing or a detail is of a wrong type.
    """
    if kind not in KINDS:
        hint = not_among(str(kind), KINDS)
        raise ValueError(f"kind is {kind!r}: {hint}")
    importlib.import_module(KINDS[kind])
    registry = _registries[kind]
    module = sys._getframe(1).f_globals.get("__name__", "")
    if thing is not None:
        return registry.add(name, thing, module, **details)

    def add(decorated: Any) -> Any:
        registry.add(name, decorated, module, **details)
        return decorated

    return add


@contextmanager
def temporary_registrations() -> Iterator[None]:
    """Context at whose end every registry is as it was: for tests of what a module registers."""
    before = []
    for registry in _registries.values():
        entries = dict(registry._entries)
        modules = dict(registry._modules)
        before.append((registry, entries, modules))
    try:
        yield
    finally:
        for registry, entries, modules in before:
            registry._entries = entries
            registry._modules = modules
