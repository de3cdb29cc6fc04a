"""Effects: what acts on the arm besides its tendons.

A scene names those that it needs, the others do not exist; see base.py.
"""

import importlib
import pkgutil

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import (
    EFFECTS,
    Configured,
    Discretisation,
    Effect,
    Effects,
)
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import (
    adds_stress,
    adds_wrench,
    allow_turning,
    limits_step,
    moves_base,
)

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

__all__ = [
    "EFFECTS",
    "LANES",
    "Configured",
    "Discretisation",
    "Effect",
    "Effects",
    "Struct",
    "adds_stress",
    "adds_wrench",
    "allow_turning",
    "limits_step",
    "kernel",
    "moves_base",
]
