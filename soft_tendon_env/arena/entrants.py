"""Who plays: controllers of the catalogue, trained agents, several seeds of one training, and policies from anywhere else.

An own policy is `module:name`, a callable that gets the environment and returns an object with Stable-Baselines3's `predict`, or a function
of observations (rows, size) that returns actions (rows, n_a). Its attribute `options`, if it has one, says what it observes and how its
actions are read (options of the environment).
"""

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import groups_of, resolved_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation.conditions import BELIEF, REGIMES, Regime
from soft_tendon_env.evaluation.sweeps import is_folder, seed_files
from soft_tendon_env.policies.agent import INTERFACE, AgentFiles, agent_options, find_agent, is_agent, load_agent, read_config
from soft_tendon_env.policies.controller_policy import make_policy, observation_options
from soft_tendon_env.policies.load import ESTIMATED, check_policy, split_name
from soft_tendon_env.policies.protocol import FunctionPolicy, Policy
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.files import digest, digests

Kind = Literal["model-based", "learned", "hybrid", "other"]
OWN = ":"  # between module and name of an own policy


class Entrant(Configuration):
    """One policy of the benchmark.

    Attributes:
        policy: a controller with a state estimator, such as filtered:predictive or adaptive:tracking@fast, see `load_policy`; the folder
            or .zip file of an agent, or "agent", the one that ships; a folder of runs seed_0, seed_1, ..., as `soft-tendon sweep` leaves
            them; or `module:name`, see soft_tendon_env.arena.entrants.
        name: in tables, by default what `policy` says.
        regimes: in which it plays, by default all whose observations suffice for it.
        told: a controller believes in the arm with the effects of the setting, by the numbers of `Setting.scene`, not those that an episode
            draws: fluid at rest, no load where loads are drawn about zero. For how much of an error is ignorance.
    """

    policy: str
    name: str = ""
    regimes: tuple[str, ...] = ()
    told: bool = False

    @property
    def label(self) -> str:
        """Its name in tables."""
        return self.name or self.policy

    def kind(self, task: str) -> Kind:
        """What sort of policy it is. Raises ValueError, OSError as `members` does."""
        first = next(iter(self.members(task).values()))
        if not is_agent(first):
            return "other" if is_own(first) else "model-based"
        return "learned" if read_config(find_agent(first, task)).residual is None else "hybrid"

    def members(self, task: str) -> dict[int | None, str]:
        """The policies of which it consists, by seed of training; None: the only one. Raises ValueError, OSError for what is none, and for
        one that is told without believing in a model."""
        if self.told and (is_own(self.policy) or is_folder(self.policy) or is_agent(self.policy)):
            raise ValueError(f"told is true of {self.policy}: it is for controllers, which believe in a model")
        if is_own(self.policy):
            own_policy(self.policy)
        elif is_folder(self.policy):
            return seed_files(Path(self.policy), task)
        else:
            check_policy(self.policy, task)
        return {None: self.policy}


def is_own(policy: str) -> bool:
    """Whether it is a policy of the caller's, `module:name`."""
    return OWN in policy and not policy.startswith(tuple(ESTIMATED)) and not is_agent(policy) and not Path(policy).exists()


def own_policy(policy: str) -> Callable[..., Any]:
    """What makes an own policy. Raises ValueError where it is not found."""
    module, _, name = policy.partition(OWN)
    try:
        made = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"policy is {policy!r}: it should be module:name of what makes a policy from an environment; {error}") from error
    if not callable(made):
        raise ValueError(f"policy is {policy!r}: {name} should be callable with an environment, not {type(made).__name__}")
    return made


def interface_options(member: str, task: str, regime: Regime) -> dict[str, Any]:
    """Options of an environment in which it observes what it needs within a regime. Raises ValueError, OSError."""
    if is_own(member):
        given = dict(getattr(own_policy(member), "options", {}))
        return {"observation": observable(task, regime), "sensors": regime.measured.sensors or (), **given}
    if is_agent(member):
        found = agent_options(member, task)
        return {key: found[key] for key in INTERFACE if key in found}
    controller, estimator, _ = split_name(member)
    return observation_options(controller, task, estimator=estimator, regime=None if estimator is None else _name_of(regime))


def _name_of(regime: Regime) -> str:
    return next(name for name, own in REGIMES.items() if own is regime)


def observable(task: str, regime: Regime) -> list[str]:
    """All groups that a task has and a regime allows."""
    return [name for name in regime.groups if name in TASKS[task].observable]


def misfit(member: str, options: Mapping[str, Any], task: str, regime: Regime) -> str:
    """Why a policy that observes what these options say cannot play in a regime; "": it can. Raises ValueError."""
    parsed = Options.parse(dict(options), "options")
    groups = groups_of(parsed, TASKS[task], resolved_scene(parsed))
    if beyond := [name for name in groups if name not in regime.groups]:
        return f"it observes {', '.join(beyond)}"
    count = parsed.sensors if isinstance(parsed.sensors, int) else len(parsed.sensors)
    if "strain" in groups and count > regime.measured.sensors:
        return f"it has {count} strain sensors"
    if member.startswith("measured:") and "strain_rate" not in groups:
        return "it needs the rates of strains"
    return ""


def make_entrant(member: str, env: Any, scene: Scene) -> Policy:
    """The policy for an environment with its `interface_options`; `scene`: the arm as everybody is told. Raises ValueError, OSError."""
    if is_own(member):
        made = own_policy(member)(env)
        return made if hasattr(made, "predict") else FunctionPolicy(made)
    if is_agent(member):
        return load_agent(member, env, other_effects=True)
    controller, estimator, belief = split_name(member)
    return make_policy(controller, env, build_model(scene, belief or BELIEF), estimator=estimator)


def fingerprint(member: str, task: str) -> dict[str, Any]:
    """What tells a policy from others, for results that are kept: name of a controller, files of an agent, source of an own policy."""
    if is_own(member):
        source = Path(str(getattr(importlib.import_module(member.partition(OWN)[0]), "__file__", "")))
        return {"policy": member, "source": digest(source) if source.is_file() else None}
    if is_agent(member):
        return {"agent": _agent_digest(find_agent(member, task))}
    return {"controller": member, "belief": split_name(member)[2] or BELIEF}


def _agent_digest(files: AgentFiles) -> dict[str, str]:
    if files.is_zip:
        beside = {path.name: digest(path) for path in (files.config, files.statistics) if path.is_file()}
        return {files.path.name: digest(files.path), **beside}
    return digests(files.path)
