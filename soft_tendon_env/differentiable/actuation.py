"""Actuators in PyTorch: the commands of a control period as tensors, from actions; clipping whose
gradient leads back inside."""

import math
from dataclasses import fields
from typing import Any, cast

import torch
from torch.autograd.function import once_differentiable

from soft_tendon_env.envs.actuation import ActionScale, Actuation


class _InwardClip(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, values: torch.Tensor, least: torch.Tensor, greatest: torch.Tensor
    ) -> torch.Tensor:
        clipped = torch.minimum(torch.maximum(values, least), greatest)
        ctx.save_for_backward(values - clipped)
        return clipped

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (beyond,) = ctx.saved_tensors
        return cotangent * (beyond * cotangent >= 0.0), None, None


def inward_clip(
    values: torch.Tensor, least: torch.Tensor | float, greatest: torch.Tensor | float
) -> torch.Tensor:
    """Values (...) clipped to [least, greatest], with a gradient that is zero beyond a limit only
    where descent would lead further out.

    The exact derivative is zero there: a tendon that an action had let go slack would stay so for
    ever.
    """
    bounds = (torch.as_tensor(bound, dtype=values.dtype) for bound in (least, greatest))
    return cast(torch.Tensor, _InwardClip.apply(values, *bounds))


class TensorActuation:
    """Rows of actuators from where they are now, for actions that carry gradients; gradients at
    limits and of slack tendons lead inside.

    command: (rows, n_a) asked for last. scale: an ActionScale of tensors.
    """

    def __init__(self, actuation: Actuation) -> None:
        self._of = of = actuation
        scale: dict[str, Any] = {
            one.name: _tensor(getattr(of.actions, one.name)) for one in fields(ActionScale)
        }
        self.scale: Any = ActionScale(**scale)
        self.command: torch.Tensor = _tensor(of.command)
        self._in_transit = _tensor(of.in_transit)

    def apply(self, action: torch.Tensor) -> torch.Tensor:
        """Commands (rows, parts, n_a) of the period that begins, for actions (rows, n_a) in [-1,
        1]: as Actuation.apply."""
        of, scale = self._of, self.scale
        self.command = inward_clip(scale.wanted(action, self.command), scale.least, scale.greatest)
        if self._in_transit is None:
            acting = self.command[:, None].expand(-1, of.substeps, -1)
        else:
            self._in_transit = torch.cat([self._in_transit[:, 1:], self.command[:, None]], dim=1)
            acting = self._in_transit[of.arriving]
        if of.imperfect:
            acting = inward_clip(
                _tensor(of.gain)[:, None] * acting + _tensor(of.offset)[:, None],
                _tensor(of.slack),
                math.inf,
            )
        return acting


def _tensor(values: Any) -> Any:
    return None if values is None else torch.tensor(values)
