"""Control periods of rows of arms in PyTorch, whose cotangents go back by the arms' adjoint."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.autograd.function import once_differentiable

from soft_tendon_env.differentiable.poses import body_cotangent
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.types import Array


class ArmTensors(NamedTuple):
    """State and readings of rows of arms as tensors, float64."""

    q: torch.Tensor  # (rows, n) coordinates
    q_dot: torch.Tensor  # (rows, n)
    state: torch.Tensor  # (rows, states) internal states of the effects
    tip_pose: torch.Tensor  # (rows, 4, 4)
    tip_twist: torch.Tensor  # (rows, 6) body twist, angular before linear
    backbone_position: torch.Tensor  # (rows, stations, 3) [m]
    tendon_length: torch.Tensor  # (rows, n_a) [m]
    strain: torch.Tensor  # (rows, sensors, 6)
    strain_rate: torch.Tensor  # (rows, sensors, 6)


def as_tensors(*values: NDArray[Any]) -> list[Any]:
    """Tensors with copies of arrays, in whose place they stand.

    What is written for both has the types of arrays.
    """
    return [torch.tensor(value) for value in values]


def arm_tensors(arms: Arms) -> ArmTensors:
    """Copies state and readings of the rows as they are now to tensors.

    Args:
        arms: whose rows are read.

    Returns:
        The tensors.
    """
    rows = arms.rows
    reading = arms.reading
    return ArmTensors(
        q=torch.tensor(rows.q),
        q_dot=torch.tensor(rows.q_dot),
        state=torch.tensor(rows.state),
        tip_pose=torch.tensor(reading.tip_pose),
        tip_twist=torch.tensor(reading.tip_twist),
        backbone_position=torch.tensor(reading.backbone[..., :3, 3]),
        tendon_length=torch.tensor(reading.tendon_length),
        strain=torch.tensor(reading.strain),
        strain_rate=torch.tensor(reading.strain_rate),
    )


class _ControlPeriod(torch.autograd.Function):
    """One period of all rows; gradients pass through commands, q, q_dot and internal states."""

    @staticmethod
    def forward(
        ctx: Any,
        arms: Arms,
        advance: Callable[..., None],
        commands: torch.Tensor,
        q: torch.Tensor,
        q_dot: torch.Tensor,
        state: torch.Tensor,
    ) -> tuple[Any, ...]:
        arms.rows.q[...] = q.numpy()
        arms.rows.q_dot[...] = q_dot.numpy()
        arms.rows.state[...] = state.numpy()
        parts = commands.shape[1]
        tape = arms.make_tape(parts)
        advance(tape=tape)
        after = arm_tensors(arms)
        ctx.arms = arms
        ctx.tape = tape
        ctx.parts = parts
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(after.tip_pose)
        return after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *cotangents: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        arms = ctx.arms
        (pose,) = ctx.saved_tensors
        after: Any = ArmTensors._make(cotangents)  # None where nothing depends on an output
        back = arms.make_cotangents(ctx.parts)
        _fill(back.q, after.q)
        _fill(back.q_dot, after.q_dot)
        _fill(back.state, after.state)
        if after.tip_pose is not None:
            cotangent = body_cotangent(pose, after.tip_pose)
            _fill(back.tip_pose, cotangent)
        _fill(back.tip_twist, after.tip_twist)
        _fill(back.backbone_position, after.backbone_position)
        _fill(back.tendon_length, after.tendon_length)
        _fill(back.strain, after.strain)
        _fill(back.strain_rate, after.strain_rate)
        rows = np.arange(arms.size, dtype=np.int64)
        arms.adjoint(ctx.tape, rows, back)
        of_arms = None
        of_advance = None
        return (
            of_arms,
            of_advance,
            torch.from_numpy(back.command),
            torch.from_numpy(back.q),
            torch.from_numpy(back.q_dot),
            torch.from_numpy(back.state),
        )


def _fill(out: Array, cotangent: torch.Tensor | None) -> None:
    """Write a cotangent, if there is one, into an array of zeros."""
    if cotangent is not None:
        out[...] = cotangent.numpy()


def control_period(
    arms: Arms,
    before: ArmTensors,
    commands: torch.Tensor,
    advance: Callable[..., None] | None = None,
) -> ArmTensors:
    """Steps all rows by a period, differentiable in commands and state before.

    The arms themselves take the step, from the state of `before`. Gradients are those of their
    adjoint, once, see Arms.adjoint; a row whose step fails has none. Poses are 4x4 matrices, whose
    cotangents count as far as they move them as rigid bodies. float64.

    Args:
        arms: whose rows are stepped.
        before: state of the rows.
        commands: (rows, parts, n_a), each held for an integrator step.
        advance: `advance(tape=...)` steps the arms under these commands in place of `Arms.step`, as
            an environment does.

    Returns:
        State and readings after the period.

    Raises:
        TypeError: for what are no numbers.
        ValueError: for other shapes and numbers that are not finite. `backward` raises what
            Arms.adjoint does.
    """
    _check("before.q", before.q, arms.rows.q.shape)
    _check("before.q_dot", before.q_dot, arms.rows.q_dot.shape)
    _check("before.state", before.state, arms.rows.state.shape)
    shape = (arms.size, None, arms.model.tendon_count)
    parts = _check("commands", commands, shape)
    if advance is None:
        rows = np.arange(arms.size, dtype=np.int64)
        advance = partial(arms.step, parts, rows)
    after = _ControlPeriod.apply(
        arms,
        advance,
        commands,
        before.q,
        before.q_dot,
        before.state,
    )
    return ArmTensors._make(after)


def _check(name: str, values: torch.Tensor, shape: tuple[int | None, ...]) -> Array:
    """Values of a tensor as an array of that shape.

    Raises TypeError, ValueError.
    """
    return checked_array(name, values.detach().numpy(), shape)
