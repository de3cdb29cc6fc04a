"""Policies by name: what an environment has to be like for them, and the policies for it. See names.py for the names that there are."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_files import is_agent, is_shipped
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.protocol import Policy

ALL = "all"  # name of all controllers of the catalogue together


def policy_options(name: str, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment in which a policy sees what it needs: its own, and those given. Raises ValueError, OSError."""
    return PolicyName.parse(name, task).options(given)


def load_policy(name: str, env: Any) -> Policy:
    """The policy for an environment with the options that it needs, see `policy_options`.

    name: a controller's, filtered:NAME or adaptive:NAME, with @FIDELITY behind it where it believes in another model; an agent's folder;
    "agent", "ppo", "sac", "dagger" or "apg", of those that ship for the environment's task; module:name of what makes one.
    Raises TypeError for environments of other packages, ValueError, OSError, ModuleNotFoundError.
    """
    return PolicyName.parse(name, episodes_of(env).task.name).load(env)


def short_name(name: str) -> str:
    """Short form of a policy's name, for pictures: the end of a path."""
    return "/".join(Path(name).parts[-2:]) if is_agent(name) and not is_shipped(name) else Path(name).name
