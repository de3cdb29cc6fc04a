"""What acts on the rod besides its tendons. One file per effect; a scene names those it wants, the others do not exist.

To add an effect, add a module to this package with a configuration class under `@register("name")`; nothing else lists
it. It becomes the optional table `[effects.name]` of a scene.
"""
import importlib
import pkgutil
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from pydantic import create_model

from soft_tendon_env.tools.configuration import Configuration


class Effect(Configuration):
    """Base of the effects' configurations."""


EFFECTS: dict[str, type[Effect]] = {}
"""Every effect's configuration class, by the name that scenes use."""


def register(name: str) -> Callable[[type[Effect]], type[Effect]]:
    """Class decorator: make an `Effect` available to scenes as `[effects.name]`."""

    def add(effect: type[Effect]) -> type[Effect]:
        if name in EFFECTS:
            raise ValueError(f"the effect {name!r} is registered twice: {EFFECTS[name].__module__}, {effect.__module__}")
        EFFECTS[name] = effect
        return effect

    return add


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

if TYPE_CHECKING:
    Effects: TypeAlias = Any  # its fields are known only when the package is imported
else:
    Effects = create_model(
        "Effects",
        __base__=Configuration,
        __doc__="The effects of a scene, one optional field per registered effect; None = absent.",
        __module__=__name__,
        **{name: (effect | None, None) for name, effect in EFFECTS.items()},
    )
