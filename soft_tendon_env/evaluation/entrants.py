"""Policies in the benchmark's conditions: what they observe within an information regime, and the arm that controllers believe in.

Folders of runs, as `soft-tendon sweep` leaves them, several seeds of one training, are one policy.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from soft_tendon_env.accuracy.fidelity import at_fidelity
from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import groups_of, resolved_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation.conditions import BELIEF
from soft_tendon_env.policies.agent_checks import CLOCK
from soft_tendon_env.policies.agent_files import INTERFACE, is_agent
from soft_tendon_env.policies.load import expand_policies
from soft_tendon_env.policies.names import BEST, Agent, Controller, Own, PolicyName, Seeds
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.files import digest, digests, read_json

Kind = Literal["model-based", "learned", "other"]
LEARNED: tuple[Kind, ...] = ("learned", "other")
SEED = re.compile(r"seed_(\d+)")
OWN = ("seed", "record", "checkpoint_every", "checkpoint_seconds")  # what a run may have for itself; the rest is that of all seeds


def policy_kind(policy: PolicyName) -> Kind:
    """Kind of a policy: controllers are model-based, agents learned."""
    return "learned" if isinstance(policy, Agent) else "model-based" if isinstance(policy, Controller) else "other"


def interface_options(policy: PolicyName, regime: str) -> dict[str, Any]:
    """Options of an environment in which a policy observes what it needs within a regime; own policies, unless they say otherwise, all that
    the task has and the regime allows. Raises ValueError, OSError."""
    if isinstance(policy, Controller):
        return policy.options({}, None if policy.estimator is None else regime)
    if isinstance(policy, Agent):
        return {key: value for key, value in policy.options({}).items() if key in INTERFACE}
    allowed = REGIMES[regime]
    observable = [name for name in allowed.groups if name in TASKS[policy.task].observable]
    return {"observation": observable, "sensors": allowed.sensors or (), **policy.options({})}


def misfit(policy: PolicyName, options: Mapping[str, Any], regime: str) -> str:
    """Reason why a policy that observes what these options say cannot play in a regime; "": it can. Raises ValueError."""
    parsed, allowed = Options.parse(dict(options), "options"), REGIMES[regime]
    if isinstance(policy, Agent) and policy.arm is not None and policy.arm[CLOCK] != parsed.control_period:
        return f"it was trained with {CLOCK} = {policy.arm[CLOCK]}"
    groups = groups_of(parsed, TASKS[policy.task], resolved_scene(parsed))
    if beyond := [name for name in groups if name not in allowed.groups]:
        return f"it observes {', '.join(beyond)}"
    count = parsed.sensors if isinstance(parsed.sensors, int) else len(parsed.sensors)
    return f"it has {count} strain sensors" if "strain" in groups and count > allowed.sensors else ""


def believed_scene(policy: PolicyName, told: Mapping[str, Any] | None) -> Scene | None:
    """Arm that a controller or an own policy is told of, at BELIEF unless its name says a fidelity; None for agents, and without `told`,
    the option `scene` of an arm that everybody is told of. Raises ValueError."""
    if told is None or not isinstance(policy, Controller | Own):
        return None
    scene = resolved_scene(Options(scene=dict(told), fidelity="scene"))
    return scene if isinstance(policy, Controller) and policy.belief else at_fidelity(scene, BELIEF)


def model_in_the_loop(policy: PolicyName, told: bool = False) -> str:
    """A policy's use of a model of the arm at run time, in words: "none" for agents that need no model, "own" for own policies, of which
    it is not known. told: whether a controller's model has the effects of a benchmark's setting. Raises ValueError, OSError."""
    if isinstance(policy, Controller):
        estimator = [] if policy.estimator is None else [f"{policy.estimator} estimator"]
        return ", ".join(["controller", *estimator, *(["told of the effects"] if told else [])])
    return "none" if isinstance(policy, Agent) else "own"


def randomised_in_training(agent: Agent) -> str:
    """Names of what domain randomisation drew in an agent's training, and of the effects that its arms had. Raises ValueError, OSError."""
    options = agent.config.options
    if options is None:
        return "not known"
    drawn = plain(options.get("randomize", {}))
    effects = resolved_scene(Options.parse(options, "options")).effects.chosen()
    return ", ".join([*(name for name in drawn if name != "effects"), *effects]) or "none"


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


def agents_of(task: str, names: tuple[str, ...]) -> dict[str, dict[int | None, str]]:
    """Agents of every policy by seed: a folder's are the best of its runs. Raises ValueError, OSError."""
    parsed = {name: PolicyName.parse(name, task) for name in expand_policies(task, names)}
    return {name: seed_files(policy) if isinstance(policy, Seeds) else {None: name} for name, policy in parsed.items()}


def every_file(files: Mapping[str, Mapping[int | None, str]]) -> list[str]:
    """Every agent or controller of policies once."""
    return [*dict.fromkeys(file for of_policy in files.values() for file in of_policy.values())]


def seed_folders(folder: Path) -> dict[int, Path]:
    """Runs seed_0, seed_1, ... of a folder by seed, in their order. Raises FileNotFoundError where there are none."""
    found = {int(match[1]): path for path in folder.glob("seed_*") if path.is_dir() and (match := SEED.fullmatch(path.name))}
    if not found:
        text = f"{folder} has no folders seed_0, seed_1, ... of runs, as `soft-tendon sweep` leaves them"
        raise FileNotFoundError(f"{text}; of a single run name its best agent, {folder / BEST}")
    return dict(sorted(found.items()))


def read_run(run: Path) -> dict[str, Any]:
    """Configuration of a run. Raises ValueError, FileNotFoundError without one."""
    path = run / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{run} is no run: it has no config.json, as `soft-tendon train` writes it")
    return read_json(path)


def seed_files(seeds: Seeds) -> dict[int | None, str]:
    """Names of the best agents by seed. Raises ValueError, FileNotFoundError unless all were trained on the task, and alike."""
    files: dict[int | None, str] = {}
    first: dict[str, Any] | None = None
    for seed, run in seed_folders(Path(seeds.text)).items():
        agent, config = run / BEST, read_run(run)
        first = first or config
        if config.get("task") != seeds.task:
            raise ValueError(f"{run} was trained on {config.get('task')}, not on {seeds.task}")
        for key in sorted((first | config).keys() - OWN):
            if config.get(key) != first.get(key):
                raise ValueError(f"{run} has {key} = {config.get(key)!r}, the first seed has {first.get(key)!r}: compare them apart")
        if not is_agent(str(agent)):
            raise FileNotFoundError(f"{run} has no agent in {BEST}: finish its training with `soft-tendon sweep`, or take it away")
        files[seed] = str(agent)
    return files
