"""SE(3) logarithms of operations that an ONNX file has, which `differentiable.poses` leaves to compiled kernels."""

import math

import torch

SMALL = 1e-6  # sine of half an angle below which the limits at zero are exact to double precision


def pose_logarithm(pose: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """SE(3) logarithms log(g^-1 g_bar) (m, 6), angular before linear, from a pose g (4, 4) to wanted ones g_bar (m, 4, 4), float64.

    Rotations go by way of unit quaternions (Shepperd 1978), which are exact at half turns too.
    """
    q = _quaternion(pose[:3, :3].T @ wanted[:, :3, :3])
    p, w, v = (wanted[:, :3, 3] - pose[:3, 3]) @ pose[:3, :3], q[:, :1], q[:, 1:]
    s = (v * v).sum(1, keepdim=True).sqrt()
    half = torch.atan((s / w.clamp(min=1e-30)).float()).double()  # runtimes have no atan of doubles: a step of Newton's adds the digits
    half = half + s * torch.sin(half + 0.5 * math.pi) - w * torch.sin(half)
    safe = s.clamp(min=SMALL)
    k = v * torch.where(s < SMALL, 2.0, 2.0 * half / safe)
    e = torch.where(s < SMALL, 1.0 / 12.0, (1.0 - half * w / safe) / (4.0 * half * half).clamp(min=SMALL**2))
    u = torch.linalg.cross(k, p)
    return torch.cat([k, p - 0.5 * u + e * torch.linalg.cross(k, u)], dim=1)


def _quaternion(R: torch.Tensor) -> torch.Tensor:
    """Unit quaternions (m, 4), w >= 0 first, of rotation matrices (m, 3, 3): the longest column of 4 q q^T, which is linear in R."""
    x, y, z = (R[:, i, i] for i in range(3))
    wx, wy, wz = (R[:, i, j] - R[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    xy, xz, yz = (R[:, i, j] + R[:, j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    rows = [1 + x + y + z, wx, wy, wz, wx, 1 + x - y - z, xy, xz, wy, xy, 1 - x + y - z, yz, wz, xz, yz, 1 - x - y + z]
    products = torch.stack(rows, dim=1)
    longest = torch.eye(4, dtype=R.dtype)[products[:, ::5].argmax(1)]
    column = (products.reshape(-1, 4, 4) * longest[:, None]).sum(2)
    side = torch.where(column[:, :1] < 0.0, -1.0, 1.0)
    return side * column / (column * column).sum(1, keepdim=True).sqrt()
