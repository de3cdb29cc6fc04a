"""A reward term of your own: a gentle tip, which an episode's policy is paid for.
`python examples/own_reward.py`"""

import gymnasium as gym
import numpy as np

from soft_tendon_env import register


@register("reward_term", "gentleness")
def gentleness(tracking):
    """How slowly the tip moves: 1 at rest, 1/2 at 0.2 m/s."""
    speed = np.linalg.norm(tracking.reading.tip_twist[:, 3:], axis=1)
    return 1.0 / (1.0 + (speed / 0.2) ** 2)


if __name__ == "__main__":
    env = gym.make(
        "TendonRod-TipPose-v0", scene="three_tendon", reward={"position": 1.0, "gentleness": 0.5}
    )
    env.reset(seed=0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    print(
        f"reward {reward:.3f}: position {info['reward_position']:.3f}, gentleness"
        f" {info['reward_gentleness']:.3f}"
    )
