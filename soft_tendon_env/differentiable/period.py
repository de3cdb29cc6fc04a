"""Control periods of rows of arms in PyTorch: next state and readings, whose cotangents go back by
the arms' adjoint."""

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

STATE = ("q", "q_dot", "state")  # state of a row through which gradients pass


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
    """Tensors with copies of arrays, in whose place they stand: what is written for both has the
    types of arrays."""
    return [torch.tensor(value) for value in values]


def arm_tensors(arms: Arms) -> ArmTensors:
    """State and readings of the rows as they are now, copied."""
    of = {
        **arms.rows.fields(),
        **arms.reading.fields(),
        "backbone_position": arms.reading.backbone[..., :3, 3],
    }
    return ArmTensors(*as_tensors(*(of[name] for name in ArmTensors._fields)))


class _ControlPeriod(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        arms: Arms,
        advance: Callable[..., None],
        commands: torch.Tensor,
        *before: torch.Tensor,
    ) -> tuple[Any, ...]:
        for name, value in zip(STATE, before, strict=True):
            getattr(arms.rows, name)[...] = value.numpy()
        ctx.arms, ctx.tape = arms, arms.make_tape(commands.shape[1])
        advance(tape=ctx.tape)
        ctx.set_materialize_grads(False)
        after = arm_tensors(arms)
        ctx.save_for_backward(after.tip_pose)
        return after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *cotangents: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        arms, (pose,) = ctx.arms, ctx.saved_tensors
        back = arms.make_cotangents(ctx.tape.duration.shape[1])
        for name, value in zip(ArmTensors._fields, cotangents, strict=True):
            if value is not None:
                getattr(back, name)[...] = (
                    body_cotangent(pose, value) if name == "tip_pose" else value
                ).numpy()
        arms.adjoint(ctx.tape, np.arange(arms.size, dtype=np.int64), back)
        return (
            None,
            None,
            torch.from_numpy(back.command),
            *(torch.from_numpy(getattr(back, name)) for name in STATE),
        )


def control_period(
    arms: Arms,
    before: ArmTensors,
    commands: torch.Tensor,
    advance: Callable[..., None] | None = None,
) -> ArmTensors:
    """State and readings of all rows after a period under commands (rows, parts, n_a), each held
    for an integrator step.

    Differentiable in the commands and in the state before. The arms themselves take the step, from
    the state of `before`. Gradients are those of their adjoint, once, see Arms.adjoint; a row whose
    step fails has none. Poses are 4x4 matrices, whose cotangents count as far as they move them as
    rigid bodies.

    advance: `advance(tape=...)` steps the arms under these commands in place of `Arms.step`, as an
    environment does. float64. Raises TypeError or ValueError for other shapes and numbers that are
    not finite; `backward` raises what Arms.adjoint does.
    """
    state = [getattr(before, name) for name in STATE]
    for name, value in zip(STATE, state, strict=True):
        checked_array(f"before.{name}", value.detach().numpy(), getattr(arms.rows, name).shape)
    parts = checked_array(
        "commands", commands.detach().numpy(), (arms.size, None, arms.model.tendon_count)
    )
    if advance is None:
        advance = partial(arms.step, parts, np.arange(arms.size, dtype=np.int64))
    return ArmTensors(*_ControlPeriod.apply(arms, advance, commands, *state))
