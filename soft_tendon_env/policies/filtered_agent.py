"""A trained agent behind a state estimator.

The agent sees the arm as a Kalman filter estimates it, at the time at which its command will
arrive: noise is filtered by a model, and latency is predicted. It is as separate from its state
estimator as a controller is (separation of estimation and control).
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control import protocol
from soft_tendon_env.control.diagnosis import Diagnosis
from soft_tendon_env.control.rigid_motions import inverse_pose, pose_at, pose_error
from soft_tendon_env.control.uncertainty import USUAL
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.observation import HISTORY, RestValues, changes_of
from soft_tendon_env.envs.tasks import TIP
from soft_tendon_env.model.model import Model
from soft_tendon_env.policies.arm_observer import (
    ArmMemory,
    believed_arm,
    make_observer,
    missing_groups,
)
from soft_tendon_env.policies.estimators import EstimatorEntry
from soft_tendon_env.policies.observed_poses import target_poses, tip_poses
from soft_tendon_env.policies.protocol import LostState, Policy, memories_of
from soft_tendon_env.tools.linear_algebra import one_thread
from soft_tendon_env.tools.types import Array


class Estimated(NamedTuple):
    """Estimated arm and its targets, of which groups of an observation are computed."""

    model: Model
    tip_pose: Array  # (4, 4)
    q: Array  # (n,)
    q_dot: Array  # (n,)
    sensors: Array  # (s,) [m] arc lengths
    rest: RestValues
    targets: Array  # (1 + previews, 4, 4), none without target poses

    @property
    def tip_twist(self) -> Array:
        """Twist (6,) of the tip in its frame."""
        jacobian = self.model.terms(self.q, self.q_dot).tip_jacobian
        return np.asarray(jacobian @ self.q_dot)

    @property
    def strain(self) -> Array:
        """Strains (6 s,) at the sensors, less those of the stress-free rod."""
        strain, _ = self.model.strain_at(self.q, self.sensors)
        change = strain - self.rest.strain
        return change.ravel()

    @property
    def tendon_length(self) -> Array:
        """Tendon lengths (n_a,) [m], less those at rest."""
        return self.model.tendon_lengths(self.q) - self.rest.tendon_length

    @property
    def strain_rate(self) -> Array:
        """Their rates (6 s,)."""
        _, slope = self.model.strain_at(self.q, self.sensors)
        rates = slope @ self.q_dot
        return rates.ravel()

    def errors(self, targets: Array) -> Array:
        """Ways log(g^-1 g_bar) (6 k,) from the tip to targets (k, 4, 4)."""
        ways = [pose_error(self.tip_pose, target) for target in targets]
        return np.array(ways).ravel()

    def seen_from_tip(self, targets: Array) -> Array:
        """Targets (k, 4, 4) as the tip sees them (9 k,).

        They are position and first two columns of the rotation.
        """
        seen = inverse_pose(self.tip_pose) @ targets
        columns = seen[:, :3, [3, 0, 1]]
        return columns.swapaxes(1, 2).ravel()


ESTIMATED: Mapping[str, Callable[[Estimated], Array]] = {
    "tip_position": lambda arm: arm.tip_pose[:3, 3],
    "tip_rotation": lambda arm: arm.tip_pose[:3, :2].T.ravel(),
    "tip_twist": lambda arm: arm.tip_twist,
    "tendon_lengths": lambda arm: arm.tendon_length,
    "strain": lambda arm: arm.strain,
    "strain_rate": lambda arm: arm.strain_rate,
    "target_error": lambda arm: arm.errors(arm.targets[:1]),
    "preview": lambda arm: arm.errors(arm.targets[1:]),
    "target_pose": lambda arm: arm.seen_from_tip(arm.targets[:1]),
    "pose_preview": lambda arm: arm.seen_from_tip(arm.targets[1:]),
}
"""Observation groups that an agent sees as they are estimated, in SI units. Others stay as they are
observed: those that no state tells, and groups of a user's own."""
UNKNOWN = (
    "coordinates",
    "rates",
    "target_coordinates",
    "coordinate_preview",
    "wanted_coordinates",
    "target_lengths",
)
"""Groups of coordinates, with which no estimator is needed, and of targets that are shapes: where
these will be when a command arrives is not observed."""
TOLD_BY = {"preview": "target_error", "target_pose": "target_error", "pose_preview": "preview"}
"""Groups of targets, and those that tell where these targets are."""


class RowMemory(NamedTuple):
    """State of a filtered agent for one row, from one call of `predict` to the next."""

    command: Array  # (n_a,) [N] asked for last
    arm: ArmMemory
    # (1 + periods, m) entries of the arm that the agent saw, the latest first
    frames: Array | None


class FilteredMemory(NamedTuple):
    """State of a filtered agent for all rows."""

    agent: Any
    rows: tuple[RowMemory, ...]


class Look(NamedTuple):
    """Arm of a row in a control period, before the agent has acted."""

    memory: RowMemory  # of the period before
    estimate: protocol.Estimate  # now
    tip_position: Array  # (3,) [m] when the command arrives
    frames: Array | None  # of the next memory


class FilteredAgent:
    """Trained agent that sees the arm as a state estimator finds it, for one row or many.

    Args:
        agent: what acts.
        env: its environment.
        model: of the arm, as the estimator believes it to be.
        estimator: of ESTIMATORS.

    Raises:
        TypeError: the environment is of another package.
        ValueError: commands are no tensions, or the agent observes what an estimator cannot give.
    """

    def __init__(self, agent: Policy, env: Any, model: Model, estimator: EstimatorEntry) -> None:
        """Makes the policy for the environment."""
        episodes = episodes_of(env)
        self.agent = agent
        self.layout = episodes.layout
        self._actions = episodes.actions
        self._ahead = episodes.ahead.copy()
        self._sensors = episodes.sensors.copy()
        self._rest = episodes.observed.rest
        self._lost = LostState("the state estimator")
        believed, known = believed_arm(model)
        self._model = believed
        self.observer = make_observer(episodes, believed, known, estimator, USUAL)
        self._check(episodes)

    def _check(self, episodes: Episodes) -> None:
        """Raises ValueError where the agent cannot act on estimates."""
        unit = episodes.model.scene.effects.command_unit
        if unit != "N":
            raise ValueError(
                f"the arm's commands are in {unit}: an agent behind a state estimator needs"
                " tensions as commands, since these are what the estimator knows"
            )
        groups = episodes.layout.slices
        unknown = [group for group in UNKNOWN if group in groups]
        if unknown:
            raise ValueError(
                f"the agent observes {', '.join(unknown)}, which no state estimator replaces: it"
                " acts without one"
            )
        missing = [group for group in TIP if group not in groups]
        missing += missing_groups(self.observer, groups)
        for group, needed in TOLD_BY.items():
            if group in groups and needed not in groups:
                missing.append(needed)
        if missing:
            raise ValueError(
                f"the agent does not observe {', '.join(missing)}, which the state estimator needs"
            )

    def predict(
        self,
        observation: Any,
        state: FilteredMemory | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, FilteredMemory]:
        """Computes actions for one observation or many, and the state to give back.

        Arguments are those of `ControllerPolicy.predict`.
        """
        is_first = np.any(episode_start)
        self._lost.notice(state is None and not is_first)
        is_dict = isinstance(observation, dict)
        flat = observation["observation"] if is_dict else observation
        rows = np.atleast_2d(flat)
        values = self.layout.values(rows)
        poses = tip_poses(values)
        targets = target_poses(values, poses)
        before = memories_of(len(rows), None if state is None else state.rows, episode_start)
        seen = rows.astype(np.float64)
        looks = []
        for row, memory in enumerate(before):
            groups = {name: value[row] for name, value in values.items()}
            target = None if targets is None else targets[row]
            with one_thread():  # matrices are small
                look = self._look(seen[row], groups, poses[row], target, memory)
            looks.append(look)
        shown: Any = seen.reshape(np.shape(flat)).astype(np.float32)
        if is_dict:
            goal = observation["achieved_goal"]
            positions = [look.tip_position for look in looks]
            tip = np.reshape(positions, goal.shape).astype(goal.dtype)
            shown = {**observation, "observation": shown, "achieved_goal": tip}
        of_agent = None if state is None else state.agent
        action, of_agent = self.agent.predict(shown, of_agent, episode_start, deterministic)
        after = []
        for look, wanted in zip(looks, np.atleast_2d(action), strict=True):
            last = look.memory
            command = self._actions.command(wanted.astype(np.float64), last.command)
            arm = self.observer.remember(last.arm, look.estimate, command)
            after.append(RowMemory(command, arm, look.frames))
        return action, FilteredMemory(of_agent, tuple(after))

    def estimate(self, state: FilteredMemory) -> tuple[Diagnosis, ...]:
        """Returns what the Kalman filter has found out about the arms.

        See `ControllerPolicy.estimate`.
        """
        return self.observer.diagnoses(tuple(memory.arm for memory in state.rows))

    def _look(
        self,
        seen: Array,
        groups: dict[str, Array],
        pose: Array,
        target: Array | None,
        memory: RowMemory | None,
    ) -> Look:
        """Estimates an arm, and writes the estimate over what is observed of it.

        Args:
            seen: the observation (size,), which changes.
            groups: the same by group.
            pose: measured (4, 4).
            target: poses (1 + previews, 4, 4) now and ahead, None without.
            memory: of the row, None when an episode begins.
        """
        if memory is None:
            _, command, arm = self.observer.begin(groups)
            memory = RowMemory(command, arm, None)
        reference = protocol.Reference(self._ahead[:0])
        if target is not None:
            # times of a preview are there also where it is not observed
            reference = protocol.Reference(self._ahead[: len(target)], target)
        sight = self.observer.look(groups, pose, reference, memory.command, memory.arm)
        arrival = sight.arrival
        frames = self._replace(seen, arrival, memory.frames)
        return Look(memory, sight.estimate, arrival.tip_pose[:3, 3], frames)

    def _replace(
        self, row: Array, arm: protocol.ControllerInput, frames: Array | None
    ) -> Array | None:
        """Writes what is estimated over an observation, a row (size,), and returns its frames.

        Args:
            row: what is observed.
            arm: as it will be when the command arrives.
            frames: of the periods before, None when an episode begins.
        """
        reference = arm.reference
        targets = np.empty((0, 4, 4))
        if reference.tip_pose is not None:
            times = self._ahead[: len(reference.ahead)]
            told = [pose_at(reference.ahead, reference.tip_pose, time) for time in times]
            targets = np.array(told)
        estimated = Estimated(
            self._model, arm.tip_pose, arm.q, arm.q_dot, self._sensors, self._rest, targets
        )
        layout = self.layout
        for name, columns in layout.slices.items():
            if name in ESTIMATED:
                bound = layout.bound[columns]
                scaled = ESTIMATED[name](estimated) * layout.scale[columns]
                row[columns] = np.clip(scaled, -bound, bound)
        if HISTORY not in layout.slices:
            return None
        present = row[layout.kept]
        columns = layout.slices[HISTORY]
        periods = (columns.stop - columns.start) // layout.kept.size
        if frames is None:
            frames = np.tile(present, (1 + periods, 1))  # at reset it has always been so
        else:
            frames = np.vstack([present, frames[:-1]])
        row[columns] = changes_of(frames[None])[0]
        return frames
