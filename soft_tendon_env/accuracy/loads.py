"""Range of loads that a trial holds for: effects up to a multiple of those of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import ConfigurationError

REACH = 1.25
"""Largest loads that a trial has, in units of those of the scene: a force that is changed in small
steps does not begin a trial at each of them."""


def has_strengths(effects: Effects) -> bool:
    """Whether any effect has a size that is not zero."""
    for effect in effects.chosen().values():
        if any(np.any(getattr(effect, key)) for key in effect.strengths):
            return True
    return False


def scaled_effects(effects: Effects, factor: float) -> Effects:
    """Effects whose `strengths` are so many times as large. Raises ConfigurationError where one
    cannot be that strong."""
    tables: dict[str, Any] = effects.model_dump()
    for name, effect in effects.chosen().items():
        for key in effect.strengths:
            larger = factor * np.array(tables[name][key])
            tables[name][key] = larger.tolist()
    return Effects(**tables)


def load_cases(scene: Scene, reach: float, seed: int) -> list[Effects]:
    """Effects that the inputs of a trial take turns with: those of the scene, `reach` times as
    strong ones, and those in random directions up to that. Raises ConfigurationError."""
    own = scene.effects.everywhere()
    if reach == 1.0:
        return [own]
    greatest = scaled_effects(own, reach)
    elsewhere = greatest.sample_smaller(np.random.default_rng(seed))
    return [own, greatest, elsewhere]


def reaches(scene: Scene) -> tuple[float, ...]:
    """Multiples of the scene's loads that a trial should hold for, the greatest first; 1: these
    loads alone, where more have no unique reference."""
    own = scene.effects.everywhere()
    if not has_strengths(own):
        return (1.0,)
    try:
        scaled_effects(own, REACH)
    except ConfigurationError:
        return (1.0,)
    return (REACH, 1.0)
