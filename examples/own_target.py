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
        size = 0.05  # of the eight [m]
        angle = self.rate * times
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, 0, 3] = 0.28
        pose[:, 1, 3] = size * np.sin(angle)
        pose[:, 2, 3] = size * np.sin(angle) * np.cos(angle)
        # The tip's frame does not turn: its velocity is that of the position.
        twist = np.zeros((times.size, 6))
        twist[:, 4] = size * self.rate * np.cos(angle)
        twist[:, 5] = size * self.rate * np.cos(2.0 * angle)
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
