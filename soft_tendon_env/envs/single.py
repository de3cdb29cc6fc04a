"""Gymnasium environments with one arm, a class per task; the tasks' descriptions are their documentation."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.spaces import Box, Dict
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.frames import RENDER_MODES, Frames, make_renderer
from soft_tendon_env.envs.options import Options, reset_options
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.envs.tasks import Task, task_of_class
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.checks import checked_array, checked_count

Class = TypeVar("Class", bound="EpisodesEnv")
ONE = np.zeros(1, dtype=np.int64)


class EpisodesEnv:
    """Base of environments with one row of `Episodes` and with many: `self.episodes`, its spaces and its renderer."""

    task: ClassVar[Task]
    closed = False

    def _make(self, options: dict[str, Any], rows: int, threads: int | None, render_mode: str | None) -> None:
        self.render_mode = render_mode
        self.episodes = Episodes(self.task, Options.parse(options, type(self).__name__), rows, threads)
        self.metadata = {"render_modes": [*RENDER_MODES], "render_fps": max(1, round(1.0 / self.episodes.period))}
        self._begun = False
        self._renderer = make_renderer(self.episodes, render_mode)

    @property
    def model(self) -> Model:
        """The model that the environment simulates, before randomisation."""
        return self.episodes.model

    def _spaces(self) -> tuple[Box | Dict, Box]:
        """Observation and action space of one row."""
        actions, seen = Box(-1.0, 1.0, (self.model.tendon_count,), np.float32), self.episodes.layout.space
        if not self.task.goal:
            return seen, actions
        reach = np.float32(self.episodes.goal_bound)
        goal = Box(-reach, reach, (3,), np.float32)
        return Dict({"observation": seen, "achieved_goal": goal, "desired_goal": goal}), actions

    def _refuse(self, called: str, begun: bool) -> None:
        """Raises ClosedEnvironmentError after close, and ResetNeeded unless begun."""
        if self.closed:
            raise ClosedEnvironmentError(f"{called} was called after close: make a new environment")
        if not begun:
            raise ResetNeeded(f"{called} was used before reset")

    def _frames(self) -> Frames | None:
        if self._renderer is None:
            gym.logger.warn("render was called, but the environment was made without a render_mode")
        frames: Frames | None = None if self._renderer is None else self._renderer.frames()
        return frames


class TendonRodEnv(EpisodesEnv, gym.Env[Any, Any]):
    """A Gymnasium environment with one arm: one row of `Episodes`, `self.episodes`. Copies and pickles go on from where it is."""

    metadata: dict[str, Any] = {"render_modes": [*RENDER_MODES]}

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """`render_mode`: None, "rgb_array", or "human", which opens the Rerun viewer; options: see `Options`.

        Raises ConfigurationError, ValueError for other modes, gymnasium.error.Error where what a mode needs is not there.
        """
        self._make(options, 1, None, render_mode)
        self.observation_space, self.action_space = self._spaces()
        self._most_steps = np.inf

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode; options: see `ResetOptions`. Raises ValueError or TypeError for bad seeds and options, before anything changes."""
        self._refuse("reset", begun=True)
        seed, given = None if seed is None else checked_count("seed", seed, 0), reset_options(options)
        beginnings = self.episodes.beginnings(given, ONE)
        super().reset(seed=seed)
        self._begun = False
        self.episodes.begin(ONE, [self.np_random], beginnings)
        self._begun, self._most_steps = True, given[0].episode_steps or np.inf if given else np.inf
        if self._renderer is not None:
            self._renderer.begin(ONE)
        return of_row(self.episodes.observation(), 0), self._info()

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control period. Raises ValueError or TypeError for an action of wrong shape or type or with NaN, before anything changes."""
        if self.closed or not self._begun:
            self._refuse("step", self._begun)
        self.episodes.step(checked_array("action", action, (self.episodes.model.tendon_count,))[None])
        if self._renderer is not None:
            self._renderer.step(ONE)
        info = self._info()
        terminated, truncated = info["diverged"], bool(self.episodes.step_count[0] >= self._most_steps)
        if terminated:
            info["cause"] = self.episodes.cause(0)
        return of_row(self.episodes.observation(), 0), float(self.episodes.reward[0]), terminated, truncated, info

    @property
    def state(self) -> State:
        """A copy of the arm's state, as `Simulation` has it. Setting it puts the arm there, in mid-episode too: the target, commands on
        their way, noise and past observations of the episode stay. Raises TypeError, ValueError where it is not one of this arm."""
        return self.episodes.state(0)

    @state.setter
    def state(self, state: State) -> None:
        self._refuse("state", self._begun)
        self.episodes.set_state(0, state)

    def target_at(self, times: ArrayLike) -> TargetSamples:
        """The episode's target at times (m,) [s] from its beginning, past or future."""
        self._refuse("target_at", self._begun)
        return self.episodes.target_at(0, checked_array("times", times, (None,)))

    def _info(self) -> dict[str, Any]:
        return {name: value.item(0) for name, value in self.episodes.info().items()}

    def render(self) -> NDArray[np.uint8] | None:
        """The arm, its tendons, the target and the tip's trail, (height, width, 3).

        None without a render mode, and with "human": there every reset and step shows itself in the viewer, no faster than in real time.
        """
        self._refuse("render", self._begun)
        frames = self._frames()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """The end: the rest of what is shown is sent (the viewer stays open); reset, step and render are refused from now on."""
        if self._renderer is not None:
            self._renderer.close()
        self.closed = True


def of_row(observation: Any, row: int) -> Any:
    """A row of observations."""
    return {key: value[row] for key, value in observation.items()} if isinstance(observation, dict) else observation[row]


def compute_reward(self: EpisodesEnv, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any) -> Any:
    """Rewards (...) of goals (..., 3) [m], as hindsight experience replay asks for; a float for one. Raises ValueError for other shapes."""
    reward = self.episodes.goal_reward(achieved_goal, desired_goal)
    return float(reward) if reward.ndim == 0 else reward


_CLASSES: dict[str, Any] = {}


def class_of(task: Task, suffix: str, base: type[Class], doc: str) -> type[Class]:
    """The class `<task><suffix>`, the same at every call; one of a goal-conditioned task has `compute_reward`."""
    name = f"{task.name}{suffix}"
    if name not in _CLASSES or _CLASSES[name].task is not task:
        of_goals = {"compute_reward": compute_reward} if task.goal else {}
        _CLASSES[name] = type(name, (base,), {"task": task, "__doc__": doc, "__module__": base.__module__, **of_goals})
    return _CLASSES[name]


def environment_class(task: Task) -> type[TendonRodEnv]:
    """The class of a task's environments with one arm, `<name>Env`; the same at every call."""
    return class_of(task, "Env", TendonRodEnv, task.description)


def __getattr__(name: str) -> type[TendonRodEnv]:
    """`<name>Env` of every registered task: for Gymnasium's entry points, and for pickles."""
    return environment_class(task_of_class(name, "Env", __name__))
