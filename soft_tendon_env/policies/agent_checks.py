"""Whether a trained agent fits an environment: the arm that it was trained on, and the meaning of its observations and actions."""

import warnings
from typing import Any

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.policies.agent_files import ARM, INTERFACE, AgentConfig
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import shown

CLOCK = "control_period"
PHYSICS = ("segments", "tendons", "effects")
"""Tables of a scene that define the physical arm, as opposed to how it is computed."""


class TrainingWarning(UserWarning):
    """An agent acts in another environment than it was trained in."""


def check_agent(name: str, config: AgentConfig, episodes: Episodes, other_effects: bool) -> None:
    """Raises ValueError where an agent was trained on another arm, or with another meaning of observations or actions. other_effects:
    those of the arm may be others. Warns (TrainingWarning) of another task, control period, or arm as it is computed."""
    now, scene, layout = episodes.options, episodes.model.scene, layout_of(episodes)
    trained = now if config.options is None else Options(**config.options)
    before = scene if config.options is None else resolved_scene(trained)
    for key in PHYSICS:
        if getattr(before, key) != getattr(scene, key) and not (other_effects and key == "effects"):
            text = f"{name} was trained on an arm with other {key} (scene {before.name!r}) than this environment's ({scene.name!r})"
            raise ValueError(f"{text}: an arm that differs from it is what `randomize` is for")
    groups = [", ".join(f"{group} ({size})" for group, size in of.items()) for of in (config.layout or layout, layout)]
    if groups[0] != groups[1]:  # also in their order
        raise ValueError(f"{name} was trained with the observation {groups[0]}, this environment has {groups[1]}")
    values = {key: (getattr(trained, key), getattr(now, key)) for key in INTERFACE[1:]}
    if {"coordinates", "rates", "target_coordinates"} & layout.keys():
        values["strain"] = (config.strain or strain_of(before), strain_of(scene))
    for key, (one, other) in values.items():
        if one != other:
            raise ValueError(f"{name} was trained with {key} = {shown(one)}, this environment has {shown(other)}")
    same = before.replace({"name": "arm"}) == scene.replace({"name": "arm"})
    soft = {"task": (config.task or episodes.task.name, episodes.task.name)}
    soft |= {key: (getattr(trained, key), getattr(now, key)) for key in ARM if key == CLOCK or not same}
    if not other_effects and (other := [f"{key} = {one!r}, judged with {two!r}" for key, (one, two) in soft.items() if one != two]):
        text = f"{name}: trained with {'; '.join(other)}. policy_options() has the options of its training"
        warnings.warn(text, TrainingWarning, stacklevel=5)


def strain_of(scene: Scene) -> dict[str, Any]:
    """Strain parametrisation of a scene as plain tables."""
    return scene.strain.model_dump(mode="json", exclude_none=True)


def layout_of(episodes: Episodes) -> dict[str, int]:
    """Groups of an observation in their order, with their sizes."""
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}
