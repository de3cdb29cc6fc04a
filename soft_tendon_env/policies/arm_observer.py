"""Observer of arms for policies: their states as measured, estimated and predicted.

A state estimator finds the state from measurements and commands; a predictor plays it forward to
the time at which the present command will arrive.
"""

from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.control import protocol
from soft_tendon_env.control.arrival_predictor import ArrivalPredictor
from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.diagnosis import Diagnosis
from soft_tendon_env.control.kalman import ExtendedKalmanFilter
from soft_tendon_env.control.uncertainty import Setting, Uncertainty
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.model.model import Model
from soft_tendon_env.policies.estimators import PARAMETERS, EstimatorEntry
from soft_tendon_env.tools.types import Array

# share of the largest command by which one that is observed in single precision may differ from
# what it was
SAME_COMMAND = 1e-6


class ArmMemory(NamedTuple):
    """Memory of one arm from one control period to the next."""

    estimate: protocol.Estimate | None
    periods: int  # that the episode has lasted
    # tensions (n_a,) [N] asked for, as far as they may not have arrived, the newest last
    sent: tuple[Array, ...]


class Sight(NamedTuple):
    """An arm as it is now, and as it will be when the present command arrives."""

    estimate: protocol.Estimate
    arrival: protocol.ControllerInput


class ArmObserver:
    """State of arms out of their observations.

    Args:
        episodes: of the environment.
        estimator: finds the coordinates; None: they are observed.
        predictor: of where the arm will be when commands arrive; None: they arrive at once.
    """

    def __init__(
        self,
        episodes: Episodes,
        estimator: protocol.Estimator | None = None,
        predictor: ArrivalPredictor | None = None,
    ) -> None:
        self.estimator = estimator
        self.predictor = predictor
        self._period = episodes.period
        self._start = episodes.start_tension.copy()
        self._start_command = episodes.start_command.copy()
        self._greatest_command = np.abs(episodes.actions.greatest)
        self._gives_tensions = episodes.model.scene.effects.command_unit == "N"
        # of lengths and strains, which are observed as differences
        self._zeros = episodes.observed.rest._asdict()
        self._waiting = 0  # tensions that are remembered
        for part in (estimator, predictor):
            if part is not None:
                self._waiting = max(self._waiting, part.history)

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of Measurement or ControllerInput that should be observed, besides the pose."""
        return ("q", "q_dot") if self.estimator is None else self.estimator.needs

    def begin(self, groups: dict[str, Array]) -> tuple[Array, Array, ArmMemory]:
        """Tensions (n_a,) [N], commands (n_a,) and memory when an episode begins.

        It is under the command that is observed, or else that of rest.

        Args:
            groups: its observation by group.
        """
        tension = self._start
        command = self._start_command
        observed = groups.get("command", command)
        round_off = SAME_COMMAND * self._greatest_command
        if not np.allclose(observed, command, 0.0, round_off):
            command = observed
            if self._gives_tensions:
                tension = observed
        sent = (tension,) * self._waiting
        return tension, command, ArmMemory(None, 0, sent)

    def look(
        self,
        groups: dict[str, Array],
        pose: Array,
        target: protocol.Reference,
        tension: Array,
        memory: ArmMemory,
    ) -> Sight:
        """State of an arm at the beginning of a control period.

        Args:
            groups: its observation by group.
            pose: measured (4, 4).
            target: of the arm.
            tension: (n_a,) [N] asked for last.
            memory: from the last period.
        """
        time = memory.periods * self._period
        estimate = self._estimate(groups, pose, time, memory)
        now = protocol.ControllerInput(
            estimate.q,
            estimate.q_dot,
            pose if estimate.tip_pose is None else estimate.tip_pose,
            tension,
            target,
            time,
            estimate.input_error,
            estimate.force_error,
            timing_spread=estimate.timing_spread,
            surprise=estimate.surprise,
        )
        if self.predictor is not None:
            now = self.predictor.predict(now, memory.sent, estimate.timing)
        return Sight(estimate, now)

    def remember(self, memory: ArmMemory, estimate: protocol.Estimate, asked: Array) -> ArmMemory:
        """Memory of an arm a period later, of which tensions `asked` (n_a,) [N] were asked."""
        every_sent = (*memory.sent[1:], asked)
        return ArmMemory(estimate, memory.periods + 1, every_sent[: self._waiting])

    def diagnoses(self, memories: tuple[ArmMemory, ...]) -> tuple[Diagnosis, ...]:
        """Estimates of the Kalman filter about arms, in SI units.

        Raises:
            TypeError: there is no Kalman filter.
            ValueError: nothing has been estimated yet.
        """
        if not isinstance(self.estimator, ExtendedKalmanFilter):
            raise TypeError(
                f"{type(self.estimator).__name__} makes no diagnosis: only the Kalman filter does,"
                " as in filtered:predictive"
            )
        found = []
        for memory in memories:
            if memory.estimate is None:
                raise ValueError("state has no estimate yet: it should be what predict() returned")
            found.append(self.estimator.diagnosis(memory.estimate))
        return tuple(found)

    def _estimate(
        self, groups: dict[str, Array], pose: Array, time: float, memory: ArmMemory
    ) -> protocol.Estimate:
        """Coordinates and rates, which the environment observes without an estimator."""
        if self.estimator is None:
            coordinates: Any = groups.get("coordinates")
            rates: Any = groups.get("rates")
            return protocol.Estimate(coordinates, rates)
        fields = {}
        for group, name in PARAMETERS.items():
            if name not in self.estimator.needs:
                continue
            value = groups[group]
            if name in ("strain", "strain_rate"):
                value = value.reshape(-1, 6)
            if name in self._zeros:
                value = value + self._zeros[name]
            fields[name] = value
        history = self.estimator.history
        last_sent = memory.sent[-history:] if history else ()
        sent = np.array(last_sent).reshape(-1, self._start.size)
        measurement = protocol.Measurement(pose, sent, time, **fields)
        return self.estimator.estimate(measurement, memory.estimate)


def missing_groups(observer: ArmObserver, groups: dict[str, Any]) -> list[str]:
    """Observation groups that an observer needs besides the tip's pose, and that are not there."""
    needed = [group for group, field in PARAMETERS.items() if field in observer.needs]
    return [group for group in needed if group not in groups]


def believed_arm(model: Model) -> tuple[Model, Timing]:
    """Model of the same arm whose commands are tensions that arrive at once.

    Returns:
        The model, and what is known of the timing of commands besides the model's own lag: the
        delay of its actuators, which it leaves out. A model without actuators knows nothing.
    """
    effects = model.scene.effects
    changes: dict[str, Any] = {}
    for name, effect in effects.chosen().items():
        if effect.command_unit != "N":
            changes[f"effects.{name}"] = None
    known = Timing(None, None)
    if effects.actuators is not None:
        known = Timing(effects.actuators.delay, 0.0)
        if effects.actuators.delay:
            changes["effects.actuators.delay"] = 0.0
    if changes:
        model = build_model(model.scene.replace(changes))
    return model, known


def greatest_timing(known: Timing, estimator: EstimatorEntry | None) -> Timing:
    """Greatest latency and lag [s] of commands that are made up for: known, or estimated."""
    estimated = Timing(0.0, 0.0) if estimator is None else estimator.greatest_timing
    return Timing(
        estimated.latency if known.latency is None else known.latency,
        estimated.lag if known.lag is None else known.lag,
    )


def make_observer(
    episodes: Episodes,
    model: Model,
    known: Timing,
    estimator: EstimatorEntry | None,
    uncertainty: Uncertainty,
) -> ArmObserver:
    """Observer of the arms of an environment.

    Args:
        episodes: of the environment.
        model: of the arm, as it is believed to be under tensions.
        known: latency and lag [s] of commands; None: not known.
        estimator: None: coordinates are observed.
        uncertainty: of a Kalman filter.
    """
    greatest = greatest_timing(known, estimator)
    predictor = None
    if max(greatest) > 0.0:
        predictor = ArrivalPredictor(model, greatest, episodes.period)
    made = None
    if estimator is not None:
        made = estimator.make(model, _setting(episodes, known, uncertainty))
    return ArmObserver(episodes, made, predictor)


def _setting(episodes: Episodes, known: Timing, uncertainty: Uncertainty) -> Setting:
    """Values of the environment that an estimator knows, with the timing of commands [s]."""
    measured = []
    for group, field in PARAMETERS.items():
        is_measured = field in protocol.Measurement._fields
        if is_measured and group in episodes.layout.slices:
            measured.append(field)
    return Setting(
        episodes.period,
        episodes.start_tension.copy(),
        tuple(measured),
        episodes.sensors.copy(),
        episodes.options.randomize.noise,
        known.latency,
        known.lag,
        uncertainty,
    )
