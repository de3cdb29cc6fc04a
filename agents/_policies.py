"""Policies by name: a controller of the catalogue, or the .zip file of a Stable-Baselines3 agent. Both have `predict`.

"measured:NAME" is the controller NAME, told strains at sensors and the tip's pose in place of the coordinates.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
from _agents import agent_file, agent_options, is_agent, load_agent

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation.run import Policy
from soft_tendon_env.policies.controller_policy import make_policy, observation_options
from soft_tendon_env.tools.configuration import not_among

ALL = "all"
MODEL = Path("best", "model.zip")  # of a run's folder
MEASURED = "measured:"


def policies_of(task: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """The names, each once, with those of the catalogue in place of "all". Raises ValueError."""
    chosen = [name for given in names for name in (CONTROLLERS[task] if given == ALL else (given,))]
    if not chosen:
        raise ValueError(f"policies is {list(names)}: no controller is known for {task}, name an agent's .zip file")
    return tuple(dict.fromkeys(chosen))


def checked_policy(name: str, task: str) -> str:
    """The name of an agent's file, or of a controller of the task. Raises ValueError."""
    controller = name.removeprefix(MEASURED)
    if is_agent(name) or controller in CONTROLLERS[task]:
        return name
    what = "a folder" if Path(name).is_dir() else "a file" if Path(name).is_file() else "no policy"
    hint = f"the .zip file of an agent{f', such as {Path(name) / MODEL},' if what == 'a folder' else ''} or a controller of {task}"
    raise ValueError(f"policy is {name!r}, {what}: it should be {hint}; {not_among(controller, CONTROLLERS[task])}")


def options_for(name: str, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment in which a policy sees what it needs: its own, and those given. Raises ValueError, OSError."""
    if is_agent(name):
        return {**agent_options(agent_file(name)[1]), **given}
    controller, measured = controller_of(checked_policy(name, task))
    return {**observation_options(controller, task, Options.parse(given, "options").control_period, measured), **given}


def load_policy(name: str, env: gym.Env) -> Policy:
    """The policy for an environment with the options that it needs. Raises ValueError, OSError, ModuleNotFoundError."""
    if is_agent(name):
        return load_agent(name, env)
    controller, measured = controller_of(name)
    return make_policy(controller, env, measured=measured)


def controller_of(name: str) -> tuple[str, bool]:
    """Its name in the catalogue, and whether it is told strains."""
    return name.removeprefix(MEASURED), name.startswith(MEASURED)


def short_name(name: str) -> str:
    """For pictures: of an agent's file or of a folder of runs, what tells it from others."""
    return "/".join(Path(name).with_suffix("").parts[-2:]) if is_agent(name) else Path(name).name
