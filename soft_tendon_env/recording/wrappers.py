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
        self._file, self._arm, self._episodes, self._flush_period = (
            file,
            arm,
            episodes,
            flush_period,
        )
        self._buffer, self._episode, self._title, self._written, self._continues = (
            RolloutBuffer(episodes, row),
            -1,
            "",
            0.0,
            False,
        )

        self.rollout: Rollout | None = None  # the newest that was written

    def begin(self, seed: int | None = None) -> None:
        """Take the state after a reset as the first sample of the next episode; one that has not
        ended ends here."""
        self.finish()
        self._episode += 1
        options, task = self._episodes.options, self._episodes.task
        target = task.target if options.target is None else options.target.type
        self._title = ", ".join(
            [
                f"episode {self._episode}",
                f"target {target}",
                *([] if seed is None else [f"seed {seed}"]),
            ]
        )
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
        if len(self._buffer) > (0 if self._continues else 1):
            self._write()

    def _write(self) -> None:
        self.rollout = self._buffer.rollout(self._title)
        self._file.write(self.rollout, self._arm, continues=self._continues)
        self._buffer.clear()
        self._continues, self._written = True, perf_counter()


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
        episodes, self._closes, self._file = (
            episodes_of(env),
            isinstance(file, str | Path),
            _open(file),
        )
        if place is not None:
            self._file.add_arm(name, episodes.model, None if place == "beside" else place)
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
        self._recorder.step()
        if result[2] or result[3]:
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
        self, env: gym.vector.VectorEnv[Any, Any, Any], path: str | Path, rows: Sequence[int] = (0,)
    ) -> None:
        super().__init__(env)
        if unknown := [row for row in rows if not 0 <= row < env.num_envs]:
            raise ValueError(f"rows should be from 0 to {env.num_envs - 1}, not {unknown}")
        self._episodes, self._file, self._recorders = (
            episodes_of(env),
            _open(path),
            dict[int, RowRecorder](),
        )
        for row in rows:
            self._file.add_arm(f"row_{row}", self._episodes.model)
            self._recorders[row] = RowRecorder(
                self._file, f"row_{row}", self._episodes, row, FLUSH_PERIOD
            )

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        result, mask = self.env.reset(seed=seed, options=options), (options or {}).get("reset_mask")
        for row, recorder in self._recorders.items():
            if mask is None or mask[row]:
                recorder.begin(
                    seed + row if isinstance(seed, int) else seed if seed is None else seed[row]
                )
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        result = self.env.step(actions)
        for row, recorder in self._recorders.items():
            if (
                self._episodes.step_count[row] == 0
            ):  # the row has been reset, either instead of a step or after one
                recorder.begin()
                continue
            recorder.step()
            if result[2][row] or result[3][row]:
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
