"""A target of your own: the tip along a figure of eight, at a speed that you choose.
`python examples/own_target.py`"""

from typing import Literal

import gymnasium as gym
import numpy as np

from soft_tendon_env import register
from soft_tendon_env.envs.targets import PoseCourse, Target, pose_samples
from soft_tendon_env.evaluation import evaluate
from soft_tendon_env.policies import make_policy, observation_options


@register("target", "figure_eight")
class FigureEight(Target):
    """`{"type": "figure_eight"}`: 0.1 m wide, 0.28 m in front of the base; `period` [s]."""

    type: Literal["figure_eight"] = "figure_eight"
    period: float = 4.0

    def draw(self, generator, setting):
        return FigureEightCourse(2.0 * np.pi / self.period)


class FigureEightCourse(PoseCourse):
    def __init__(self, rate):
        self.rate = rate

    def sample(self, times):
        s, c, zero = 0.05 * np.sin(self.rate * times), np.cos(self.rate * times), 0.0 * times
        pose, twist = np.tile(np.eye(4), (times.size, 1, 1)), np.zeros((times.size, 6))
        pose[:, :3, 3] = np.stack([zero + 0.28, s, s * c], axis=1)
        twist[:, 3:] = (
            0.05 * self.rate * np.stack([zero, c, 2.0 * c * c - 1.0], axis=1)
        )  # the tip's frame does not turn
        return pose_samples(pose, twist)


if __name__ == "__main__":
    options = observation_options("tracking_position", "TipPose")
    env = gym.make(
        "TendonRod-TipPose-v0",
        scene="three_tendon",
        target={"type": "figure_eight", "period": 6.0},
        **options,
    )
    (score,) = evaluate(make_policy("tracking_position", env), env, seeds=[0], skip=2.0)
    print(
        f"on the figure of eight: {1e3 * score.errors['position_error'].rms:.2f} mm root mean"
        " square from 2 s on"
    )
