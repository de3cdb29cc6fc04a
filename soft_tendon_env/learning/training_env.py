"""Vector environment of a training: many arms, and domain randomisation by its options."""

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.vec_env import StableBaselinesVecEnv, make_sb3_vec_env


def make_training_env(training: Training) -> StableBaselinesVecEnv:
    """Vector environment of a training. Raises ConfigurationError, ValueError.

    The first episode of every arm ends at another time, so that every batch has beginnings, middles and ends of episodes: of arms that all
    begin together an agent learns how to begin once in an episode, and has forgotten it when they end.
    """
    steps = training.episode_steps
    env = make_sb3_vec_env(IDS[training.task], training.arms, max_episode_steps=steps, threads=training.threads, **training.options)
    env.set_options([{"episode_steps": 1 + steps * row // training.arms} for row in range(training.arms)])
    return env
