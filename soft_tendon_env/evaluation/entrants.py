"""Policies in the benchmark's conditions: what they observe within an information regime, and the arm that controllers believe in."""

from collections.abc import Mapping
from typing import Any, Literal

from soft_tendon_env.accuracy.fidelity import at_fidelity, build_model
from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import groups_of, resolved_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation.conditions import BELIEF, REGIMES
from soft_tendon_env.policies.agent_files import INTERFACE
from soft_tendon_env.policies.names import Agent, Controller, Own, PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.files import digest, digests

Kind = Literal["model-based", "learned", "hybrid", "other"]
LEARNED: tuple[Kind, ...] = ("learned", "hybrid", "other")


def policy_kind(policy: PolicyName) -> Kind:
    """Kind of a policy: controllers are model-based, agents learned, those that add to a controller's actions hybrid. Raises ValueError,
    OSError."""
    if isinstance(policy, Agent):
        return "learned" if policy.config.residual is None else "hybrid"
    return "model-based" if isinstance(policy, Controller) else "other"


def interface_options(policy: PolicyName, regime: str) -> dict[str, Any]:
    """Options of an environment in which a policy observes what it needs within a regime; own policies, unless they say otherwise, all that
    the task has and the regime allows. Raises ValueError, OSError."""
    if isinstance(policy, Controller):
        return policy.options({}, None if policy.estimator is None else regime)
    if isinstance(policy, Agent):
        return {key: value for key, value in policy.options({}).items() if key in INTERFACE}
    allowed = REGIMES[regime]
    observable = [name for name in allowed.groups if name in TASKS[policy.task].observable]
    return {"observation": observable, "sensors": allowed.measured.sensors or (), **policy.options({})}


def misfit(policy: PolicyName, options: Mapping[str, Any], regime: str) -> str:
    """Reason why a policy that observes what these options say cannot play in a regime; "": it can. Raises ValueError."""
    parsed, allowed = Options.parse(dict(options), "options"), REGIMES[regime]
    groups = groups_of(parsed, TASKS[policy.task], resolved_scene(parsed))
    if beyond := [name for name in groups if name not in allowed.groups]:
        return f"it observes {', '.join(beyond)}"
    count = parsed.sensors if isinstance(parsed.sensors, int) else len(parsed.sensors)
    if "strain" in groups and count > allowed.measured.sensors:
        return f"it has {count} strain sensors"
    by_strains = isinstance(policy, Controller) and policy.estimator == "strain"
    return "it needs the rates of strains" if by_strains and "strain_rate" not in groups else ""


def believed_scene(policy: PolicyName, told: Mapping[str, Any] | None) -> Scene | None:
    """Arm that a controller believes in, at BELIEF unless its name says another fidelity; None for other policies, and without `told`, the
    option `scene` of an arm that everybody is told of. Raises ValueError."""
    if told is None or not isinstance(policy, Controller):
        return None
    return at_fidelity(resolved_scene(Options(scene=dict(told), fidelity="scene")), policy.belief or BELIEF)


def load_entrant(policy: PolicyName, env: Any, told: Mapping[str, Any] | None) -> Policy:
    """Policy for an environment with the options that it needs; controllers know the arm that they are told of, see `believed_scene`.

    With `told` agents may act on arms with other effects than they were trained with. Raises ValueError, OSError.
    """
    scene = believed_scene(policy, told)
    if scene is not None and isinstance(policy, Controller):
        return policy.load(env, build_model(scene, "scene"))
    return policy.load(env, other_effects=True) if told is not None and isinstance(policy, Agent) else policy.load(env)


def fingerprint(policy: PolicyName) -> dict[str, Any]:
    """Name of a controller, digests of an agent's files, or source of an own policy, by which it is told from others. Raises ValueError,
    OSError."""
    if isinstance(policy, Agent):
        files = policy.files
        beside = [path for path in (files.path, files.config, files.statistics) if path.is_file()]
        return {"agent": {path.name: digest(path) for path in beside} if files.is_zip else digests(files.path)}
    source = policy.source if isinstance(policy, Own) else None
    parameters = policy.parameters if isinstance(policy, Controller) else {}
    return {"policy": policy.text, "parameters": dict(parameters), "source": None if source is None else digest(source)}
