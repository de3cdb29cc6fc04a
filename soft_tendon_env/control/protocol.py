"""Interfaces of controllers and state estimators.

They say what a controller measures, the reference it follows, the tensions it decides on.

A controller knows a `Model` (which may be a wrong one) and what is measured; never the environment.
Its memory goes in and comes out of `act`, so that one controller serves any number of arms. SI
units, twists angular before linear in the body frame, coordinates q.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from pydantic import Field

from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.force_errors import ForceError
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import SimulationDiverged
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array

FAILURES = (StrainLimitError, SimulationDiverged, OverflowError, np.linalg.LinAlgError)
"""Errors by which a model says that it has no motion or no solution there: a controller then holds
its tensions, an estimator its state."""

AT_LIMIT = 1e-9  # share of the range of tensions within which a tendon counts as at its limit


class Reference(NamedTuple):
    """Reference trajectory at m instants, the first of them now.

    None stands where the task does not give it.
    """

    # (m,) [s] from now, increasing from 0, or from before now where the situation is one that is
    # predicted
    ahead: Array
    tip_pose: Array | None = None  # (m, 4, 4)
    # (m, 3) [m]; the tip may point anywhere where only this is given
    tip_position: Array | None = None
    q: Array | None = None  # (m, n) coordinates of the shapes, which tensions can hold
    # (n_a,) [N] that would hold the first of them, or the nearest that can be held: see
    # ReferenceGovernor
    tension: Array | None = None


class InputError(NamedTuple):
    """Estimated error of the inputs, by tendon.

    The arm moves as the model would under tensions gain * (those asked for) + offset.
    """

    gain: Array  # (n_a,)
    offset: Array  # (n_a,) [N]


class LaggingActuators(NamedTuple):
    """Actuators that follow their commands with a first-order lag."""

    lag: float  # [s] time constant
    tension: Array  # (n_a,) [N] that acts when the next command arrives


class ControllerInput(NamedTuple):
    """State of one arm and its reference at the beginning of a control period.

    The state is measured or estimated, of n coordinates and n_a tendons.
    """

    q: Array  # (n,)
    q_dot: Array  # (n,)
    tip_pose: Array  # (4, 4) as measured: not that of q, if the model is wrong
    tension: Array  # (n_a,) [N] asked for last
    reference: Reference  # target of the controller, now and ahead
    time: float = 0.0  # [s] since the episode began, on which a model's effects may depend
    # where an estimator finds one: a controller that allows for it needs no observer of its own
    input_error: InputError | None = None
    force_error: ForceError | None = None  # likewise, of the model's generalised forces
    actuators: LaggingActuators | None = None  # None: they follow at once
    timing_spread: float = 0.0  # [s] by which the arrival of commands is uncertain
    # mean square of what an estimator did not expect, in its standard deviations, see Surprise
    surprise: float = 0.0
    lead: float = 0.0  # [s] by which this state is predicted ahead of the last measurement
    # (n_a,) [N] by which actuators let tensions change in a period; None: by any amount
    greatest_change: Array | None = None


@dataclass(frozen=True)
class ControllerOutput:
    """Tensions (n_a,) [N] to hold over the control period, with a memory and a report.

    The memory is given back next time. The report has numbers to look at: at least "limited", the
    share of tendons at their limits, and "singular", 1.0 where the task could not be resolved and
    0.0 otherwise.
    """

    tension: Array  # (n_a,) [N]
    memory: Any = None
    report: Mapping[str, float] = field(default_factory=dict)


class Controller(Protocol):
    """Feedback or feedforward law: tensions from the measured state and the reference."""

    def act(self, now: ControllerInput, memory: Any = None) -> ControllerOutput:
        """Computes the tensions of a control period.

        Raises nothing for finite arrays.

        Args:
            now: state and reference at the beginning of the period.
            memory: that of the last output, None when an episode begins.

        Returns:
            The tensions, the memory for the next period, and numbers to look at.
        """


class ModelController:
    """Base of the controllers of this package.

    It has a model, limits (n_a, 2) [N] of tensions, and the control period [s].
    """

    def __init__(self, model: Model, limits: Array, period: float) -> None:
        self.model = model
        self.period = period
        self.least, self.greatest = limits.T.copy()
        self._near = AT_LIMIT * (self.greatest - self.least)

    def reachable(self, now: ControllerInput) -> tuple[Array, Array]:
        """Least and greatest tensions (n_a,) [N] that actuators reach in the period that begins."""
        if now.greatest_change is None:
            return self.least, self.greatest
        last = np.clip(now.tension, self.least, self.greatest)
        lowest = last - now.greatest_change
        highest = last + now.greatest_change
        least = np.maximum(self.least, lowest)
        greatest = np.minimum(self.greatest, highest)
        return least, greatest

    def hold(self, now: ControllerInput, memory: Any = None) -> ControllerOutput:
        """The last tensions: where the model has no motion, or the task no solution."""
        return self.output(now.tension, memory, is_singular=True)

    def output(
        self, tension: Array, memory: Any = None, is_singular: bool = False, **more: float
    ) -> ControllerOutput:
        """Tensions (n_a,) [N] cut off at their limits, with their report; `more` goes into that."""
        tension = np.minimum(np.maximum(tension, self.least), self.greatest)
        is_least = tension <= self.least + self._near
        is_greatest = tension >= self.greatest - self._near
        report = {
            "limited": np.count_nonzero(is_least | is_greatest) / tension.size,
            "singular": float(is_singular),
            **more,
        }
        return ControllerOutput(tension, memory, report)


class Measurement(NamedTuple):
    """Measurements of one arm at the beginning of a control period; None: not measured.

    There are s strain sensors.
    """

    tip_pose: Array  # (4, 4)
    sent: Array  # (k, n_a) [N] tensions asked for in the last k periods, the newest last
    time: float  # [s] since the episode began
    tip_twist: Array | None = None  # (6,) body twist
    tendon_length: Array | None = None  # (n_a,) [m]
    strain: Array | None = None  # (s, 6)
    strain_rate: Array | None = None  # (s, 6)


Deviation = Annotated[float, Field(ge=0, le=1e6)]


class SensorNoise(Configuration):
    """Standard deviations of Gaussian noise on what is observed.

    Rewards and errors are the true ones.
    """

    position: Deviation = 0.0  # [m] of the tip
    rotation: Deviation = 0.0  # [rad] of the tip
    length: Deviation = 0.0  # [m] of tendons
    curvature: Deviation = 0.0  # [1/m] torsion and bending at strain sensors
    stretch: Deviation = 0.0  # [-] stretch and shear there
    curvature_rate: Deviation = 0.0  # [1/(m s)]
    stretch_rate: Deviation = 0.0  # [1/s]

    def of_strains(self, sensors: int) -> Array:
        """Deviations (6 sensors,) of the strains at so many sensors."""
        of_one = np.repeat([self.curvature, self.stretch], 3)
        return np.tile(of_one, sensors)

    def of_strain_rates(self, sensors: int) -> Array:
        """Deviations (6 sensors,) of the rates of those strains."""
        of_one = np.repeat([self.curvature_rate, self.stretch_rate], 3)
        return np.tile(of_one, sensors)


class Estimate(NamedTuple):
    """Estimated state of one arm, and what an estimator needs of it a period later."""

    q: Array  # (n,)
    q_dot: Array  # (n,)
    tip_pose: Array | None = None  # (4, 4) where the estimator knows better than the measurement
    input_error: InputError | None = None
    force_error: ForceError | None = None
    timing: Timing | None = None  # [s] of commands, where it is estimated
    timing_spread: float = 0.0  # [s] by which that is uncertain, as long as it is far from found
    surprise: float = 0.0  # mean square of what was not expected, in its standard deviations
    memory: Any = None


class Estimator(Protocol):
    """A state estimator: coordinates and rates of an arm from what is measured."""

    needs: tuple[str, ...]  # fields of Measurement that it is to be told, besides the tip's pose
    history: int  # how many of the tensions asked for last

    def estimate(self, measured: Measurement, last: Estimate | None) -> Estimate:
        """Estimates the state now.

        `last` is the estimate of the period before, None when an episode begins.
        """
