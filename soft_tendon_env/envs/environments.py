"""Gymnasium environments of tasks, with one arm and with many that compiled code steps together.

There are two classes per task, whose description is their documentation. Those of registered tasks
are made when the tasks are registered, as Gymnasium's entry points and pickles find them by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.envs.episodes import Beginning, Episodes
from soft_tendon_env.envs.frames import RENDER_MODES, Frames, make_renderer
from soft_tendon_env.envs.observation import of_row
from soft_tendon_env.envs.options import MASK, Options, reset_options, row_seeds
from soft_tendon_env.envs.randomization import drawn_in_rows
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.envs.tasks import REACH, SHAPE, TASKS, TIP_POSE, Task
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.tools.checks import checked_array, checked_count
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among
from soft_tendon_env.tools.types import Array

ONE = np.zeros(1, dtype=np.int64)
"""The only row of an environment with one arm."""

MODES = {mode.name.lower(): mode for mode in AutoresetMode}
"""Gymnasium's autoreset modes by their names in lower case."""


class EpisodesEnv:
    """Base of environments with one row of `Episodes` and with many.

    Attributes:
        episodes: the rows.
        task: that the class is of.
        closed: whether `close` was called.
    """

    metadata: dict[str, Any] = {"render_modes": [*RENDER_MODES]}
    task: ClassVar[Task]
    closed = False

    def _make(
        self,
        options: dict[str, Any],
        rows: int,
        threads: int | None,
        render_mode: str | None,
    ) -> None:
        """Make the rows and their renderer.

        Raises ConfigurationError, and as make_renderer.
        """
        self.render_mode = render_mode
        parsed = Options.parse(options, type(self).__name__)
        self.episodes = Episodes(self.task, parsed, rows, threads)
        rate = round(1.0 / self.episodes.period)
        frames_per_second = max(1, rate)
        self.metadata = {"render_modes": [*RENDER_MODES], "render_fps": frames_per_second}
        self._begun = False
        self._renderer = make_renderer(self.episodes, render_mode)

    @property
    def model(self) -> Model:
        """The model that the environment simulates, before randomisation."""
        return self.episodes.model

    def _spaces(self) -> tuple[Box | Dict, Box]:
        """Observation and action space of one row."""
        shape = (self.model.tendon_count,)
        action = Box(-1.0, 1.0, shape, np.float32)
        observation = self.episodes.layout.space
        if not self.task.goal:
            return observation, action
        bound = np.float32(self.episodes.goal_bound)
        goal = Box(-bound, bound, (3,), np.float32)
        parts: dict[str, gym.Space[Any]] = {
            "observation": observation,
            "achieved_goal": goal,
            "desired_goal": goal,
        }
        return Dict(parts), action

    def set_target(self, target: Any, rows: ArrayLike | None = None) -> None:
        """Set another target from now on, in the episode that runs and in later ones.

        In the one that runs it begins at once and is observed after the next step.

        Args:
            target: as the argument of that name, None for that itself.
            rows: an index of them, by default all.

        Raises:
            ConfigurationError: where the target does not fit, or the arm cannot hold it.
            IndexError: for rows that there are not.
        """
        self._refuse("set_target", begun=True)
        members = np.arange(self.episodes.size)
        if rows is not None:
            chosen = members[np.asarray(rows)]
            members = np.unique(chosen)
        options = Options.parse({"target": target}, type(self).__name__)
        self.episodes.set_target(options.target, members)

    def _refuse(self, called: str, begun: bool) -> None:
        """Raises ClosedEnvironmentError after close, and ResetNeeded unless begun."""
        if self.closed:
            raise ClosedEnvironmentError(f"{called} was called after close: make a new environment")
        if not begun:
            raise ResetNeeded(f"{called} was used before reset")

    def _frames(self) -> Frames | None:
        """A frame of each row; None without a render mode, of which Gymnasium's logger warns."""
        if self._renderer is None:
            gym.logger.warn("render was called, but the environment was made without a render_mode")
            return None
        frames: Frames = self._renderer.frames()
        return frames


class TendonRodEnv(EpisodesEnv, gym.Env[Any, Any]):
    """Gymnasium environment with one arm: one row of `Episodes`, `self.episodes`.

    Copies and pickles go on from where it is.

    Args:
        render_mode: None, "rgb_array", or "human", which opens the Rerun viewer.
        options: see `Options`.

    Raises:
        ConfigurationError: of all invalid options.
        ValueError: for other modes.
        gymnasium.error.Error: where what a mode needs is not there.
    """

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """Makes an environment."""
        self._make(options, 1, None, render_mode)
        self.observation_space, self.action_space = self._spaces()
        self._most_steps = np.inf

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins a new episode.

        Args:
            seed: of the episodes from this one on; None to go on with the generator.
            options: see `ResetOptions`.

        Returns:
            The observation and the info.

        Raises:
            ValueError: for bad seeds and options, before anything changes.
            TypeError: likewise.
            gymnasium.error.ClosedEnvironmentError: after close.
        """
        self._refuse("reset", begun=True)
        if seed is not None:
            seed = checked_count("seed", seed, 0)
        options_of_row = reset_options(options)
        # nothing has changed so far: what is refused leaves the environment as it was
        beginnings = self.episodes.beginnings(options_of_row, ONE)
        super().reset(seed=seed)
        self._begun = False
        self.episodes.begin(ONE, [self.np_random], beginnings)
        self._begun = True
        self._most_steps = np.inf
        if options_of_row:
            self._most_steps = options_of_row[0].episode_steps or np.inf
        if self._renderer is not None:
            self._renderer.begin(ONE)
        observation = of_row(self.episodes.observation(), 0)
        drawn = self.episodes.drawn(0)
        return observation, self._info() | drawn

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Takes one control period.

        Args:
            action: (n_a,) in [-1, 1]; larger ones are clipped.

        Returns:
            Observation, reward, whether the episode is terminated, whether it is truncated, info.

        Raises:
            ValueError: for an action of wrong shape or with NaN, before anything changes.
            TypeError: for one of wrong type.
            gymnasium.error.ResetNeeded: before the first reset.
            gymnasium.error.ClosedEnvironmentError: after close.
        """
        if self.closed or not self._begun:
            self._refuse("step", self._begun)
        shape = (self.model.tendon_count,)
        checked = checked_array("action", action, shape)
        self.episodes.step(checked[None])
        if self._renderer is not None:
            self._renderer.step(ONE)
        info = self._info()
        terminated = info["diverged"]
        steps = self.episodes.step_count[0]
        truncated = bool(steps >= self._most_steps)
        if terminated:
            info["cause"] = self.episodes.cause(0)
        observation = of_row(self.episodes.observation(), 0)
        reward = float(self.episodes.reward[0])
        return observation, reward, terminated, truncated, info

    @property
    def state(self) -> State:
        """State of the arm as `Simulation` has it, a copy.

        Setting it puts the arm there, in mid-episode too: the target, commands on their way, noise
        and past observations of the episode stay.

        Raises:
            TypeError: where it is set to what is no state.
            ValueError: where it is set to one of another arm.
        """
        return self.episodes.state(0)

    @state.setter
    def state(self, state: State) -> None:
        self._refuse("state", self._begun)
        self.episodes.set_state(0, state)

    def target_at(self, times: ArrayLike) -> TargetSamples:
        """Samples the target of the episode.

        Args:
            times: (m,) [s] from its beginning, past or future.

        Returns:
            Samples of the target.

        Raises:
            TypeError: for what are no numbers.
            ValueError: for other shapes and times that are not finite.
            gymnasium.error.ResetNeeded: before the first reset.
        """
        self._refuse("target_at", self._begun)
        moments = checked_array("times", times, (None,))
        return self.episodes.trajectories.at(0, moments)

    def _info(self) -> dict[str, Any]:
        """The episode's info, with plain values."""
        info = self.episodes.info()
        return {name: value.item(0) for name, value in info.items()}

    def render(self) -> NDArray[np.uint8] | None:
        """Draws the arm, its tendons, the target and the tip's trail.

        Returns:
            Frame (height, width, 3); None without a render mode, and with "human": there every
            reset and step shows itself in the viewer, no faster than in real time.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        self._refuse("render", self._begun)
        frames = self._frames()
        if frames is None:
            return None
        return frames[0]

    def close(self) -> None:
        """Closes the environment, after which other calls raise ClosedEnvironmentError.

        The viewer gets the rest, and stays open.
        """
        if self._renderer is not None:
            self._renderer.close()
        self.closed = True


class TendonRodVectorEnv(EpisodesEnv, gym.vector.VectorEnv[Any, Any, Any]):
    """Rows of one environment that are stepped together.

    Row i with seed s is the single environment with seed s + i, bit for bit.

    Args:
        num_envs: rows.
        max_episode_steps: steps after which a row is truncated; None: never.
        autoreset_mode: "next_step" (an ended row is reset by the next step, whose action it
            ignores), "same_step" (at once; what it ended with is in `info["final_obs"]` and
            `info["final_info"]`) or "disabled" (by `reset(options={"reset_mask": ...})`).
        threads: at most this many; None: as many as there are processors, with at least eight rows
            each.
        render_mode: None, "rgb_array", a frame per row, or "human", the first six rows in the Rerun
            viewer, in real time.
        options: see `Options`.

    Raises:
        ConfigurationError: of all invalid options.
        TypeError: for numbers of wrong types.
        ValueError: for numbers that are not allowed, and other modes.
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
        """Makes the rows."""
        self.num_envs = num_envs = checked_count("num_envs", num_envs, 1)
        if max_episode_steps is not None:
            max_episode_steps = checked_count("max_episode_steps", max_episode_steps, 1)
        if threads is not None:
            threads = checked_count("threads", threads, 1)
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = _checked_mode(autoreset_mode)
        self._make(options, num_envs, threads, render_mode)
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.single_observation_space, self.single_action_space = self._spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.arange(num_envs, dtype=np.int64)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._usual_steps = max_episode_steps or np.inf
        self._most_steps = np.full(num_envs, self._usual_steps)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins new episodes, of all rows or of those that `options["reset_mask"]` names.

        Args:
            seed: an int s seeds row i with s + i; a list names one for each, None to go on with its
                generator.
            options: the entries of `ResetOptions`, each a sequence of one value per row, None for
                what is usual, and "reset_mask", (rows,) bool.

        Returns:
            The observations and the info of all rows.

        Raises:
            ValueError: for bad seeds and options, before anything changes.
            TypeError: likewise.
            gymnasium.error.ResetNeeded: where the first reset is not of all rows.
            gymnasium.error.ClosedEnvironmentError: after close.
        """
        self._refuse("reset", begun=True)
        seeds = row_seeds(seed, self.num_envs)
        options_of_rows = reset_options(options, self.num_envs)
        members = self._members_of(options)
        if not self._begun and members.size < self.num_envs:
            raise ResetNeeded("the first reset should be of all rows")
        # nothing has changed so far: what is refused leaves the environment as it was
        beginnings = self.episodes.beginnings(options_of_rows, members)
        generators = self.episodes.generators
        for row in members.tolist():
            if seeds[row] is not None or row not in generators:
                generators[row], _ = seeding.np_random(seeds[row])
        if isinstance(seed, int | np.integer):
            # as every vector environment of Gymnasium has it; rows draw from their own
            self._np_random, self._np_random_seed = seeding.np_random(seeds[0])
        self._begun = False
        self._begin(members, beginnings)
        self._begun = True
        if options_of_rows:
            for row in members.tolist():
                most_steps = options_of_rows[row].episode_steps or np.inf
                self._most_steps[row] = min(most_steps, self._usual_steps)
        stepped = np.zeros(self.num_envs, dtype=bool)
        observation = self.episodes.observation()
        return observation, self._info(stepped) | self._drawn(members)

    def _members_of(self, options: Mapping[str, Any] | None) -> Indices:
        """The rows that options of a reset name by their mask, all without one.

        Raises ValueError.
        """
        if options is None or MASK not in options:
            return self._all
        mask = np.asarray(options[MASK])
        has_shape = mask.shape == (self.num_envs,)
        if mask.dtype != bool or not has_shape or not mask.any():
            raise ValueError(
                f"reset_mask should be a bool array of shape ({self.num_envs},) with at least"
                f" one true, not {mask!r}"
            )
        return np.flatnonzero(mask)

    def _begin(self, members: Indices, beginnings: Mapping[int, Beginning] | None = None) -> None:
        """Begin new episodes of rows, drawn from their generators."""
        generators = [self.episodes.generators[row] for row in members]
        self.episodes.begin(members, generators, beginnings)
        self._ended[members] = False
        self._most_steps[members] = self._usual_steps
        if self._renderer is not None:
            self._renderer.begin(members)

    def step(
        self, actions: ArrayLike
    ) -> tuple[Any, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Takes one control period of every row.

        Args:
            actions: (rows, n_a) in [-1, 1]; larger ones are clipped.

        Returns:
            Observations, rewards (rows,), which rows are terminated, which are truncated, info.

        Raises:
            ValueError: for actions of wrong shape or with NaN, before anything changes.
            TypeError: for ones of wrong type.
            gymnasium.error.ResetNeeded: before the first reset, and where rows have ended that
                are not reset by themselves.
            gymnasium.error.ClosedEnvironmentError: after close.
        """
        self._refuse("step", self._begun)
        shape = (self.num_envs, self.model.tendon_count)
        action = checked_array("actions", actions, shape)
        # rows that ended in the step before begin anew in this one, which ignores their actions
        stepped = ~self._ended
        members = self._all
        begun = np.flatnonzero(self._ended)
        if begun.size:
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise ResetNeeded(f"rows {begun.tolist()} have ended: reset them with a reset_mask")
            members = np.flatnonzero(stepped)
            self._begin(begun)
        self.episodes.step(action, members)
        if self._renderer is not None:
            self._renderer.step(members)
        reward = np.where(stepped, self.episodes.reward, 0.0)
        terminated = self.episodes.diverged & stepped
        truncated = stepped & self.timed_out
        self._ended = terminated | truncated
        observation = self.episodes.observation()
        numbers = self._info(stepped)
        drawn = self._drawn(begun)
        info = numbers | drawn
        if terminated.any():
            info["cause"] = self._causes(terminated)
            info["_cause"] = terminated.copy()
        ends_in_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        if ends_in_step and self._ended.any():
            observation, info = self._restart(observation, info)
        return observation, reward, terminated, truncated, info

    def _causes(self, terminated: NDArray[np.bool_]) -> NDArray[Any]:
        """Why rows are terminated, (rows,) of objects: None for the others."""
        causes = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(terminated).tolist():
            causes[row] = self.episodes.cause(row)
        return causes

    def _restart(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Reset the ended rows at once; what they ended with goes to final_obs and final_info."""
        ended = self._ended.copy()
        begun = np.flatnonzero(ended)
        final_obs = np.full(self.num_envs, None, dtype=object)
        for row in begun.tolist():
            final_obs[row] = of_row(observation, row)
        final_info: dict[str, Any] = {}
        for key, value in info.items():
            is_mask = key.startswith("_")
            if is_mask:
                final_info[key] = value & ended
            else:
                final_info[key] = value
        self._begin(begun)
        new_info = self._info(~ended)
        new_info["final_obs"] = final_obs
        new_info["_final_obs"] = ended
        new_info["final_info"] = final_info
        new_info["_final_info"] = ended
        return self.episodes.observation(), new_info | self._drawn(begun)

    def _info(self, stepped: NDArray[np.bool_]) -> dict[str, Any]:
        """The episodes' info with its masks; rewards belong to rows that have stepped."""
        info = self.episodes.info()
        everywhere = np.ones(self.num_envs, dtype=bool)
        masks = {}
        for name in info:
            is_reward = name.startswith("reward_")
            if is_reward:
                masks[f"_{name}"] = stepped
            else:
                masks[f"_{name}"] = everywhere
        return info | masks

    def _drawn(self, begun: Indices) -> dict[str, Any]:
        """Info of what was drawn for rows that have just begun."""
        drawn = [self.episodes.drawn(row) for row in begun.tolist()]
        return drawn_in_rows(drawn, begun, self.num_envs)

    @property
    def state(self) -> tuple[State, ...]:
        """Copies of the rows' states."""
        rows = range(self.num_envs)
        return tuple(self.episodes.state(row) for row in rows)

    @property
    def timed_out(self) -> NDArray[np.bool_]:
        """Rows (rows,) whose episodes have lasted for their steps."""
        is_over = self.episodes.step_count >= self._most_steps
        return np.asarray(is_over)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Draws the rows.

        Returns:
            Frames (height, width, 3) of the rows; None without a render mode and with "human".

        Raises:
            gymnasium.error.ClosedEnvironmentError: after close.
        """
        self._refuse("render", begun=True)
        return self._frames()

    def close_extras(self, **kwargs: Any) -> None:
        """Stops the threads; the viewer stays open.

        Args:
            kwargs: of `close`, which changes nothing.
        """
        self.episodes.arms.close()
        if self._renderer is not None:
            self._renderer.close()


def _checked_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """An autoreset mode by its name or itself.

    Raises ConfigurationError.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    if mode not in MODES:
        hint = not_among(str(mode), MODES)
        problem = Problem(("autoreset_mode",), f"is {mode!r}: {hint}")
        raise ConfigurationError([problem], "environment")
    return MODES[mode]


class GoalRewards(EpisodesEnv):
    """Rewards of goals, which environments of goal-conditioned tasks have besides."""

    def compute_reward(
        self,
        achieved_goal: NDArray[Any],
        desired_goal: NDArray[Any],
        info: Any,
    ) -> Any:
        """Computes rewards of goals, as hindsight experience replay asks for.

        Args:
            achieved_goal: positions (..., 3) [m].
            desired_goal: positions of the same shape [m].
            info: of steps, which rewards do not depend on.

        Returns:
            Rewards (...); a float for one goal.

        Raises:
            ValueError: for other shapes.
        """
        reward = self.episodes.goal_reward(achieved_goal, desired_goal)
        if reward.ndim == 0:
            return float(reward)
        return reward


class TipPoseEnv(TendonRodEnv):
    """Environment of the task TipPose with one arm; its description takes this place."""

    __doc__ = TIP_POSE.description
    task = TIP_POSE


class TipPoseVectorEnv(TendonRodVectorEnv):
    """Rows of `TipPoseEnv`."""

    task = TIP_POSE


class ShapeEnv(TendonRodEnv):
    """Environment of the task Shape with one arm; its description takes this place."""

    __doc__ = SHAPE.description
    task = SHAPE


class ShapeVectorEnv(TendonRodVectorEnv):
    """Rows of `ShapeEnv`."""

    task = SHAPE


class ReachEnv(GoalRewards, TendonRodEnv):
    """Environment of the task Reach with one arm; its description takes this place."""

    __doc__ = REACH.description
    task = REACH


class ReachVectorEnv(GoalRewards, TendonRodVectorEnv):
    """Rows of `ReachEnv`."""

    task = REACH


def _make_classes(name: str, task: Task) -> None:
    """Make the classes of a task in this module, where they are not written already."""
    classes = globals()
    rows_doc = f"Rows of `{name}Env`."
    for base, suffix, doc in (
        (TendonRodEnv, "Env", task.description),
        (TendonRodVectorEnv, "VectorEnv", rows_doc),
    ):
        present = classes.get(name + suffix)
        if present is not None and present.task is task:
            continue
        bases: tuple[type, ...] = (base,)
        if task.goal:
            bases = (GoalRewards, base)
        attributes = {"task": task, "__doc__": doc, "__module__": __name__}
        class_name = name + suffix
        classes[class_name] = type(class_name, bases, attributes)


TASKS.follow(_make_classes)
