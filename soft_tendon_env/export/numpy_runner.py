"""Runner of exported agents with NumPy alone: copy this file to the robot's computer, nothing else of the package is needed there.

    agent = Agent("agent.onnx")
    print(agent.inputs)                                  # shapes of what it wants to be told, by name; agent.metadata has their units
    agent.reset()
    while True:
        command = agent(tip_pose=..., tendon_lengths=..., ...)   # (n_a,) to be sent, every agent.metadata["control_period_s"]

The graph's few operators are computed as ONNX defines them; the file is read as protocol buffers, field by field (onnx.proto).
"""

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

KINDS = {1: np.float32, 6: np.int32, 7: np.int64, 11: np.float64}  # TensorProto.DataType
ROUNDED = 1e-3
"""Departure of measured rotation matrices from orthonormal ones."""
OPERATORS: dict[str, Callable[..., Any]] = {
    "Abs": lambda of, x: np.abs(x),
    "Add": lambda of, x, y: x + y,
    "ArgMax": lambda of, x: np.argmax(x, of["axis"]),
    "Atan": lambda of, x: np.arctan(x),
    "Cast": lambda of, x: x.astype(KINDS[of["to"]]),
    "Concat": lambda of, *parts: np.concatenate(parts, of["axis"]),
    "Div": lambda of, x, y: x / y,
    "Elu": lambda of, x: np.where(x > 0, x, x.dtype.type(of["alpha"]) * np.expm1(np.minimum(x, 0))),
    "Gather": lambda of, x, indices: np.take(x, indices, of["axis"]),
    "Greater": lambda of, x, y: x > y,
    "Identity": lambda of, x: x,
    "LeakyRelu": lambda of, x: np.where(x > 0, x, x.dtype.type(of["alpha"]) * x),
    "Less": lambda of, x, y: x < y,
    "LessOrEqual": lambda of, x, y: x <= y,
    "MatMul": lambda of, x, y: x @ y,
    "Max": lambda of, x, y: np.maximum(x, y),
    "Min": lambda of, x, y: np.minimum(x, y),
    "Mul": lambda of, x, y: x * y,
    "ReduceMax": lambda of, x: x.max(of["axes"][0], keepdims=True),
    "ReduceSum": lambda of, x, axes: x.sum(axes[0], keepdims=True),
    "Relu": lambda of, x: np.maximum(x, 0),
    "Reshape": lambda of, x, shape: x.reshape(shape),
    "Sigmoid": lambda of, x: 1 / (1 + np.exp(-x)),
    "Sin": lambda of, x: np.sin(x),
    "Sqrt": lambda of, x: np.sqrt(x),
    "Sub": lambda of, x, y: x - y,
    "Tanh": lambda of, x: np.tanh(x),
    "Where": lambda of, condition, x, y: np.where(condition, x, y),
}


class Agent:
    """An exported agent that remembers what it needs from one call to the next.

    Attributes:
        inputs: shapes of what is measured of the arm and known of its target, by name.
        states: what is remembered, by name; `command` is what was sent last: replace it where something else was sent.
        metadata: table of units, rate, limits and origin.
    """

    def __init__(self, path: str | Path) -> None:
        """Raises OSError, ValueError for what is no exported agent."""
        try:
            nodes, self._constants, shapes, outputs, self.metadata = _read(Path(path).read_bytes())
        except (AttributeError, IndexError, KeyError, TypeError, ValueError, struct.error) as error:
            raise ValueError(f"{path} is no exported agent, or was cut or damaged: {type(error).__name__}, {error}") from error
        self._steps = [(OPERATORS[kind], *rest) for kind, *rest in nodes]
        self._shapes = {name: shape for name, shape in shapes.items() if f"next_{name}" in outputs}
        self.inputs = {name: shape for name, shape in shapes.items() if name not in self._shapes}
        self.reset()

    def reset(self) -> None:
        """Begin an episode: what was remembered is forgotten."""
        kinds = {"history": np.float32}
        self.states = {name: np.zeros(shape, kinds.get(name, np.float64)) for name, shape in self._shapes.items()}

    def __call__(self, **measured: Any) -> np.ndarray:
        """Command (n_a,) to be sent, for measurements by name, see `inputs`. Raises TypeError for missing or unknown ones, ValueError for
        shapes and numbers that cannot be."""
        found = self._outputs(self._checked(measured))
        self.states = {name: found[f"next_{name}"] for name in self.states}
        return found["next_command"]

    def _outputs(self, measured: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """Values of the graph by name, its outputs among them."""
        values = {**self._constants, **self.states, **measured}
        for operator, attributes, inputs, output in self._steps:
            values[output] = operator(attributes, *[values[name] for name in inputs])
        return values

    def _checked(self, measured: Mapping[str, Any]) -> dict[str, np.ndarray]:
        if measured.keys() != self.inputs.keys():
            raise TypeError(f"measurements should be {', '.join(self.inputs)}; they are {', '.join(measured) or 'none'}")
        arrays = {name: np.asarray(value, dtype=np.float64) for name, value in measured.items()}
        for name, array in arrays.items():
            if array.shape != self.inputs[name]:
                raise ValueError(f"{name} should have shape {self.inputs[name]}, not {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"{name} should be finite, not {array.ravel()[~np.isfinite(array.ravel())][0]}")
            if array.shape[-2:] == (4, 4) and not _are_poses(array):
                raise ValueError(f"{name} should be homogeneous transforms: a rotation matrix, beside it a position, below 0, 0, 0, 1")
        return arrays


def _are_poses(array: np.ndarray) -> bool:
    R = array[..., :3, :3]
    close = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < ROUNDED
    return bool(close and (np.linalg.det(R) > 0.0).all() and (array[..., 3, :] == [0.0, 0.0, 0.0, 1.0]).all())


def _read(content: bytes) -> tuple[list[Any], dict[str, np.ndarray], dict[str, tuple[int, ...]], list[str], dict[str, Any]]:
    """Nodes in order, constants, shapes of inputs, names of outputs and metadata of a ModelProto."""
    model = [*_fields(content)]
    (graph,) = ([*_fields(value)] for number, value in model if number == 7)
    properties = [dict(_fields(value)) for number, value in model if number == 14]
    metadata = {of[1].decode(): of[2].decode() for of in properties}["soft_tendon_env"]
    constants = dict(_tensor(value) for number, value in graph if number == 5)
    shapes = dict(_shape(value) for number, value in graph if number == 11)
    outputs = [dict(_fields(value))[1].decode() for number, value in graph if number == 12]
    return [_node(value) for number, value in graph if number == 1], constants, shapes, outputs, json.loads(metadata)


def _fields(content: bytes) -> Iterator[tuple[int, Any]]:
    """Numbers and values of a message's fields: whole numbers, floats, or bytes."""
    place = 0
    while place < len(content):
        key, place = _varint(content, place)
        number, kind = key >> 3, key & 7
        if kind == 0:
            value, place = _varint(content, place)
            yield number, value
        elif kind == 2:
            size, place = _varint(content, place)
            yield number, content[place : place + size]
            place += size
        else:  # 5: a float; files of this kind have no other
            yield number, struct.unpack_from("<f", content, place)[0]
            place += 4


def _varint(content: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[place]
        value, place, shift = value | (byte & 127) << shift, place + 1, shift + 7
        if byte < 128:
            return value, place


def _tensor(content: bytes) -> tuple[str, np.ndarray]:
    fields = [*_fields(content)]
    of = dict(fields)
    array = np.frombuffer(of[9], KINDS[of[2]]).reshape([value for number, value in fields if number == 1])
    return of[8].decode(), array


def _shape(content: bytes) -> tuple[str, tuple[int, ...]]:
    """Name and shape of a ValueInfoProto: type.tensor_type.shape.dim[].dim_value."""
    of = dict(_fields(content))
    tensor = dict(_fields(dict(_fields(of[2]))[1]))
    return of[1].decode(), tuple(dict(_fields(dim))[1] for number, dim in _fields(tensor.get(2, b"")) if number == 1)


def _node(content: bytes) -> tuple[str, dict[str, Any], list[str], str]:
    fields = [*_fields(content)]
    names = {key: [value.decode() for number, value in fields if number == key] for key in (1, 2, 4)}
    attributes = dict(_attribute(value) for number, value in fields if number == 5)
    return names[4][0], attributes, names[1], names[2][0]


def _attribute(content: bytes) -> tuple[str, Any]:
    """Name and value of an AttributeProto: a float (2), a whole number (3) or several (8)."""
    fields = [*_fields(content)]
    of = dict(fields)
    several = [value for number, value in fields if number == 8]
    return of[1].decode(), several or of.get(2, of.get(3, 0))
