"""Export of a trained agent: one ONNX graph from measurements to the command.

Measurements are in SI units; the command is to be sent. The graph is checked.

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
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor

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

Parts = dict[str, Tensor]  # tensors of one row by name
# of ONNX 1.12 (2022), which runtimes of small computers have
OPSET = 17
IR_VERSION = 8
SMALL = 1e-6  # sine of half an angle below which the limits at zero are exact to double precision
TINY = 1e-30  # in place of a cosine of 0, so that the quotient with it stays finite
SEEDS = EVALUATION_SEEDS[:4]  # of the check: 1,000 observations
# difference of commands, as a share of their range, beyond which it is no round-off of a network in
# single precision
ALLOWED = 1e-4


class Measurement(NamedTuple):
    """An input of exported agents."""

    unit: str
    values: Callable[[Observed], Array]  # (rows, ...)


def _target_length(observed: Observed) -> Array:
    """Tendon lengths (rows, n_a) [m] of the target less those at rest, (rows, 0) without them."""
    lengths = observed.target.tendon_length
    if lengths.size:
        return observed.target_length
    return lengths[:, 0]


MEASUREMENTS: Mapping[str, Measurement] = {
    "tip_pose": Measurement("1, last column m", lambda o: o.tip_pose),
    "tip_twist": Measurement("rad/s, then m/s", lambda o: o.tip_twist),
    "tendon_lengths": Measurement("m", lambda o: o.tendon_length),
    "strain": Measurement("1/m three times, then 1", lambda o: o.measured.strain - o.rest.strain),
    "strain_rate": Measurement("1/(m s) three times, then 1/s", lambda o: o.measured.strain_rate),
    "coordinates": Measurement("the coordinates'", lambda o: o.q),
    "rates": Measurement("the coordinates' per second", lambda o: o.q_dot),
    "target_pose": Measurement("1, last column m", lambda o: o.target.tip_pose),
    "target_twist": Measurement("rad/s, then m/s", lambda o: o.target.tip_twist),
    "target_coordinates": Measurement("the coordinates'", lambda o: o.target.q),
    "target_lengths": Measurement("m", _target_length),
}
"""Inputs of exported agents by name. Lengths and strains are less those at rest."""


def measurements(episodes: Episodes) -> dict[str, Array]:
    """Measurements of a single environment now, by name."""
    values = {}
    for name, measurement in MEASUREMENTS.items():
        rows = measurement.values(episodes.observed)
        values[name] = rows[0].copy()
    return values


def pose_logarithm(pose: Tensor, target: Tensor) -> Tensor:
    """SE(3) logarithms log(g^-1 g_bar) (m, 6) from a pose to target poses, angular before linear.

    They are made of operations that ONNX has. Rotations go by way of unit quaternions (Shepperd
    1978), which are exact at half turns too.

    Args:
        pose: g (4, 4), float64.
        target: g_bar (m, 4, 4), float64.
    """
    rotation = pose[:3, :3]
    target_rotation = target[:, :3, :3]
    # R^T R_bar as a sum: not all runtimes have products of transposed doubles
    rows = rotation[None, :, :, None]
    columns = target_rotation[:, :, None]
    turn = (rows * columns).sum(1)
    position = pose[:3, 3]
    target_position = target[:, :3, 3]
    translation = (target_position - position) @ rotation
    # cosine of half the angle, and its sine times the axis
    quaternion = _quaternion(turn)
    cosine = quaternion[:, :1]
    axis = quaternion[:, 1:]
    sine = _length(axis)
    half = _half_angle(sine, cosine)
    # rotation vector: the axis times angle / sine, by its limit 2 at zero
    is_small = sine < SMALL
    safe_sine = sine.clamp(min=SMALL)
    quotient = 2.0 * half / safe_sine
    stretch = torch.where(is_small, 2.0, quotient)
    vector = axis * stretch
    # factor of the square in the inverse of the Jacobian: (1 - x cot x) / (4 x^2), x half the
    # angle, by its limit 1 / 12 at zero
    cotangent = cosine / safe_sine
    numerator = 1.0 - half * cotangent
    square = 4.0 * half * half
    denominator = square.clamp(min=SMALL**2)
    quotient = numerator / denominator
    factor = torch.where(is_small, 1.0 / 12.0, quotient)
    # inverse of the Jacobian times the translation
    once = torch.linalg.cross(vector, translation)
    twice = torch.linalg.cross(vector, once)
    first_order = translation - 0.5 * once
    linear = first_order + factor * twice
    return torch.cat([vector, linear], dim=1)


def _length(vectors: Tensor) -> Tensor:
    """Lengths (m, 1) of vectors (m, n)."""
    squares = vectors * vectors
    return squares.sum(1, keepdim=True).sqrt()


def _half_angle(sine: Tensor, cosine: Tensor) -> Tensor:
    """Angles (m, 1) in [0, pi/2] by their sines and cosines, in double precision."""
    safe_cosine = cosine.clamp(min=TINY)
    tangent = sine / safe_cosine
    # runtimes have no atan of doubles: a step of Newton's adds the digits
    rough = torch.atan(tangent.float()).double()
    # a sine for the cosine, which some do not have for doubles either
    shifted = rough + 0.5 * math.pi
    rough_cosine = torch.sin(shifted)
    rough_sine = torch.sin(rough)
    first_order = rough + sine * rough_cosine
    return first_order - cosine * rough_sine


def _quaternion(rotation: Tensor) -> Tensor:
    """Unit quaternions (m, 4) of rotation matrices (m, 3, 3), w >= 0 first.

    They are the longest column of 4 q q^T, which is linear in the matrix.
    """
    entries = rotation.flatten(1)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = entries.unbind(1)
    trace = xx + yy + zz
    rest = 1.0 - trace
    # 4 times the squares
    w_w = 1.0 + trace
    x_x = xx + xx + rest
    y_y = yy + yy + rest
    z_z = zz + zz + rest
    # 4 w times the vector part
    w_x = zy - yz
    w_y = xz - zx
    w_z = yx - xy
    # 4 times the products of the vector part
    x_y = xy + yx
    x_z = xz + zx
    y_z = yz + zy
    columns = [
        torch.stack([w_w, w_x, w_y, w_z], dim=1),
        torch.stack([w_x, x_x, x_y, x_z], dim=1),
        torch.stack([w_y, x_y, y_y, y_z], dim=1),
        torch.stack([w_z, x_z, y_z, z_z], dim=1),
    ]
    products = torch.stack(columns, dim=2)
    squares = [w_w, x_x, y_y, z_z]
    diagonal = torch.stack(squares, dim=1)
    # a product with a unit vector takes a column in all runtimes
    units = torch.eye(4, dtype=rotation.dtype)
    largest = diagonal.argmax(1)
    longest = units[largest]
    is_chosen = longest[:, None]
    column = (products * is_chosen).sum(2)
    w = column[:, :1]
    sign = torch.where(w < 0.0, -1.0, 1.0)
    return sign * column / _length(column)


class _ArmTensors(NamedTuple):
    """Measurements of an arm as tensors of one row: its state and its reading at once."""

    tip_pose: Tensor  # (1, 4, 4)
    tip_twist: Tensor  # (1, 6)
    tendon_length: Tensor  # (1, n_a) less those at rest
    strain: Tensor  # (1, sensors, 6) less the stress-free ones
    strain_rate: Tensor  # (1, sensors, 6)
    q: Tensor  # (1, n)
    q_dot: Tensor  # (1, n)


class _Arms(NamedTuple):
    """In place of `envs.arms.Arms`, as far as groups of tensors read it."""

    rows: _ArmTensors
    reading: _ArmTensors


class _TensorNormalisation:
    """Observation normalisation by running statistics, on tensors, see Normalization."""

    def __init__(self, normalise: Normalization) -> None:
        self._clip = normalise.clip
        self._moments: dict[str, list[Tensor]] = {}
        for key, moments in normalise.moments.items():
            variance = moments.variance + normalise.epsilon
            deviation = np.sqrt(variance)
            self._moments[key] = as_tensors(moments.mean, deviation)

    def __call__(self, parts: Parts) -> Parts:
        seen = dict(parts)
        for key, (mean, deviation) in self._moments.items():
            away = parts[key] - mean
            scaled = away / deviation
            clipped = scaled.clamp(-self._clip, self._clip)
            seen[key] = clipped.float()
        return seen


class _TensorIntegral:
    """Integral action on tensors, see IntegralPolicy, by its two linear maps as matrices."""

    def __init__(self, integral: IntegralPolicy, episodes: Episodes) -> None:
        self._share = integral.share
        if episodes.task.goal:
            unit = integral.goal_unit
            way = np.eye(3) / unit
            shift = unit * np.eye(3)
        else:
            # the maps are linear, so that rows of the identity give their matrices
            entries = episodes.layout.space.shape[0]
            way = integral.way_to_target(np.eye(entries))
            ways = way.shape[1]
            nothing = np.zeros((ways, entries))
            shift = integral.move_target(nothing, np.eye(ways))
        # (entries, ways) and (ways, entries): from an observation to the way that is integrated,
        # and from the integral to what moves
        self._way, self._shift = as_tensors(way, shift)
        self.start = torch.zeros(len(shift))

    def __call__(self, parts: Parts, integral: Tensor) -> tuple[Parts, Tensor]:
        """Parts of an observation with their target moved, and the next integral (1, ways)."""
        if BOX in parts:
            key = BOX
        else:
            key = "desired_goal"
        target = parts[key]
        start = parts.get("achieved_goal", 0.0)
        observed_way = (target - start).double()
        way = observed_way @ self._way
        largest = way.abs().amax(1, keepdim=True)
        # far from the target the integral rests, so that it does not wind up
        is_near = largest <= NEAR
        near_way = torch.where(is_near, way, 0.0)
        grown = integral + self._share * near_way
        total = grown.clamp(-MOST, MOST)
        shift = total @ self._shift
        moved = target.double() + shift
        return {**parts, key: moved.float()}, total


class _ControlPeriod(torch.nn.Module):
    """One control period of an agent, from measurements and states to values in SI units.

    It takes them in the order of `inputs`, and gives those of `outputs`.
    """

    def __init__(
        self, episodes: Episodes, agent: NetworkPolicy, integral: IntegralPolicy | None
    ) -> None:
        super().__init__()
        self.network = TensorNetwork(agent.network)
        self.episodes = episodes
        self.observation = TensorObservation(episodes, torch.float32)
        self.scale = TensorActuation(episodes.actuation).scale
        self.normalise: _TensorNormalisation | None = None
        if isinstance(agent.normalise, Normalization):
            self.normalise = _TensorNormalisation(agent.normalise)
        self.integral: _TensorIntegral | None = None
        if integral is not None:
            self.integral = _TensorIntegral(integral, episodes)
        self._start_command, self._start_action = as_tensors(
            episodes.start_command, episodes.actuation.start_action
        )
        measured = measurements(episodes)
        tensors = as_tensors(*measured.values())
        self.inputs = dict(zip(measured, tensors, strict=True))
        states = self._first_states()
        for name, value in states.items():
            self.inputs[name] = value.double()
        # inputs that the agent reads, of which measurements are looked at for a lost sensor; none
        # before the first trace has shown them
        self.read = set[str]()
        self.outputs = ["action"]
        for name in states:
            self.outputs.append(f"next_{name}")

    def _first_states(self) -> Parts:
        """Zeros for all that is remembered, by name."""
        states = {
            "started": torch.zeros(1),
            "command": torch.zeros_like(self._start_command),
            "last_action": torch.zeros_like(self._start_action),
        }
        if self.episodes.history is not None:
            periods = self.episodes.options.history
            entries = self.episodes.layout.kept.size
            states["history"] = torch.zeros(periods, entries)
        if self.integral is not None:
            states["integral"] = self.integral.start
        if self.network.memory:
            states["memory"] = torch.zeros(self.network.memory)
        return states

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        rows = self._rows(values)
        is_running = rows["started"] > 0.5
        # an episode begins with these two as they are at rest
        command = torch.where(is_running, rows["command"], self._start_command)
        last_action = torch.where(is_running, rows["last_action"], self._start_action)
        observed = self._observed(rows, command, last_action)
        parts, history = self._observation(observed, rows, is_running)
        total = None
        if self.integral is not None:
            parts, total = self.integral(parts, rows["integral"])
        if self.normalise is not None:
            parts = self.normalise(parts)
        mean, memory = self._network(parts, rows)
        action = mean.clamp(-1.0, 1.0).double()
        sent = self.scale.wanted(action, command)
        most = self.scale.greatest_change
        if most is not None:
            raised = torch.maximum(sent, command - most)
            sent = torch.minimum(raised, command + most)
        raised = torch.maximum(sent, self.scale.least)
        sent = torch.minimum(raised, self.scale.greatest)
        started = rows["started"].clamp(min=1.0)
        states = {
            "started": started,
            "command": sent,
            "last_action": action,
            "history": history,
            "integral": total,
            "memory": memory,
        }
        # an output of its own, though the same as what is remembered
        same_action = 1.0 * action
        results: dict[str, Tensor | None] = {"action": same_action, **states}
        if self.read:
            held_action = self._held_action(command, last_action)
            before = {
                **rows,
                "command": command,
                "last_action": held_action,
                "action": held_action,
            }
            is_lost = self._is_lost(rows)
            for name, value in results.items():
                if value is not None:
                    results[name] = torch.where(is_lost, before[name], value)
        return tuple(value[0] for value in results.values() if value is not None)

    def _held_action(self, command: Tensor, last_action: Tensor) -> Tensor:
        """Action of a lost measurement (1, n_a): the last one, or one that leaves the command."""
        if "last_action" in self.read:
            return last_action
        if self.episodes.options.action == "increment":
            return torch.zeros_like(last_action)
        above = command - self.scale.least
        width = self.scale.greatest - self.scale.least
        # shares in [0, 1] are actions in [-1, 1]
        share = above / width
        return 2.0 * share - 1.0

    def _is_lost(self, rows: Parts) -> Tensor:
        """Whether a measurement is not finite, as of a sensor that is lost.

        Then the command and all that is remembered stay: no NaN reaches motors or memory.
        """
        # x - x is NaN for what is not finite, which is not equal to 0
        total = torch.zeros((), dtype=torch.float64)
        for name in MEASUREMENTS:
            if name in self.read:
                difference = rows[name] - rows[name]
                total = total + difference.abs().sum()
        return torch.logical_not(total == 0.0)

    def _rows(self, values: tuple[Tensor, ...]) -> Parts:
        """Inputs by name, as rows."""
        rows = {}
        for name, value in zip(self.inputs, values, strict=True):
            rows[name] = value[None]
        return rows

    def _observed(self, rows: Parts, command: Tensor, last_action: Tensor) -> Any:
        """Quantities that observation groups are computed from, as tensors of one row."""
        arm = _ArmTensors(
            rows["tip_pose"],
            rows["tip_twist"],
            rows["tendon_lengths"],
            rows["strain"],
            rows["strain_rate"],
            rows["coordinates"],
            rows["rates"],
        )
        # tensors in place of arrays
        target: dict[str, Any] = {
            "tip_pose": rows["target_pose"],
            "tip_twist": rows["target_twist"],
            "q": rows["target_coordinates"],
            "tendon_length": rows["target_lengths"][:, None],
            "backbone": None,
        }
        # measurements are less those at rest already
        zeros = [0.0 * value for value in self.episodes.observed.rest]
        rest = RestValues(*as_tensors(*zeros))
        target_pose = rows["target_pose"][0]
        error = pose_logarithm(arm.tip_pose[0], target_pose)
        tensors: dict[str, Any] = {
            "arms": _Arms(arm, arm),
            "measured": arm,
            "error": error[None],
            "target": TargetSamples(**target),
            "action": last_action,
            "command": command,
            "rest": rest,
        }
        return replace(self.episodes.observed, **tensors)

    def _observation(
        self, observed: Any, rows: Parts, is_running: Tensor
    ) -> tuple[Parts, Tensor | None]:
        """Parts of the observation by key, BOX where there is but one, and the next history."""
        flat = self.observation.groups(observed)
        history = rows.get("history")
        if history is not None:
            # an episode begins as if it had always been so
            kept = self.episodes.layout.kept
            now = flat[:, None, kept]
            goes_on = is_running[..., None]
            history = torch.where(goes_on, history, now)
        seen, history = self.observation.complete(observed, flat, history)
        if isinstance(seen, dict):
            parts = seen
        else:
            parts = {BOX: seen}
        return parts, history

    def _network(self, parts: Parts, rows: Parts) -> tuple[Tensor, Tensor | None]:
        """Mean action (1, n_a) and the next memory, None without one."""
        seen = parts.get(BOX, parts)
        memory: Tensor | None = None
        if self.network.memory:
            memory = rows["memory"].float()
        mean, memory = self.network(seen, memory)
        if memory is not None:
            memory = memory.double()
        return mean, memory


def export_agent(
    policy: Policy, env: gym.Env[Any, Any], origin: Mapping[str, Any] | None = None
) -> onnx.ModelProto:
    """Exports a trained agent as an ONNX model from measurements to commands.

    The model is for the observation and the actions of its environment.

    Args:
        policy: trained agent, see `load_agent`.
        env: its environment.
        origin: what the model's metadata should say besides.

    Returns:
        The model, checked.

    Raises:
        ValueError: it is another policy, or an observation group is in NumPy.
        ConfigurationError: groups of contact, which it names.
        TypeError: the environment is of another package.
    """
    episodes = episodes_of(env)
    agent, integral = _parts_of(policy)
    module = _ControlPeriod(episodes, agent, integral).eval()
    # first to see what the agent reads, with nothing looked at for a lost sensor
    first = _trace(module)
    module.read = _drop_unused_inputs(first)
    model = _trace(module)
    used = _drop_unused_inputs(model)
    model.ir_version = IR_VERSION
    about = _metadata(episodes, used)
    if origin is not None:
        about.update(origin)
    properties = {"soft_tendon_env": json.dumps(about)}
    onnx.helper.set_model_props(model, properties)
    onnx.checker.check_model(model, full_check=True)
    return model


def _parts_of(policy: Policy) -> tuple[NetworkPolicy, IntegralPolicy | None]:
    """The agent of a policy, and the integral action around it.

    Raises ValueError.
    """
    agent = policy
    integral = None
    if isinstance(policy, IntegralPolicy):
        agent = policy.policy
        integral = policy
    if (
        isinstance(agent, NetworkPolicy)
        and isinstance(agent.network, PolicyNetwork)
        and isinstance(agent.normalise, Normalization | None)
    ):
        return agent, integral
    kind = type(agent).__name__
    raise ValueError(f"policy should be a trained agent, as load_agent gives it, not {kind}")


def _trace(module: _ControlPeriod) -> onnx.ModelProto:
    """ONNX model of a module.

    Raises ValueError where it makes an array of a tensor.
    """
    file = io.BytesIO()
    options: dict[str, Any] = {
        "input_names": [*module.inputs],
        "output_names": module.outputs,
        "opset_version": OPSET,
        "dynamo": False,
    }
    inputs = (*module.inputs.values(),)
    with warnings.catch_warnings(record=True, action="always") as caught, torch.no_grad():
        # it takes files too
        torch.onnx.export(module, inputs, file, **options)  # type: ignore[arg-type]
    # the tracer's other warnings are of sizes, which are constants
    messages = [str(warning.message) for warning in caught]
    if any("to a NumPy array" in message for message in messages):
        raise ValueError(
            "an observation group uses NumPy, whose values the file would have as constants: use"
            " what tensors have too"
        )
    return onnx.load_from_string(file.getvalue())


def _drop_unused_inputs(model: onnx.ModelProto) -> set[str]:
    """Removes the inputs of a model that it does not read; names of what it reads."""
    used: set[str] = set()
    for node in model.graph.node:
        used.update(node.input)
    unused = [entry for entry in model.graph.input if entry.name not in used]
    for entry in unused:
        model.graph.input.remove(entry)
    return used


def _metadata(episodes: Episodes, used: set[str]) -> dict[str, Any]:
    """Metadata of the file on its inputs and its command."""
    actions = episodes.actuation.actions
    limits = np.c_[actions.least, actions.greatest]
    values = measurements(episodes)
    inputs = {}
    for name, measurement in MEASUREMENTS.items():
        if name in used:
            shape = values[name].shape
            inputs[name] = {"shape": shape, "unit": measurement.unit}
    unit = episodes.model.scene.effects.command_unit
    return {
        "task": episodes.task.name,
        "control_period_s": episodes.period,
        "inputs": inputs,
        "preview_s": episodes.ahead[1:].tolist(),
        "sensors_m": episodes.sensors.tolist(),
        "command": {"unit": unit, "limits": limits.tolist()},
        "lost": "NaN in an input repeats the last command and changes nothing that is remembered",
    }


class _ExportedAgent:
    """An exported agent that acts in the ONNX runtime."""

    def __init__(self, path: Path) -> None:
        session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        self._session = session
        self._inputs = {entry.name: entry.shape for entry in session.get_inputs()}
        self._outputs = [entry.name for entry in session.get_outputs()]

    def start(self) -> dict[str, Any]:
        """Outputs before the first control period: what is remembered is zero."""
        return {f"next_{name}": np.zeros(shape) for name, shape in self._inputs.items()}

    def act(self, before: Mapping[str, Any], measured: Mapping[str, Array]) -> dict[str, Any]:
        """Outputs by name, of those before and of measurements."""
        known = dict[str, Any]()
        for output, value in before.items():
            name = output.removeprefix("next_")
            known[name] = value
        # what is measured goes over the zeros that it starts with
        known.update(measured)
        inputs = {name: known[name] for name in self._inputs}
        values = self._session.run(self._outputs, inputs)
        return dict(zip(self._outputs, values, strict=True))


def compare(
    path: Path,
    policy: Policy,
    env: gym.Env[Any, Any],
    seeds: Sequence[int] = SEEDS,
    steps: int = 250,
) -> tuple[int, float, float]:
    """Largest difference of an exported agent's commands from those of its original.

    The original acts for `steps` control periods of an episode from each seed. The exported agent
    gets what is measured meanwhile, and remembers as command what the original has sent.

    Args:
        path: of the file.
        policy: the original.
        env: its environment.
        seeds: of episodes, one each.
        steps: control periods of an episode.

    Returns:
        Number of observations, and the largest difference of commands on them, in their unit and
        as a share of their range.
    """
    episodes = episodes_of(env)
    exported = _ExportedAgent(path)
    differences: list[Array] = []
    for seed in seeds:
        outputs = exported.start()
        for k, step in enumerate(play_steps(policy, env, [seed])):
            if k > 0:
                command = episodes.actuation.command[0].copy()
                difference = outputs["next_command"] - command
                differences.append(np.abs(difference))
                outputs["next_command"] = command
            if k == steps or step.ended[0]:
                break
            outputs = exported.act(outputs, measurements(episodes))
    actions = episodes.actuation.actions
    width = actions.greatest - actions.least
    largest = np.max(differences, axis=0)
    shares = largest / width
    greatest_difference = float(largest.max())
    greatest_share = float(shares.max())
    return len(differences), greatest_difference, greatest_share
