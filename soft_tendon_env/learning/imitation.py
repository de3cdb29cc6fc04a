"""Imitation of a privileged, model-based teacher by dataset aggregation, the algorithm "DAgger".

The teacher knows each arm as it was drawn (material, payload, actuators, delay) and its true state;
the agent sees its own observation alone, and learns to act as the teacher would in the states that
its own actions lead to. Ross, Gordon and Bagnell, A reduction of imitation learning and structured
prediction to no-regret online learning, AISTATS 2011; Chen et al., Learning by cheating, CoRL 2019.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.save_util import load_from_pkl, save_to_pkl

from soft_tendon_env.control.catalogue import tip_pose_objective
from soft_tendon_env.control.feedforward import ReferenceGovernor, StaticFeedforward
from soft_tendon_env.control.objectives import TipPosition
from soft_tendon_env.control.protocol import Controller, ControllerInput, Reference
from soft_tendon_env.control.shape_tracking import ShapeTracking
from soft_tendon_env.control.smith_predictor import whole_periods
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.learning.algorithm import ActorAlgorithm
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.tools.types import Array

LOOKS_AHEAD = (
    2  # control periods ahead for which the teacher needs the target, besides those of the delay
)
# added to standard deviations of features, of which those that never change would get weights
# without bounds
LEAST_DEVIATION = 0.01
EXACT = 0.1  # errors of actions beyond which they count by their size, no longer by its square
LAST_RATE = 0.05  # share of the learning rate that is left at the end of each round


@dataclass(frozen=True)
class DAggerSettings:
    """Settings of dataset aggregation.

    Attributes:
        rounds: how often the agent learns from all that was shown so far.
        n_epochs, batch_size: stochastic gradient descent of a round.
        lead: part of the steps over which the share of episodes that the teacher leads falls from
            all to none.
        noise: standard deviation of what is added to actions, so that there is something to
            correct.
        settling_time: settling time of the teacher's controllers [s].
    """

    rounds: int = 12
    n_epochs: int = 20
    batch_size: int = 512
    lead: float = 0.3
    noise: float = 0.05
    settling_time: float = 0.2


class Teacher:
    """A controller per row that knows the row's arm, actuators, delay and state: the catalogue's
    `tracking`, without integral.

    Where commands are late, a copy of the arms gets those on their way first (Smith predictor, all
    rows at once). settling_time: [s]. Raises ValueError where commands are no tensions, or late by
    the scene rather than by `randomize`, and for too short a preview.
    """

    def __init__(self, episodes: Episodes, settling_time: float) -> None:
        effects = episodes.model.scene.effects
        if effects.command_unit != "N" or effects.actuators is not None:
            raise ValueError(
                "a teacher needs commands that are tensions and act as they are, without"
                " tendon_elasticity and actuators"
            )
        self.episodes, self._settling_time = episodes, settling_time
        self._copy = Arms(
            episodes.model, episodes.size, episodes.period, np.empty(0), np.empty(0), threads=1
        )
        self._laws: list[Controller | None] = [None] * episodes.size
        self.memories: list[Any] = [None] * episodes.size  # of the laws

    def actions(self) -> Array:
        """Actions that each row should take now, (rows, n_a). A row begins anew where its episode
        does."""
        episodes, actuation = self.episodes, self.episodes.actuation
        late = np.array([actuation.delay(row) for row in range(episodes.size)])
        sent = np.stack([actuation.sent(row) for row in range(episodes.size)])
        target = episodes.target_ahead(
            LOOKS_AHEAD + int(np.ceil(late.max() / episodes.period - 1e-9))
        )
        q, q_dot, tip_pose = self._predict_arrival(sent, late)
        ahead = episodes.period * np.arange(target.tip_pose.shape[1], dtype=np.float64)
        tensions = np.empty((episodes.size, episodes.model.tendon_count))
        for row in range(episodes.size):
            law, begins = self._laws[row], not episodes.step_count[row]
            if law is None or begins:
                law = self._make_controller(row)
            reference, time = (
                self._reference(row, target, ahead - late[row]),
                float(episodes.arms.rows.clock[row, 0]) + late[row],
            )
            now = ControllerInput(q[row], q_dot[row], tip_pose[row], sent[row, -1], reference, time)
            decision = law.act(now, None if begins else self.memories[row])
            self._laws[row], self.memories[row] = law, decision.memory
            tensions[row] = actuation.commanded(decision.tension, row)
        return actuation.actions.action(tensions, actuation.command)

    def _make_controller(self, row: int) -> Controller:
        """Controller of a row's arm as it was drawn."""
        episodes, model = self.episodes, self.episodes.arms.model_of(row)
        limits = np.stack(
            [episodes.actuation.acting(bound, row) for bound in episodes.limits.T], axis=1
        )
        arm = model, limits, episodes.period
        if episodes.task.shapes:
            return ShapeTracking(*arm, settling_time=self._settling_time)
        objective = TipPosition() if episodes.task.goal else tip_pose_objective(model)
        return ReferenceGovernor(
            StaticFeedforward(*arm, objective),
            TipTracking(*arm, objective, settling_time=self._settling_time),
        )

    def _predict_arrival(self, sent: Array, late: Array) -> tuple[Array, Array, Array]:
        """Coordinates, rates and tip poses of rows when commands that are late by `late` (rows,)
        [s] arrive, after tensions sent (rows, m, n_a); those now where that motion fails."""
        arms, copied, period = self.episodes.arms, self._copy, self.episodes.period
        for name, values in arms.rows.fields().items():
            getattr(copied.rows, name)[...] = values
        durations = np.zeros(sent.shape[:2])
        for row, delay in enumerate(late):
            whole, rest = whole_periods(delay, period)
            durations[row, sent.shape[1] - whole :], durations[row, -1 - whole] = period, rest
        copied.step(sent, np.flatnonzero(late), durations)
        moved = (late > 0.0) & (copied.outcome.status == OK)
        q = np.where(moved[:, None], copied.rows.q, arms.rows.q)
        q_dot = np.where(moved[:, None], copied.rows.q_dot, arms.rows.q_dot)
        return (
            q,
            q_dot,
            np.where(moved[:, None, None], copied.reading.tip_pose, arms.reading.tip_pose),
        )

    def _reference(self, row: int, target: TargetSamples, ahead: Array) -> Reference:
        episodes, pose = self.episodes, target.tip_pose[row]
        if episodes.task.shapes:
            return Reference(
                ahead, tip_pose=pose, q=episodes.arms.coordinates_of(row, target.q[row])
            )
        return (
            Reference(ahead, tip_position=pose[:, :3, 3])
            if episodes.task.goal
            else Reference(ahead, tip_pose=pose)
        )


def loss(means: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Huber loss, in which a mean beyond the bounds is right where the teacher is at them."""
    means = torch.where(
        wanted >= 1.0,
        means.clamp(max=1.0),
        torch.where(wanted <= -1.0, means.clamp(min=-1.0), means),
    )
    return torch.nn.functional.smooth_l1_loss(means, wanted, beta=EXACT)


class DAgger(ActorAlgorithm):
    """Dataset aggregation (DAgger) with the interface of Stable-Baselines3, on the vector
    environments of this package.

    In every round the teacher says what it would do in each control period, while a share of the
    episodes is led by it and the others by the agent; then the agent's mean is regressed on all
    that was said so far. See DAggerSettings and ActorAlgorithm for arguments.

    Raises TypeError for environments of other packages, ValueError for arms that no teacher can
    control, see `Teacher`, and for observations under running statistics, since the first layer has
    a scale of its own.
    """

    settings_class: ClassVar[type] = DAggerSettings
    generator: np.random.Generator
    _teacher: Teacher
    _shown: list[
        tuple[Any, Array]
    ]  # observations of all rows, and the answers (rows, n_a), by control period

    def _prepare(self) -> None:
        if (statistics := self.get_vec_normalize_env()) is not None and statistics.norm_obs:
            raise ValueError(
                "normalise.observations is true: DAgger has a scale of its own for what it observes"
            )
        vars(self).setdefault("generator", np.random.default_rng(self.seed))
        vars(self).setdefault("_shown", [])
        if "_teacher" not in vars(self) or self._teacher.episodes is not self.rows.episodes:
            self._leads, self._teacher = (
                np.ones(self.n_envs, dtype=bool),
                Teacher(self.rows.episodes, self.settings.settling_time),
            )

    def _learn_part(self, callback: BaseCallback) -> bool:
        periods, rounds = -(-self._total_timesteps // self.n_envs), self.settings.rounds
        ends = (-(-number * periods // rounds) for number in range(1, rounds + 1))
        callback.on_rollout_start()
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        if not self._watch(
            next(end for end in ends if end > self.num_timesteps // self.n_envs), periods, callback
        ):
            return False
        callback.on_rollout_end()
        self.logger.record(
            "train/loss", self._teach(self.lr_schedule(self._current_progress_remaining))
        )
        return True

    def _watch(self, end: int, periods: int, callback: BaseCallback) -> bool:
        """Act until control period `end` of `periods`, while the teacher says what it would do;
        False where the callback ends it."""
        env: Any = self.env
        observation: Any = self._last_obs
        for done in range(self.num_timesteps // self.n_envs, end):
            wanted = self._teacher.actions()
            self._shown.append((observation, wanted))
            chosen = self.predict(observation, deterministic=True)[0]
            noise = self.settings.noise * self.generator.standard_normal(wanted.shape)
            actions = np.clip(
                np.where(self._leads[:, None], wanted, chosen) + noise, -1.0, 1.0
            ).astype(np.float32)
            observation, _, ended, infos = env.step(actions)
            self._last_obs = observation
            self.num_timesteps += self.n_envs
            self._update_info_buffer(infos, ended)
            share = (
                max(0.0, 1.0 - (done + 1) / (self.settings.lead * periods))
                if self.settings.lead
                else 0.0
            )
            self._leads[ended] = self.generator.random(ended.sum()) < share
            callback.update_locals(locals())
            if not callback.on_step():
                return False
        return True

    def _teach(self, rate: float) -> float:
        """Mean loss of the last epoch of regressing the policy's mean on all that was shown, at a
        rate that falls from `rate` along a line.

        Meanwhile features are less their mean and over their standard deviation, which then becomes
        part of the first layer.
        """
        policy: Any = self.policy
        observations, answers = zip(*self._shown, strict=True)
        keys = [*observations[0]] if isinstance(observations[0], dict) else []
        joined: Any = {
            key: np.concatenate([seen[key] for seen in observations]) for key in keys
        } or np.concatenate(observations)
        wanted = torch.as_tensor(np.concatenate(answers), dtype=torch.float32)
        actor = torch.nn.Sequential(*policy.mlp_extractor.policy_net, policy.action_net)
        first = next(layer for layer in actor if isinstance(layer, torch.nn.Linear))
        with torch.no_grad():
            seen = policy.extract_features(
                policy.obs_to_tensor(joined)[0], policy.pi_features_extractor
            )
            mean, deviation = seen.mean(0), seen.std(0) + LEAST_DEVIATION
            seen = (seen - mean) / deviation
            first.bias.add_(first.weight @ mean)
            first.weight.mul_(deviation)
        epochs, batch = self.settings.n_epochs, self.settings.batch_size
        optimizer, found = torch.optim.Adam(actor.parameters(), lr=rate), list[float]()
        orders = (
            torch.as_tensor(self.generator.permutation(len(wanted))).split(batch)
            for _ in range(epochs)
        )
        for index, part in enumerate(batches := [part for order in orders for part in order]):
            optimizer.param_groups[0]["lr"] = rate * (
                1.0 - (1.0 - LAST_RATE) * index / len(batches)
            )
            optimizer.zero_grad()
            error = loss(actor(seen[part]), wanted[part])
            error.backward()
            found.append(error.item())
            torch.nn.utils.clip_grad_norm_(actor.parameters(), 1.0)
            optimizer.step()
        with torch.no_grad():
            first.weight.div_(deviation)
            first.bias.sub_(first.weight @ mean)
        return float(np.mean(found[-len(found) // epochs :]))

    def save_replay_buffer(self, path: str | Path) -> None:
        """Write all that was shown so far, with what teacher and leads remember."""
        save_to_pkl(path, (self._shown, self._leads, self._teacher.memories))

    def load_replay_buffer(self, path: str | Path) -> None:
        """Read what `save_replay_buffer` has written. Loading runs what is in the file."""
        self._shown, self._leads, self._teacher.memories = load_from_pkl(path)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_shown", "_teacher", "_leads"]
