"""Controllers as policies: Stable-Baselines3's `predict` around a controller of `soft_tendon_env.control`.

What the controller knows comes out of the observation and of its own state; what it decides becomes an action.
"""

import warnings
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.control.catalogue import CONTROLLERS, LOOKS_AHEAD, Entry
from soft_tendon_env.control.kalman import USUAL, Uncertainty
from soft_tendon_env.control.protocol import (
    FAILURES,
    Controller,
    ControllerInput,
    ControllerOutput,
    Estimate,
    Estimator,
    Measurement,
    Reference,
)
from soft_tendon_env.control.smith_predictor import SAME, SmithPredictor, whole_periods
from soft_tendon_env.envs.actuation import ActionScale
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.observation import Layout
from soft_tendon_env.envs.tasks import TASKS, TIP, Task
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.policies.estimators import PARAMETERS, EstimatorEntry, Setting, estimator_entry
from soft_tendon_env.policies.observed_poses import target_coordinates, target_poses, tip_poses
from soft_tendon_env.policies.protocol import LostState
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, shown
from soft_tendon_env.tools.types import Array

SAME_COMMAND = 1e-6
"""Share of the largest command by which one that is observed in single precision may differ from what it was."""


class Interface(NamedTuple):
    """Meaning of observations and actions of an environment."""

    task: str
    layout: Layout
    actions: ActionScale
    ahead: Array  # (1 + previews,) [s] of the target's samples, the first 0
    start: Array  # (n_a,) [N] at reset
    start_command: Array  # (n_a,) which holds that
    period: float  # [s] of control
    model: Model  # of the environment, or what is believed of it, which knows what commands make tensions


class RowMemory(NamedTuple):
    """State of a controller's policy for one row, from one call of `predict` to the next."""

    decision: ControllerOutput | None
    tension: Array  # (n_a,) [N] asked for last
    command: Array  # (n_a,) given for that: the same, or displacements [m]
    estimate: Estimate | None
    periods: int  # that the episode has lasted
    sent: tuple[Array, ...]  # tensions (n_a,) [N] asked for, as far as they may not have arrived, the newest last


def interface_of(env: Any) -> Interface:
    """Interface of an environment of this package, single, vector or for Stable-Baselines3, wrapped or not. Raises TypeError."""
    episodes = episodes_of(env)
    own = episodes.task.name, episodes.layout, episodes.actions, episodes.ahead.copy(), episodes.start_tension.copy()
    return Interface(*own, episodes.start_command.copy(), episodes.period, episodes.model)


def observation_options(
    controller: str | Entry,
    task: str,
    period: float = 0.02,
    latency: float = 0.0,
    estimator: str | None = None,
    regime: str | None = None,
) -> dict[str, Any]:
    """Options of an environment of this task ("TipPose", ...) under which a controller sees what it needs. Raises ValueError.

    estimator: of ESTIMATORS, which finds the coordinates; None: they are observed. regime: of REGIMES, what a Kalman filter is told, by
    default "sensors". latency: delay of commands [s] that the controller is to make up for, see `make_policy`.
    """
    found = None if estimator is None else estimator_entry(estimator)
    ahead = _periods_ahead(_entry(controller, task), latency, period, found)
    options: dict[str, Any] = {"preview": [period * k for k in range(1, ahead + 1)]}
    if estimator is None and regime is None:
        return options
    regime = "sensors" if regime is None else regime
    if regime not in REGIMES:
        raise ValueError(f"regime is {regime!r}: {not_among(regime, REGIMES)}")
    told = REGIMES[regime]
    return {**options, "observation": (*told.measured, *_task(task).measured_reference), "sensors": told.sensors or ()}


def make_policy(
    controller: str | Entry,
    env: Any,
    model: Model | str | None = None,
    latency: float | None = None,
    estimator: str | None = None,
    uncertainty: Uncertainty = USUAL,
) -> "ControllerPolicy":
    """Controller of `soft_tendon_env.control.CONTROLLERS` as a policy, for an environment made with `observation_options`.

    model: what the controller believes, the environment's own before randomisation by default; a name, "fast": that at another fidelity,
    see envs.Options. Where coordinates are observed, it should have the same. estimator: of ESTIMATORS, finds the coordinates from what
    else is observed, knowing the noise of the sensors; None: they are observed. uncertainty: of what it believes, for a Kalman filter.
    latency: delay of commands [s] that it knows of and makes up for (Smith predictor), by default that of the actuators in its model; with
    estimator="adaptive" what it believes at first.
    Raises TypeError, ValueError; ConfigurationError where the environment does not show what the controller needs.
    """
    finds = None if estimator is None else estimator_entry(estimator)
    episodes, interface = episodes_of(env), interface_of(env)
    believed = build_model(episodes.model.scene, model) if isinstance(model, str) else model or episodes.model
    if believed.coordinate_count != episodes.model.coordinate_count:
        if estimator is None or episodes.task.shapes:
            there = f"{believed.coordinate_count} coordinates where the environment's has {episodes.model.coordinate_count}"
            raise ValueError(f"the controller's model has {there}, which are observed: it should have the same strain parametrisation")
        interface = interface._replace(model=believed)
    believed, delay = _under_tensions(believed)
    late = checked_number("latency", delay if latency is None else latency, 0.0, "a number of seconds, at least 0")
    entry = _entry(controller, episodes.task.name)
    _check_preview(entry, interface, _periods_ahead(entry, late, episodes.period, finds))
    greatest = late if finds is None else finds.greatest_latency or late
    predictor = SmithPredictor(believed, greatest, episodes.period) if greatest else None
    setting = _setting(episodes, believed, late, uncertainty)
    if finds is not None and finds.greatest_latency and {"q", "q_dot"} & {*setting.observed}:
        text = "an estimate of the latency from observed coordinates makes the loop unstable, with errors up to a thousand times as large"
        warnings.warn(f"{text}: make the environment with observation_options(..., estimator={estimator!r})", stacklevel=2)
    found = None if finds is None else finds.make(believed, setting)
    return ControllerPolicy(entry.make(believed, episodes.limits.copy(), episodes.period), interface, found, predictor)


def _under_tensions(model: Model) -> tuple[Model, float]:
    """Model of the same arm whose commands are tensions that arrive at once, and the delay of its actuators [s]."""
    effects = model.scene.effects
    changes: dict[str, Any] = {f"effects.{name}": None for name, effect in effects.chosen().items() if effect.command_unit != "N"}
    delay = 0.0 if effects.actuators is None else effects.actuators.delay
    if delay:
        changes["effects.actuators.delay"] = 0.0
    return build_model(model.scene.replace(changes)) if changes else model, delay


def _setting(episodes: Episodes, model: Model, latency: float, uncertainty: Uncertainty) -> Setting:
    """Observation of an environment, for an estimator that believes in a model and a latency [s] of commands."""
    foreign = () if model.scene.strain == episodes.model.scene.strain else ("coordinates", "rates")  # of another parametrisation
    observed = tuple(field for group, field in PARAMETERS.items() if group in episodes.layout.slices and group not in foreign)
    noise = episodes.options.randomize.noise
    return Setting(episodes.period, episodes.start_tension.copy(), episodes.sensors.copy(), noise, observed, latency, uncertainty)


def _periods_ahead(entry: Entry, latency: float, period: float, estimator: EstimatorEntry | None) -> int:
    """Control periods ahead of now for which a controller should be told the target, so that it makes up for a latency [s] too."""
    late, rest = whole_periods(latency if estimator is None else estimator.greatest_latency or latency, period)
    return entry.looks_ahead + late + (rest > 0.0)


def _check_preview(entry: Entry, interface: Interface, periods: int) -> None:
    """Raises ConfigurationError where a target that moves is not told for as long as a controller looks ahead, or for every period of it.

    Between the times of a preview the target goes straight. What looks two periods ahead takes the target's velocity of that, and feedback
    makes up for the rest; what plans for longer follows every kink, tens of times as far off.
    """
    told, needed = interface.ahead, interface.period * np.arange(1, periods + 1)
    missed = np.abs(told[:, None] - needed).min(axis=0) > SAME * needed
    if entry.looks_ahead <= LOOKS_AHEAD:
        missed = needed > told[-1] * (1.0 + SAME)
    if _task(interface.task).goal is None and missed.any():
        text = f"tells the target at {shown(told[1:].tolist())} s, and it is needed at every control period up to {needed[-1]:.3g} s"
        _fail("preview", f"{text}: make the environment with observation_options()")


def _fail(key: str, text: str) -> NoReturn:
    raise ConfigurationError([Problem((key,), text)], "environment")


def _task(name: str) -> Task:
    if name not in TASKS:
        raise ValueError(f"task is {name!r}: {not_among(name, TASKS)}")
    return TASKS[name]


def _entry(controller: str | Entry, task: str) -> Entry:
    if isinstance(controller, Entry):
        return controller
    entries = CONTROLLERS.get(_task(task).name, {})
    if controller not in entries:
        raise ValueError(f"controller is {controller!r}: {not_among(controller, entries)}")
    return entries[controller]


class ControllerPolicy:
    """Controller behind Stable-Baselines3's `predict`, for one row or many.

    estimator: finds the coordinates from what is measured; None: they are observed. predictor: of where the arm will be when commands
    arrive; None: they arrive at once. Raises ConfigurationError where the observation lacks what the controller needs.
    """

    def __init__(
        self,
        controller: Controller,
        interface: Interface,
        estimator: Estimator | None = None,
        predictor: SmithPredictor | None = None,
    ) -> None:
        self.controller, self.interface, self.estimator, self.predictor = controller, interface, estimator, predictor
        self._lost = LostState(type(controller).__name__)
        own = interface.model
        pulled = None if own.scene.effects.command_unit == "N" else build_model(own.scene.replace({"effects": own.scene.effects.on_arm()}))
        self._simulation = None if pulled is None else Simulation(pulled)  # of the arm under tensions
        groups = interface.layout.slices
        state = ("q", "q_dot") if estimator is None else estimator.needs
        needed = [*TIP, *(group for group, name in PARAMETERS.items() if name in state)]
        needed += [] if "wanted_coordinates" in groups else _task(interface.task).reference
        if missing := [name for name in needed if name not in groups]:
            _fail("observation", f"lacks {', '.join(missing)}, which {type(controller).__name__} needs: make it with observation_options()")
        if (np.diff(interface.ahead) <= 0.0).any():
            _fail("preview", f"is {interface.ahead[1:].tolist()} s: it should be times that increase by at least a control period")

    def predict(
        self,
        observation: Any,
        state: tuple[RowMemory, ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[RowMemory, ...]]:
        """Actions (n_a,) for one observation, (rows, n_a) for many, and the state to give back with the next ones.

        state: what the last call returned, None at the beginning of episodes; without it every call is the first of an episode, and the
        arm tracks far worse: protocol.STATELESS_CALLS of them in a row end in a UserWarning. episode_start (rows,) bool: rows that forget.
        `deterministic` is not used: controllers always are.
        """
        self._lost.notice(state is None and not np.any(episode_start))
        flat = observation["observation"] if isinstance(observation, dict) else observation
        values = self.interface.layout.values(np.atleast_2d(flat))
        goal = np.atleast_2d(observation["desired_goal"]).astype(np.float64) if isinstance(observation, dict) else None
        memories: list[RowMemory | None] = [None] * len(values["tip_position"]) if state is None else list(state)
        if episode_start is not None:
            memories = [None if begins else memory for begins, memory in zip(np.atleast_1d(episode_start), memories, strict=True)]
        poses = tip_poses(values)
        targets = target_poses(values, poses)
        actions, after = [], []
        for row, kept in enumerate(memories):
            own = {name: value[row] for name, value in values.items()}
            memory = self._fresh(own) if kept is None else kept
            estimate = self._estimated(own, poses[row], memory)
            target = Reference(
                ahead=self.interface.ahead if goal is None else np.zeros(1),
                tip_pose=None if targets is None else targets[row],
                tip_position=None if goal is None else goal[row : row + 1],
                q=target_coordinates(own, len(self.interface.ahead)),
            )
            q, q_dot, pose = estimate.q, estimate.q_dot, poses[row] if estimate.tip_pose is None else estimate.tip_pose
            now = ControllerInput(q, q_dot, pose, memory.tension, target, memory.periods * self.interface.period, estimate.input_error)
            if self.predictor is not None:
                now = self.predictor.predicted(now, memory.sent, estimate.latency)
            decision = self.controller.act(now, None if memory.decision is None else memory.decision.memory)
            action, asked, command = self._commanded(decision.tension, q, q_dot, memory.command)
            actions.append(action)
            sent = (*memory.sent[1:], asked) if memory.sent else ()
            after.append(RowMemory(decision, asked, command, estimate, memory.periods + 1, sent))
        return actions[0] if np.ndim(flat) == 1 else np.stack(actions), tuple(after)

    def _fresh(self, own: dict[str, Array]) -> RowMemory:
        """The memory of a row whose episode begins, from its observation by group: under the command that is observed, or else that of
        rest."""
        start, command, scale = self.interface.start, self.interface.start_command, self.interface.actions
        seen = own.get("command", command)
        if "command" not in own and "last_action" in own and scale.increment is None:
            seen = scale.command(own["last_action"], command)
        if not np.allclose(seen, command, rtol=0.0, atol=SAME_COMMAND * np.abs(scale.greatest)):
            command, start = seen, seen if self._simulation is None else start
        waiting = max(0 if self.predictor is None else self.predictor.history, 0 if self.estimator is None else self.estimator.history)
        return RowMemory(None, start, command, None, 0, (start,) * waiting)

    def _commanded(self, tension: Array, q: Array, q_dot: Array, before: Array) -> tuple[NDArray[np.float32], Array, Array]:
        """The action that asks for tensions (n_a,) [N] at q, q_dot after a command (n_a,), the tensions that it asks for, and its command.

        Displacements are those that have these tensions where the arm would be under them at the end of the period: held from where it is,
        they would hold it there.
        """
        scale, model = self.interface.actions, self.interface.model
        if self._simulation is None:
            action = scale.action(tension, before).astype(np.float32)
            command = scale.command(action.astype(np.float64), before)
            return action, command, command
        try:
            self._simulation.reset(q, q_dot)
            self._simulation.step(tension, self.interface.period)
            q = self._simulation.state.q
        except FAILURES:
            pass  # from where it is, then
        action = scale.action(model.command(tension, q), before).astype(np.float32)
        return action, tension, scale.command(action.astype(np.float64), before)

    def _estimated(self, own: dict[str, Array], pose: Array, memory: RowMemory) -> Estimate:
        """State of a row from its observation, by group, and its measured pose (4, 4)."""
        if self.estimator is None:
            return Estimate(own["coordinates"], own["rates"])
        fields = {name: own[group] for group, name in PARAMETERS.items() if name in self.estimator.needs}
        for name in {"strain", "strain_rate"} & fields.keys():
            fields[name] = fields[name].reshape(-1, 6)
        sent, time = np.array(memory.sent).reshape(-1, self.interface.start.size), memory.periods * self.interface.period
        return self.estimator.estimate(Measurement(pose, sent, time, **fields), memory.estimate)
