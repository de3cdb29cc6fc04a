"""Controllers as policies: Stable-Baselines3's `predict` around a controller.

Controllers are those of `soft_tendon_env.control`.

What the controller knows comes out of the observation and of its own state; what it decides becomes
an action.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.control import protocol
from soft_tendon_env.control.catalogue import LOOKS_AHEAD, Entry, controllers_of, valid_controllers
from soft_tendon_env.control.command_filter import SAME, Timing, whole_periods
from soft_tendon_env.control.diagnosis import Diagnosis
from soft_tendon_env.control.own_cost import Given, own_cost
from soft_tendon_env.control.uncertainty import USUAL, Uncertainty
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.tasks import TASKS, TIP
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.policies.arm_observer import (
    SAME_COMMAND,
    ArmMemory,
    ArmObserver,
    believed_arm,
    greatest_timing,
    make_observer,
    missing_groups,
)
from soft_tendon_env.policies.estimators import ESTIMATORS, EstimatorEntry
from soft_tendon_env.policies.observed_poses import target_poses, tip_poses
from soft_tendon_env.policies.protocol import LostState, memories_of
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.configuration import (
    ConfigurationError,
    Problem,
    not_among,
    not_registered,
    shown,
)
from soft_tendon_env.tools.linear_algebra import one_thread
from soft_tendon_env.tools.registry import Registry
from soft_tendon_env.tools.types import Array


class RowMemory(NamedTuple):
    """State of a controller's policy for one row, from one call of `predict` to the next."""

    decision: protocol.ControllerOutput | None
    tension: Array  # (n_a,) [N] asked for last
    command: Array  # (n_a,) given for that: the same, or displacements [m]
    arm: ArmMemory


def observation_options(
    controller: str | Entry,
    task: str,
    period: float = 0.02,
    latency: float | None = None,
    estimator: str | None = None,
    regime: str | None = None,
) -> dict[str, Any]:
    """Returns options under which a controller sees what it needs, and gives tensions.

    Args:
        controller: of CONTROLLERS, or an entry like those there.
        task: "TipPose", ...
        period: of control [s].
        latency: known input delay [s] that the controller compensates, see `make_policy`; None: it
            is estimated, if the estimator does.
        estimator: of ESTIMATORS, which finds the coordinates; None: they are observed.
        regime: of REGIMES, what a Kalman filter observes, by default "sensors".

    Returns:
        Options of an environment, by name.

    Raises:
        ValueError: a name is not known.
    """
    estimator_entry = _among("estimator", estimator, ESTIMATORS)
    reference = _among("task", task, TASKS).measured_reference
    entry = _controller(controller, task)
    greatest = greatest_timing(Timing(latency, None), estimator_entry)
    ahead = _periods_ahead(entry, greatest.latency, period)
    options: dict[str, Any] = {"action": "tension"}
    periods = range(1, ahead + 1)
    options["preview"] = [period * k for k in periods]
    if estimator is not None or regime is not None:
        sensors = _among("regime", regime or "sensors", REGIMES)
        options["observation"] = (*sensors.measured, *reference)
        options["sensors"] = sensors.sensors or ()
    return options


def make_policy(
    controller: str | Entry,
    env: Any,
    model: Model | None = None,
    latency: float | None = None,
    estimator: str | None = None,
    uncertainty: Uncertainty = USUAL,
    objectives: Sequence[Given] | None = None,
) -> "ControllerPolicy":
    """Makes a controller of `soft_tendon_env.control.CONTROLLERS` a policy.

    Args:
        controller: of CONTROLLERS, or an entry like those there.
        env: environment made with `observation_options`.
        model: the assumed model, by default the environment's own before randomisation. Where
            coordinates are observed, it should have the same.
        latency: known input delay [s], which the controller compensates, by default that of the
            actuators in its model; without actuators there an estimator finds it.
        estimator: of ESTIMATORS, finds the coordinates from the other observations and the known
            noise of the sensors; None: they are observed.
        uncertainty: process noise and first uncertainty of a Kalman filter.
        objectives: a cost of your own for predictive control, see `own_cost`: TipPose, TipPosition,
            TipDirection, Shape, Avoidance, Effort and Smoothness of `soft_tendon_env.control`,
            others with linear_error(posture), or classes or functions of the model that make them;
            None: the controller's own.

    Returns:
        The policy, for one row or many.

    Raises:
        TypeError: the environment is of another package, or an objective is none.
        ValueError: a name is not known, the model does not fit, or the controller or the task has
            no use for an objective.
        ConfigurationError: the environment does not show what the controller needs.
    """
    estimator_entry: EstimatorEntry | None = _among("estimator", estimator, ESTIMATORS)
    episodes = episodes_of(env)
    if model is None:
        model = episodes.model
    differs = model.coordinate_count != episodes.model.coordinate_count
    if differs and (estimator_entry is None or episodes.task.shapes):
        raise ValueError(
            f"the controller's model has {model.coordinate_count} coordinates where the"
            f" environment's has {episodes.model.coordinate_count}, which are observed: it should"
            " have the same strain parametrisation"
        )
    believed, known = believed_arm(model)
    if latency is not None:
        late = checked_number("latency", latency, 0.0, "a number of seconds, at least 0")
        known = known._replace(latency=late)
    entry = _controller(controller, episodes.task.name)
    if objectives is not None:
        entry = _with_objectives(entry, objectives, believed, episodes)
    greatest = greatest_timing(known, estimator_entry)
    ahead = _periods_ahead(entry, greatest.latency, episodes.period)
    _check_preview(entry, episodes, ahead)
    observer = make_observer(episodes, believed, known, estimator_entry, uncertainty)
    law = entry.make(believed, episodes.limits.copy(), episodes.period)
    return ControllerPolicy(law, env, model if differs else None, observer)


def _with_objectives(
    entry: Entry, objectives: Sequence[Given], model: Model, episodes: Episodes
) -> Entry:
    """Entry with a cost of the user's own.

    Raises TypeError, ValueError.
    """
    if not entry.takes_objectives:
        others = controllers_of(episodes.task.name)
        able = [name for name, other in others.items() if other.takes_objectives]
        raise ValueError(
            f"objectives are given to a controller without them ({entry.description}): of"
            f" {episodes.task.name} {', '.join(able) or 'none'} may have some"
        )
    groups = episodes.layout.slices
    told = list[str]()
    if "target_error" in groups:
        told.append("tip_pose")
    if episodes.task.goal is not None:
        told.append("tip_position")
    if "wanted_coordinates" in groups or "target_coordinates" in groups:
        told.append("q")
    return entry.with_cost(own_cost(objectives, model, told))


def _periods_ahead(entry: Entry, latency: float, period: float) -> int:
    """Control periods ahead of now for which a controller should be told the target.

    They make up for a latency [s] too.
    """
    late, rest = whole_periods(latency, period)
    return entry.looks_ahead + late + (rest > 0.0)


def _check_preview(entry: Entry, episodes: Episodes, periods: int) -> None:
    """Raises ConfigurationError where a target that moves is not told for long enough.

    A controller that plans for more than two periods needs every period of it, since it follows the
    kinks of a target that goes straight between the times of a preview.
    """
    if episodes.task.goal is not None:
        return
    times = episodes.ahead
    needed = episodes.period * np.arange(1, periods + 1)
    if entry.looks_ahead <= LOOKS_AHEAD:
        missed = needed > times[-1] * (1.0 + SAME)
    else:
        distances = np.abs(times[:, None] - needed)
        missed = distances.min(axis=0) > SAME * needed
    if missed.any():
        text = (
            f"tells the target at {shown(times[1:].tolist())} s, and it is needed at every control"
            f" period up to {needed[-1]:.3g} s: make the environment with observation_options()"
        )
        raise ConfigurationError([Problem(("preview",), text)], "environment")


def _controller(chosen: str | Entry, task: str) -> Entry:
    """Entry of a controller by its name, or itself. Raises ValueError."""
    if isinstance(chosen, Entry):
        return chosen
    entries = controllers_of(task)
    if isinstance(chosen, str) and chosen in entries:
        return entries[chosen]
    valid = valid_controllers(str(chosen), task)
    raise ValueError(f"controller is {shown(chosen)}: {valid}")


def _among(kind: str, chosen: Any, valid: Mapping[str, Any]) -> Any:
    """Entry of a table by its name; None as it is. Raises ValueError."""
    if chosen is None:
        return None
    if isinstance(chosen, str) and chosen in valid:
        return valid[chosen]
    # users add to registries
    describe = not_registered if isinstance(valid, Registry) else not_among
    hint = describe(str(chosen), valid)
    raise ValueError(f"{kind} is {shown(chosen)}: {hint}")


class ControllerPolicy:
    """Controller behind Stable-Baselines3's `predict`, for one row or many.

    Args:
        controller: what acts.
        env: its environment.
        model: which knows what commands make tensions, by default the environment's.
        observer: of the arm's state, by default one whose coordinates are observed, and whose
            commands arrive at once.

    Raises:
        TypeError: the environment is of another package.
        ConfigurationError: the observation lacks what the controller needs.
    """

    def __init__(
        self,
        controller: protocol.Controller,
        env: Any,
        model: Model | None = None,
        observer: ArmObserver | None = None,
    ) -> None:
        """Makes the policy for the environment."""
        self.controller = controller
        episodes = episodes_of(env)
        self.observer = observer or ArmObserver(episodes)
        self.layout = episodes.layout
        self._actions = episodes.actions
        self._ahead = episodes.ahead.copy()
        self._period = episodes.period
        self._model = model or episodes.model
        self._lost = LostState(type(controller).__name__)
        self._simulation: Simulation | None = None  # of the arm under tensions
        # (n_a,) [N] of tensions in a period; commands of other units limit them in other ways
        self._greatest_change = self._actions.greatest_change
        effects = self._model.scene.effects
        if effects.command_unit != "N":
            pulled = build_model(self._model.scene.replace({"effects": effects.on_arm()}))
            self._simulation = Simulation(pulled)
            self._greatest_change = None
        self._check(episodes)

    def _check(self, episodes: Episodes) -> None:
        """Raises ConfigurationError where the observation lacks something."""
        groups = episodes.layout.slices
        missing = [group for group in TIP if group not in groups]
        missing += missing_groups(self.observer, groups)
        if "wanted_coordinates" not in groups:
            missing += [group for group in episodes.task.reference if group not in groups]
        problems = []
        if missing:
            text = (
                f"lacks {', '.join(missing)}, which {type(self.controller).__name__} needs: make"
                " it with observation_options()"
            )
            problems.append(Problem(("observation",), text))
        if (np.diff(episodes.ahead) <= 0.0).any():
            text = (
                f"is {episodes.ahead[1:].tolist()} s: it should be times that increase by at least"
                " a control period"
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
        """Computes actions for one observation or many.

        Args:
            observation: of the environment, or rows of them.
            state: what the last call returned, None at the beginning of episodes; a UserWarning
                says where it is never passed.
            episode_start: (rows,) bool, rows that forget.
            deterministic: is not used: controllers always are.

        Returns:
            Actions (n_a,), or (rows, n_a) for many, and the state to pass with the next ones.
        """
        is_first = np.any(episode_start)
        self._lost.notice(state is None and not is_first)
        flat = observation
        goal = None
        if isinstance(observation, dict):
            flat = observation["observation"]
            goal = np.atleast_2d(observation["desired_goal"]).astype(np.float64)
        values = self.layout.values(np.atleast_2d(flat))
        memories = memories_of(len(values["tip_position"]), state, episode_start)
        poses = tip_poses(values)
        targets = target_poses(values, poses)
        actions = []
        after = []
        for row, memory in enumerate(memories):
            groups = {name: value[row] for name, value in values.items()}
            target = protocol.Reference(
                ahead=self._ahead if goal is None else np.zeros(1),
                tip_pose=None if targets is None else targets[row],
                tip_position=None if goal is None else goal[row : row + 1],
                q=_target_coordinates(groups, len(self._ahead)),
            )
            before = self._fresh(groups) if memory is None else memory
            with one_thread():  # matrices are small
                pose = poses[row]
                action, next_memory = self._decide(groups, pose, target, before)
            actions.append(action)
            after.append(next_memory)
        if np.ndim(flat) == 1:
            return actions[0], tuple(after)
        return np.stack(actions), tuple(after)

    def estimate(self, state: tuple[RowMemory, ...]) -> tuple[Diagnosis, ...]:
        """Returns what the Kalman filter has found out about the arms, in SI units.

        Loads, a payload, gains, stiffness, damping, latency and lag, each with its interval.

        Args:
            state: which `predict` returned.

        Returns:
            A diagnosis for every row.

        Raises:
            TypeError: the policy has no Kalman filter.
            ValueError: nothing has been estimated yet.
        """
        return self.observer.diagnoses(tuple(memory.arm for memory in state))

    def _decide(
        self, groups: dict[str, Array], pose: Array, target: protocol.Reference, memory: RowMemory
    ) -> tuple[Any, RowMemory]:
        """Action (n_a,) and memory of a row.

        Args:
            groups: its observation by group.
            pose: measured (4, 4).
            target: what the controller is to follow.
            memory: from the last call.
        """
        sight = self.observer.look(groups, pose, target, memory.tension, memory.arm)
        now = sight.arrival._replace(greatest_change=self._greatest_change)
        of_controller = None if memory.decision is None else memory.decision.memory
        decision = self.controller.act(now, of_controller)
        estimate = sight.estimate
        action, asked, command = self._command(
            decision.tension, estimate.q, estimate.q_dot, memory.command
        )
        arm = self.observer.remember(memory.arm, estimate, asked)
        return action, RowMemory(decision, asked, command, arm)

    def _fresh(self, groups: dict[str, Array]) -> RowMemory:
        """The memory of a row whose episode begins."""
        tension, command, arm = self.observer.begin(groups)
        return RowMemory(None, tension, command, arm)

    def _command(
        self, tension: Array, q: Array, q_dot: Array, before: Array
    ) -> tuple[NDArray[np.float32], Array, Array]:
        """The action that asks for tensions, the tensions that it asks for, and its command.

        Displacements are those that have these tensions where the arm would be under them at the
        end of the period.

        Args:
            tension: (n_a,) [N].
            q: coordinates (n,).
            q_dot: their rates (n,).
            before: the last command (n_a,).
        """
        command = tension
        if self._simulation is not None:
            try:
                self._simulation.reset(q, q_dot)
                self._simulation.step(tension, self._period)
                q = self._simulation.state.q
            except protocol.FAILURES:
                pass  # from where it is, then
            command = self._model.command(tension, q)
        action = self._actions.action(command, before).astype(np.float32)
        # as the action says it in single precision
        sent = self._actions.command(action.astype(np.float64), before)
        if self._simulation is None:
            return action, sent, sent
        cut = sent - command
        asked = tension
        round_off = SAME_COMMAND * np.abs(self._actions.greatest)
        if (np.abs(cut) > round_off).any():
            # what limits or rate cut off a displacement, its spring lacks
            none = np.zeros_like(tension)
            of_a_newton = self._model.command(none + 1.0, q)
            of_none = self._model.command(none, q)
            lacking = cut / (of_a_newton - of_none)
            asked = np.maximum(tension + lacking, 0.0)
        return action, asked, sent


def _target_coordinates(groups: dict[str, Array], samples: int) -> Array | None:
    """Coordinates (samples, n) of the target of one row, now and at each preview time.

    None where the observation has none.
    """
    if "wanted_coordinates" in groups:
        return groups["wanted_coordinates"].reshape(samples, -1)
    if "target_coordinates" not in groups:
        return None
    coordinates = groups["coordinates"]
    ways_ahead = groups.get("coordinate_preview", np.empty(0))
    ahead = ways_ahead.reshape(-1, coordinates.size)
    return coordinates + np.vstack([groups["target_coordinates"], ahead])
