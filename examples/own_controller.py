"""A controller of your own: resolved-rate control of the tip's position, found by its name.
`python examples/own_controller.py`"""

import gymnasium as gym
import numpy as np

from soft_tendon_env import register
from soft_tendon_env.control import ControllerInput, ControllerOutput
from soft_tendon_env.policies import make_policy, observation_options


@register(
    "controller",
    "resolved_rate",
    task="Reach",
    description="tensions along the pseudoinverse of the static tip Jacobian",
)
class ResolvedRate:
    """du = gain (J G^-1 B)^+ e: tensions change as they would to take the error e of an arm at rest
    away at this rate."""

    def __init__(self, model, limits, period, rate=0.5):
        self.model = model
        self.gain = rate * period
        self.least, self.greatest = limits.T

    def act(self, now: ControllerInput, memory=None) -> ControllerOutput:
        terms = self.model.terms(now.q, now.q_dot)
        error = now.tip_pose[:3, :3].T @ (
            now.reference.tip_position[0] - now.tip_pose[:3, 3]
        )  # [m], tip frame
        jacobian = terms.tip_jacobian[3:] @ np.linalg.solve(
            terms.stiffness, terms.actuation
        )  # [m/N]
        wanted = now.tension + self.gain * np.linalg.pinv(jacobian) @ error
        tension = np.clip(wanted, self.least, self.greatest)
        return ControllerOutput(
            tension, report={"limited": float(np.mean(tension != wanted)), "singular": 0.0}
        )


if __name__ == "__main__":
    env = gym.make(
        "TendonRod-Reach-v0", scene="three_tendon", **observation_options("resolved_rate", "Reach")
    )
    policy = make_policy("resolved_rate", env)
    observation, info = env.reset(seed=0)
    print(f"the goal is {1e3 * info['position_error']:.0f} mm away")
    state = None
    ended = False
    while not ended:
        action, state = policy.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        ended = terminated or truncated
    print(f"after 10 s it is {1e3 * info['position_error']:.2f} mm away")
