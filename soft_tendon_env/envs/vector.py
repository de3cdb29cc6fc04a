"""Gymnasium vector environments, a class per task: many arms, stepped together by compiled code on several threads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.envs.episodes import Beginning
from soft_tendon_env.envs.options import MASK, reset_options
from soft_tendon_env.envs.single import EpisodesEnv, class_of, of_row
from soft_tendon_env.envs.tasks import Task, task_of_class
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.checks import checked_array, checked_count
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among
from soft_tendon_env.tools.types import Array

MODES = {mode.name.lower(): mode for mode in AutoresetMode}


class TendonRodVectorEnv(EpisodesEnv, gym.vector.VectorEnv[Any, Any, Any]):
    """Rows of one environment; row i with seed s is the single environment with seed s + i, bit for bit.

    Args:
        num_envs: rows.
        max_episode_steps: steps after which a row is truncated; None: never.
        autoreset_mode: "next_step" (an ended row is reset by the next step, whose action it ignores), "same_step" (at once; what it ended
            with is in `info["final_obs"]` and `info["final_info"]`) or "disabled" (by `reset(options={"reset_mask": ...})`).
        threads: at most this many; None: as many as there are processors, with at least eight rows each.
        render_mode: None, "rgb_array", a frame per row, or "human", the first six rows in the Rerun viewer, in real time.
        options: see `Options`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = 500,
        autoreset_mode: str | AutoresetMode = "next_step",
        threads: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Raises ConfigurationError, ValueError or TypeError."""
        self.num_envs = num_envs = checked_count("num_envs", num_envs, 1)
        self.max_episode_steps = None if max_episode_steps is None else checked_count("max_episode_steps", max_episode_steps, 1)
        if autoreset_mode not in (*MODES, *MODES.values()):
            problem = Problem(("autoreset_mode",), f"is {autoreset_mode!r}: {not_among(str(autoreset_mode), MODES)}")
            raise ConfigurationError([problem], "environment")
        self.autoreset_mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else MODES[autoreset_mode]
        self._make(options, num_envs, None if threads is None else checked_count("threads", threads, 1), render_mode)
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.single_observation_space, self.single_action_space = self._spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all, self._ended = np.arange(num_envs, dtype=np.int64), np.zeros(num_envs, dtype=bool)
        self._usual_steps = np.inf if self.max_episode_steps is None else self.max_episode_steps
        self._most_steps = np.full(num_envs, self._usual_steps)
        self._generators: dict[int, np.random.Generator] = {}

    def reset(self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """New episodes: of all rows, or of those that `options={"reset_mask": (rows,) bool}` names.

        options: the entries of `ResetOptions`, each a sequence of one value per row, None for what is usual.
        seed: an int s seeds row i with s + i; a list names one for each, None to go on with its generator.
        Raises ValueError or TypeError for bad seeds and options, before anything changes.
        """
        self._refuse("reset", begun=True)
        members, seeds, given = self._all, _checked_seeds(seed, self.num_envs), reset_options(options, self.num_envs)
        if options is not None and MASK in options:
            mask = np.asarray(options[MASK])
            if mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
                raise ValueError(f"reset_mask should be a bool array of shape ({self.num_envs},) with at least one true, not {mask!r}")
            members = np.flatnonzero(mask)
        if not self._begun and members.size < self.num_envs:
            raise ResetNeeded("the first reset should be of all rows")
        beginnings = self.episodes.beginnings(given, members)
        for row in members.tolist():
            if seeds[row] is not None or row not in self._generators:
                self._generators[row] = seeding.np_random(seeds[row])[0]
        self._begun = False
        self._begin(members, beginnings)
        self._begun = True
        for row in members.tolist() if given else ():
            self._most_steps[row] = min(given[row].episode_steps or np.inf, self._usual_steps)
        return self.episodes.observation(), self._info(np.zeros(self.num_envs, dtype=bool))

    def _begin(self, members: Indices, beginnings: Mapping[int, Beginning] | None = None) -> None:
        self.episodes.begin(members, [self._generators[row] for row in members], beginnings)
        self._ended[members], self._most_steps[members] = False, self._usual_steps
        if self._renderer is not None:
            self._renderer.begin(members)

    def step(self, actions: ArrayLike) -> tuple[Any, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One control period of every row. Raises ValueError or TypeError for bad actions, before anything changes."""
        self._refuse("step", self._begun)
        action = checked_array("actions", actions, (self.num_envs, self.episodes.model.tendon_count))
        stepped, members = ~self._ended, self._all
        if self._ended.any():
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise ResetNeeded(f"rows {np.flatnonzero(self._ended).tolist()} have ended: reset them with a reset_mask")
            members = np.flatnonzero(stepped)
            self._begin(np.flatnonzero(self._ended))
        self.episodes.step(action, members)
        if self._renderer is not None:
            self._renderer.step(members)
        reward = np.where(stepped, self.episodes.reward, 0.0)
        terminated, truncated = self.episodes.diverged & stepped, stepped & self.timed_out
        self._ended = terminated | truncated
        observation, info = self.episodes.observation(), self._info(stepped)
        if terminated.any():
            causes = [self.episodes.cause(row) if failed else None for row, failed in enumerate(terminated.tolist())]
            info |= {"cause": np.array(causes, dtype=object), "_cause": terminated.copy()}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._ended.any():
            observation, info = self._restarted(observation, info)
        return observation, reward, terminated, truncated, info

    def _restarted(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Reset the ended rows at once; what they ended with goes to final_obs and final_info."""
        ended, final_obs = self._ended.copy(), np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(ended):
            final_obs[row] = of_row(observation, int(row))
        final_info = {key: value & ended if key.startswith("_") else value for key, value in info.items()}
        self._begin(np.flatnonzero(ended))
        final = {"final_obs": final_obs, "_final_obs": ended, "final_info": final_info, "_final_info": ended}
        return self.episodes.observation(), {**self._info(~ended), **final}

    def _info(self, stepped: NDArray[np.bool_]) -> dict[str, Any]:
        """The episodes' info with its masks; rewards belong to rows that have stepped."""
        info, everywhere = self.episodes.info(), np.ones(self.num_envs, dtype=bool)
        return info | {f"_{name}": stepped if name.startswith("reward_") else everywhere for name in info}

    @property
    def state(self) -> tuple[State, ...]:
        """Copies of the rows' states."""
        return tuple(self.episodes.state(row) for row in range(self.num_envs))

    @property
    def timed_out(self) -> NDArray[np.bool_]:
        """Rows (rows,) whose episodes have lasted for their steps."""
        return np.asarray(self.episodes.step_count >= self._most_steps)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A frame (height, width, 3) per row; None without a render mode, and with "human"."""
        self._refuse("render", begun=True)
        return self._frames()

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads; the viewer stays open."""
        self.episodes.arms.close()
        if self._renderer is not None:
            self._renderer.close()


def _checked_seeds(seed: Any, rows: int) -> list[int | None]:
    """A seed for each row, None to go on. Raises TypeError or ValueError."""
    if seed is None:
        return [None] * rows
    if isinstance(seed, list | tuple | np.ndarray) and np.ndim(seed):
        if len(seed) != rows:
            raise ValueError(f"seed should be an int or a list of {rows}, not of {len(seed)}")
        return [None if own is None else checked_count(f"seed[{i}]", own, 0) for i, own in enumerate(seed)]
    first = checked_count("seed", seed, 0)
    return [first + i for i in range(rows)]


def vector_environment_class(task: Task) -> type[TendonRodVectorEnv]:
    """The class of a task's environments with many arms, `<name>VectorEnv`; the same at every call."""
    return class_of(task, "VectorEnv", TendonRodVectorEnv, f"Rows of `{task.name}Env`.")


def __getattr__(name: str) -> type[TendonRodVectorEnv]:
    """`<name>VectorEnv` of every registered task: for Gymnasium's entry points, and for pickles."""
    return vector_environment_class(task_of_class(name, "VectorEnv", __name__))
