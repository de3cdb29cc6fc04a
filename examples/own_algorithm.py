"""An algorithm of your own: PPO whose exploration fades, trained by its name as any other.
`python examples/own_algorithm.py`"""

from pathlib import Path

import gymnasium as gym
from stable_baselines3 import PPO

from soft_tendon_env import register
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate, summarise
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.train import train
from soft_tendon_env.policies import load_policy


@register("algorithm", "FadingPPO")
class FadingPPO(PPO):
    """The entropy bonus falls to zero in proportion to what remains of the training: explore first,
    refine later."""

    def _setup_model(self):
        super()._setup_model()
        self.first_bonus = self.ent_coef

    def train(self):
        self.ent_coef = self.first_bonus * self._current_progress_remaining
        super().train()


if __name__ == "__main__":
    training = Training(
        task="TipPose",
        algorithm="FadingPPO",
        steps=8192,
        arms=32,
        seconds=2.0,
        hyperparameters={"n_steps": 64, "batch_size": 512, "ent_coef": 0.01},
        options={"scene": "three_tendon", "fidelity": "fast"},
        evaluation={"every": 8192, "episodes": 4, "skip": 0.5},
    )
    folder = Path("out/fading_ppo")
    model = train(training, folder)
    env = gym.make("TendonRod-TipPose-v0", max_episode_steps=100, **training.options)
    policy = load_policy(str(folder / "best"), env)
    error = summarise(evaluate(policy, env, EVALUATION_SEEDS[:4], skip=0.5)).errors[
        "position_error"
    ]
    print(
        f"after {model.num_timesteps} steps the tip is {1e3 * error.rms:.1f} mm off, and the bonus"
        f" {model.ent_coef:.4f}"
    )
