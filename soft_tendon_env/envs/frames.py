"""Frames of the rows of episodes, for `render`."""

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.rendering import ArmRenderer, Picture
from soft_tendon_env.scene import Array

TRAIL = 250
"""Tip positions that are shown."""


class RowRenderer:
    """Remembers where the tips have been and draws rows."""

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes
        self._renderer = ArmRenderer(episodes.model)
        self._trails: list[list[Array]] = [[] for _ in range(episodes.size)]

    def begin(self, members: Indices) -> None:
        """New episodes of the rows `members`."""
        for row in members:
            self._trails[row] = []
        self.step()

    def step(self) -> None:
        """Remember where the tips are."""
        for trail, pose in zip(self._trails, self._episodes.arms.reading.tip_pose, strict=True):
            trail.append(pose[:3, 3].copy())
            del trail[:-TRAIL]

    def frame(self, row: int) -> NDArray[np.uint8]:
        """A row now, (height, width, 3)."""
        episodes = self._episodes
        errors = "   ".join(f"{name.replace('_', ' ')} {value[row]:.3g}" for name, value in episodes.errors.items())
        picture = Picture(
            strain=episodes.arms.rows.xi[row],
            tension=episodes.tension[row],
            trail=np.array(self._trails[row]),
            target_pose=episodes.target_pose[row],
            target_backbone=episodes.target_backbone[row] if episodes.task.shapes else None,
            title=f"t = {episodes.step_count[row] * episodes.period:.2f} s   {errors}",
        )
        return self._renderer.frame(picture)
