"""What recordings read of an environment, and whole episodes of it as arrays."""

from collections.abc import Callable
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.model.model import Model
from soft_tendon_env.recording.rollout import Rollout, RolloutBuffer
from soft_tendon_env.scene.scene import Array


class Motions(Protocol):
    @property
    def xi(self) -> Array: ...  # (rows, points * 6)


class Readings(Protocol):
    @property
    def tip_pose(self) -> Array: ...  # (rows, 4, 4)


class Arms(Protocol):
    @property
    def rows(self) -> Motions: ...
    @property
    def reading(self) -> Readings: ...


class Sample(Protocol):
    """Where every row stands, as `RolloutBuffer.append` takes it less the first axis."""

    @property
    def strain(self) -> Array: ...
    @property
    def tension(self) -> Array: ...
    @property
    def tip_pose(self) -> Array: ...
    @property
    def target_pose(self) -> Array: ...
    @property
    def target_backbone(self) -> Array: ...


class Episodes(Protocol):
    """What is read of `env.unwrapped.episodes` after each reset and step; the environment may write over it afterwards.

    With `AutoresetMode.SAME_STEP`, `last` says where the rows that ended in the last step stood before they were reset.
    """

    @property
    def model(self) -> Model: ...
    @property
    def period(self) -> float: ...  # [s] of a step
    @property
    def step_count(self) -> NDArray[np.int64]: ...  # (rows,) steps since the reset
    @property
    def arms(self) -> Arms: ...
    @property
    def tension(self) -> Array: ...  # (rows, n_a) [N], as applied
    @property
    def target_pose(self) -> Array: ...  # (rows, 4, 4)
    @property
    def target_backbone(self) -> Array: ...  # (rows, m, 3) [m], m = 0 where there is none
    @property
    def last(self) -> Sample | None: ...


def collect(env: gym.Env[Any, Any], policy: Callable[[Any], ArrayLike], seed: int | None = None) -> Rollout:
    """One episode of an environment with actions policy(observation), until it ends."""
    episodes = episodes_of(env)
    buffer = RolloutBuffer(episodes.model, episodes.period, episodes.target_backbone.shape[1], action_size(env.action_space))
    observation, info = env.reset(seed=seed)
    take_sample(buffer, episodes, 0, np.nan, dict(info))
    ended = False
    while not ended:
        action = policy(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        take_sample(buffer, episodes, 0, action, {**info, "reward": float(reward)})
        ended = terminated or truncated
    return buffer.rollout("" if seed is None else f"seed {seed}")


def take_sample(buffer: RolloutBuffer, now: Episodes, row: int, action: ArrayLike, scalars: dict[str, object]) -> None:
    """Add where a row stands now, with the action that led there and the numbers to keep."""
    arms = now.arms
    buffer.append(
        arms.rows.xi[row], now.tension[row], arms.reading.tip_pose[row], now.target_pose[row], now.target_backbone[row], action, scalars
    )


def episodes_of(env: Any) -> Episodes:
    """What the environment lets recordings read. Raises TypeError for environments of other packages."""
    episodes: Episodes | None = getattr(env.unwrapped, "episodes", None)
    if episodes is None:
        raise TypeError(f"only environments of soft_tendon_env can be recorded, not {env.unwrapped}")
    return episodes


def action_size(space: gym.Space[Any]) -> int:
    """Entries of one action."""
    return int(np.prod(space.shape or ()))
