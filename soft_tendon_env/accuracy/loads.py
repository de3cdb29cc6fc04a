"""Range of loads that a trial holds for.

It is of effects from none up to a multiple of those of a scene, in their directions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Effect, Effects
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import ConfigurationError

REACH = 1.25
"""Largest loads that a trial has, in units of those of the scene: a force that is changed in small
steps does not begin a trial at each of them."""

ROUNDING = 1e-9
"""Relative size by which a load may exceed the largest one that was tried, and still be equal."""


def tried_effects(effects: Effects) -> Effects:
    """Effects that a trial has: those that act on the arm everywhere, and those of its tendons.

    Obstacles and what lies between commands and tensions are left out. Friction lies along the
    tendons: what it takes bends coordinates that tensions alone leave at zero, and holds them bent
    when tendons are let out. Elastic tendons are springs beside the arm's own: it vibrates faster
    with them, and a model errs more.
    """
    tried = dict(effects.everywhere().chosen())
    friction = effects.tendon_friction
    if friction is not None and friction.coefficient > 0.0:
        tried["tendon_friction"] = friction
    if effects.tendon_elasticity is not None:
        tried["tendon_elasticity"] = effects.tendon_elasticity
    return Effects(**tried)


def has_strengths(effects: Effects) -> bool:
    """Whether any effect has a size that is not zero."""
    for effect in effects.chosen().values():
        for key in effect.strengths:
            strength = getattr(effect, key)
            if np.any(strength):
                return True
    return False


def scaled_effects(effects: Effects, factor: float) -> Effects:
    """Effects whose `strengths` are so many times as large.

    Raises ConfigurationError where one cannot be that strong.
    """
    tables: dict[str, Any] = effects.model_dump()
    for name, effect in effects.chosen().items():
        table = tables[name]
        for key in effect.strengths:
            strengths = np.array(table[key])
            larger = factor * strengths
            table[key] = larger.tolist()
    return Effects(**tables)


def weaker_effects(effects: Effects, random: np.random.Generator) -> Effects:
    """Effects each of which has a random part of its strength, in the same directions."""
    weaker = {}
    for name, effect in effects.chosen().items():
        alone = Effects(**{name: effect})
        scaled = scaled_effects(alone, random.random())
        weaker[name] = scaled.chosen()[name]
    return Effects(**weaker)


def load_cases(scene: Scene, reach: float, seed: int) -> list[Effects]:
    """Effects that the inputs of a trial take turns with.

    They are those of the scene, `reach` times as strong ones, and weaker ones. Raises
    ConfigurationError.
    """
    own = tried_effects(scene.effects)
    if reach == 1.0:
        return [own]
    greatest = scaled_effects(own, reach)
    random = np.random.default_rng(seed)
    weaker = weaker_effects(greatest, random)
    return [own, greatest, weaker]


def reaches(scene: Scene) -> tuple[float, ...]:
    """Multiples of the scene's loads that a trial should hold for, the greatest first.

    1: these loads alone, where more have no unique reference.
    """
    own = tried_effects(scene.effects)
    if not has_strengths(own):
        return (1.0,)
    try:
        scaled_effects(own, REACH)
    except ConfigurationError:
        return (1.0,)
    return (REACH, 1.0)


def covers(tried: Effects, loads: Effects) -> bool:
    """Whether effects are between none and those that were tried, in all that they have."""
    greatest = tried.chosen()
    for name, effect in tried_effects(loads).chosen().items():
        if name not in greatest or not _is_weaker(effect, greatest[name]):
            return False
    return True


def _is_weaker(effect: Effect, greatest: Effect) -> bool:
    largest = greatest.model_dump()
    for key, value in effect.model_dump().items():
        if key in effect.strengths:
            if not _is_between(value, largest[key]):
                return False
        elif value != largest[key]:
            return False
    return True


def _is_between(value: ArrayLike, largest: ArrayLike) -> bool:
    """Whether every component is between zero and the largest one."""
    part = np.array(value, dtype=float)
    whole = np.array(largest, dtype=float)
    is_same_side = part * whole >= 0.0
    size = np.abs(whole)
    bound = (1.0 + ROUNDING) * size
    is_smaller = np.abs(part) <= bound
    return bool(np.all(is_same_side & is_smaller))
