"""Policies by name: what an environment has to be like for them, and the policies for it. See names.py for the names that there are."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_files import ARM, is_agent, is_shipped
from soft_tendon_env.policies.names import Agent, Controller, PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.configuration import shown

ALL = "all"
"""Name of all controllers of the catalogue together."""


def expand_policies(task: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """The names, each once, with those of the catalogue in place of "all". Raises ValueError."""
    chosen = [name for given in names for name in (CONTROLLERS.get(task, {}) if given == ALL else (given,))]
    if not chosen:
        raise ValueError(f"policies is {list(names)}: no controller is known for {task}, name an agent's folder")
    return tuple(dict.fromkeys(chosen))


def policy_options(name: str, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment in which a policy sees what it needs: its own, and those given. Raises ValueError, OSError."""
    return PolicyName.parse(name, task).options(given)


def shared_options(names: Iterable[str], task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of the arm on which all of these policies act: those given, and for what they leave open those that the agents have.

    Controllers act on the arm that the agents among them were trained on, and believe its model; where no agent says what its arm was,
    nothing is added. Raises ValueError where agents differ in what is left open, OSError.
    """
    agents = [policy for name in names if isinstance(policy := PolicyName.parse(name, task), Agent)]
    arms = {agent.text: arm for agent in agents if (arm := agent.arm) is not None}
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

    name: a controller's, filtered:NAME or adaptive:NAME, with @FIDELITY behind it where it believes in another model; an agent's folder or
    .zip file; "agent", "ppo", "sac", "dagger" or "apg", of those that ship for the environment's task; module:name of what makes one.
    belief: fidelity of the model that a controller believes in, where its name says none.
    Raises TypeError for environments of other packages, ValueError, OSError, ModuleNotFoundError.
    """
    parsed = PolicyName.parse(name, episodes_of(env).task.name)
    if belief is None:
        return parsed.load(env)
    if not isinstance(parsed, Controller):
        raise ValueError(f"belief is {belief!r}: it should be None for agents, which believe in no model")
    return parsed.load(env) if parsed.belief is not None else parsed.load(env, at_fidelity(episodes_of(env).model.scene, belief))


def short_name(name: str) -> str:
    """Short form of a policy's name, for pictures: the end of a path."""
    is_path = is_agent(name) and not is_shipped(name)
    return "/".join(Path(name.removesuffix(".zip")).parts[-2:]) if is_path else Path(name).name
