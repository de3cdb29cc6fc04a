"""One episode as arrays, the buffer that collects them while an environment runs, and whole episodes. Knows nothing of files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

NUMBERS = (bool, int, float, np.bool_, np.integer, np.floating)


@dataclass(frozen=True, eq=False)
class Rollout:
    """An episode, or a stretch of one: sample 0 of an episode is what its reset left, sample k what its k-th step did.

    period [s] between samples; strain (samples, points, 6) as of `Model.strain`; tension (samples, n_a) [N] as applied;
    tip_pose, target_pose (samples, 4, 4); target_backbone (samples, m, 3) [m], m = 0 being as good as None; action (samples, k), the one
    that led to the sample; scalars (samples,) each, NaN where there is none;
    effects of the arm, None: those of its scene; markers (samples, m, 3) [m], measured points, NaN where one was not seen.
    """

    model: Model
    period: float
    strain: Array
    tension: Array
    tip_pose: Array
    target_pose: Array | None = None
    target_backbone: Array | None = None
    action: Array | None = None
    scalars: Mapping[str, Array] = field(default_factory=dict)
    title: str = ""
    effects: Effects | None = None
    markers: Array | None = None

    @property
    def samples(self) -> int:
        return len(self.strain)


class RolloutBuffer:
    """Collects samples one at a time; `append` copies arrays, so that the environment may reuse what it hands over."""

    def __init__(self, model: Model, period: float) -> None:
        self.model, self.period = model, period
        self.clear()

    def __len__(self) -> int:
        return len(self._scalars)

    def append(self, sample: Sequence[ArrayLike], scalars: dict[str, object]) -> None:
        """Add a sample: strain (m,) as the kernels have it, and tension, tip pose, target pose, target backbone and action of a `Rollout`.

        Numbers and bools count as scalars.
        """
        self._samples.append([np.array(values, dtype=np.float64) for values in sample])
        self._scalars.append(scalars)

    def clear(self) -> None:
        """Forget the samples."""
        self._samples: list[list[Array]] = []
        self._scalars: list[dict[str, object]] = []

    def rollout(self, title: str = "", effects: Effects | None = None) -> Rollout:
        """The samples since the last `clear`, of which there is at least one; `effects` of the arm, None: those of its scene."""
        strain, tension, tip, target, backbone, action = (np.array(column) for column in zip(*self._samples, strict=True))
        strain, scalars = self.model.grid.unpacked(strain), scalar_columns(self._scalars)
        return Rollout(self.model, self.period, strain, tension, tip, target, backbone, action, scalars, title, effects)


def scalar_columns(records: list[dict[str, object]]) -> dict[str, Array]:
    """The numbers and bools of one record per sample as columns (samples,), NaN where a record has none of that name."""
    names = {name: None for record in records for name, value in record.items() if isinstance(value, NUMBERS)}  # in order of appearance
    columns = {name: [record.get(name) for record in records] for name in names}
    return {name: np.array([float(value) if isinstance(value, NUMBERS) else np.nan for value in own]) for name, own in columns.items()}


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
    reading, strain = now.arms.reading, now.arms.rows.xi[row]
    buffer.append((strain, now.tension[row], reading.tip_pose[row], now.target_pose[row], now.target_backbone[row], action), scalars)


def no_action(space: gym.Space[Any]) -> Array:
    """NaN in place of an action (k,), for samples that none has led to."""
    return np.full(int(np.prod(space.shape or ())), np.nan)
