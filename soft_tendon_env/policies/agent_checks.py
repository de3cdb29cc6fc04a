"""Whether a trained agent fits an environment: the arm that it was trained on, and the meaning of its observations and actions."""

from collections.abc import Iterable
from typing import Any

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import resolved_scene, sensor_places
from soft_tendon_env.policies.agent_files import ARM, CONFIG, INTERFACE, AgentConfig, find_agent, read_config
from soft_tendon_env.policies.normalization import STATISTICS
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import shown

CLOCK = "control_period"


class TrainingWarning(UserWarning):
    """An agent acts in another environment than it was trained in."""


PHYSICS = ("segments", "tendons", "effects")
"""Tables of a scene that define the physical arm, as opposed to how it is computed."""


def check_arm(name: str, config: AgentConfig, episodes: Episodes, physics: Iterable[str]) -> None:
    """Raises ValueError where an agent was trained on another arm, or with other observations or actions of the same size."""
    trained = None if config.options is None else Options(**config.options)
    scene = None if trained is None else resolved_scene(trained)
    for part in physics:
        if scene is not None and getattr(scene, part) != getattr(episodes.model.scene, part):
            text = f"{name} was trained on an arm with other {part} (scene {scene.name!r}) than this environment's"
            raise ValueError(f"{text} ({episodes.model.scene.name!r}): an arm that differs from it is what `randomize` is for")
    layout = layout_of(episodes)
    arm = [] if trained is None else [key for key in ARM if getattr(trained, key) != getattr(episodes.options, key)]
    remedy = "".join(f"; its {key} was {shown(getattr(trained, key))}" for key in arm)
    if config.layout is not None and [*config.layout.items()] != [*layout.items()]:  # in the same order
        seen, there = (", ".join(f"{group} ({size})" for group, size in of.items()) for of in (config.layout, layout))
        raise ValueError(f"{name} was trained with the observation {seen}, this environment has {there}{remedy}")
    before, now = (_interface(options, episodes) for options in (trained or episodes.options, episodes.options))
    if config.strain is not None and before["strain"] is not None:
        before["strain"] = config.strain
    for key in before:
        if before[key] != now[key]:
            raise ValueError(f"{name} was trained with {key} = {shown(before[key])}, this environment has {shown(now[key])}{remedy}")


def _interface(options: Options, episodes: Episodes) -> dict[str, Any]:
    """Meaning of observations and actions beyond the names and sizes of groups, as far as there are such groups."""
    groups, scene = tuple(episodes.layout.slices), resolved_scene(options)
    return {
        "strain": strain_of(scene) if any("coordinates" in group or group == "rates" for group in groups) else None,
        "action": options.action,
        "tension_rate": options.tension_rate if options.action == "increment" else None,
        "preview": options.preview if any("preview" in group for group in groups) else None,
        "sensors": tuple(sensor_places(options, scene)) if any(group.startswith("strain") for group in groups) else None,
    }


def strain_of(scene: Scene) -> dict[str, Any]:
    """Strain parametrisation of a scene as plain tables."""
    return scene.strain.model_dump(mode="json", exclude_none=True)


def layout_of(episodes: Episodes) -> dict[str, int]:
    """Groups of an observation in their order, with their sizes."""
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}


def caveats(judged: Iterable[tuple[str, str, dict[str, Any]]]) -> list[str]:
    """Warnings, a line each, of agents that are judged otherwise than they were trained. judged: name, task and options of each.

    Raises ValueError, OSError.
    """
    found: dict[str, dict[str, None]] = {}
    for name, task, options in judged:
        files = find_agent(name, task)
        config = read_config(files)
        texts = differences(config, Options(**options), task)
        if (trained := config.options) is None:
            text = "no config.json says what it was trained on; numbers are right only if that was the arm and the options"
            texts.append(f"{text} of this evaluation")
        elif left_out := sorted(key for key in trained if key not in (*ARM, *INTERFACE) and trained[key] != options.get(key)):
            texts.append(f"judged without the {', '.join(left_out)} of the training")
        if not (files.is_zip or files.statistics.exists() or "observations" in config.normalise):  # a .zip file says it by itself
            text = f"there is no {STATISTICS}, and {CONFIG} does not say normalise.observations; numbers are right only if it learned"
            texts.append(f"{text} without VecNormalize's statistics of observations")
        for text in texts:
            found.setdefault(text, {})[name] = None
    return [f"{', '.join(names)}: {text}" for text, names in found.items()]


def differences(config: AgentConfig, now: Options, task: str) -> list[str]:
    """Lines on how an environment differs from that of a training: in its task, the clock, or the arm as it is computed."""
    trained, values = None if config.options is None else Options(**config.options), {"task": (config.task or task, task)}
    if trained is not None:
        before, there = (resolved_scene(options).replace({"name": "arm"}) for options in (trained, now))
        values |= {key: (getattr(trained, key), getattr(now, key)) for key in ARM if key == CLOCK or before != there}
    return [f"trained with {key} = {shown(one)}, judged with {shown(other)}" for key, (one, other) in values.items() if one != other]
