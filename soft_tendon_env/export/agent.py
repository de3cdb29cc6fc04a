"""Export of a trained agent: one ONNX graph from measurements in SI units to the command that is to
be sent, and its check.

PyTorch traces the observation (`differentiable.observation`), integral action, normalisation,
network and action scaling. What is remembered from one call to the next goes in and comes out, NAME
and next_NAME, and is all zeros at the beginning.
"""

import io
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import onnx
import onnxruntime
import torch

from soft_tendon_env.differentiable.actuation import TensorActuation
from soft_tendon_env.differentiable.observation import TensorObservation
from soft_tendon_env.differentiable.period import as_tensors
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.observation import Observed, RestValues
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.evaluation.conditions import EVALUATION_SEEDS
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.export.network import TensorNetwork
from soft_tendon_env.policies.agent import NetworkPolicy
from soft_tendon_env.policies.integral import MOST, NEAR, IntegralPolicy
from soft_tendon_env.policies.network import PolicyNetwork
from soft_tendon_env.policies.normalization import BOX, Normalization
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.types import Array

OPSET, IR_VERSION = 17, 8  # of ONNX 1.12 (2022), which runtimes of small computers have
SMALL = 1e-6  # sine of half an angle below which the limits at zero are exact to double precision
SEEDS = EVALUATION_SEEDS[:4]  # of the check: 1,000 observations
# difference of commands, as a share of their range, beyond which it is no round-off of a network in
# single precision
ALLOWED = 1e-4
MEASUREMENTS: Mapping[str, tuple[str, Callable[[Observed], Array]]] = {
    "tip_pose": ("1, last column m", lambda o: o.tip_pose),
    "tip_twist": ("rad/s, then m/s", lambda o: o.tip_twist),
    "tendon_lengths": ("m", lambda o: o.tendon_length),
    "strain": ("1/m three times, then 1", lambda o: o.measured.strain - o.rest.strain),
    "strain_rate": ("1/(m s) three times, then 1/s", lambda o: o.measured.strain_rate),
    "coordinates": ("the coordinates'", lambda o: o.q),
    "rates": ("the coordinates' per second", lambda o: o.q_dot),
    "target_pose": ("1, last column m", lambda o: o.target.tip_pose),
    "target_twist": ("rad/s, then m/s", lambda o: o.target.tip_twist),
    "target_coordinates": ("the coordinates'", lambda o: o.target.q),
    "target_lengths": (
        "m",
        lambda o: o.target_length if o.target.tendon_length.size else o.target.tendon_length[:, 0],
    ),
}
"""Inputs of exported agents by name: unit, and values (rows, ...). Lengths and strains are less
those at rest."""


def measurements(episodes: Episodes) -> dict[str, Array]:
    """Measurements of a single environment now, by name."""
    return {name: values(episodes.observed)[0].copy() for name, (_, values) in MEASUREMENTS.items()}


def pose_logarithm(pose: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """SE(3) logarithms log(g^-1 g_bar) (m, 6), angular before linear, from a pose g (4, 4) to
    wanted ones g_bar (m, 4, 4), float64, by operations that ONNX has. Rotations go by way of unit
    quaternions (Shepperd 1978), which are exact at half turns too."""
    turn = (pose[None, :3, :3, None] * wanted[:, :3, None, :3]).sum(
        1
    )  # R^T R_bar: not all runtimes have products of transposed doubles
    q = _quaternion(turn)
    p, w, v = (wanted[:, :3, 3] - pose[:3, 3]) @ pose[:3, :3], q[:, :1], q[:, 1:]
    s = (v * v).sum(1, keepdim=True).sqrt()
    half = torch.atan(
        (s / w.clamp(min=1e-30)).float()
    ).double()  # runtimes have no atan of doubles: a step of Newton's adds the digits
    half = half + s * torch.sin(half + 0.5 * math.pi) - w * torch.sin(half)
    safe = s.clamp(min=SMALL)
    k = v * torch.where(s < SMALL, 2.0, 2.0 * half / safe)
    e = torch.where(
        s < SMALL, 1.0 / 12.0, (1.0 - half * w / safe) / (4.0 * half * half).clamp(min=SMALL**2)
    )
    u = torch.linalg.cross(k, p)
    return torch.cat([k, p - 0.5 * u + e * torch.linalg.cross(k, u)], dim=1)


def _quaternion(R: torch.Tensor) -> torch.Tensor:
    """Unit quaternions (m, 4), w >= 0 first, of rotation matrices (m, 3, 3): the longest column of
    4 q q^T, which is linear in R."""
    trace = (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2])[:, None, None]
    axial = torch.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], dim=1
    )[:, None]
    symmetric = R + R.transpose(1, 2) + (1.0 - trace) * torch.eye(3, dtype=R.dtype)
    products = torch.cat(
        [
            torch.cat([1.0 + trace, axial], dim=2),
            torch.cat([axial.transpose(1, 2), symmetric], dim=2),
        ],
        dim=1,
    )
    longest = torch.eye(4, dtype=R.dtype)[products.reshape(-1, 16)[:, ::5].argmax(1)]
    column = (products * longest[:, None]).sum(2)
    return (
        torch.where(column[:, :1] < 0.0, -1.0, 1.0)
        * column
        / (column * column).sum(1, keepdim=True).sqrt()
    )


class _ControlPeriod(torch.nn.Module):
    """One control period of an agent: measurements and states, in the order of `inputs`, to values
    in the order of `outputs`."""

    def __init__(
        self, episodes: Episodes, agent: NetworkPolicy, integral: IntegralPolicy | None
    ) -> None:
        super().__init__()
        self.network = TensorNetwork(agent.network)
        self.agent = agent
        self.episodes = episodes
        self.integral = integral
        self.observation, self.scale = (
            TensorObservation(episodes, torch.float32),
            TensorActuation(episodes.actuation).scale,
        )
        self.start = dict(
            zip(
                ("command", "last_action"),
                as_tensors(episodes.start_command, episodes.actuation.start_action),
                strict=True,
            )
        )
        states = {"started": torch.zeros(1)} | {
            name: torch.zeros_like(value) for name, value in self.start.items()
        }
        if episodes.history is not None:
            states["history"] = torch.zeros(episodes.options.history, episodes.layout.kept.size)
        if (
            integral is not None
        ):  # its linear maps: to the way that is integrated, and from the integral to what moves
            unit, size = integral.goal_unit, episodes.layout.space.shape[0]
            way = np.eye(3) / unit if episodes.task.goal else integral._way(np.eye(size))
            moved = (
                unit * np.eye(3)
                if episodes.task.goal
                else integral._move_target(np.zeros(way.T.shape), np.eye(way.shape[1]))
            )
            self.way, self.shift = as_tensors(way, moved)
            states["integral"] = torch.zeros(len(moved))
        if self.network.memory:
            states["memory"] = torch.zeros(self.network.memory)
        measured = dict(
            zip(MEASUREMENTS, as_tensors(*measurements(episodes).values()), strict=True)
        )
        self.inputs = {**measured, **{name: value.double() for name, value in states.items()}}
        self.outputs = ["action", *(f"next_{name}" for name in states)]

    def forward(self, *values: torch.Tensor) -> tuple[torch.Tensor, ...]:
        given = {name: value[None] for name, value in zip(self.inputs, values, strict=True)}
        running = given["started"] > 0.5
        command, before = (
            torch.where(running, given[name], start) for name, start in self.start.items()
        )
        arm = SimpleNamespace(
            **given,
            q=given["coordinates"],
            q_dot=given["rates"],
            tendon_length=given["tendon_lengths"],
        )
        wanted: Any = (
            *(given[f"target_{name}"] for name in ("pose", "twist", "coordinates")),
            given["target_lengths"][:, None],
            None,
        )
        error: Any = pose_logarithm(arm.tip_pose[0], given["target_pose"][0])[None]
        rest: Any = RestValues(
            *as_tensors(*(0.0 * value for value in self.episodes.observed.rest))
        )  # of which measurements are free
        of_arm: dict[str, Any] = {
            "arms": SimpleNamespace(rows=arm, reading=arm),
            "measured": arm,
            "action": before,
            "command": command,
        }
        observed: Any = replace(
            self.episodes.observed, error=error, target=TargetSamples(*wanted), rest=rest, **of_arm
        )
        flat, past, total = self.observation.groups(observed), given.get("history"), None
        if past is not None:
            past = torch.where(running[..., None], past, flat[:, None, self.episodes.layout.kept])
        seen, past = self.observation.complete(observed, flat, past)
        parts = dict(seen) if isinstance(seen, dict) else {BOX: seen}
        if self.integral is not None:
            key = BOX if BOX in parts else "desired_goal"
            way = (parts[key] - parts.get("achieved_goal", 0.0)).double() @ self.way
            grown = self.integral.share * torch.where(
                way.abs().amax(1, keepdim=True) <= NEAR, way, 0.0
            )
            total = (given["integral"] + grown).clamp(-MOST, MOST)
            parts[key] = (parts[key].double() + total @ self.shift).float()
        if isinstance(by := self.agent.normalise, Normalization):
            for key, of in by.moments.items():
                mean, deviation = as_tensors(of.mean, np.sqrt(of.variance + by.epsilon))
                parts[key] = ((parts[key] - mean) / deviation).clamp(-by.clip, by.clip).float()
        seen, memory = parts.get(BOX, parts), given.get("memory")
        action, remembered = self.network(seen, None if memory is None else memory.float())
        if memory is not None:
            memory = remembered.double()
        action = action.clamp(-1.0, 1.0).double()
        sent = torch.minimum(
            torch.maximum(self.scale.wanted(action, command), self.scale.least), self.scale.greatest
        )
        found = [action, given["started"].clamp(min=1.0), sent, 1.0 * action, past, total, memory]
        return tuple(value[0] for value in found if value is not None)


def export_agent(
    policy: Policy, env: gym.Env[Any, Any], origin: Mapping[str, Any] | None = None
) -> onnx.ModelProto:
    """ONNX model of a trained agent, see `load_agent`, for the observation and the actions of its
    environment.

    origin: what its metadata should say besides. Raises ValueError for other policies and
    observation groups in NumPy, ConfigurationError naming those of contact, TypeError
    for environments of other packages."""
    episodes, file = episodes_of(env), io.BytesIO()
    integral, agent = (
        (policy, policy.policy) if isinstance(policy, IntegralPolicy) else (None, policy)
    )
    known = (
        isinstance(agent, NetworkPolicy)
        and isinstance(agent.network, PolicyNetwork)
        and isinstance(agent.normalise, Normalization | None)
    )
    if not isinstance(agent, NetworkPolicy) or not known:
        raise ValueError(
            f"policy should be a trained agent, as load_agent gives it, not {type(agent).__name__}"
        )
    module = _ControlPeriod(episodes, agent, integral).eval()
    options: dict[str, Any] = {
        "input_names": [*module.inputs],
        "output_names": module.outputs,
        "opset_version": OPSET,
        "dynamo": False,
    }
    with warnings.catch_warnings(record=True, action="always") as told, torch.no_grad():
        torch.onnx.export(module, (*module.inputs.values(),), file, **options)  # type: ignore[arg-type] # takes files too
    if any(
        "to a NumPy array" in str(warning.message) for warning in told
    ):  # the tracer's others are of sizes, which are constants
        raise ValueError(
            "an observation group uses NumPy, whose values the file would have as constants: use"
            " what tensors have too"
        )
    model = onnx.load_from_string(file.getvalue())
    used = {name for node in model.graph.node for name in node.input}
    for unused in [of for of in model.graph.input if of.name not in used]:
        model.graph.input.remove(unused)
    model.ir_version, actions, values = (
        IR_VERSION,
        episodes.actuation.actions,
        measurements(episodes),
    )
    said = {
        "task": episodes.task.name,
        "control_period_s": episodes.period,
        "inputs": {
            name: {"shape": values[name].shape, "unit": unit}
            for name, (unit, _) in MEASUREMENTS.items()
            if name in used
        },
        "preview_s": episodes.ahead[1:].tolist(),
        "sensors_m": episodes.sensors.tolist(),
        "command": {
            "unit": episodes.model.scene.effects.command_unit,
            "limits": np.c_[actions.least, actions.greatest].tolist(),
        },
    }
    onnx.helper.set_model_props(model, {"soft_tendon_env": json.dumps({**said, **(origin or {})})})
    onnx.checker.check_model(model, full_check=True)
    return model


def compare(
    path: Path,
    policy: Policy,
    env: gym.Env[Any, Any],
    seeds: Sequence[int] = SEEDS,
    steps: int = 250,
) -> tuple[int, float, float]:
    """Number of observations, and the largest difference of commands on them, in their unit and as
    a share of their range.

    The original acts for `steps` control periods of an episode from each seed. The exported agent
    gets what is measured meanwhile, and remembers as command what the original has sent.
    """
    episodes, session = (
        episodes_of(env),
        onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"]),
    )
    names, found = [of.name for of in session.get_outputs()], list[Array]()
    for seed in seeds:
        after = {f"next_{of.name}": np.zeros(of.shape) for of in session.get_inputs()}
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if k:
                found.append(np.abs(after["next_command"] - episodes.actuation.command[0]))
                after["next_command"] = episodes.actuation.command[0].copy()
            if k == steps or step.ended[0]:
                break
            known = {
                **{name.removeprefix("next_"): value for name, value in after.items()},
                **measurements(episodes),
            }
            after = dict(
                zip(
                    names,
                    session.run(names, {of.name: known[of.name] for of in session.get_inputs()}),
                    strict=True,
                )
            )
    actions, largest = episodes.actuation.actions, np.max(found, axis=0)
    return (
        len(found),
        float(largest.max()),
        float((largest / (actions.greatest - actions.least)).max()),
    )
