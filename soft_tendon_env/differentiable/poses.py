"""SE(3) in PyTorch: cotangents of poses (4, 4) as body twists, and logarithms between poses."""

from typing import Any, cast

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from soft_tendon_env.mechanics.motion.pose_errors import pose_error_cotangents, pose_errors


def body_cotangent(pose: torch.Tensor, cotangent: torch.Tensor) -> torch.Tensor:
    """Cotangents of the body twists of poses, from those of their entries.

    Args:
        pose: (..., 4, 4).
        cotangent: of the entries (..., 4, 4).

    Returns:
        Cotangents (..., 6) of body twists, angular before linear.
    """
    R = pose[..., :3, :3]
    of_rotation = cotangent[..., :3, :3]
    of_position = cotangent[..., :3, 3:]
    turned = R.mT @ of_rotation
    # the vector of the antisymmetric part
    antisymmetric = turned - turned.mT
    moment = antisymmetric[..., [2, 0, 1], [1, 2, 0]]
    force = R.mT @ of_position
    column = force[..., 0]
    return torch.cat([moment, column], dim=-1)


def pose_cotangent(pose: torch.Tensor, cotangent: torch.Tensor) -> torch.Tensor:
    """Cotangents of the entries of poses, of which `body_cotangent` makes these of body twists.

    Args:
        pose: (..., 4, 4).
        cotangent: of body twists (..., 6), angular before linear.

    Returns:
        Cotangents (..., 4, 4) of the entries.
    """
    R = pose[..., :3, :3]
    moment = cotangent[..., None, :3]
    force = cotangent[..., 3:, None]
    half_moment = (0.5 * moment).expand_as(R)
    out = torch.zeros_like(pose)
    out[..., :3, :3] = torch.linalg.cross(R, half_moment)  # R w~ / 2, row by row
    out[..., :3, 3:] = R @ force
    return out


class _PoseErrors(torch.autograd.Function):
    """SE(3) logarithms from poses to desired ones, by the kernel of the environments."""

    @staticmethod
    def forward(ctx: Any, pose: torch.Tensor, desired: torch.Tensor) -> torch.Tensor:
        shape = desired.shape[:2]
        error = torch.empty(*shape, 6, dtype=torch.float64)
        pose_errors(pose.numpy(), desired.numpy(), error.numpy())
        ctx.save_for_backward(pose, desired, error)
        return error

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        pose, desired, error = ctx.saved_tensors
        of_error = cotangent.contiguous().numpy()
        of_pose = np.empty(error.shape)
        of_desired = np.empty(error.shape)
        pose_error_cotangents(error.numpy(), of_error, of_pose, of_desired)
        # a pose has errors to all the desired ones of its row
        of_pose_twist = torch.from_numpy(of_pose).sum(1)
        back = pose_cotangent(pose, of_pose_twist)
        _, needs_desired = ctx.needs_input_grad
        if not needs_desired:
            return back, None
        of_target = pose_cotangent(desired, torch.from_numpy(of_desired))
        return back, of_target


def pose_logarithm(pose: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Computes the SE(3) logarithms log(g^-1 g_bar) from poses g to desired g_bar.

    They are float64, differentiable in both along rigid motions, once, exact near no rotation and
    finite at a half turn, where the logarithm jumps.

    Args:
        pose: g (rows, 4, 4).
        wanted: g_bar (rows, m, 4, 4).

    Returns:
        Logarithms (rows, m, 6), angular [rad] before linear [m].

    Raises:
        ValueError: for other shapes.
    """
    rows = pose.shape[:1]
    is_pose = pose.shape[1:] == (4, 4)
    are_poses = is_pose and wanted.shape[2:] == (4, 4)
    if not are_poses or wanted.shape[:1] != rows:
        own = tuple(pose.shape)
        other = tuple(wanted.shape)
        shapes = f"{own} and {other}"
        raise ValueError(
            f"pose and wanted should have shapes (rows, 4, 4) and (rows, m, 4, 4), not {shapes}"
        )
    pose_64 = pose.to(torch.float64).contiguous()
    desired_64 = wanted.to(torch.float64).contiguous()
    return cast(torch.Tensor, _PoseErrors.apply(pose_64, desired_64))
