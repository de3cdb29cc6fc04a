"""ONNX graphs node by node: an expression per call, whose name is what the next one takes.

Values are vectors of one observation in place of batches.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import TensorProto, helper, numpy_helper

OPSET, IR_VERSION = 17, 8  # of ONNX 1.12 (2022), which runtimes of small computers have
KINDS = {np.dtype(np.float32): TensorProto.FLOAT, np.dtype(np.float64): TensorProto.DOUBLE}
Value = str | float | NDArray[Any]
"""Name of a value of the graph, or a constant; numbers are constants of type float64."""


class Graph:
    """Graph under construction. A value is its name."""

    def __init__(self) -> None:
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._inputs: dict[str, Any] = {}
        self._outputs: dict[str, Any] = {}

    def input(self, name: str, shape: tuple[int, ...], description: str, kind: type = np.float64) -> str:
        """Add an input, once for each name."""
        if name not in self._inputs:
            self._inputs[name] = helper.make_tensor_value_info(name, KINDS[np.dtype(kind)], shape, description)
        return name

    def output(self, name: str, value: str, shape: tuple[int, ...], description: str, kind: type = np.float64) -> None:
        """Add an output that has this value."""
        self._nodes.append(helper.make_node("Identity", [value], [name]))
        self._outputs[name] = helper.make_tensor_value_info(name, KINDS[np.dtype(kind)], shape, description)

    def add(self, operator: str, *values: Value, **attributes: Any) -> str:
        """Result of an operator of ONNX."""
        name = f"{operator.lower()}_{len(self._nodes)}"
        self._nodes.append(helper.make_node(operator, [self._named(value) for value in values], [name], **attributes))
        return name

    def sum(self, *values: Value) -> str:
        """Sum of values, from left to right."""
        first, *others = values
        for value in others:
            first = self.add("Add", first, value)
        return self._named(first)

    def take(self, value: Value, indices: ArrayLike, axis: int = 0) -> str:
        """Entries at constant indices along an axis; an index alone takes the axis away."""
        return self.add("Gather", value, np.asarray(indices, dtype=np.int64), axis=axis)

    def reshape(self, value: Value, *shape: int) -> str:
        return self.add("Reshape", value, np.array(shape, dtype=np.int64))

    def cast(self, value: Value, kind: type) -> str:
        return self.add("Cast", value, to=KINDS[np.dtype(kind)])

    def clip(self, value: Value, least: Value, greatest: Value) -> str:
        """Value within bounds, of which each entry has its own."""
        return self.add("Min", self.add("Max", value, least), greatest)

    def model(self, name: str, metadata: Mapping[str, str]) -> onnx.ModelProto:
        """The finished model, checked: types and shapes of all values. Raises onnx.checker.ValidationError."""
        graph = helper.make_graph(self._nodes, name, [*self._inputs.values()], [*self._outputs.values()], self._constants)
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="soft_tendon_env"
        )
        helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        return model

    def _named(self, value: Value) -> str:
        if isinstance(value, str):
            return value
        name = f"constant_{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.array(value, order="C"), name))
        return name
