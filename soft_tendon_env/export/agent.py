"""Export of a trained agent: one ONNX graph from measurements in SI units to the command that is to be sent.

In it: pose errors, scales and bounds of the observation, its history, the integral, normalisation, network, action scaling and limits. What
is remembered from one call to the next goes in and comes out, NAME and next_NAME, and is all zeros at the beginning.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import onnx

from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.evaluation.provenance import versions
from soft_tendon_env.export.graph import Graph
from soft_tendon_env.export.measurements import measurements
from soft_tendon_env.export.network import actions
from soft_tendon_env.export.observation import ObservationNodes
from soft_tendon_env.policies.agent import NetworkPolicy
from soft_tendon_env.policies.integral import MOST, NEAR, IntegralPolicy
from soft_tendon_env.policies.normalization import BOX, Normalization
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.scene import scene_to_dict
from soft_tendon_env.tools.types import Array

METADATA = "soft_tendon_env"
"""Key of the model's metadata: a table as JSON, see `metadata`."""
COMMANDS = {"N": "tension", "m": "displacement"}
"""Names of the output that is to be sent, by its unit."""


def export_agent(policy: Policy, env: gym.Env[Any, Any], origin: Mapping[str, Any] | None = None) -> onnx.ModelProto:
    """ONNX model of a trained agent, see `load_agent`, for the observation and the actions of its environment.

    origin: what else its metadata should say, such as where it comes from. Raises ValueError for what cannot be exported: networks other
    than layers in a row; TypeError for environments of other packages.
    """
    episodes, graph = episodes_of(env), Graph()
    nodes = ObservationNodes(graph, episodes)
    integral, agent = (policy, policy.policy) if isinstance(policy, IntegralPolicy) else (None, policy)
    if not isinstance(agent, NetworkPolicy) or not isinstance(agent.normalise, Normalization | None):
        raise ValueError(f"policy should be a trained agent, as load_agent gives it, not {type(agent).__name__}")
    seen = {BOX: nodes.flat()}
    if episodes.task.goal is not None:
        achieved, desired = nodes.goals()
        seen = {"achieved_goal": achieved, "desired_goal": desired, "observation": seen[BOX]}
    if integral is not None:
        seen = _moved(graph, seen, integral, episodes)
    if agent.normalise is not None:
        seen = {key: _normalised(graph, value, key, agent.normalise) for key, value in seen.items()}
    action = graph.cast(actions(graph, agent.network, seen), np.float64)
    _outputs(graph, action, nodes.command, episodes)
    return graph.model(episodes.task.name, {METADATA: json.dumps({**metadata(episodes, integral), **(origin or {})})})


def _moved(graph: Graph, seen: dict[str, str], integral: IntegralPolicy, episodes: Episodes) -> dict[str, str]:
    """Observations whose target is moved by the integral of the error, see IntegralPolicy."""
    key = BOX if episodes.task.goal is None else "desired_goal"
    if key == BOX:
        size = episodes.layout.space.shape[0]
        way = graph.take(seen[key], [i for now, _ in integral.ways for i in range(size)[now]])
    else:
        distance = graph.cast(graph.add("Sub", seen[key], seen["achieved_goal"]), np.float64)
        way = graph.add("Div", distance, integral.goal_unit)
    shift = _shift(integral, episodes)
    way, before = graph.cast(way, np.float64), graph.input("integral", (len(shift),), "integral of the error, scaled as the observation")
    largest = graph.add("ReduceMax", graph.add("Abs", way), axes=[0], keepdims=1)
    grown = graph.add("Mul", integral.share, graph.add("Where", graph.add("LessOrEqual", largest, NEAR), way, 0.0))
    total = graph.clip(graph.sum(before, grown), -MOST, MOST)
    graph.output("next_integral", total, (len(shift),), "for the next call")
    moved = graph.sum(graph.cast(seen[key], np.float64), graph.add("MatMul", total, shift))
    return {**seen, key: graph.cast(moved, np.float32)}


def _shift(integral: IntegralPolicy, episodes: Episodes) -> Array:
    """By how much each entry of the observation, or of the goal, moves with each of the integral (entries, size)."""
    if episodes.task.goal is not None:
        return integral.goal_unit * np.eye(3)
    numbers, rows = np.arange(episodes.layout.space.shape[0]), []
    for now, ahead in integral.ways:
        for i, entry in enumerate(numbers[now]):
            moves = [entry, *numbers[ahead][i :: now.stop - now.start]]
            rows.append(np.isin(numbers, moves).astype(np.float64))
    return np.array(rows)


def _normalised(graph: Graph, value: str, key: str, normalise: Normalization) -> str:
    if key not in normalise.moments:
        return value
    mean, variance = normalise.moments[key]
    scaled = graph.add("Div", graph.add("Sub", graph.cast(value, np.float64), mean), np.sqrt(variance + normalise.epsilon))
    return graph.cast(graph.clip(scaled, -normalise.clip, normalise.clip), np.float32)


def _outputs(graph: Graph, action: str, command: str, episodes: Episodes) -> None:
    """The command that an action asks for, within the limits."""
    scale, unit, shape = episodes.actuation.actions, episodes.model.scene.effects.command_unit, (episodes.model.tendon_count,)
    if scale.increment is None:
        wanted = graph.sum(scale.least, graph.add("Mul", 0.5 * (scale.greatest - scale.least), graph.sum(action, 1.0)))
    else:
        wanted = graph.sum(command, graph.add("Mul", scale.increment, action))
    sent = graph.clip(wanted, scale.least, scale.greatest)
    graph.output(COMMANDS.get(unit, "sent"), sent, shape, f"to be sent to the tendons' actuators [{unit}]")
    graph.output("next_command", sent, shape, "for the next call, or what was really sent")
    graph.output("action", action, shape, "in [-1, 1]")
    if "last_action" in episodes.layout.slices:
        graph.output("next_last_action", action, shape, "for the next call")


def metadata(episodes: Episodes, integral: IntegralPolicy | None) -> dict[str, Any]:
    """Table of what an exported agent takes and gives: inputs and layout of its observation with units, rate, limits, scene, versions."""
    options, model, actions = episodes.options, episodes.model, episodes.actuation.actions
    scene = scene_to_dict(model.scene)
    layout = {
        name: {"size": where.stop - where.start, "unit": [*map(float, 1.0 / episodes.layout.scale[where])]}
        for name, where in episodes.layout.slices.items()
    }
    return {
        "task": episodes.task.name,
        "control_period_s": episodes.period,
        "inputs": {
            name: {"shape": of.shape, "unit": of.unit, "description": of.description} for name, of in measurements(episodes).items()
        },
        "observation": layout,
        "history_periods": options.history,
        "preview_s": [*map(float, episodes.ahead[1:])],
        "sensors_m": [*map(float, episodes.sensors)],
        "action": options.action,
        "command": {
            "unit": model.scene.effects.command_unit,
            "least": actions.least.tolist(),
            "greatest": actions.greatest.tolist(),
            "increment": None if actions.increment is None else actions.increment.tolist(),
            "start": episodes.start_command.tolist(),
        },
        "integral_share_of_a_period": None if integral is None else integral.share,
        "scene": model.scene.name,
        "scene_digest": hashlib.sha256(json.dumps(scene, sort_keys=True).encode()).hexdigest(),
        "versions": versions(),
    }
