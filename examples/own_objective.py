"""An objective of your own: model-predictive control that reaches a point, its elbow held level.
`python examples/own_objective.py`"""

import gymnasium as gym
import numpy as np

from soft_tendon_env.control import LinearError, Objective, Posture, TipPosition
from soft_tendon_env.policies import make_policy, observation_options

STEP = 1e-4  # of the unit of a coordinate, which bends the arm by about 1e-4 rad
HEIGHT = 0.0  # [m] of the elbow above the base: level with it
SECONDS = 3.0


class ElbowHeight(Objective):
    """Height [m] that the middle of the arm lacks, along the world's z axis."""

    def __init__(self, model, height=HEIGHT, weight=1.0):
        self.model, self.height, self.weight = model, height, weight

    def elbow(self, q):
        (pose,) = self.model.backbone_at(q, [0.5 * self.model.length])
        return pose[2, 3]

    def linear_error(self, posture: Posture) -> LinearError:
        """The error, and how it falls with the coordinates: here by central differences."""
        error = self.height - self.elbow(posture.q)
        steps = STEP * np.diag(self.model.coordinate_scale())
        rise = [
            (self.elbow(posture.q + step) - self.elbow(posture.q - step)) / (2.0 * step.sum())
            for step in steps
        ]
        return LinearError(np.array([self.weight * error]), self.weight * np.array([rise]))


def misses(objectives):
    """Distances [mm] of the tip from its goal and of the elbow from its height, at the end."""
    env = gym.make(
        "TendonRod-Reach-v0", scene="two_segment_six", **observation_options("predictive", "Reach")
    )
    policy = make_policy("predictive", env, objectives=objectives)
    observation, info = env.reset(seed=0)
    state = None
    for _ in range(round(SECONDS / env.unwrapped.episodes.period)):
        action, state = policy.predict(observation, state)
        observation, _, _, _, info = env.step(action)
    elbow = ElbowHeight(env.unwrapped.model).elbow(env.unwrapped.state.q)
    return 1e3 * info["position_error"], 1e3 * abs(elbow - HEIGHT)


if __name__ == "__main__":
    for name, objectives in {
        "the tip alone": [TipPosition()],
        "tip and elbow": [TipPosition(), ElbowHeight],
    }.items():
        tip, elbow = misses(objectives)
        print(f"{name}: the tip is {tip:.2f} mm from its goal, the elbow {elbow:.1f} mm off")
