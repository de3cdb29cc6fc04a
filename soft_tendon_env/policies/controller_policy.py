"""Controllers as policies: Stable-Baselines3's `predict` around a controller of
`soft_tendon_env.control`.

What the controller knows comes out of the observation and of its own state; what it decides becomes
an action.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.control import protocol
from soft_tendon_env.control.catalogue import CONTROLLERS, LOOKS_AHEAD, Entry
from soft_tendon_env.control.kalman import USUAL, Setting, Uncertainty
from soft_tendon_env.control.smith_predictor import SAME, SmithPredictor, whole_periods
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.tasks import TASKS, TIP
from soft_tendon_env.mechanics.motion.pose_errors import move_poses
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.policies.estimators import ESTIMATORS, PARAMETERS, EstimatorEntry
from soft_tendon_env.policies.protocol import LostState
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.configuration import (
    ConfigurationError,
    Problem,
    not_among,
    not_registered,
    shown,
)
from soft_tendon_env.tools.types import Array

# share of the largest command by which one that is observed in single precision may differ from
# what it was
SAME_COMMAND = 1e-6


class RowMemory(NamedTuple):
    """State of a controller's policy for one row, from one call of `predict` to the next."""

    decision: protocol.ControllerOutput | None
    tension: Array  # (n_a,) [N] asked for last
    command: Array  # (n_a,) given for that: the same, or displacements [m]
    estimate: protocol.Estimate | None
    periods: int  # that the episode has lasted
    sent: tuple[
        Array, ...
    ]  # tensions (n_a,) [N] asked for, as far as they may not have arrived, the newest last


def observation_options(
    controller: str | Entry,
    task: str,
    period: float = 0.02,
    latency: float = 0.0,
    estimator: str | None = None,
    regime: str | None = None,
) -> dict[str, Any]:
    """Options of an environment of this task ("TipPose", ...) under which a controller sees what it
    needs, and gives tensions. Raises ValueError.

    estimator: of ESTIMATORS, which finds the coordinates; None: they are observed. regime: of
    REGIMES, what a Kalman filter observes, by default "sensors". latency: known input delay [s]
    that the controller compensates, see `make_policy`.
    """
    finds, reference = (
        _among("estimator", estimator, ESTIMATORS),
        _among("task", task, TASKS).measured_reference,
    )
    ahead = _periods_ahead(
        _among("controller", controller, CONTROLLERS.get(task, {})), latency, period, finds
    )
    options: dict[str, Any] = {
        "action": "tension",
        "preview": [period * k for k in range(1, ahead + 1)],
    }
    if estimator is None and regime is None:
        return options
    told = _among("regime", regime or "sensors", REGIMES)
    return {**options, "observation": (*told.measured, *reference), "sensors": told.sensors or ()}


def make_policy(
    controller: str | Entry,
    env: Any,
    model: Model | None = None,
    latency: float | None = None,
    estimator: str | None = None,
    uncertainty: Uncertainty = USUAL,
) -> "ControllerPolicy":
    """Controller of `soft_tendon_env.control.CONTROLLERS` as a policy, for an environment made with
    `observation_options`.

    model: the assumed model, by default the environment's own before randomisation. Where
    coordinates are observed, it should have the same. estimator: of ESTIMATORS, finds the
    coordinates from the other observations and the known noise of the sensors; None: they are
    observed. uncertainty: process noise and first uncertainty of a Kalman filter. latency: known
    input delay [s], which the controller compensates (Smith predictor), by default that of the
    actuators in its model; with estimator="adaptive" the first estimate of it. Raises TypeError,
    ValueError; ConfigurationError where the environment does not show what the controller needs.
    """
    finds = _among("estimator", estimator, ESTIMATORS)
    episodes, model = episodes_of(env), episodes_of(env).model if model is None else model
    if (differs := model.coordinate_count != episodes.model.coordinate_count) and (
        finds is None or episodes.task.shapes
    ):
        there = (
            f"{model.coordinate_count} coordinates where the environment's has"
            f" {episodes.model.coordinate_count}"
        )
        raise ValueError(
            f"the controller's model has {there}, which are observed: it should have the same"
            " strain parametrisation"
        )
    believed, delay = _under_tensions(model)
    late = checked_number(
        "latency", delay if latency is None else latency, 0.0, "a number of seconds, at least 0"
    )
    entry: Entry = _among("controller", controller, CONTROLLERS.get(episodes.task.name, {}))
    _check_preview(entry, episodes, _periods_ahead(entry, late, episodes.period, finds))
    greatest = late if finds is None else finds.greatest_latency or late
    predictor = SmithPredictor(believed, greatest, episodes.period) if greatest else None
    seen = tuple(
        field
        for group, field in PARAMETERS.items()
        if group in episodes.layout.slices and field in protocol.Measurement._fields
    )
    noise, starts = episodes.options.randomize.noise, episodes.start_tension.copy()
    setting = Setting(
        episodes.period, starts, seen, episodes.sensors.copy(), noise, late, uncertainty
    )
    found = None if finds is None else finds.make(believed, setting)
    decides = entry.make(believed, episodes.limits.copy(), episodes.period)
    return ControllerPolicy(decides, env, model if differs else None, found, predictor)


def _under_tensions(model: Model) -> tuple[Model, float]:
    """Model of the same arm whose commands are tensions that arrive at once, and the delay of its
    actuators [s]."""
    effects = model.scene.effects
    changes: dict[str, Any] = {
        f"effects.{name}": None
        for name, effect in effects.chosen().items()
        if effect.command_unit != "N"
    }
    if delay := 0.0 if effects.actuators is None else effects.actuators.delay:
        changes["effects.actuators.delay"] = 0.0
    return build_model(model.scene.replace(changes)) if changes else model, delay


def _periods_ahead(
    entry: Entry, latency: float, period: float, finds: EstimatorEntry | None
) -> int:
    """Control periods ahead of now for which a controller should be told the target, so that it
    makes up for a latency [s] too."""
    late, rest = whole_periods((finds and finds.greatest_latency) or latency, period)
    return entry.looks_ahead + late + (rest > 0.0)


def _check_preview(entry: Entry, episodes: Episodes, periods: int) -> None:
    """Raises ConfigurationError where a target that moves is not told for as long as a controller
    looks ahead; one that plans for more than two periods needs every period of it, since it follows
    the kinks of a target that goes straight between the times of a preview."""
    told, needed = episodes.ahead, episodes.period * np.arange(1, periods + 1)
    missed = np.abs(told[:, None] - needed).min(axis=0) > SAME * needed
    if entry.looks_ahead <= LOOKS_AHEAD:
        missed = needed > told[-1] * (1.0 + SAME)
    if episodes.task.goal is None and missed.any():
        text = (
            f"tells the target at {shown(told[1:].tolist())} s, and it is needed at every control"
            f" period up to {needed[-1]:.3g} s"
        )
        raise ConfigurationError(
            [Problem(("preview",), f"{text}: make the environment with observation_options()")],
            "environment",
        )


def _among(kind: str, chosen: Any, valid: Mapping[str, Any]) -> Any:
    """Entry of a table by its name; a controller's entry itself, or None, as it is. Raises
    ValueError."""
    if chosen is None or isinstance(chosen, Entry):
        return chosen
    if not isinstance(chosen, str) or chosen not in valid:
        known = (not_registered if kind in ("controller", "task") else not_among)(
            str(chosen), valid
        )
        raise ValueError(f"{kind} is {shown(chosen)}: {known}")
    return valid[chosen]


class ControllerPolicy:
    """Controller behind Stable-Baselines3's `predict`, for one row or many.

    model: which knows what commands make tensions, by default the environment's. estimator: finds
    the coordinates; None: they are observed. predictor: of where the arm will be when commands
    arrive; None: they arrive at once. Raises TypeError for environments of other packages,
    ConfigurationError where the observation lacks what the controller needs.
    """

    def __init__(
        self,
        controller: protocol.Controller,
        env: Any,
        model: Model | None = None,
        estimator: protocol.Estimator | None = None,
        predictor: SmithPredictor | None = None,
    ) -> None:
        self.controller, self.estimator, self.predictor = controller, estimator, predictor
        of = episodes_of(env)
        self.layout, self._actions, self._ahead, self._period = (
            of.layout,
            of.actions,
            of.ahead.copy(),
            of.period,
        )
        self._start, self._start_command, self._model = (
            of.start_tension.copy(),
            of.start_command.copy(),
            model or of.model,
        )
        self._zeros = (
            of.observed.rest._asdict()
        )  # of lengths and strains, which are observed as differences
        self._waiting = max(0 if part is None else part.history for part in (estimator, predictor))
        effects, name = self._model.scene.effects, type(controller).__name__
        pulled = (
            None
            if effects.command_unit == "N"
            else build_model(self._model.scene.replace({"effects": effects.on_arm()}))
        )
        self._lost, self._simulation = (
            LostState(name),
            None if pulled is None else Simulation(pulled),
        )  # of the arm under tensions
        groups, needed = of.layout.slices, [*TIP]
        state = ("q", "q_dot") if estimator is None else estimator.needs
        needed += [group for group, field in PARAMETERS.items() if field in state]
        needed += [] if "wanted_coordinates" in groups else of.task.reference
        problems = list[Problem]()
        if missing := [group for group in needed if group not in groups]:
            text = (
                f"lacks {', '.join(missing)}, which {name} needs: make it with"
                " observation_options()"
            )
            problems.append(Problem(("observation",), text))
        if (np.diff(of.ahead) <= 0.0).any():
            text = (
                f"is {of.ahead[1:].tolist()} s: it should be times that increase by at least a"
                " control period"
            )
            problems.append(Problem(("preview",), text))
        if problems:
            raise ConfigurationError(problems, "environment")

    def predict(
        self,
        observation: Any,
        state: tuple[RowMemory, ...] | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[RowMemory, ...]]:
        """Actions (n_a,) for one observation, (rows, n_a) for many, and the state to give back with
        the next ones.

        state: what the last call returned, None at the beginning of episodes; a UserWarning says
        where it is never given back. episode_start (rows,) bool: rows that forget. `deterministic`
        is not used: controllers always are.
        """
        self._lost.notice(state is None and not np.any(episode_start))
        flat = observation["observation"] if isinstance(observation, dict) else observation
        values = self.layout.values(np.atleast_2d(flat))
        goal = (
            np.atleast_2d(observation["desired_goal"]).astype(np.float64)
            if isinstance(observation, dict)
            else None
        )
        memories: list[RowMemory | None] = (
            [None] * len(values["tip_position"]) if state is None else list(state)
        )
        if episode_start is not None:
            memories = [
                None if begins else memory
                for begins, memory in zip(np.atleast_1d(episode_start), memories, strict=True)
            ]
        poses = _tip_poses(values)
        targets = _target_poses(values, poses)
        actions, after = [], []
        for row, kept in enumerate(memories):
            groups = {name: value[row] for name, value in values.items()}
            target = protocol.Reference(
                ahead=self._ahead if goal is None else np.zeros(1),
                tip_pose=None if targets is None else targets[row],
                tip_position=None if goal is None else goal[row : row + 1],
                q=_target_coordinates(groups, len(self._ahead)),
            )
            action, memory = self._decide(
                groups, poses[row], target, self._fresh(groups) if kept is None else kept
            )
            actions.append(action)
            after.append(memory)
        return actions[0] if np.ndim(flat) == 1 else np.stack(actions), tuple(after)

    def _decide(
        self, groups: dict[str, Array], pose: Array, target: protocol.Reference, memory: RowMemory
    ) -> tuple[Any, RowMemory]:
        """Action (n_a,) and memory of a row from its observation by group, its measured pose (4, 4)
        and the reference."""
        time = memory.periods * self._period
        # without an estimator the environment observes both
        coordinates: Any = groups.get("coordinates")
        rates: Any = groups.get("rates")
        estimate = protocol.Estimate(coordinates, rates)
        if self.estimator is not None:
            fields = {
                name: groups[group]
                for group, name in PARAMETERS.items()
                if name in self.estimator.needs
            }
            fields |= {
                name: fields[name].reshape(-1, 6)
                for name in {"strain", "strain_rate"} & fields.keys()
            }
            fields |= {
                name: fields[name] + zero for name, zero in self._zeros.items() if name in fields
            }
            sent = np.array(memory.sent).reshape(-1, self._start.size)
            estimate = self.estimator.estimate(
                protocol.Measurement(pose, sent, time, **fields), memory.estimate
            )
        q, q_dot, tip = (
            estimate.q,
            estimate.q_dot,
            pose if estimate.tip_pose is None else estimate.tip_pose,
        )
        now = protocol.ControllerInput(
            q, q_dot, tip, memory.tension, target, time, estimate.input_error
        )
        if self.predictor is not None:
            now = self.predictor.predict(now, memory.sent, estimate.latency)
        decision = self.controller.act(
            now, None if memory.decision is None else memory.decision.memory
        )
        action, asked, command = self._command(decision.tension, q, q_dot, memory.command)
        return action, RowMemory(
            decision,
            asked,
            command,
            estimate,
            memory.periods + 1,
            (*memory.sent[1:], asked)[: self._waiting],
        )

    def _fresh(self, groups: dict[str, Array]) -> RowMemory:
        """The memory of a row whose episode begins: under the command that is observed, or else
        that of rest."""
        start, command = self._start, self._start_command
        if not np.allclose(
            seen := groups.get("command", command),
            command,
            0.0,
            SAME_COMMAND * np.abs(self._actions.greatest),
        ):
            command, start = seen, seen if self._simulation is None else start
        return RowMemory(None, start, command, None, 0, (start,) * self._waiting)

    def _command(
        self, tension: Array, q: Array, q_dot: Array, before: Array
    ) -> tuple[NDArray[np.float32], Array, Array]:
        """The action that asks for tensions (n_a,) [N] at q, q_dot after a command (n_a,), the
        tensions that it asks for, and its command.

        Displacements are those that have these tensions where the arm would be under them at the
        end of the period.
        """
        wanted, scale = tension, self._actions
        if self._simulation is not None:
            try:
                self._simulation.reset(q, q_dot)
                self._simulation.step(tension, self._period)
                q = self._simulation.state.q
            except protocol.FAILURES:
                pass  # from where it is, then
            wanted = self._model.command(tension, q)
        action = scale.action(wanted, before).astype(np.float32)
        command = scale.command(action.astype(np.float64), before)
        return action, command if self._simulation is None else tension, command


def _tip_poses(values: dict[str, Array]) -> Array:
    """Measured poses (rows, 4, 4), the rotation's columns made orthonormal again after their
    rounding."""
    x, y = np.split(values["tip_rotation"], 2, axis=1)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    y = y - (x * y).sum(axis=1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=1, keepdims=True)
    pose = np.tile(np.eye(4), (len(x), 1, 1))
    pose[:, :3, :3] = np.stack([x, y, np.cross(x, y)], axis=2)
    pose[:, :3, 3] = values["tip_position"]
    return pose


def _target_poses(values: dict[str, Array], poses: Array) -> Array | None:
    """Target poses (rows, 1 + previews, 4, 4), or None where the observation has none."""
    if "target_error" not in values:
        return None
    errors = np.concatenate(
        [values["target_error"], values.get("preview", np.empty((len(poses), 0)))], axis=1
    ).reshape(len(poses), -1, 6)
    out = np.empty((*errors.shape[:2], 4, 4))
    move_poses(poses, errors, out)
    return out


def _target_coordinates(groups: dict[str, Array], samples: int) -> Array | None:
    """Coordinates (samples, n) of the target of one row now and at each preview time, or None where
    the observation has none."""
    if "wanted_coordinates" in groups:
        return groups["wanted_coordinates"].reshape(samples, -1)
    if "target_coordinates" not in groups:
        return None
    ahead = groups.get("coordinate_preview", np.empty(0)).reshape(-1, groups["coordinates"].size)
    return groups["coordinates"] + np.vstack([groups["target_coordinates"], ahead])
