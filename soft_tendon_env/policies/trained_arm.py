"""Arms that an agent was trained for: their numbers, ranges and disturbances."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.accuracy.fidelity import AS_SCENE
from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.envs.options import Options, given_scene, resolved_scene
from soft_tendon_env.scene.parameters import scene_entries
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import shown

PHYSICS = ("segments", "tendons", "base", "effects")
"""Tables of a scene that define the physical arm, as opposed to how it is computed."""

LISTED = 4
"""Numbers that a message names of those that are outside."""

ROUND_OFF = 1e-9
"""Relative difference of numbers that count as the same."""


class Outside(NamedTuple):
    """Number of an arm that is none of those that an agent was trained for."""

    key: str
    value: Any  # of the arm; None: it has none
    allowed: str  # in the training, in words
    is_load: bool  # whether it is of a disturbance, which comes and goes

    @property
    def table(self) -> str:
        """Table of the scene that has it, one of PHYSICS."""
        return self.key.partition(".")[0]

    def __str__(self) -> str:
        if isinstance(self.value, int):
            return f"it has {self.value} {self.key}, in its training {self.allowed}"
        return f"{self.key} is {_text(self.value)}, in its training {self.allowed}"


def _text(value: Any) -> str:
    """A number of a scene, or what stands in its place, in words."""
    if value is None:
        return "absent"
    return f"{value:g}" if isinstance(value, float) else shown(value)


def numbers_outside(trained: Options, scene: Scene) -> list[Outside]:
    """Numbers of an arm that are none of those that an agent was trained for.

    Args:
        trained: options of the training.
        scene: of the arm.

    Returns:
        They in the order of their keys; empty for an arm as in the training.
    """
    arm = as_written(trained)
    names = disturbances(trained)
    outside = _other_counts(arm, scene)
    before = _entries(arm, names)
    now = _entries(scene, names)
    ranges = _ranges(trained, arm)
    counted = {number.key for number in outside}
    for key in sorted({*before, *now}):
        value = now.get(key)
        top_key = key.partition(".")[0]
        if value == before.get(key) or top_key in counted:
            continue
        least, greatest = ranges.get(key, (np.inf, -np.inf))
        slack = ROUND_OFF * max(abs(least), abs(greatest))
        lowest = least - slack
        highest = greatest + slack
        if isinstance(value, float) and lowest <= value <= highest:
            continue
        is_load = _effect_of(key) in names
        if is_load and (value is None or not _is_strength(key, ranges)):
            continue
        allowed = _text(before.get(key))
        if key in ranges:
            allowed = f"{least:g} to {greatest:g}"
        outside.append(Outside(key, value, allowed, is_load))
    return outside


def _other_counts(arm: Scene, scene: Scene) -> list[Outside]:
    """Numbers of segments and tendons, where those of a scene are others than of the arm."""
    others = []
    for table in ("segments", "tendons"):
        count = len(getattr(scene, table))
        expected = len(getattr(arm, table))
        if count != expected:
            others.append(Outside(table, count, str(expected), is_load=False))
    return others


def _is_strength(key: str, ranges: Mapping[str, Any]) -> bool:
    """Whether a number of a disturbance says how strong it is, not when it comes."""
    _, effect, number, *_ = key.split(".")
    return key in ranges or number in EFFECTS[effect].strengths


def _entries(scene: Scene, disturbances: set[str]) -> dict[str, Any]:
    """Numbers of the physical arm of a scene by dotted keys; of effects, those that it has."""
    effects = {*scene.effects.chosen(), *disturbances}
    entries = {}
    for key, value in scene_entries(scene).items():
        effect = _effect_of(key)
        if not effect or effect in effects:
            entries[key] = value
    return entries


def _effect_of(key: str) -> str:
    """Name of the effect that a key of a scene is of; "": of none."""
    table, *names = key.split(".")
    return names[0] if table == "effects" and names else ""


def _ranges(trained: Options, arm: Scene) -> dict[str, tuple[float, float]]:
    """Least and greatest of the numbers that a training draws, by key, those of the arm too."""
    ranges = {}
    for drawn in trained.randomize.ranges(arm):
        least = drawn.changes(drawn.least)
        greatest = drawn.changes(drawn.greatest)
        for key, value in zip(drawn.keys, drawn.values, strict=True):
            ends = (value, least[key], greatest[key])
            ranges[key] = (min(ends), max(ends))
    return ranges


def listed_tables(outside: Sequence[Outside]) -> str:
    """Tables of the scene that have numbers outside, as words."""
    tables = {number.table for number in outside}
    return " and ".join(table for table in PHYSICS if table in tables)


def listed_numbers(outside: Sequence[Outside]) -> str:
    """Numbers outside, as words; of many the first."""
    texts = [str(number) for number in outside[:LISTED]]
    if len(outside) > LISTED:
        texts.append(f"and {len(outside) - LISTED} more")
    return "; ".join(texts)


def disturbances(options: Options) -> set[str]:
    """Names of effects that a training draws from nothing on, or from the least that there is.

    An arm has them or not.
    """
    scene = given_scene(options.scene)
    is_disturbance: dict[str, bool] = {}
    for drawn in options.randomize.ranges(scene):
        least_values = drawn.changes(drawn.least)
        for key, value in zip(drawn.keys, drawn.values, strict=True):
            table, name, number, *_ = key.split(".")
            if table != "effects":
                continue
            begins = value in (0.0, least_values[key])
            effect = getattr(scene.effects, name)
            # still water is there without a current
            alone = not _has_other_strength(effect, number)
            before = is_disturbance.get(name, True)
            is_disturbance[name] = before and begins and alone
    return {name for name, holds in is_disturbance.items() if holds}


def _has_other_strength(effect: Any, number: str) -> bool:
    """Whether an effect acts by another number than this one; None: it is not there."""
    if effect is None:
        return False  # it is there where its number is drawn alone
    others = [strength for strength in effect.strengths if strength != number]
    return any(np.any(getattr(effect, strength)) for strength in others)


def undisturbed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a training with the arm alone.

    They are without what it draws, and changes of the scene by which there are disturbances.
    """
    scene = options.get("scene")
    names = disturbances(Options.parse(options, "options"))
    arm = {**options, "randomize": {}}
    if not isinstance(scene, Mapping) or "segments" in scene:
        return arm
    left = {}
    for key, value in scene.items():
        is_effect = key.startswith("effects.")
        is_disturbance = is_effect and key.split(".")[1] in names
        if not is_disturbance:
            left[key] = value
    arm["scene"] = left["scene"] if left.keys() == {"scene"} else left
    return arm


def physics(scene: Scene, names: set[str]) -> dict[str, Any]:
    """Physical arm of a scene by the names of PHYSICS, without effects of these names."""
    chosen = scene.effects.chosen()
    effects = {name: effect for name, effect in chosen.items() if name not in names}
    tables = {key: getattr(scene, key) for key in PHYSICS}
    return {**tables, "effects": effects}


def as_written(options: Options) -> Scene:
    """The scene of options with the strain, quadrature and integrator that it has.

    No trial of the arm is needed then.
    """
    return resolved_scene(options.model_copy(update={"fidelity": AS_SCENE}))


def is_of(options: Options, scene: Scene) -> bool:
    """Whether a scene is that of options but for its name.

    It is of the same physical arm, and then the same at their fidelity.
    """
    trained_scene = as_written(options)
    if physics(trained_scene, set()) != physics(scene, set()):
        return False
    return resolved_scene(options).replace({"name": scene.name}) == scene
