"""SE(3) in PyTorch: cotangents of poses (4, 4) as body twists, and the logarithm from poses to
wanted ones."""

from typing import Any, cast

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from soft_tendon_env.mechanics.motion.pose_errors import pose_error_cotangents, pose_errors


def body_cotangent(pose: torch.Tensor, cotangent: torch.Tensor) -> torch.Tensor:
    """Cotangents (..., 6) of the body twist, angular before linear, of poses (..., 4, 4) and
    cotangents of their entries (..., 4, 4)."""
    R = pose[..., :3, :3]
    turned = R.mT @ cotangent[..., :3, :3]
    moment = (turned - turned.mT)[..., [2, 0, 1], [1, 2, 0]]
    return torch.cat([moment, (R.mT @ cotangent[..., :3, 3:])[..., 0]], dim=-1)


def pose_cotangent(pose: torch.Tensor, cotangent: torch.Tensor) -> torch.Tensor:
    """Cotangents (..., 4, 4) of the entries of poses (..., 4, 4) of which `body_cotangent` makes
    these (..., 6)."""
    R, out = pose[..., :3, :3], torch.zeros_like(pose)
    half = 0.5 * cotangent[..., None, :3]
    out[..., :3, :3] = torch.linalg.cross(R, half.expand_as(R))  # R w~ / 2, row by row
    out[..., :3, 3:] = R @ cotangent[..., 3:, None]
    return out


class _PoseErrors(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, pose: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        error = torch.empty(*wanted.shape[:2], 6, dtype=torch.float64)
        pose_errors(pose.numpy(), wanted.numpy(), error.numpy())
        ctx.save_for_backward(pose, wanted, error)
        return error

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        pose, wanted, error = ctx.saved_tensors
        of_pose, of_wanted = np.empty(error.shape), np.empty(error.shape)
        pose_error_cotangents(error.numpy(), cotangent.contiguous().numpy(), of_pose, of_wanted)
        back = pose_cotangent(pose, torch.from_numpy(of_pose).sum(1))
        return back, pose_cotangent(wanted, torch.from_numpy(of_wanted)) if ctx.needs_input_grad[
            1
        ] else None


def pose_logarithm(pose: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """SE(3) logarithms log(g^-1 g_bar) (rows, m, 6), angular before linear, from poses g (rows, 4,
    4) to desired g_bar (rows, m, 4, 4).

    float64. Differentiable in both along rigid motions, once, exact near no rotation and finite at
    a half turn, where the logarithm jumps. Raises ValueError for other shapes.
    """
    if pose.shape[1:] != (4, 4) or wanted.shape[:1] != pose.shape[:1] or wanted.shape[2:] != (4, 4):
        shapes = f"{tuple(pose.shape)} and {tuple(wanted.shape)}"
        raise ValueError(
            f"pose and wanted should have shapes (rows, 4, 4) and (rows, m, 4, 4), not {shapes}"
        )
    poses = (of.to(torch.float64).contiguous() for of in (pose, wanted))
    return cast(torch.Tensor, _PoseErrors.apply(*poses))
