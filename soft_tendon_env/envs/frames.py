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
TRAIL = 250  # tip positions that are shown

Frames = tuple[NDArray[np.uint8], ...]


def make_renderer(episodes: Episodes, render_mode: str | None) -> Any:
    """The renderer of a mode, which has the methods of RowRenderer; None for None. Raises
    ValueError for other modes, gymnasium.error.Error where a package is missing or the viewer
    cannot be opened."""
    if render_mode is None:
        return None
    if render_mode not in RENDER_MODES:
        raise ValueError(
            f"render_mode should be None, {' or '.join(map(repr, RENDER_MODES))}, not"
            f" {render_mode!r}"
        )
    return (
        RowRenderer(episodes)
        if render_mode == "rgb_array"
        else pkgutil.resolve_name(LIVE)(episodes)
    )


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
        for row in members:
            self._trails[row].append(self._episodes.arms.reading.tip_pose[row, :3, 3].copy())
            del self._trails[row][:-TRAIL]

    def frames(self) -> Frames | None:
        """A frame of each row now, (height, width, 3); None where they are seen elsewhere."""
        renderer = self._renderer = self._renderer or ArmRenderer(self._episodes.model)
        return tuple(renderer.frame(self._picture(row)) for row in range(self._episodes.size))

    def close(self) -> None:
        """Nothing is to be shown any more."""

    def _picture(self, row: int) -> Picture:
        episodes = self._episodes
        units = {name: error_unit(name) for name in episodes.errors}
        errors = "   ".join(
            f"{unit.label} {unit.text(episodes.errors[name][row])}" for name, unit in units.items()
        )
        return Picture(
            strain=episodes.model.grid.unpacked(episodes.arms.rows.xi[row]),
            tension=episodes.tension[row],
            trail=np.array(self._trails[row]),
            target_pose=episodes.target_pose[row],
            target_backbone=episodes.target_backbone[row] if episodes.task.shapes else None,
            title=f"t = {episodes.step_count[row] * episodes.period:.2f} s   {errors}",
            time=float(episodes.arms.rows.clock[row, 0]),
            scene=episodes.arms.model_of(row).scene,
        )
