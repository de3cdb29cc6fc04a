"""One episode as arrays, the buffer that collects them while an environment runs, and whole
episodes. Knows nothing of files."""

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
    """An episode, or a stretch of one: sample 0 of an episode is what its reset left, sample k what
    its k-th step did.

    period [s] between samples; strain (samples, points, 6) as of `Model.strain`; tension (samples,
    n_a) [N] as applied; tip_pose, target_pose (samples, 4, 4); target_backbone (samples, m, 3) [m],
    m = 0 being as good as None; action (samples, k), the one that led to the sample; scalars
    (samples,) each, NaN where there is none; scene of the arm, None: the model's.
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
    scene: Scene | None = None

    @property
    def samples(self) -> int:
        return len(self.strain)


class RolloutBuffer:
    """Collects samples of a row of running episodes."""

    def __init__(self, episodes: Episodes, row: int = 0) -> None:
        self._episodes, self._row = episodes, row
        self.clear()

    def __len__(self) -> int:
        return len(self._scalars)

    def take(self) -> None:
        """Add where the row stands now, and the action that led there, NaN where none did."""
        now, row, reading = self._episodes, self._row, self._episodes.arms.reading
        steps = now.step_count[row] > 0
        action = np.where(steps, now.observed.action[row], np.nan)
        sample = (
            now.arms.rows.xi,
            now.tension,
            reading.tip_pose,
            now.target_pose,
            now.target_backbone,
        )
        self._samples.append([*(values[row].copy() for values in sample), action])
        self._scalars.append(
            {name: float(values[row]) for name, values in now.info().items()}
            | {"reward": float(now.reward[row]) if steps else np.nan}
        )
        self._scene = now.arms.model_of(row).scene

    def clear(self) -> None:
        """Forget the samples."""
        self._samples: list[list[Array]] = []
        self._scalars: list[dict[str, float]] = []

    def rollout(self, title: str = "") -> Rollout:
        """The samples since the last `clear`, of which there is at least one."""
        model, records = self._episodes.model, self._scalars
        strain, *columns = (np.array(column) for column in zip(*self._samples, strict=True))
        scalars = {name: np.array([record[name] for record in records]) for name in records[0]}
        sampled: dict[str, Any] = dict(
            zip(
                ("tension", "tip_pose", "target_pose", "target_backbone", "action"),
                columns,
                strict=True,
            )
        )
        strain = model.grid.unpacked(strain)
        return Rollout(
            model,
            self._episodes.period,
            strain,
            scalars=scalars,
            title=title,
            scene=self._scene,
            **sampled,
        )


def collect(
    env: gym.Env[Any, Any], policy: Callable[[Any], ArrayLike], seed: int | None = None
) -> Rollout:
    """One episode of an environment with actions policy(observation), until it ends."""
    buffer, ended = RolloutBuffer(episodes_of(env)), False
    observation, _ = env.reset(seed=seed)
    buffer.take()
    while not ended:
        observation, _, terminated, truncated, _ = env.step(policy(observation))
        buffer.take()
        ended = terminated or truncated
    return buffer.rollout("" if seed is None else f"seed {seed}")
