"""Episodes as arrays, and the buffer that collects them while an environment runs.

The module knows nothing of files.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array


@dataclass(frozen=True, eq=False)
class Rollout:
    """Episode as arrays, or a stretch of one.

    Sample 0 of an episode is what its reset left, sample k what its k-th step did.

    Targets, actions and titles may be missing.
    """

    model: Model  # of the arm, for drawing
    period: float  # between samples [s]
    strain: Array  # (samples, points, 6) as of `Model.strain`
    tension: Array  # (samples, n_a) [N] as applied
    tip_pose: Array  # (samples, 4, 4)
    target_pose: Array | None = None  # (samples, 4, 4)
    target_backbone: Array | None = None  # (samples, m, 3) [m]; m = 0 is as good as None
    action: Array | None = None  # (samples, k), the one that led to the sample
    # (samples,) each, NaN where there is none
    scalars: Mapping[str, Array] = field(default_factory=dict)
    title: str = ""  # of the episode, in recordings
    scene: Scene | None = None  # of the arm; None: the model's

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.strain)


class RolloutBuffer:
    """Collects samples of a row of running episodes.

    Args:
        episodes: that run.
        row: of the episodes.
    """

    def __init__(self, episodes: Episodes, row: int = 0) -> None:
        self._episodes = episodes
        self._row = row
        self.clear()

    def __len__(self) -> int:
        return len(self._scalars)

    def take(self) -> None:
        """Adds the present sample of the row, and the action that led there, NaN where none did."""
        episodes = self._episodes
        row = self._row
        arms = episodes.arms
        values_of_rows = (
            arms.rows.xi,
            episodes.tension,
            arms.reading.tip_pose,
            episodes.target_pose,
            episodes.target_backbone,
        )
        sample = [values[row].copy() for values in values_of_rows]
        numbers = episodes.info().items()
        scalars = {name: float(values[row]) for name, values in numbers}
        row_action = episodes.observed.action[row]
        action = np.array(row_action, dtype=float)
        reward = episodes.reward[row]
        scalars["reward"] = float(reward)
        if episodes.step_count[row] == 0:  # neither has led there
            action[:] = np.nan
            scalars["reward"] = np.nan
        self._samples.append([*sample, action])
        self._scalars.append(scalars)
        self._scene = arms.model_of(row).scene

    def clear(self) -> None:
        """Forgets the samples."""
        self._samples: list[list[Array]] = []
        self._scalars: list[dict[str, float]] = []

    def rollout(self, title: str = "") -> Rollout:
        """Returns the samples since the last `clear`, of which there is at least one.

        Args:
            title: of the rollout.

        Returns:
            The episode, or the stretch of one.
        """
        model = self._episodes.model
        xi, tension, tip_pose, target_pose, target_backbone, action = (
            np.array(column) for column in zip(*self._samples, strict=True)
        )
        scalars = {}
        for name in self._scalars[0]:
            values = [record[name] for record in self._scalars]
            scalars[name] = np.array(values)
        return Rollout(
            model,
            self._episodes.period,
            model.grid.unpacked(xi),
            tension,
            tip_pose,
            target_pose,
            target_backbone,
            action,
            scalars,
            title,
            self._scene,
        )


def collect(
    env: gym.Env[Any, Any],
    policy: Callable[[Any], ArrayLike],
    seed: int | None = None,
) -> Rollout:
    """Runs one episode of an environment until it ends, and returns its samples.

    Args:
        env: with one arm of this package.
        policy: function of an observation that returns an action (n_a,).
        seed: of the episode.

    Returns:
        The episode.

    Raises:
        TypeError: for environments of other packages.
    """
    buffer = RolloutBuffer(episodes_of(env))
    ended = False
    observation, _ = env.reset(seed=seed)
    buffer.take()
    while not ended:
        observation, _, terminated, truncated, _ = env.step(policy(observation))
        buffer.take()
        ended = terminated or truncated
    if seed is None:
        title = ""
    else:
        title = f"seed {seed}"
    return buffer.rollout(title)
