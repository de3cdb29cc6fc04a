"""A task of your own: point the tip, a camera say, along a moving direction, wherever it is.
`python examples/own_task.py`"""

import gymnasium as gym
import numpy as np

from soft_tendon_env import register
from soft_tendon_env.envs.observation import Group
from soft_tendon_env.envs.tasks import Task, TrackingError


def angle_between_axes(tracking):
    """Angle (rows,) [rad] between the tip's x axis and the target's."""
    cosine = (tracking.tip_pose[:, :3, 0] * tracking.target_pose[:, :3, 0]).sum(axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


POINTING = TrackingError(
    "pointing_error",
    "pointing",
    "angle between the x axes of tip and target [rad]",
    0.2,
    angle_between_axes,
)
register(
    "observation_group",
    "tip_axis",
    Group("the tip's x axis, world frame", lambda observed: observed.tip_pose[:, :3, 0]),
)
register(
    "task",
    "Point",
    Task(
        description="Point the tip along a moving direction.",
        target="random",
        observations={
            "full": ("coordinates", "rates", "tip_axis", "target_error", "preview", "last_action")
        },
        errors=(POINTING,),
        reward={"pointing": 1.0, "effort": 0.05},
    ),
)

if __name__ == "__main__":
    env = gym.make("TendonRod-Point-v0", scene="three_tendon")
    env.reset(seed=0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    print(
        f"{env.observation_space.shape[0]} numbers observed,"
        f" {np.degrees(info['pointing_error']):.1f} degrees off, reward {reward:.3f}"
    )
    envs = gym.make_vec("TendonRod-Point-v0", num_envs=8, scene="three_tendon")
    envs.reset(seed=0)
    print("eight rows:", envs.step(envs.action_space.sample())[1].round(3))
