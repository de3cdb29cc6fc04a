"""Actuators in PyTorch: commands from actions, and clipping whose gradient leads back inside."""

import math
from typing import Any, cast

import torch
from torch.autograd.function import once_differentiable

from soft_tendon_env.envs.actuation import ActionScale, Actuation


class _InwardClip(torch.autograd.Function):
    """Clipping, whose gradient is zero where descent would lead further out alone."""

    @staticmethod
    def forward(
        ctx: Any,
        values: torch.Tensor,
        least: torch.Tensor,
        greatest: torch.Tensor,
    ) -> torch.Tensor:
        raised = torch.maximum(values, least)
        clipped = torch.minimum(raised, greatest)
        ctx.save_for_backward(values - clipped)
        return clipped

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (beyond,) = ctx.saved_tensors
        leads_inside = beyond * cotangent >= 0.0
        return cotangent * leads_inside, None, None


def inward_clip(
    values: torch.Tensor, least: torch.Tensor | float, greatest: torch.Tensor | float
) -> torch.Tensor:
    """Clips values, with a gradient beyond a limit unless descent would lead further out.

    The exact derivative is zero there: a tendon that an action had let go slack would stay so for
    ever.

    Args:
        values: (...).
        least: limit, which broadcasts with the values.
        greatest: limit, which broadcasts with the values.

    Returns:
        Values (...) in [least, greatest].
    """
    low = torch.as_tensor(least, dtype=values.dtype)
    high = torch.as_tensor(greatest, dtype=values.dtype)
    return cast(torch.Tensor, _InwardClip.apply(values, low, high))


class TensorActuation:
    """Rows of actuators from where they are now, for actions that carry gradients.

    Gradients at limits and of slack tendons lead inside.

    Attributes:
        command: (rows, n_a) asked for last.
        scale: an ActionScale of tensors.
    """

    def __init__(self, actuation: Actuation) -> None:
        """Begin where the actuators of an environment are."""
        self._actuation = actuation
        actions = actuation.actions
        self.scale: Any = ActionScale(
            _tensor(actions.least),
            _tensor(actions.greatest),
            _tensor(actions.increment),
            _tensor(actions.greatest_change),
        )
        self.command: torch.Tensor = _tensor(actuation.command)
        self._in_transit = _tensor(actuation.in_transit)

    def apply(self, action: torch.Tensor) -> torch.Tensor:
        """Commands of the period that begins, as `Actuation.apply`.

        Args:
            action: (rows, n_a) in [-1, 1].

        Returns:
            Commands (rows, parts, n_a), with the errors of the actuators.
        """
        actuation = self._actuation
        command = self.scale.wanted(action, self.command)
        if self.scale.greatest_change is not None:
            command = self._at_rate(action)
        self.command = inward_clip(command, self.scale.least, self.scale.greatest)
        if self._in_transit is None:
            held = self.command[:, None]
            acting = held.expand(-1, actuation.substeps, -1)
        else:
            newest = self.command[:, None]
            kept = self._in_transit[:, 1:]
            self._in_transit = torch.cat([kept, newest], dim=1)
            acting = self._in_transit[actuation.arriving]
        if actuation.imperfect:
            gain = _tensor(actuation.gain)[:, None]
            offset = _tensor(actuation.offset)[:, None]
            slack = _tensor(actuation.slack)
            erroneous = gain * acting + offset
            acting = inward_clip(erroneous, slack, math.inf)
        return acting

    def _at_rate(self, action: torch.Tensor) -> torch.Tensor:
        """Commands (rows, n_a) that actions ask for, as far as the actuators' rate lets them."""
        most = self.scale.greatest_change
        before = self.command.detach()
        asked = self.scale.wanted(action, before)
        command = inward_clip(asked, before - most, before + most)
        # increments, and what is cut off, go on from the command before: its gradient comes in by a
        # difference of zero
        goes_on = command != asked
        if self.scale.increment is not None:
            goes_on = torch.ones_like(goes_on)
        change = goes_on * (self.command - before)
        return command + change


def _tensor(values: Any) -> Any:
    """A tensor with a copy of an array; None of None."""
    if values is None:
        return None
    return torch.tensor(values)
