"""Rendering of rows of episodes: frames as arrays, or the Rerun viewer."""

import pkgutil
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.drawing.renderer import ArmRenderer, Picture
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.tools.types import Array

RENDER_MODES = ("rgb_array", "human")
LIVE = "soft_tendon_env.recording.live:LiveRows"
"""Entry point of the renderer of "human", which is imported when an environment is made with it:
Rerun is an extra."""

TRAIL = 250
"""Tip positions that are shown."""

Frames = tuple[NDArray[np.uint8], ...]


def make_renderer(episodes: Episodes, render_mode: str | None) -> Any:
    """Renderer of a mode, which has the methods of RowRenderer; None for None.

    Args:
        episodes: rows to be drawn.
        render_mode: one of RENDER_MODES, or None.

    Returns:
        The renderer.

    Raises:
        ValueError: for other modes.
        gymnasium.error.Error: where a package is missing or the viewer cannot be opened.
    """
    if render_mode is None:
        return None
    if render_mode not in RENDER_MODES:
        modes = " or ".join(map(repr, RENDER_MODES))
        raise ValueError(f"render_mode should be None, {modes}, not {render_mode!r}")
    if render_mode == "rgb_array":
        return RowRenderer(episodes)
    return pkgutil.resolve_name(LIVE)(episodes)


class RowRenderer:
    """Remembers where the tips have been and draws rows."""

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes
        self._renderer: ArmRenderer | None = ArmRenderer(episodes.model)
        self._trails: list[list[Array]] = [[] for _ in range(episodes.size)]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_renderer": None}  # a figure cannot be copied

    def begin(self, members: Iterable[int]) -> None:
        """New episodes of the rows `members`."""
        for row in members:
            self._trails[row] = []
            self.step([row])

    def step(self, members: Iterable[int]) -> None:
        """Remember where the tips of the rows `members` are."""
        tips = self._episodes.arms.reading.tip_pose[:, :3, 3]
        for row in members:
            trail = self._trails[row]
            trail.append(tips[row].copy())
            del trail[:-TRAIL]

    def frames(self) -> Frames | None:
        """A frame of each row now, (height, width, 3); None where they are seen elsewhere."""
        if self._renderer is None:  # in a copy
            self._renderer = ArmRenderer(self._episodes.model)
        pictures = [self._picture(row) for row in range(self._episodes.size)]
        frames = (self._renderer.frame(picture) for picture in pictures)
        return tuple(frames)

    def close(self) -> None:
        """Nothing is to be shown any more."""

    def _picture(self, row: int) -> Picture:
        """Picture of a row that is to be drawn."""
        episodes = self._episodes
        time = episodes.step_count[row] * episodes.period
        title = [f"t = {time:.2f} s"]
        for name, values in episodes.errors.items():
            unit = error_unit(name)
            text = unit.text(values[row])
            title.append(f"{unit.label} {text}")
        target_backbone = None
        if episodes.task.shapes:
            target_backbone = episodes.target_backbone[row]
        return Picture(
            strain=episodes.model.grid.unpacked(episodes.arms.rows.xi[row]),
            tension=episodes.tension[row],
            trail=np.array(self._trails[row]),
            target_pose=episodes.target_pose[row],
            target_backbone=target_backbone,
            title="   ".join(title),
            time=float(episodes.arms.rows.clock[row, 0]),
            scene=episodes.arms.model_of(row).scene,
            has_axes=episodes.task.goal is None,
        )
