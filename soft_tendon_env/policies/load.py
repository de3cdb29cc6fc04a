"""Policies by name: a controller of the catalogue, the agent that ships, an agent's folder or .zip file. All have `predict`.

Before a controller's NAME may stand how it knows the state that it is not told: "measured:NAME", by least squares from strains, their rates
and the tip's pose; "filtered:NAME", by an extended Kalman filter from whatever is observed; "adaptive:NAME", by one that estimates the
latency of commands too. After it the fidelity of the model that it believes in, where that is not the arm's: "filtered:NAME@fast".
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from soft_tendon_env.accuracy.fidelity import checked_fidelity
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.envs import Options
from soft_tendon_env.policies.agent import ARM, SHIPPED, agent_arm, agent_options, is_agent, is_run, load_agent
from soft_tendon_env.policies.controller_policy import make_policy, observation_options
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.configuration import not_among, shown

ALL = "all"
BEST = "best"  # the agent of a run's folder
ESTIMATED = {"measured:": "strain", "filtered:": "kalman", "adaptive:": "adaptive"}
"""Estimators by what stands before a controller's name."""
BELIEVED = "@"
"""Between a controller's name and the fidelity of the model that it believes in."""


def expand_policies(task: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """The names, each once, with those of the catalogue in place of "all". Raises ValueError."""
    chosen = [name for given in names for name in (CONTROLLERS.get(task, {}) if given == ALL else (given,))]
    if not chosen:
        raise ValueError(f"policies is {list(names)}: no controller is known for {task}, name an agent's folder")
    return tuple(dict.fromkeys(chosen))


def check_policy(name: str, task: str) -> str:
    """The name of an agent, or of a controller of the task. Raises ValueError."""
    controller, _, belief = split_name(name)
    if is_agent(name) or controller in CONTROLLERS.get(task, {}):
        if belief is not None and not is_agent(name):
            try:
                checked_fidelity(belief)
            except ValueError as error:
                raise ValueError(f"policy is {name!r}: what stands behind {BELIEVED!r} {error}") from error
        return name
    path = Path(name)
    what = "a folder" if path.is_dir() else "a file" if path.is_file() else "no policy"
    hint = f", such as {path / BEST}," if is_run(path) else ""
    agents = f"the folder of an agent{hint or ','} a .zip file of Stable-Baselines3, {SHIPPED!r} for the one that ships"
    controllers = not_among(controller, CONTROLLERS.get(task, {}))
    raise ValueError(f"policy is {name!r}, {what}: it should be {agents}, or a controller of {task}; {controllers}")


def policy_options(name: str, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment in which a policy sees what it needs: its own, and those given. Raises ValueError, OSError."""
    if is_agent(name):
        return {**agent_options(name, task), **given}
    controller, estimator, _ = split_name(check_policy(name, task))
    period = Options.parse(given, "options").control_period
    return {**observation_options(controller, task, period, estimator=estimator), **given}


def shared_options(names: Iterable[str], task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of the arm on which all of these policies act: those given, and for what they leave open those that the agents have.

    Controllers act on the arm that the agents among them were trained on, and believe its model; where no agent says what its arm was,
    nothing is added. Raises ValueError where agents differ in what is left open, OSError.
    """
    arms = {name: arm for name in filter(is_agent, names) if (arm := agent_arm(name, task)) is not None}
    if not arms:
        return dict(given)
    first, found = next(iter(arms.items()))
    for name, arm in arms.items():
        for key in ARM:
            if key not in given and arm[key] != found[key]:
                text = f"{name} has {key} = {shown(arm[key])}, {first} has {shown(found[key])}: their episodes would not be the same"
                raise ValueError(f"{text}. Give {key} in options, for all of them, or take them apart")
    usual = Options().model_dump(mode="json")
    return {**{key: found[key] for key in ARM if found[key] != usual[key]}, **given}


def load_policy(name: str, env: gym.Env[Any, Any], belief: str | None = None) -> Policy:
    """The policy for an environment with the options that it needs, see `policy_options`.

    name: a controller's, measured:NAME, filtered:NAME or adaptive:NAME, with @FIDELITY behind it where it believes in another model; an
    agent's folder or .zip file; "agent", the one that ships for the environment's task. belief: the same as @FIDELITY.
    Raises ValueError, OSError, ModuleNotFoundError.
    """
    if is_agent(name):
        if belief is not None:
            raise ValueError(f"belief is {belief!r}: it should be None for agents, which believe in no model")
        return load_agent(name, env)
    controller, estimator, named = split_name(name)
    return make_policy(controller, env, belief if named is None else named, estimator=estimator)


def split_name(name: str) -> tuple[str, str | None, str | None]:
    """A controller's name in the catalogue, the name of the estimator of its state, and the fidelity of the model that it believes in; None
    where the name does not say."""
    prefix = next((prefix for prefix in ESTIMATED if name.startswith(prefix)), None)
    controller, mark, belief = name.removeprefix(prefix or "").partition(BELIEVED)
    return controller, None if prefix is None else ESTIMATED[prefix], belief if mark else None


def short_name(name: str) -> str:
    """For pictures: of an agent or of a folder of runs, what tells it from others."""
    if not is_agent(name) or name == SHIPPED:
        return Path(name).name
    return "/".join(Path(name.removesuffix(".zip")).parts[-2:])
