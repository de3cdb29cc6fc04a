"""Wrappers that record the episodes of an environment to a Rerun file, as
`gymnasium.wrappers.RecordVideo` does to videos."""

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
    """Records the episodes of one row as an arm of a file, at their ends and, with `flush_period`,
    whenever as many seconds have passed."""

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
        """Take the state after a reset as the first sample of the next episode; one that has not
        ended ends here."""
        self.finish()
        self._episode += 1
        chosen = self._episodes.options.target
        target = self._episodes.task.target if chosen is None else chosen.type
        self._title = f"episode {self._episode}, target {target}"
        if seed is not None:
            self._title += f", seed {seed}"
        self._written = perf_counter()
        self._buffer.take()

    def step(self) -> None:
        """Take the state after a step."""
        self._buffer.take()
        if self._flush_period is not None and perf_counter() >= self._written + self._flush_period:
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
    """Records all episodes as the arm `name` of a Rerun file.

    `file`: a path, or an open `RerunFile`, in which several environments can have arms and which
    who opened it closes; `place` (3,) [m]: where this one is drawn, "beside" the others by default,
    None for an arm that the file has already. What is at hand is written at the end of every
    episode and, within one, every `flush_period` seconds of wall-clock time (None: not): what a
    killed process leaves. Raises gymnasium.error.DependencyNotInstalled without Rerun, ValueError
    for a second arm of one name.
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
            position = None if place == "beside" else place
            self._file.add_arm(name, episodes.model, position)
        self._recorder = RowRecorder(self._file, name, episodes, 0, flush_period)

    @property
    def rollout(self) -> Rollout | None:
        """Newest stretch of an episode that was written: with `flush_period=None` the whole episode
        that ended last. None: nothing was."""
        return self._recorder.rollout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        result = self.env.reset(seed=seed, options=options)
        self._recorder.begin(seed)
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        result = self.env.step(action)
        _, _, terminated, truncated, _ = result
        self._recorder.step()
        if terminated or truncated:
            self._recorder.finish()
        return result

    def close(self) -> None:
        self._recorder.finish()
        if self._closes:
            self._file.close()
        super().close()


class VectorRecordRollout(gym.vector.VectorWrapper):
    """Records these `rows` of a vector environment to the Rerun file `path`, each as an arm
    `row_0`, `row_1`, ... with its own episodes.

    The step in which an environment resets a row belongs to no episode: of
    `AutoresetMode.SAME_STEP` episodes are recorded without their last step. Raises as
    RecordRollout.
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
            raise ValueError(f"rows should be from 0 to {env.num_envs - 1}, not {unknown}")
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
        result = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        seeds = seed
        if seed is None or isinstance(seed, int):  # as Gymnasium counts on
            seeds = [None if seed is None else seed + row for row in range(self.num_envs)]
        for row, recorder in self._recorders.items():
            if mask is None or mask[row]:
                recorder.begin(seeds[row])
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
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
        for recorder in self._recorders.values():
            recorder.finish()
        self._file.close()
        super().close(**kwargs)


def _open(file: "str | Path | RerunFile") -> "RerunFile":
    from soft_tendon_env.recording.rerun_file import RerunFile  # imports Rerun

    return RerunFile(file) if isinstance(file, str | Path) else file
