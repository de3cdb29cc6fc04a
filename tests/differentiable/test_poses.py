"""Logarithms of SE(3) and clips in PyTorch: gradients against differences along rigid motions, and back inside."""

import numpy as np
import pytest
import torch

from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.differentiable import inward_clip, pose_logarithm
from soft_tendon_env.differentiable.poses import body_cotangent


def slopes(value, pose, h=1e-6):
    """Central differences (6,) of value(pose) along body twists."""
    return np.array([(value(moved_pose(pose, h * axis)) - value(moved_pose(pose, -h * axis))) / (2.0 * h) for axis in np.eye(6)])


@pytest.mark.cases("angle", [(0.0,), (1e-9,), (1e-4,), (0.3,), (2.0,), (3.1,), (np.pi - 1e-4,)])
def test_gradients_of_the_logarithm_are_differences_along_body_twists(angle):
    rng = np.random.default_rng(0)
    axis, weight = rng.normal(size=3), rng.normal(size=6)
    pose = moved_pose(np.eye(4), rng.normal(size=6))
    wanted = moved_pose(pose, np.concatenate([angle * axis / np.linalg.norm(axis), rng.normal(size=3)]))
    g, g_bar = (torch.tensor(of, requires_grad=True) for of in (pose[None], wanted[None, None]))
    error = pose_logarithm(g, g_bar)
    np.testing.assert_array_equal(error.detach()[0, 0], pose_error(pose, wanted))
    (error[0, 0] @ torch.tensor(weight)).backward()
    by_pose = slopes(lambda moved: weight @ pose_error(moved, wanted), pose)
    by_wanted = slopes(lambda moved: weight @ pose_error(pose, moved), wanted)
    np.testing.assert_allclose(body_cotangent(g.detach(), g.grad)[0], by_pose, atol=1e-7)
    np.testing.assert_allclose(body_cotangent(g_bar.detach(), g_bar.grad)[0, 0], by_wanted, atol=1e-7)


def test_a_clip_has_gradients_that_lead_back_inside():
    values = torch.tensor([-2.0, -2.0, 0.3, 0.3, 2.0, 2.0], dtype=torch.float64, requires_grad=True)
    clipped = inward_clip(values, -1.0, 1.0)
    assert clipped.tolist() == [-1.0, -1.0, 0.3, 0.3, 1.0, 1.0]
    clipped.backward(torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))  # descent goes against it
    assert values.grad.tolist() == [0.0, -1.0, 1.0, -1.0, 1.0, 0.0]
