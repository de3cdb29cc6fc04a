"""Wrappers that record the episodes of an environment to a Rerun file.

They do as `gymnasium.wrappers.RecordVideo` does to videos.
"""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import gymnasium as gym

from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.recording.rollout import Rollout, RolloutBuffer

if TYPE_CHECKING:
    from soft_tendon_env.recording.rerun_file import RerunFile
    from soft_tendon_env.recording.rerun_stream import RerunStream

FLUSH_PERIOD = 2.0  # [s]


class RowRecorder:
    """Records the episodes of one row as an arm of a file, at their ends.

    With `flush_period` it also does whenever as many seconds have passed.
    """

    def __init__(
        self,
        file: "RerunStream",
        arm: str,
        episodes: Episodes,
        row: int,
        flush_period: float | None,
    ) -> None:
        self._file = file
        self._arm = arm
        self._episodes = episodes
        self._flush_period = flush_period
        self._buffer = RolloutBuffer(episodes, row)
        self._episode = -1  # number of the episode
        self._title = ""
        self._written = 0.0  # [s] of the clock
        self._continues = False  # whether a part of the episode is written

        self.rollout: Rollout | None = None  # the newest that was written

    def begin(self, seed: int | None = None) -> None:
        """Takes the state after a reset as the first sample of the next episode.

        One that has not ended ends here.
        """
        self.finish()
        self._episode += 1
        chosen = self._episodes.options.target
        if chosen is None:
            target = self._episodes.task.target
        else:
            target = chosen.type
        self._title = f"episode {self._episode}, target {target}"
        if seed is not None:
            self._title += f", seed {seed}"
        self._written = perf_counter()
        self._buffer.take()

    def step(self) -> None:
        """Take the state after a step."""
        self._buffer.take()
        if self._flush_period is None:
            return
        due = self._written + self._flush_period
        if perf_counter() >= due:
            self._write()

    def finish(self) -> None:
        """Write what there is of the episode and end it."""
        self.flush()
        self._buffer.clear()
        self._continues = False

    def flush(self) -> None:
        """Write what there is of the episode so far, unless not a step of it has been done."""
        after_reset = 0 if self._continues else 1  # samples without a step
        if len(self._buffer) > after_reset:
            self._write()

    def _write(self) -> None:
        self.rollout = self._buffer.rollout(self._title)
        self._file.write(
            self.rollout,
            self._arm,
            continues=self._continues,
        )
        self._buffer.clear()
        self._continues = True
        self._written = perf_counter()


class RecordRollout(gym.Wrapper[Any, Any, Any, Any]):
    """Records all episodes of an environment as an arm of a Rerun file.

    Episodes are written when they end, and while they go on, which is what a killed process leaves.

    Args:
        env: with one arm.
        file: a path, or an open `RerunFile`, in which several environments can have arms and which
            who opened it closes.
        flush_period: wall-clock time [s] after which an episode that goes on is written; None: not.
        name: of the arm in the file.
        place: (3,) [m] where this arm is drawn, "beside" the others by default, None for an arm
            that the file has already.

    Raises:
        gymnasium.error.DependencyNotInstalled: without Rerun.
        TypeError: for environments of other packages.
        ValueError: for a second arm of one name.
        OSError: where the file cannot be written.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        file: "str | Path | RerunFile",
        flush_period: float | None = FLUSH_PERIOD,
        name: str = "arm",
        place: Sequence[float] | Literal["beside"] | None = "beside",
    ) -> None:
        super().__init__(env)
        episodes = episodes_of(env)
        self._closes = isinstance(file, str | Path)
        self._file = _open(file)
        if place is not None:
            if place == "beside":
                position = None
            else:
                position = place
            self._file.add_arm(name, episodes.model, position)
        self._recorder = RowRecorder(self._file, name, episodes, 0, flush_period)

    @property
    def rollout(self) -> Rollout | None:
        """Newest stretch of an episode that was written; None: nothing was.

        With `flush_period=None` it is the whole episode that ended last.
        """
        return self._recorder.rollout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets the environment, and writes an episode that has not ended.

        Args:
            seed: as of the environment.
            options: as of the environment.

        Returns:
            The environment's observation and info.
        """
        result = self.env.reset(seed=seed, options=options)
        self._recorder.begin(seed)
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Steps the environment, and writes an episode that ends.

        Args:
            action: as of the environment.

        Returns:
            The environment's observation, reward, whether the episode is terminated, whether it is
            truncated, info.
        """
        result = self.env.step(action)
        _, _, terminated, truncated, _ = result
        self._recorder.step()
        if terminated or truncated:
            self._recorder.finish()
        return result

    def close(self) -> None:
        """Writes what is left, and closes the environment, and the file if it was opened here."""
        self._recorder.finish()
        if self._closes:
            self._file.close()
        super().close()


class VectorRecordRollout(gym.vector.VectorWrapper):
    """Records rows of a vector environment to a Rerun file.

    Each row is an arm `row_0`, `row_1`, ... with its own episodes. The step in which an environment
    resets a row belongs to no episode: of `AutoresetMode.SAME_STEP` episodes are recorded without
    their last step.

    Args:
        env: vector environment of this package.
        path: of the file.
        rows: those that are recorded.

    Raises:
        gymnasium.error.DependencyNotInstalled: without Rerun.
        TypeError: for environments of other packages.
        ValueError: for rows that do not exist, or one that is named twice.
        OSError: where the file cannot be written.
    """

    def __init__(
        self,
        env: gym.vector.VectorEnv[Any, Any, Any],
        path: str | Path,
        rows: Sequence[int] = (0,),
    ) -> None:
        super().__init__(env)
        unknown = [row for row in rows if not 0 <= row < env.num_envs]
        if unknown:
            last = env.num_envs - 1
            raise ValueError(f"rows should be from 0 to {last}, not {unknown}")
        self._episodes = episodes_of(env)
        self._file = _open(path)
        self._recorders = dict[int, RowRecorder]()
        for row in rows:
            arm = f"row_{row}"
            self._file.add_arm(arm, self._episodes.model)
            self._recorders[row] = RowRecorder(self._file, arm, self._episodes, row, FLUSH_PERIOD)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Resets rows of the environment, and writes episodes that have not ended.

        Args:
            seed: as of the environment.
            options: as of the environment.

        Returns:
            The environment's observations and info.
        """
        result = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        seeds = seed
        if seed is None or isinstance(seed, int):  # as Gymnasium counts on
            rows = range(self.num_envs)
            seeds = [None if seed is None else seed + row for row in rows]
        for row, recorder in self._recorders.items():
            if mask is None or mask[row]:
                recorder.begin(seeds[row])
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Steps the environment, and writes episodes that end.

        Args:
            actions: as of the environment.

        Returns:
            The environment's observations, rewards, which rows are terminated, which are truncated,
            info.
        """
        result = self.env.step(actions)
        _, _, terminated, truncated, _ = result
        for row, recorder in self._recorders.items():
            # the row has been reset, either instead of a step or after one
            if self._episodes.step_count[row] == 0:
                recorder.begin()
                continue
            recorder.step()
            if terminated[row] or truncated[row]:
                recorder.finish()
        return result

    def close(self, **kwargs: Any) -> None:
        """Writes what is left, and closes the file and the environment.

        Args:
            kwargs: of the environment's `close`.
        """
        for recorder in self._recorders.values():
            recorder.finish()
        self._file.close()
        super().close(**kwargs)


def _open(file: "str | Path | RerunFile") -> "RerunFile":
    from soft_tendon_env.recording.rerun_file import RerunFile  # imports Rerun

    if isinstance(file, str | Path):
        return RerunFile(file)
    return file
