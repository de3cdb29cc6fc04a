"""Trained agents behind a state estimator: they act on sensors that are noisy, or fewer than those that they learned with.

    policy = load_policy("filtered:apg", env)

An extended Kalman filter (or another of `ESTIMATORS`) estimates coordinates and rates of a model's arm, and the agent observes what its own
sensors would measure on that arm without noise.
"""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.control.protocol import Estimate
from soft_tendon_env.control.rigid_motions import pose_error
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.envs.observation import GROUPS, History, stress_free_strain
from soft_tendon_env.envs.tasks import TIP
from soft_tendon_env.policies.agent_files import INTERFACE
from soft_tendon_env.policies.controller_policy import (
    estimator_setting,
    interface_of,
    measurement,
    regime_options,
    target_poses,
    tip_poses,
    without_delay,
)
from soft_tendon_env.policies.estimators import PARAMETERS, EstimatorEntry
from soft_tendon_env.policies.protocol import LostState, Policy
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.types import Array

OF_ARM = (
    *("coordinates", "rates", "tip_position", "tip_rotation", "tip_twist"),
    *("tendon_lengths", "strain", "strain_rate", "last_action", "command"),
)
"""Observation groups that are made of the estimate, and of what was asked for."""
OF_TARGET = ("target_error", "target_twist", "preview", "target_lengths")
"""Observation groups that the environment gives as seen from the measured arm: they are moved to the estimated one."""


class Rates(NamedTuple):
    """Estimated strain rates (rows, sensors, 6)."""

    strain_rate: Array


class Ahead(NamedTuple):
    """Target twists (rows, 1, 6)."""

    tip_twist: Array


class Seen(NamedTuple):
    """Quantities of the estimated arm that observation groups are computed from, rows first, as in envs.observation.Observed."""

    q: Array
    q_dot: Array
    tip_pose: Array
    tip_twist: Array
    tendon_length: Array
    strain: Array
    measured: Rates
    error: Array
    target: Ahead
    target_length: Array
    action: Array
    command: Array


class EstimatedMemory(NamedTuple):
    """State of an EstimatingAgent from one call of `predict` to the next, rows first."""

    estimates: tuple[Estimate | None, ...]
    sent: Array  # (rows, k, n_a) [N] asked for in the last k periods, the newest last
    action: Array  # (rows, n_a) the last one
    periods: NDArray[np.int64]  # (rows,) that the episodes have lasted
    frames: NDArray[np.float32]  # see envs.observation.History
    agent: Any


class EstimatingAgent:
    """An agent that observes an estimate of the arm's state in place of measurements.

    Args:
        agent: made for `own`.
        own: an environment like that of the agent's training, with the arm that the estimator believes in; it is never stepped.
        env: that it acts in, single or vector, with the observation of `estimated_options`.
        entry: state estimator.

    Raises ValueError where the agent observes a group of neither OF_ARM nor OF_TARGET, where actions are read differently in the two
    environments, or where commands are displacements.
    """

    def __init__(self, agent: Policy, own: gym.Env[Any, Any], env: Any, entry: EstimatorEntry) -> None:
        episodes, learned = episodes_of(env), episodes_of(own)
        self.agent, self.model, self._layout, self._history = agent, learned.model, learned.layout, learned.options.history
        self._interface = interface_of(env)
        groups = self._layout.groups
        if unknown := [name for name in groups if name not in (*OF_ARM, *OF_TARGET) or groups[name] is not GROUPS[name]]:
            raise ValueError(f"the agent observes {unknown[0]}, which no state estimator finds: {', '.join((*OF_ARM, *OF_TARGET))}")
        for key in ("control_period", "tension_limits", *(name for name in INTERFACE if name not in ("observation", "history", "sensors"))):
            given, needed = (getattr(of.options, key) for of in (episodes, learned))
            if given != needed and (key != "preview" or "preview" in groups):
                raise ValueError(f"the environment has {key} = {given!r}, the agent was trained with {needed!r}")
        if not self._interface.model.scene.effects.command_tension:
            raise ValueError("the scene's commands are displacements, but state estimators need tensions: leave out tendon_elasticity")
        at_once, delay = without_delay(self.model)
        self._estimator = entry.make(at_once, estimator_setting(episodes, at_once)._replace(latency=delay))
        estimated = (group for group, name in PARAMETERS.items() if name in self._estimator.needs)
        needed = [*TIP, "tendon_lengths", *estimated, *(name for name in OF_TARGET if name in groups)]
        if missing := [name for name in needed if name not in self._interface.layout.slices]:
            raise ValueError(f"the environment's observation lacks {missing[0]}, see policy_options")
        rest = np.zeros(self.model.coordinate_count)
        self._sensors = np.asarray(learned.sensors)
        self._rest_length, self._stress_free = self.model.tendon_lengths(rest), stress_free_strain(self.model.scene, self._sensors)
        self._lost = LostState("the state estimator")

    def predict(
        self,
        observation: Any,
        state: EstimatedMemory | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], EstimatedMemory]:
        """Actions (n_a,) for one observation, (rows, n_a) for many, and the state to give back; see ControllerPolicy.predict."""
        self._lost.notice(state is None and not np.any(episode_start))
        flat = observation["observation"] if isinstance(observation, dict) else observation
        values = self._interface.layout.values(np.atleast_2d(flat))
        rows = len(values["tip_position"])
        memory = self._fresh(rows) if state is None else self._begun(state, episode_start)
        poses = tip_poses(values)
        estimates = tuple(self._estimated(row, values, poses[row], memory) for row in range(rows))
        seen = self._seen(values, poses, estimates, memory)
        present = self._layout.present(seen)  # type: ignore[arg-type]  # which has what OF_ARM and OF_TARGET are computed from
        history = History(rows, self._history, self._layout.kept)
        history.frames[:] = memory.frames
        history.keep(present, memory.periods, np.arange(rows))
        own: Any = np.concatenate([present, history.changes], axis=1) if self._history else present
        own = own.reshape(*np.shape(flat)[:-1], -1)
        if isinstance(observation, dict):
            measured = np.asarray(observation["achieved_goal"])
            tip = seen.tip_pose[:, :3, 3].reshape(measured.shape).astype(measured.dtype)
            own = {**observation, "observation": own, "achieved_goal": tip}
        action, inner = self.agent.predict(own, memory.agent, episode_start, deterministic)
        sent = np.concatenate([memory.sent[:, 1:], memory.sent[:, -1:]], axis=1)
        after = EstimatedMemory(estimates, sent, memory.action, memory.periods + 1, history.frames, inner)
        return action, self.instead(after, action)

    def instead(self, memory: EstimatedMemory, action: NDArray[Any]) -> EstimatedMemory:
        """The memory where these actions (rows, n_a) or (n_a,) were taken."""
        asked = np.atleast_2d(action).astype(np.float64)
        command = self._interface.actions.command(asked, memory.sent[:, -2])
        return memory._replace(sent=np.concatenate([memory.sent[:, :-1], command[:, None]], axis=1), action=asked)

    def _fresh(self, rows: int) -> EstimatedMemory:
        """Memory of rows whose episodes begin."""
        start = self._interface.start
        frames = np.zeros((rows, 1 + self._history, self._layout.kept.size), dtype=np.float32)
        sent = np.tile(start, (rows, 2 + self._estimator.history, 1))
        return EstimatedMemory((None,) * rows, sent, np.zeros((rows, start.size)), np.zeros(rows, dtype=np.int64), frames, None)

    def _begun(self, memory: EstimatedMemory, episode_start: NDArray[Any] | None) -> EstimatedMemory:
        """The memory, forgotten by rows whose episodes begin."""
        if episode_start is None or not np.any(episode_start):
            return memory
        begins, fresh = np.atleast_1d(episode_start), self._fresh(len(memory.estimates))
        estimates = tuple(None if new else old for new, old in zip(begins, memory.estimates, strict=True))
        sent, action = (np.where(begins[:, None, None], fresh.sent, memory.sent), np.where(begins[:, None], fresh.action, memory.action))
        return memory._replace(estimates=estimates, sent=sent, action=action, periods=np.where(begins, 0, memory.periods))

    def _estimated(self, row: int, values: dict[str, Array], pose: Array, memory: EstimatedMemory) -> Estimate:
        own = {name: value[row] for name, value in values.items()}
        time = int(memory.periods[row]) * self._interface.period
        sent = memory.sent[row, len(memory.sent[row]) - self._estimator.history :]
        return self._estimator.estimate(measurement(self._estimator, own, pose, sent, time), memory.estimates[row])

    def _seen(self, values: dict[str, Array], poses: Array, estimates: tuple[Estimate, ...], memory: EstimatedMemory) -> Seen:
        """Quantities that the agent's sensors would measure on the estimated arms, and their ways to the targets."""
        model, found = self.model, list[tuple[Array, ...]]()
        for estimate, pose in zip(estimates, poses, strict=True):
            terms = model.terms(estimate.q, estimate.q_dot)
            strain, slope = model.strain_at(estimate.q, self._sensors)
            tip = pose if estimate.tip_pose is None else estimate.tip_pose
            length = model.tendon_lengths(estimate.q) - self._rest_length
            found.append((tip, terms.tip_jacobian @ estimate.q_dot, length, strain - self._stress_free, slope @ estimate.q_dot))
        tip, twist, length, strain, strain_rate = (np.stack(parts) for parts in zip(*found, strict=True))
        targets = target_poses(values, poses)
        error = np.zeros((len(tip), 0, 6))
        if targets is not None:
            error = np.array([[pose_error(at, to) for to in ahead] for at, ahead in zip(tip, targets, strict=True)])
        way = values.get("target_lengths", np.zeros_like(length))
        return Seen(
            q=np.stack([estimate.q for estimate in estimates]),
            q_dot=np.stack([estimate.q_dot for estimate in estimates]),
            tip_pose=tip,
            tip_twist=twist,
            tendon_length=length,
            strain=strain,
            measured=Rates(strain_rate),
            error=error,
            target=Ahead(values.get("target_twist", np.zeros((len(tip), 6)))[:, None]),
            target_length=way + values["tendon_lengths"],
            action=memory.action,
            command=memory.sent[:, -1],
        )


def estimated_options(groups: tuple[str, ...], task: str, regime: str) -> dict[str, Any]:
    """Options of an environment in an information regime, for an agent that observes these groups behind a state estimator. Raises
    ValueError."""
    options = regime_options(regime, task)
    return {**options, "observation": (*REGIMES[regime].measured, *(name for name in OF_TARGET if name in groups)), "history": 0}
