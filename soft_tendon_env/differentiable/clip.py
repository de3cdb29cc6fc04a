"""Clipping whose gradient leads back inside: a policy at a limit goes on learning to leave it."""

from typing import Any, cast

import torch
from torch.autograd.function import once_differentiable


class _InwardClip(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, least: torch.Tensor, greatest: torch.Tensor) -> torch.Tensor:
        clipped = torch.minimum(torch.maximum(values, least), greatest)
        ctx.save_for_backward(values - clipped)
        return clipped

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (beyond,) = ctx.saved_tensors
        return cotangent * (beyond * cotangent >= 0.0), None, None


def inward_clip(values: torch.Tensor, least: torch.Tensor | float, greatest: torch.Tensor | float) -> torch.Tensor:
    """Values (...) clipped to [least, greatest], with a gradient that is zero beyond a limit only where descent would lead further out.

    The exact derivative is zero there: a tendon that an action had let go slack would stay so for ever.
    """
    bounds = (torch.as_tensor(bound, dtype=values.dtype) for bound in (least, greatest))
    return cast(torch.Tensor, _InwardClip.apply(values, *bounds))
