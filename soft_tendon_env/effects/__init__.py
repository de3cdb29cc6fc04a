"""Effects: loads on the rod besides its tendons, one file each. A scene names those it wants, the others do not exist; see base.py."""

import importlib
import pkgutil

from soft_tendon_env.effects.base import EFFECTS, Effect, Effects, register_effect
from soft_tendon_env.mechanics.terms.loads import adds_wrench
from soft_tendon_env.tools.compilation import kernel

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

__all__ = ["EFFECTS", "Effect", "Effects", "adds_wrench", "kernel", "register_effect"]
