"""Wrappers that record the episodes of an environment to a Rerun file, as `gymnasium.wrappers.RecordVideo` does to videos."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.recording.rollout import RolloutBuffer, no_action, take_sample
from soft_tendon_env.tools.types import Array

if TYPE_CHECKING:
    from soft_tendon_env.recording.rerun_file import RerunFile
    from soft_tendon_env.recording.rerun_stream import RerunStream

Trigger = Callable[[int], bool]
FLUSH_PERIOD = 2.0  # [s]


class RowRecorder:
    """Records the episodes of one row that `trigger` selects by their numbers 0, 1, ...; None selects all. The row is an arm of the file.

    An episode is written at its end and, with `flush_period`, whenever as many seconds have passed since the last part of it was.
    """

    def __init__(
        self,
        file: "RerunStream",
        arm: str,
        episodes: Episodes,
        row: int,
        no_action: Array,
        trigger: Trigger | None,
        flush_period: float | None,
    ) -> None:
        self._file, self._arm, self._episodes, self._row = file, arm, episodes, row
        self._trigger, self._flush_period = trigger, flush_period
        self._buffer, self._no_action = RolloutBuffer(episodes.model, episodes.period), no_action
        self._episode, self._title, self._written = -1, "", 0.0
        self._effects: Effects | None = None
        self._recording = self._continues = False

    def begin(self, info: Mapping[str, object], seed: int | None = None) -> None:
        """Take the state after a reset as the first sample of the next episode; one that has not ended ends here."""
        self.finish()
        self._episode += 1
        self._recording = self._trigger is None or self._trigger(self._episode)
        if self._recording:
            self._effects = self._episodes.arms.effects_of(self._row)
            options, task = self._episodes.options, self._episodes.task
            target = task.target if options.target is None else options.target.type
            self._title = ", ".join([f"episode {self._episode}", f"target {target}", *([] if seed is None else [f"seed {seed}"])])
            self._written = perf_counter()
            take_sample(self._buffer, self._episodes, self._row, self._no_action, dict(info))

    def step(self, action: ArrayLike, reward: float, info: Mapping[str, object]) -> None:
        """Take the state after a step."""
        if self._recording:
            take_sample(self._buffer, self._episodes, self._row, action, {**info, "reward": reward})
            if self._flush_period is not None and perf_counter() >= self._written + self._flush_period:
                self._write()

    def finish(self) -> None:
        """Write what there is of the episode and end it."""
        self.flush()
        self._buffer.clear()
        self._recording = self._continues = False

    def flush(self) -> None:
        """Write what there is of the episode so far, unless not a step of it has been done."""
        if len(self._buffer) > (0 if self._continues else 1):
            self._write()

    def _write(self) -> None:
        self._file.write(self._buffer.rollout(self._title, self._effects), self._arm, continues=self._continues)
        self._buffer.clear()
        self._continues, self._written = True, perf_counter()


class RecordRollout(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Records the episodes for which `episode_trigger(number)` is true, None meaning all, as the arm `name` of a Rerun file.

    `file`: a path, or an open `RerunFile`, in which several environments can have arms; `place` (3,) [m]: where this one is drawn, "beside"
    the others by default, None for an arm that the file has already. What is at hand is written at the end of every episode and, within
    one, every `flush_period` seconds of wall-clock time (None: not): that is what a killed process leaves.
    `close` completes a file given by its path; another is closed by who opened it.
    Raises gymnasium.error.DependencyNotInstalled without Rerun, ValueError for a second arm of one name.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        file: "str | Path | RerunFile",
        episode_trigger: Trigger | None = None,
        flush_period: float | None = FLUSH_PERIOD,
        name: str = "arm",
        place: Sequence[float] | Literal["beside"] | None = "beside",
    ) -> None:
        self._own = isinstance(file, str | Path)
        path = file if isinstance(file, str | Path) else file.path  # an open file has no copy
        gym.utils.RecordConstructorArgs.__init__(
            self, file=path, episode_trigger=episode_trigger, flush_period=flush_period, name=name, place=place
        )
        gym.Wrapper.__init__(self, env)
        episodes = episodes_of(env)
        self._file = _open(file) if isinstance(file, str | Path) else file
        if place is not None:
            self._file.add_arm(name, episodes.model, None if place == "beside" else place)
        self._recorder = RowRecorder(self._file, name, episodes, 0, no_action(env.action_space), episode_trigger, flush_period)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._recorder.begin(info, seed)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        result = self.env.step(action)
        _, reward, terminated, truncated, info = result
        self._recorder.step(action, float(reward), info)
        if terminated or truncated:
            self._recorder.finish()
        return result

    def close(self) -> None:
        self._recorder.finish()
        if self._own:
            self._file.close()
        super().close()


class VectorRecordRollout(gym.vector.VectorWrapper, gym.utils.RecordConstructorArgs):
    """Records these `rows` of a vector environment to the Rerun file `path`, each as an arm `row_0`, `row_1`, ... with its own episodes.

    `episode_trigger(number)` is asked for each episode of each row, otherwise as `RecordRollout`. The step in which an environment resets a
    row belongs to no episode: of `AutoresetMode.SAME_STEP` episodes are recorded without their last step.
    """

    def __init__(
        self,
        env: gym.vector.VectorEnv[Any, Any, Any],
        path: str | Path,
        rows: Sequence[int] = (0,),
        episode_trigger: Trigger | None = None,
        flush_period: float | None = FLUSH_PERIOD,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, path=path, rows=rows, episode_trigger=episode_trigger, flush_period=flush_period)
        super().__init__(env)
        if unknown := [row for row in rows if not 0 <= row < env.num_envs]:
            raise ValueError(f"rows should be from 0 to {env.num_envs - 1}, not {unknown}")
        self._episodes = episodes_of(env)
        self._file = _open(path)
        action, self._recorders = no_action(env.single_action_space), {}
        for row in rows:
            self._file.add_arm(f"row_{row}", self._episodes.model)
            self._recorders[row] = RowRecorder(self._file, f"row_{row}", self._episodes, row, action, episode_trigger, flush_period)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observations, infos = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        for row, recorder in self._recorders.items():
            if mask is None or mask[row]:
                recorder.begin(row_info(infos, row), _row_seed(seed, row))
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        result = self.env.step(actions)
        _, rewards, terminations, truncations, infos = result
        for row, recorder in self._recorders.items():
            ended = terminations[row] or truncations[row]
            if self._episodes.step_count[row] > 0:
                recorder.step(actions[row], float(rewards[row]), row_info(infos, row))
                if ended:
                    recorder.finish()
            else:  # the row has been reset, either instead of a step or after one
                recorder.begin(row_info(infos, row))
        return result

    def close(self, **kwargs: Any) -> None:
        for recorder in self._recorders.values():
            recorder.finish()
        self._file.close()
        super().close(**kwargs)


def row_info(infos: Mapping[str, Any], row: int) -> dict[str, object]:
    """One row of a vector environment's infos: the entries of its arrays that no mask excludes."""
    info = {}
    for name, values in infos.items():
        if name[:1] != "_" and isinstance(values, np.ndarray):
            mask = infos.get("_" + name)
            if mask is None or mask[row]:
                info[name] = values[row]
    return info


def _row_seed(seed: int | Sequence[int | None] | None, row: int) -> int | None:
    """The seed of a row by Gymnasium's rule for vector environments."""
    return seed + row if isinstance(seed, int) else seed if seed is None else seed[row]


def _open(path: str | Path) -> "RerunFile":
    from soft_tendon_env.recording.rerun_file import RerunFile  # imports Rerun

    return RerunFile(path)
