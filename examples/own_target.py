"""A target of your own: the tip along a figure of eight, at a speed that you choose. `python examples/own_target.py`"""

from typing import Literal

import gymnasium as gym
import numpy as np
from pydantic import Field

from soft_tendon_env.envs.targets import PoseCourse, Target, pose_samples, register_target
from soft_tendon_env.policies import make_policy, observation_options


@register_target
class FigureEight(Target):
    """`{"type": "figure_eight"}`: `width` [m] and `period` [s] of a figure of eight in a plane x = `distance` [m] from the base."""

    type: Literal["figure_eight"] = "figure_eight"
    distance: float = 0.28
    width: float = Field(default=0.1, gt=0)
    period: float = Field(default=4.0, gt=0)

    def draw(self, generator, setting):
        return FigureEightCourse(self)


class FigureEightCourse(PoseCourse):
    def __init__(self, target):
        self.target = target

    def sample(self, times):
        rate, half = 2.0 * np.pi / self.target.period, 0.5 * self.target.width
        s, c, zero = np.sin(rate * times), np.cos(rate * times), 0.0 * times
        pose, twist = np.tile(np.eye(4), (times.size, 1, 1)), np.zeros((times.size, 6))
        pose[:, :3, 3] = np.stack([zero + self.target.distance, half * s, half * s * c], axis=1)
        twist[:, 3:] = np.stack([zero, half * rate * c, half * rate * (c * c - s * s)], axis=1)  # the tip's frame does not turn
        return pose_samples(pose, twist)


if __name__ == "__main__":
    options = {"scene": "three_tendon", "target": {"type": "figure_eight", "period": 6.0}}
    env = gym.make("TendonRod-TipPose-v0", **options, **observation_options("tracking_position", "TipPose"))
    policy, (observation, info), state, errors = make_policy("tracking_position", env), env.reset(seed=0), None, []
    for _ in range(500):
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = env.step(action)
        errors.append(1e3 * info["position_error"])
    print(f"on the figure of eight: {np.sqrt(np.mean(np.square(errors[100:]))):.2f} mm root mean square from 2 s on")
