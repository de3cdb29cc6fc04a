"""Gymnasium environments with one arm, a class per task; the tasks' descriptions are their documentation."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.frames import RENDER_MODES, make_renderer
from soft_tendon_env.envs.options import parsed_options
from soft_tendon_env.envs.reset_options import reset_options
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.envs.tasks import Task, task_of_class
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import SimulationDiverged
from soft_tendon_env.model.state import State
from soft_tendon_env.registration import MAX_EPISODE_STEPS
from soft_tendon_env.tools.checks import checked_array, checked_count
from soft_tendon_env.tools.configuration import plain
from soft_tendon_env.tools.types import Array

ONE = np.zeros(1, dtype=np.int64)
SHORT, USUAL = 5.0, 10.0
"""Seconds of an episode below which its length gets a word, and that it has at the default control period."""


def checked_seed(seed: Any, name: str = "seed") -> int | None:
    """A seed of `reset`: None or a whole number of at least 0, NumPy's among them. Raises TypeError or ValueError."""
    return None if seed is None else checked_count(name, seed, 0)


def checked_seeds(seed: Any, rows: int) -> list[int | None] | None:
    """A seed for each row: s + i from a number s, or those of a list. Raises TypeError or ValueError."""
    if seed is None:
        return None
    if isinstance(seed, list | tuple) or isinstance(seed, np.ndarray) and seed.ndim > 0:
        if len(seed) != rows:
            raise ValueError(f"seed should be an int or a list of {rows}, not of {len(seed)}")
        return [checked_seed(own, f"seed[{i}]") for i, own in enumerate(seed)]
    first = checked_count("seed", seed, 0)
    return [first + i for i in range(rows)]


def refuse_closed(closed: bool, called: str) -> None:
    """Raises ClosedEnvironmentError."""
    if closed:
        raise ClosedEnvironmentError(f"{called} was called after close: make a new environment")


def warn_of_short_episodes(period: float, steps: int | None) -> None:
    """Warns where the usual number of steps, which does not follow the control period [s], makes short episodes."""
    if steps == MAX_EPISODE_STEPS and steps * period < SHORT:
        text = f"control_period is {period:g} s: an episode has {steps} steps, {steps * period:g} s, unless max_episode_steps is given"
        warnings.warn(f"{text}: {round(USUAL / period)} of them last {USUAL:g} s", stacklevel=3)


class PlainSpec:
    """An environment whose `spec` goes to JSON, whatever its options were given as: NumPy's numbers and arrays, paths, a Scene."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium made the environment."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            named = {key: value.name.lower() if isinstance(value, AutoresetMode) else value for key, value in spec.kwargs.items()}
            spec = dataclasses.replace(spec, kwargs=plain(named))
        self._spec = spec


class TendonRodEnv(PlainSpec, gym.Env[Any, Any]):
    """A Gymnasium environment with one arm: one row of `Episodes`, `self.episodes`. Copies and pickles go on from where it is."""

    metadata: dict[str, Any] = {"render_modes": [*RENDER_MODES]}
    task: ClassVar[Task]

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """`render_mode`: None, "rgb_array", or "human", which opens the Rerun viewer; options: see `Options`.

        Raises ConfigurationError, ValueError for other modes, gymnasium.error.DependencyNotInstalled or gymnasium.error.Error where what a
        mode needs is not there.
        """
        self.render_mode = render_mode
        chosen = parsed_options(options, type(self).__name__)
        self.episodes = Episodes(self.task, chosen, rows=1)
        warn_of_short_episodes(chosen.control_period, MAX_EPISODE_STEPS)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / chosen.control_period))}
        self.observation_space = observation_space(self.episodes)
        self.action_space = action_space(self.episodes)
        self._on_divergence, self._begun, self._closed = chosen.on_divergence, False, False
        self._most_steps: int | None = None
        self._renderer = make_renderer(self.episodes, render_mode)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode; options: see `ResetOptions`. Raises ValueError or TypeError for bad seeds and options, before anything changes."""
        refuse_closed(self._closed, "reset")
        seed, given = checked_seed(seed), reset_options(options)
        beginnings = self.episodes.beginnings(given, ONE)
        super().reset(seed=seed)
        self._begun = False
        self.episodes.begin(ONE, [self.np_random], beginnings)
        self._begun, self._most_steps = True, given[0].episode_steps if given else None
        if self._renderer is not None:
            self._renderer.begin(ONE)
        return self._observation(), self._info()

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control period. Raises ValueError or TypeError for an action of wrong shape or type or with NaN, before anything changes."""
        refuse_closed(self._closed, "step")
        if not self._begun:
            raise ResetNeeded("step was called before reset")
        self.episodes.step(checked_array("action", action, (self.episodes.model.tendon_count,))[None])
        if self._renderer is not None:
            self._renderer.step(ONE)
        info = self._info()
        terminated, truncated = False, self._most_steps is not None and bool(self.episodes.step_count[0] >= self._most_steps)
        if info["diverged"]:
            info["cause"] = self.episodes.cause(0)
            if self._on_divergence == "raise":
                raise SimulationDiverged(self.episodes.state(0), info["cause"], self.episodes.tension[0])
            terminated, truncated = self._on_divergence == "terminate", truncated or self._on_divergence == "truncate"
        return self._observation(), float(self.episodes.reward[0]), terminated, truncated, info

    @property
    def model(self) -> Model:
        """The model that the environment simulates, before randomisation."""
        return self.episodes.model

    @property
    def state(self) -> State:
        """A copy of the arm's state, as `Simulation` has it. Set, it is taken whole, see `Episodes.put`; TypeError or ValueError leave the
        environment as it was."""
        return self.episodes.state(0)

    @state.setter
    def state(self, state: State) -> None:
        if not self._begun:
            raise ResetNeeded("the state was set before reset")
        self.episodes.put({0: state})

    def target_at(self, times: ArrayLike) -> TargetSamples:
        """The episode's target at times (m,) [s] from its beginning, past or future."""
        if not self._begun:
            raise ResetNeeded("the target is drawn by reset")
        return self.episodes.target_at(0, checked_array("times", times, (None,)))

    def _observation(self) -> Any:
        observation = self.episodes.observation()
        return {key: value[0] for key, value in observation.items()} if isinstance(observation, dict) else observation[0]

    def _info(self) -> dict[str, Any]:
        return {name: value.item(0) for name, value in self.episodes.info().items()}

    def render(self) -> NDArray[np.uint8] | None:
        """The arm, its tendons, the target and the tip's trail, (height, width, 3).

        None without a render mode, and with "human": there every reset and step shows itself in the viewer, no faster than in real time.
        """
        refuse_closed(self._closed, "render")
        if self._renderer is None:
            gym.logger.warn("render was called, but the environment was made without a render_mode")
            return None
        if not self._begun:
            raise ResetNeeded("render was called before reset")
        frames = self._renderer.frames()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """The end: the rest of what is shown is sent (the viewer stays open); reset, step and render are refused from now on."""
        if self._renderer is not None:
            self._renderer.close()
        self._closed = True


def action_space(episodes: Episodes) -> Box:
    """Action space of one row."""
    return Box(-1.0, 1.0, (episodes.model.tendon_count,), np.float32)


def observation_space(episodes: Episodes) -> Box | Dict:
    """Observation space of one row."""
    flat = episodes.layout.space
    if not episodes.task.goal:
        return flat
    reach = np.float32(episodes.goal_bound)
    goal = Box(-reach, reach, (3,), np.float32)
    return Dict({"observation": flat, "achieved_goal": goal, "desired_goal": goal})


class GoalEnv(TendonRodEnv):
    """A goal-conditioned environment: rewards of other goals can be asked for, as hindsight experience replay does."""

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any) -> Any:
        """Rewards (...) of goals (..., 3) [m]; a float for one. Raises ValueError for goals of other shapes."""
        reward = goal_reward(self.episodes, achieved_goal, desired_goal)
        return float(reward) if reward.ndim == 0 else reward


def goal_reward(episodes: Episodes, achieved: ArrayLike, desired: ArrayLike) -> Array:
    """Rewards (...) of goals (..., 3) [m] as the options of these episodes have it."""
    assert episodes.task.goal is not None
    return episodes.task.goal.reward(achieved, desired, episodes.goal_kind, episodes.threshold)


def class_of(task: Task, suffix: str, bases: tuple[type, type], doc: str) -> Any:
    """The class `<task><suffix>`, the same at every call: of the first base, or of the second for goal-conditioned tasks."""
    name, base = f"{task.name}{suffix}", bases[task.goal is not None]
    made = _CLASSES.get(name)
    if made is None or made.task is not task:
        made = _CLASSES[name] = type(name, (base,), {"task": task, "__doc__": doc, "__module__": bases[0].__module__})
    return made


_CLASSES: dict[str, Any] = {}


def environment_class(task: Task) -> type[TendonRodEnv]:
    """The class of a task's environments with one arm, `<name>Env`; the same at every call."""
    made: type[TendonRodEnv] = class_of(task, "Env", (TendonRodEnv, GoalEnv), task.description)
    return made


def __getattr__(name: str) -> type[TendonRodEnv]:
    """`<name>Env` of every registered task: for Gymnasium's entry points, and for pickles."""
    return environment_class(task_of_class(name, "Env", __name__))
