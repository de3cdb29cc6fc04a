"""The environments with one arm. Their docstrings are their documentation."""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.envs.divergence import DivergenceLog
from soft_tendon_env.envs.door import PlainSpec, check_options, checked_seed, refuse_closed
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.frames import RENDER_MODES, make_renderer
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.targets import Samples
from soft_tendon_env.envs.tasks import REACH, SHAPE, TIP_POSE, Task, goal_reward
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import SimulationDiverged, State
from soft_tendon_env.tools.checks import checked_array

ONE = np.zeros(1, dtype=np.int64)


class TendonRodEnv(PlainSpec, gym.Env[Any, Any], EzPickle):
    """What the environments share: one row of `Episodes`, `self.episodes`."""

    metadata: dict[str, Any] = {"render_modes": [*RENDER_MODES]}
    task: ClassVar[Task]

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """`render_mode`: None, "rgb_array", or "human", which opens the Rerun viewer; options: see `Options`.

        Raises ConfigurationError, ValueError for other modes, gymnasium.error.DependencyNotInstalled or gymnasium.error.Error where what a
        mode needs is not there.
        """
        EzPickle.__init__(self, render_mode=render_mode, **options)
        self.render_mode = render_mode
        chosen = Options.parse(options, type(self).__name__)
        self.episodes = Episodes(self.task, chosen, rows=1)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / chosen.control_period))}
        self.observation_space = observation_space(self.episodes)
        self.action_space = action_space(self.episodes)
        self._on_divergence, self._begun, self._closed = chosen.on_divergence, False, False
        folder = chosen.divergence_folder
        self._log = DivergenceLog(folder, self.task.name, options, 1) if folder is not None else None
        self._renderer = make_renderer(self.episodes, render_mode)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode; `options` are not used. Raises ValueError or TypeError for a bad seed, before anything changes."""
        refuse_closed(self._closed, "reset")
        check_options(options)
        super().reset(seed=checked_seed(seed))
        if self._log is not None:
            self._log.begin(0, self.np_random)
        self.episodes.begin(ONE, [self.np_random])
        self._begun = True
        if self._renderer is not None:
            self._renderer.begin(ONE)
        return self._observation(), self._info()

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One control period. Raises ValueError or TypeError for an action of wrong shape or type or with NaN, before anything changes."""
        refuse_closed(self._closed, "step")
        if not self._begun:
            raise ResetNeeded("step was called before reset")
        checked = checked_array("action", action, (self.episodes.model.tendon_count,))
        if self._log is not None:
            self._log.append(0, checked)
        self.episodes.step(checked[None])
        if self._renderer is not None:
            self._renderer.step(ONE)
        info = self._info()
        terminated = truncated = False
        if info["diverged"]:
            info["cause"] = self.episodes.cause(0)
            if self._log is not None:
                info["divergence_file"] = str(self._log.write(0, info["cause"], self.episodes.state(0)))
            if self._on_divergence == "raise":
                raise SimulationDiverged(self.episodes.state(0), info["cause"], self.episodes.tension[0])
            terminated, truncated = self._on_divergence == "terminate", self._on_divergence == "truncate"
        return self._observation(), float(self.episodes.reward[0]), terminated, truncated, info

    @property
    def model(self) -> Model:
        """The model that the environment simulates, before randomisation."""
        return self.episodes.model

    @property
    def state(self) -> State:
        """A copy of the arm's state, as `Simulation` has it."""
        return self.episodes.state(0)

    def target_at(self, times: ArrayLike) -> Samples:
        """The episode's target at times (m,) [s] from its beginning, past or future."""
        if not self._begun:
            raise ResetNeeded("the target is drawn by reset")
        return self.episodes.target_at(0, checked_array("times", times, (None,)))

    def _observation(self) -> Any:
        observation = self.episodes.observation()
        return {key: value[0] for key, value in observation.items()} if isinstance(observation, dict) else observation[0]

    def _info(self) -> dict[str, Any]:
        return {name: value[0].item() for name, value in self.episodes.info().items()}

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
    """Of one row."""
    return Box(-1.0, 1.0, (episodes.model.tendon_count,), np.float32)


def observation_space(episodes: Episodes) -> Box | Dict:
    """Of one row."""
    flat = episodes.layout.space
    if not episodes.task.goal:
        return flat
    reach = np.float32(episodes.goal_bound)
    goal = Box(-reach, reach, (3,), np.float32)
    return Dict({"observation": flat, "achieved_goal": goal, "desired_goal": goal})


class TipPoseEnv(TendonRodEnv):
    """
    ## Description
    A soft arm, pulled by tendons, is to carry its tip along a moving pose. The arm is a Cosserat rod with the statics-based
    reduced dynamics of Mathew, Renda et al. (RA-L 2024); by default the paper's arm of 1 m with ten tendons.

    ## Action Space
    `Box(-1, 1, (n_a,), float32)`, one entry per tendon, clipped to that. With `action="tension"` -1 is the least and 1 the greatest
    tension (by default those of the scene, 0 to 60 N on the paper's arm: tendons pull), with "increment" the largest change down or up.

    ## Observation Space
    `Box(float32)` of the groups below side by side, each scaled to about 1 and clipped to ±10 (ways to the target: ±100), for n
    coordinates, n_a tendons, p preview times; `observation` chooses others (see docs/environments.md).

    | group | size | what |
    |---|---|---|
    | coordinates | n | generalised coordinates |
    | rates | n | their rates |
    | tip_position | 3 | tip position over the rod's length |
    | tip_rotation | 6 | first two columns of the tip's rotation matrix |
    | tip_twist | 6 | tip twist, angular then linear |
    | target_error | 6 | SE(3) logarithm from tip to target, angular then linear |
    | target_twist | 6 | twist of the target |
    | preview | 6 p | SE(3) logarithm from tip to the target at each preview time |
    | last_action | n_a | the last action |

    ## Rewards
    The weighted mean of terms between 0 and 1, so between 0 and 1 itself; 0 where the simulation diverged. Each term is in `info` as
    `reward_<term>`: `position` and `angle`, 1 / (1 + (error / scale)^2) with scales 0.05 m and 0.5 rad; `effort`, 1 less the mean
    square tension; `smoothness`, 1 less the mean square change of the action. Weights 1, 0.5, 0.05, 0.05.

    ## Starting State
    At rest under the tensions nearest to zero. The target is drawn: by default a closed smooth random motion that the statics can follow.

    ## Episode End
    Truncated after 500 steps (10 s). Terminated if no time step of the simulation succeeds, however small: `info["diverged"]` is true
    and `info["cause"]` says why, the observation is the last good one.

    ## Arguments
    All of `soft_tendon_env.envs.Options`: `scene`, `fidelity`, `target`, `observation`, `reward`, `randomize`, ...

    ## Version History
    * v0: initial version
    """

    task = TIP_POSE


class ShapeEnv(TendonRodEnv):
    """
    ## Description
    A soft arm, pulled by tendons, is to take a sequence of shapes: those in which given tensions would hold it at rest (shape
    control of Mathew, Renda et al., RA-L 2024, Section IV-A).

    ## Action Space
    As `TipPoseEnv`.

    ## Observation Space
    As `TipPoseEnv`, with the groups

    | group | size | what |
    |---|---|---|
    | coordinates | n | generalised coordinates |
    | rates | n | their rates |
    | tip_position | 3 | tip position over the rod's length |
    | tip_rotation | 6 | first two columns of the tip's rotation matrix |
    | target_coordinates | n | coordinates of the target less the arm's |
    | coordinate_preview | n p | the same at each preview time |
    | last_action | n_a | the last action |

    ## Rewards
    As `TipPoseEnv`, with the term `backbone` (root mean square distance between backbone and target, scale 0.05 m) in place of
    `position` and `angle`; also `coordinates` (norm of the coordinates' error) and `position` may be given weights.

    ## Starting State
    As `TipPoseEnv`. `target="ramp"` is the paper's: from rest to static tensions within 2.5 s, then held.

    ## Episode End
    As `TipPoseEnv`.

    ## Arguments
    As `TipPoseEnv`. A target must be made of tensions.

    ## Version History
    * v0: initial version
    """

    task = SHAPE


class ReachEnv(TendonRodEnv):
    """
    ## Description
    A soft arm, pulled by tendons, is to bring its tip to a point: goal-conditioned, for hindsight experience replay.

    ## Action Space
    As `TipPoseEnv`.

    ## Observation Space
    `Dict` of `observation` (as `TipPoseEnv`: coordinates, rates, tip_position, tip_rotation, tip_twist, last_action), `achieved_goal` and
    `desired_goal`, both tip positions in metres, `Box((3,), float32)`.

    ## Rewards
    `reward="sparse"`: 1 within `threshold` (10 mm) of the goal, else 0. `reward="dense"`: 1 / (1 + (distance / (5 threshold))^2).
    `compute_reward(achieved_goal, desired_goal, info)` gives the same for many.

    ## Starting State
    As `TipPoseEnv`. The goal is drawn: the tip's position at rest under random tensions.

    ## Episode End
    As `TipPoseEnv`; reaching the goal does not end the episode. `info["is_success"]` says whether it is reached now.

    ## Arguments
    As `TipPoseEnv`, and `threshold`.

    ## Version History
    * v0: initial version
    """

    task = REACH

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any) -> Any:
        """Rewards (...) of goals (..., 3); a float for one. Raises ValueError for goals of other shapes."""
        options = self.episodes.options
        reward = goal_reward(achieved_goal, desired_goal, self.episodes.goal_kind, options.threshold)
        return float(reward) if reward.ndim == 0 else reward


ENVIRONMENTS: dict[str, type[TendonRodEnv]] = {env.task.name: env for env in (TipPoseEnv, ShapeEnv, ReachEnv)}
"""The environments by their tasks' names."""
