"""Imitation of a privileged, model-based teacher by dataset aggregation, the algorithm "DAgger".

The teacher knows each arm as it was drawn (material, payload, actuators, delay) and its true state;
the agent sees its own observation alone, and learns to act as the teacher would in the states that
its own actions lead to. Ross, Gordon and Bagnell, A reduction of imitation learning and structured
prediction to no-regret online learning, AISTATS 2011; Chen et al., Learning by cheating, CoRL 2019.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.save_util import load_from_pkl, save_to_pkl
from torch import Tensor

from soft_tendon_env.control.catalogue import tip_pose_objective
from soft_tendon_env.control.command_filter import whole_periods
from soft_tendon_env.control.feedforward import ReferenceGovernor, StaticFeedforward
from soft_tendon_env.control.objectives import TipPosition, TrackedObjective
from soft_tendon_env.control.protocol import Controller, ControllerInput, Reference
from soft_tendon_env.control.shape_tracking import ShapeTracking
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.learning.algorithm import ActorAlgorithm
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.tools.types import Array

# control periods ahead for which the teacher needs the target, besides those of the delay
LOOKS_AHEAD = 2
ROUND_OFF = 1e-9  # of a delay, in control periods
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


class Arrival(NamedTuple):
    """States of rows when their commands arrive."""

    q: Array  # (rows, n)
    q_dot: Array  # (rows, n)
    tip_pose: Array  # (rows, 4, 4)


class Teacher:
    """A controller per row that knows the row's arm, actuators, delay and state.

    It is the catalogue's `tracking`, without integral. Where commands are late, a copy of the arms
    gets those on their way first (Smith predictor, all rows at once).
    """

    def __init__(self, episodes: Episodes, settling_time: float) -> None:
        """A teacher of the rows of an environment.

        Args:
            episodes: the rows.
            settling_time: of the controllers [s].

        Raises:
            ValueError: commands are no tensions, or late by the scene rather than by `randomize`.
        """
        effects = episodes.model.scene.effects
        is_command = effects.command_unit != "N"
        if is_command or effects.actuators is not None:
            raise ValueError(
                "a teacher needs commands that are tensions and act as they are, without"
                " tendon_elasticity and actuators"
            )
        self.episodes = episodes
        self._settling_time = settling_time
        nothing = np.empty(0)
        self._copy = Arms(
            episodes.model,
            episodes.size,
            episodes.period,
            nothing,
            nothing,
            threads=1,
        )
        self._laws: list[Controller | None] = [None] * episodes.size
        self.memories: list[Any] = [None] * episodes.size  # of the laws

    def actions(self) -> Array:
        """Actions (rows, n_a) that each row should take now.

        A row begins anew where its episode does. Raises ValueError for too short a preview.
        """
        episodes = self.episodes
        actuation = episodes.actuation
        period = episodes.period
        rows = range(episodes.size)
        delays = [actuation.delay(row) for row in rows]
        late = np.array(delays)
        commands = [actuation.sent(row) for row in rows]
        sent = np.stack(commands)
        periods_late = late.max() / period
        longest = np.ceil(periods_late - ROUND_OFF)
        target = episodes.target_ahead(LOOKS_AHEAD + int(longest))
        arrival = self._predict_arrival(sent, late)
        times = target.tip_pose.shape[1]
        counts = np.arange(times, dtype=np.float64)
        ahead = period * counts
        shape = (episodes.size, episodes.model.tendon_count)
        tensions = np.empty(shape)
        for row in rows:
            times_ahead = ahead - late[row]
            reference = self._reference(row, target, times_ahead)
            now = self._row_input(row, arrival, sent, late, reference)
            tension = self._decide(row, now)
            tensions[row] = actuation.commanded(tension, row)
        return actuation.actions.action(tensions, actuation.command)

    def _row_input(
        self, row: int, arrival: Arrival, sent: Array, late: Array, reference: Reference
    ) -> ControllerInput:
        """Knowledge of the controller of a row when its command arrives."""
        seconds = self.episodes.arms.rows.clock[row, 0]
        clock = float(seconds)
        time = clock + late[row]
        last_tension = sent[row, -1]
        return ControllerInput(
            arrival.q[row],
            arrival.q_dot[row],
            arrival.tip_pose[row],
            last_tension,
            reference,
            time,
        )

    def _decide(self, row: int, now: ControllerInput) -> Array:
        """Tensions (n_a,) [N] by the controller of a row, a new one where its episode begins."""
        law = self._laws[row]
        memory = self.memories[row]
        begins = self.episodes.step_count[row] == 0
        if law is None or begins:
            law = self._make_controller(row)
        if begins:
            memory = None
        decision = law.act(now, memory)
        self._laws[row] = law
        self.memories[row] = decision.memory
        return decision.tension

    def _make_controller(self, row: int) -> Controller:
        """Controller of a row's arm as it was drawn."""
        episodes = self.episodes
        model = episodes.arms.model_of(row)
        least_and_greatest = episodes.limits.T
        bounds = [episodes.actuation.acting(bound, row) for bound in least_and_greatest]
        limits = np.stack(bounds, axis=1)
        arm = (model, limits, episodes.period)
        if episodes.task.shapes:
            return ShapeTracking(*arm, settling_time=self._settling_time)
        objective: TrackedObjective = tip_pose_objective(model)
        if episodes.task.goal:
            objective = TipPosition()
        feedforward = StaticFeedforward(*arm, objective)
        tracking = TipTracking(*arm, objective, settling_time=self._settling_time)
        return ReferenceGovernor(feedforward, tracking)

    def _predict_arrival(self, sent: Array, late: Array) -> Arrival:
        """States of rows when commands arrive; those now where that motion fails.

        Args:
            sent: (rows, m, n_a) tensions [N] that were sent, the newest last.
            late: (rows,) delays [s].
        """
        arms = self.episodes.arms
        predicted = self._copy
        for name, values in arms.rows.fields().items():
            getattr(predicted.rows, name)[...] = values
        durations = self._durations(sent, late)
        predicted.step(sent, np.flatnonzero(late), durations)
        is_fine = predicted.outcome.status == OK
        is_predicted = (late > 0.0) & is_fine

        def choose(arrived: Array, now: Array) -> Array:
            chosen = now.copy()
            chosen[is_predicted] = arrived[is_predicted]
            return chosen

        return Arrival(
            choose(predicted.rows.q, arms.rows.q),
            choose(predicted.rows.q_dot, arms.rows.q_dot),
            choose(predicted.reading.tip_pose, arms.reading.tip_pose),
        )

    def _durations(self, sent: Array, late: Array) -> Array:
        """How long (rows, m) [s] tensions that were sent act until the next command arrives."""
        period = self.episodes.period
        durations = np.zeros(sent.shape[:2])
        count = sent.shape[1]
        for row, delay in enumerate(late):
            whole, rest = whole_periods(delay, period)
            durations[row, count - whole :] = period
            durations[row, -1 - whole] = rest  # the last part of the one before
        return durations

    def _reference(self, row: int, target: TargetSamples, ahead: Array) -> Reference:
        """Reference of the controller of a row at times (m,) [s] from now."""
        episodes = self.episodes
        pose = target.tip_pose[row]
        if episodes.task.shapes:
            shape = target.q[row]
            q = episodes.arms.coordinates_of(row, shape)
            return Reference(ahead, tip_pose=pose, q=q)
        if episodes.task.goal:
            return Reference(ahead, tip_position=pose[:, :3, 3])
        return Reference(ahead, tip_pose=pose)


def loss(means: Tensor, answers: Tensor) -> Tensor:
    """Huber loss, in which a mean beyond the bounds is right where the teacher is at them."""
    raised = means.clamp(min=-1.0)
    is_least = answers <= -1.0
    least = torch.where(is_least, raised, means)
    lowered = means.clamp(max=1.0)
    bounded = torch.where(answers >= 1.0, lowered, least)
    return torch.nn.functional.smooth_l1_loss(bounded, answers, beta=EXACT)


class DAgger(ActorAlgorithm):
    """Dataset aggregation (DAgger) with Stable-Baselines3's interface, on this package's rows.

    In every round the teacher says what it would do in each control period, while a share of the
    episodes is led by it and the others by the agent; then the agent's mean is regressed on all
    that was said so far. See DAggerSettings and ActorAlgorithm for arguments.

    Raises:
        TypeError: the environment is of another package.
        ValueError: no teacher can control the arms, see `Teacher`, or observations are under
            running statistics, since the first layer has a scale of its own.
    """

    settings_class: ClassVar[type] = DAggerSettings
    generator: np.random.Generator
    _teacher: Teacher
    # observations of all rows, and the answers (rows, n_a), by control period
    _shown: list[tuple[Any, Array]]

    def _prepare(self) -> None:
        statistics = self.get_vec_normalize_env()
        if statistics is not None and statistics.norm_obs:
            raise ValueError(
                "normalise.observations is true: DAgger has a scale of its own for what it observes"
            )
        # what a loaded training has already
        known = vars(self)
        generator = np.random.default_rng(self.seed)
        known.setdefault("generator", generator)
        known.setdefault("_shown", [])
        episodes = self.rows.episodes
        if "_teacher" not in known or self._teacher.episodes is not episodes:
            self._leads = np.ones(self.n_envs, dtype=bool)
            self._teacher = Teacher(episodes, self.settings.settling_time)

    def _learn_part(self, callback: BaseCallback) -> bool:
        periods = _divided_up(self._total_timesteps, self.n_envs)
        done = self.num_timesteps // self.n_envs
        callback.on_rollout_start()
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        ended = self._end_of_round(done, periods)
        if not self._watch(ended, periods, callback):
            return False
        callback.on_rollout_end()
        rate = self.lr_schedule(self._current_progress_remaining)
        self.logger.record("train/loss", self._teach(rate))
        return True

    def _end_of_round(self, done: int, periods: int) -> int:
        """Control period at which the round ends that the period `done` of `periods` is in."""
        rounds = self.settings.rounds
        for number in range(1, rounds + 1):
            end = _divided_up(number * periods, rounds)
            if end > done:
                return end
        raise AssertionError("a training learns no part after its last period")

    def _watch(self, end: int, periods: int, callback: BaseCallback) -> bool:
        """Act until control period `end` of `periods`, while the teacher says what it would do.

        Returns:
            False where the callback ends it.
        """
        env: Any = self.env
        observation: Any = self._last_obs
        begin = self.num_timesteps // self.n_envs
        for done in range(begin, end):
            answers = self._teacher.actions()
            self._shown.append((observation, answers))
            actions = self._noisy_actions(observation, answers)
            observation, _, ended, infos = env.step(actions)
            self._last_obs = observation
            self.num_timesteps += self.n_envs
            self._update_info_buffer(infos, ended)
            draws = self.generator.random(ended.sum())
            # who leads an episode leads it to its end
            lead_share = self._lead_share(done + 1, periods)
            self._leads[ended] = draws < lead_share
            callback.update_locals(locals())
            if not callback.on_step():
                return False
        return True

    def _noisy_actions(self, observation: Any, answers: Array) -> Any:
        """Actions (rows, n_a), float32, of the teacher where it leads, else of the agent."""
        chosen, _ = self.predict(observation, deterministic=True)
        draws = self.generator.standard_normal(answers.shape)
        noise = self.settings.noise * draws
        leads = self._leads[:, None]
        actions = np.where(leads, answers, chosen)
        bounded = np.clip(actions + noise, -1.0, 1.0)
        return bounded.astype(np.float32)

    def _lead_share(self, done: int, periods: int) -> float:
        """Share of the episodes that the teacher leads after so many control periods."""
        if not self.settings.lead:
            return 0.0
        led = self.settings.lead * periods
        return max(0.0, 1.0 - done / led)

    def _teach(self, rate: float) -> float:
        """Mean loss of the last epoch of regressing the policy's mean on all that was shown.

        The learning rate falls from `rate` along a line. Meanwhile features are less their mean and
        over their standard deviation, which then becomes part of the first layer.
        """
        policy: Any = self.policy
        observations, answers = self._joined()
        actor = torch.nn.Sequential(*policy.mlp_extractor.policy_net, policy.action_net)
        layers = (layer for layer in actor if isinstance(layer, torch.nn.Linear))
        first = next(layers)
        # the first layer sees features of one scale, by weights that give the same values
        with torch.no_grad():
            tensors, _ = policy.obs_to_tensor(observations)
            features = policy.extract_features(tensors, policy.pi_features_extractor)
            mean = features.mean(0)
            deviation = features.std(0) + LEAST_DEVIATION
            features = (features - mean) / deviation
            first.bias.add_(first.weight @ mean)
            first.weight.mul_(deviation)
        losses = self._regress(actor, features, answers, rate)
        # and back: the policy itself sees features as they are
        with torch.no_grad():
            first.weight.div_(deviation)
            first.bias.sub_(first.weight @ mean)
        last = -len(losses) // self.settings.n_epochs
        return float(np.mean(losses[last:]))

    def _joined(self) -> tuple[Any, Tensor]:
        """All observations that were shown, and the answers to them."""
        observations, answers = zip(*self._shown, strict=True)
        every_answer = np.concatenate(answers)
        together = torch.as_tensor(every_answer, dtype=torch.float32)
        if not isinstance(observations[0], dict):
            return np.concatenate(observations), together
        joined = {}
        for key in observations[0]:
            parts = [observation[key] for observation in observations]
            joined[key] = np.concatenate(parts)
        return joined, together

    def _regress(
        self, actor: torch.nn.Sequential, features: Tensor, answers: Tensor, rate: float
    ) -> list[float]:
        """Losses of all batches of stochastic gradient descent (Adam)."""
        optimizer = torch.optim.Adam(actor.parameters(), lr=rate)
        batches: list[Tensor] = []
        for _ in range(self.settings.n_epochs):
            permutation = self.generator.permutation(len(answers))
            order = torch.as_tensor(permutation)
            batches += order.split(self.settings.batch_size)
        losses = []
        for index, batch in enumerate(batches):
            lost = (1.0 - LAST_RATE) * index / len(batches)
            left = 1.0 - lost
            optimizer.param_groups[0]["lr"] = rate * left
            optimizer.zero_grad()
            means = actor(features[batch])
            error = loss(means, answers[batch])
            error.backward()
            losses.append(error.item())
            torch.nn.utils.clip_grad_norm_(actor.parameters(), 1.0)
            optimizer.step()
        return losses

    def save_replay_buffer(self, path: str | Path) -> None:
        """Write all that was shown so far, with what teacher and leads remember."""
        midst = (self._shown, self._leads, self._teacher.memories)
        save_to_pkl(path, midst)

    def load_replay_buffer(self, path: str | Path) -> None:
        """Read what `save_replay_buffer` has written.

        Loading runs what is in the file.
        """
        shown, leads, memories = load_from_pkl(path)
        self._shown = shown
        self._leads = leads
        self._teacher.memories = memories

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_shown", "_teacher", "_leads"]


def _divided_up(number: int, by: int) -> int:
    """Quotient of whole numbers, rounded up."""
    return -(-number // by)
