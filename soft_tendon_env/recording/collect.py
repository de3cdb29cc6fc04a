"""Whole episodes of an environment as arrays: samples of state, tension, target and action at every step."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.recording.rollout import Rollout, RolloutBuffer
from soft_tendon_env.tools.types import Array


def collect(env: gym.Env[Any, Any], policy: Callable[[Any], ArrayLike], seed: int | None = None) -> Rollout:
    """One episode of an environment with actions policy(observation), until it ends."""
    episodes = episodes_of(env)
    buffer = RolloutBuffer(episodes.model, episodes.period)
    observation, info = env.reset(seed=seed)
    take_sample(buffer, episodes, 0, no_action(env.action_space), dict(info))
    ended = False
    while not ended:
        action = policy(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        take_sample(buffer, episodes, 0, action, {**info, "reward": float(reward)})
        ended = terminated or truncated
    return buffer.rollout("" if seed is None else f"seed {seed}", episodes.arms.effects_of(0))


def take_sample(buffer: RolloutBuffer, now: Episodes, row: int, action: ArrayLike, scalars: dict[str, object]) -> None:
    """Add where a row stands now, with the action that led there and the numbers to keep."""
    arms = now.arms
    buffer.append(
        arms.rows.xi[row], now.tension[row], arms.reading.tip_pose[row], now.target_pose[row], now.target_backbone[row], action, scalars
    )


def no_action(space: gym.Space[Any]) -> Array:
    """NaN in place of an action (k,), for samples that none has led to."""
    return np.full(int(np.prod(space.shape or ())), np.nan)
