"""Numbers of a training in units of its arm: "0.5 length" or "2.5 tension/pace" in place of SI's.

One file is then the training for a catheter and for a crane. A training is resolved once, where its
options meet their scene: from there on it has numbers in SI units alone, as its `config.json`.
"""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import Options, given_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.scene.file import scene_names
from soft_tendon_env.scene.plausibility import GRAVITY, ArmScales, scales_of
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.configuration import (
    ConfigurationError,
    Key,
    Problem,
    not_among,
    plain,
    shown,
)

SHARE = re.compile(r"([-+]?\d+\.?\d*(?:e[-+]?\d+)?) ([a-z]+)(?:/([a-z]+))?")
"""Pattern of a share: a number, its unit, and the unit that this is divided by."""

SLOW = 0.5
"""Part of the period of an arm's slowest vibration that is its pace, where that is above 1 s: soft
arms that ship have a pace of 1 s."""

TIP_SHARE = 4.1
"""Masses at the tip of a cantilever count as this many times as much along it, in its period: by
Rayleigh's quotient 33/140 of its own mass moves with the tip."""

REACTION = 0.1
"""Time of a controller to meet a push, as a share of the pace: some control periods."""

GIVE = 0.1
"""Greatest turn of the tip within that time [rad]. An arm of a period of 0.1 s yields to a push
before any command comes, one of 1.4 s turns by 0.09 of what it does at rest."""

DIGITS = 2
"""Significant digits of the pace, and of shares of ROUNDED units."""

UNITS: Mapping[str, str] = {
    "length": "length of the rod [m]",
    "mass": "mass of rod and discs [kg]",
    "tension": "greatest tension of its actuators [N]",
    "force": "at the tip, which bends it by a radian, and by at most GIVE before it is met [N]",
    "gravity": "acceleration by which its weight bends it by a radian, at most the Earth's [m/s^2]",
    "speed": "of a tip that swings by a radian in its slowest vibration [m/s]",
    "pace": "a second, or half a period of its slowest vibration if that is longer [s]",
    "rad": "a radian",
}
"""Units of an arm, in which numbers of a training can be given."""

ROUNDED = ("mass", "tension", "force", "gravity", "speed")
"""Units whose shares have DIGITS: of what is an estimate of the arm, or a choice of its maker."""

OF_ENVIRONMENT = ("options", "hyperparameters", "seconds", "evaluation", "added_effects")
"""Keys of a training that can have shares."""


def arm_units(scene: Scene, options: Mapping[str, Any]) -> dict[str, float]:
    """Sizes of the units of an arm.

    Args:
        scene: of the arm.
        options: of its environment, whose limits of tensions go before those of the scene.

    Returns:
        Sizes in SI units, by the names of UNITS.
    """
    arm = scales_of(scene)
    limits = options.get("tension_limits") or ()
    pace = _pace(scene, arm)
    # the tip of a cantilever turns by F L^2 / (2 E I)
    stiffness = 2.0 * arm.bending
    bends = stiffness / arm.length**2
    # by a third of that where the force is spread over its length
    weight = 3.0 * bends / arm.mass
    return {
        "length": arm.length,
        "mass": arm.mass,
        "tension": max(map(abs, limits), default=arm.pull),
        "force": bends * min(1.0, GIVE / _early_turn(arm.rate * REACTION * pace)),
        "gravity": min(weight, GRAVITY),
        "speed": arm.length * arm.rate,
        "pace": pace,
        "rad": 1.0,
    }


def _early_turn(phase: float) -> float:
    """Greatest turn under a sudden load until a phase [rad] of the vibration, 1 at rest.

    It is that of an oscillator without damping, which swings as far beyond its rest as to it.
    """
    cosine = math.cos(min(phase, math.pi))
    return 1.0 - cosine


def _pace(scene: Scene, arm: ArmScales) -> float:
    """The pace of an arm [s], in DIGITS."""
    tip_load = scene.effects.tip_load
    if tip_load is None:
        payload = 0.0
    else:
        payload = tip_load.mass
    whole_mass = 1.0 + TIP_SHARE * payload / arm.mass
    loading = math.sqrt(whole_mass)
    own_period = 2.0 * math.pi / arm.rate
    period = own_period * loading
    return _rounded(max(1.0, SLOW * period))


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def in_si_units(value: Any, sizes: Mapping[str, float], key: Key = ()) -> Any:
    """A plain value with its shares in SI units, in tables and lists too.

    Args:
        value: of a training.
        sizes: of the arm's units, see `arm_units`.
        key: of the value, for messages.

    Returns:
        The value; what has no share is as it was.

    Raises:
        ConfigurationError: for shares of what is no unit.
    """
    if isinstance(value, Mapping):
        table = {}
        for name, entry in value.items():
            table[name] = in_si_units(entry, sizes, (*key, name))
        return table
    if isinstance(value, list | tuple):
        entries = []
        for place, entry in enumerate(value):
            entries.append(in_si_units(entry, sizes, (*key, place)))
        if isinstance(value, tuple):
            return tuple(entries)
        return entries
    share = None
    if isinstance(value, str):
        share = SHARE.fullmatch(value)
    if share is None:
        return value
    number, unit, divisor = share.groups(default="rad")
    for name in (unit, divisor):
        if name not in sizes:
            hint = not_among(name, sizes)
            text = f"is {shown(value)}, a share of the arm's {name!r}: {hint}"
            raise ConfigurationError([Problem(key, text)])
    scaled = float(number) * sizes[unit]
    size = scaled / sizes[divisor]
    if unit in ROUNDED:
        return _rounded(size)
    return size


def resolved(table: Mapping[str, Any]) -> dict[str, Any]:
    """A training's table with numbers in SI units, for its own arm.

    Effects of `added_effects` go to an arm that lacks them. Where it has one of its own, what is
    drawn is added to that. A scene of a file is taken into the table, so that agents keep their arm
    when the file changes. A text as `policy_kwargs.posture`, the name of an observation group,
    becomes the number of entries up to that group.

    Args:
        table: keys of Training, as in a file.

    Returns:
        The table; it is as it was where nothing is to be resolved.

    Raises:
        ConfigurationError: for shares, scenes and groups that are none.
    """
    options = table.get("options", {})
    if not isinstance(options, Mapping):
        return dict(table)  # which is refused later
    scene = _arm(options)
    sizes = arm_units(scene, options)
    changed = dict(table)
    for name in OF_ENVIRONMENT:
        if name in table:
            table_alone = _without_scene(name, table[name])
            changed[name] = in_si_units(table_alone, sizes, (name,))
    changed_options = changed.get("options", {})
    changed["options"] = {**changed_options, **_scene_option(options)}
    added = changed.get("added_effects", {})
    is_table = isinstance(added, Mapping)
    are_tables = is_table and all(isinstance(table, Mapping) for table in added.values())
    if are_tables:
        changed["options"] = _with_effects(changed["options"], scene, added)
        changed["added_effects"] = {}
    _count_posture(changed)
    return changed


def _arm(options: Mapping[str, Any]) -> Scene:
    """The scene that options name. Raises ConfigurationError with its key in a training."""
    try:
        return given_scene(options.get("scene", "paper"))
    except ConfigurationError as error:
        lines = str(error).splitlines()
        problems = [Problem(("options", "scene"), f"cannot be used: {line}") for line in lines]
        raise ConfigurationError(problems) from error


def _without_scene(name: str, table: Any) -> Any:
    """A table of a training without the scene of its options, which has texts of its own."""
    if name != "options":
        return table
    return {key: value for key, value in table.items() if key != "scene"}


def _scene_option(options: Mapping[str, Any]) -> dict[str, Any]:
    """The option `scene`, if there is one, with the contents of a file in place of its path."""
    if "scene" not in options:
        return {}
    scene = options["scene"]
    if not isinstance(scene, Mapping):
        return {"scene": _contents(scene)}
    if "scene" in scene:
        return {"scene": {**scene, "scene": _contents(scene["scene"])}}
    return {"scene": scene}


def _contents(scene: Any) -> Any:
    """A scene as a plain table, but the name of one that ships as it is."""
    if isinstance(scene, Mapping) or scene in scene_names():
        return scene
    return scene_to_dict(given_scene(scene))


def _with_effects(
    options: Mapping[str, Any], scene: Scene, added: Mapping[str, Any]
) -> dict[str, Any]:
    """Options whose arm has the added effects, by name, and draws their numbers."""
    if not added:
        return dict(options)
    names = scene.effects.chosen().keys()
    own = names & added.keys()
    changes: dict[str, Any] = {}
    for effect in added.keys() - own:
        for name, value in added[effect].items():
            changes[f"effects.{effect}.{name}"] = value
    base = options.get("scene", "paper")
    # a whole scene, and the name of one, takes changes beside it
    if not isinstance(base, Mapping) or "segments" in base:
        base = {"scene": base}
    randomize = dict(plain(options.get("randomize", {})))
    drawn = dict(randomize.get("effects", {}))
    randomize["effects"] = dict(_of_arm_with(own, drawn))
    return {**options, "scene": {**base, **changes}, "randomize": randomize}


def _of_arm_with(own: set[str], drawn: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Ranges of effects' numbers by key, of which the arm has some, `own`, itself.

    They are added to what it has. Pushes of its own are as they are.
    """
    for key, value in drawn.items():
        effect, _, number = key.partition(".")
        if effect not in own:
            yield key, value
        elif not number.startswith("loads."):
            yield key, _added(value)


def _added(value: Any) -> Any:
    """A range, or a list of them, as offsets; those that are relative stay so."""
    if isinstance(value, Mapping):
        return value
    is_list = isinstance(value, list)
    is_vector = is_list and any(isinstance(entry, list) for entry in value)
    if is_vector:
        return [_added(entry) for entry in value]
    return {"offset": value}


def _count_posture(table: dict[str, Any]) -> None:
    """Put the number of entries up to a group, in place of its name, into a training's table.

    Raises ConfigurationError.
    """
    hyperparameters = table.get("hyperparameters", {})
    if isinstance(hyperparameters, dict):
        policy = hyperparameters.get("policy_kwargs", {})
    else:
        policy = {}
    group = None
    if isinstance(policy, dict):
        group = policy.get("posture")
    if not isinstance(group, str) or table.get("task") not in TASKS:
        return
    task = TASKS[table["task"]]
    entries = _entries_by_group(task, table["options"])
    if group not in entries:
        key = ("hyperparameters", "policy_kwargs", "posture")
        text = (
            f"is {group!r}: it should be a number or an observed group; {not_among(group, entries)}"
        )
        raise ConfigurationError([Problem(key, text)])
    table["hyperparameters"] = {
        **hyperparameters,
        "policy_kwargs": {**policy, "posture": entries[group]},
    }


def _entries_by_group(task: Any, options: Mapping[str, Any]) -> dict[str, int]:
    """Number of entries of an observation up to each of its groups, with it.

    Raises ConfigurationError where there is no such environment.
    """
    # what is drawn changes no sizes, and takes time to make
    undrawn = {key: value for key, value in options.items() if key != "randomize"}
    try:
        parsed = Options.parse(undrawn, "options")
        layout = Episodes(task, parsed, rows=1, threads=1).layout
    except ConfigurationError as error:
        problems = [Problem(("options", *key), text) for key, text in error.problems]
        raise ConfigurationError(problems) from error
    return {name: columns.stop for name, columns in layout.slices.items()}
