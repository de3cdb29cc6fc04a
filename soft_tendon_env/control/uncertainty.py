"""Assumptions of the Kalman filter: sensors, actuators, and how wrong the model may be."""

from typing import NamedTuple

from numpy.typing import ArrayLike

from soft_tendon_env.control.protocol import SensorNoise

GREATEST_LATENCY = 0.08
"""[s] that an estimate of an unknown latency reaches."""
GREATEST_LAG = 0.06
"""[s] that an estimate of an unknown lag reaches."""


class Uncertainty(NamedTuple):
    """Standard deviations of the model's errors.

    They are those at the beginning, and of their change in 1 s, unless said otherwise.

    Tensions are in units of those of a single tendon that bend the arm by 1 rad. Those of
    configs/tuned_predictive.toml were found by a search.
    """

    # white generalised forces, held over a period each, as a share of those that bend the arm by 1
    # rad
    force: float = 1.53e-3
    # more white forces, as a share of the inertial forces of the period: of quick motions the model
    # knows less
    inertial: float = 0.0404
    tension: float = 2e-3  # white tensions, held over a period each
    offset: float = 0.005  # tensions that are added
    offset_share: float = 0.3  # of themselves, by which they change besides
    offset_start: float = 0.01
    offset_time: float = 5.0  # [s] in which they are forgotten
    gain: float = 0.008  # gains of the tendons
    gain_share: float = 0.4  # of their distance from 1, by which they change besides
    gain_start: float = 0.05
    gain_time: float = 30.0  # [s] in which they are forgotten
    # displacement of the tip, as a share of the rod's length; a radian counts as this length
    tip: float = 7.9e-4
    tip_start: float = 2e-3
    # loads at each place, as shares of the arm's weight on earth
    load: float = 0.004
    # of themselves, by which they change besides, up to the most: what the arm carries is not all
    # at these places
    load_share: float = 0.15
    load_most: float = 0.01
    load_start: float = 0.25
    load_jump: float = 0.0696  # where innovations surprise
    stiffness: float = 0.005  # factor of the stiffness
    stiffness_start: float = 0.1
    damping: float = 0.01  # factor of the damping
    damping_start: float = 0.3
    payload: float = 0.001  # mass at the tip, as a share of the arm's
    payload_start: float = 0.1
    friction: float = 0.002  # coefficient of friction of the tendons
    friction_start: float = 0.05
    # white tensions, as a share of what friction takes: places of a tendon slide in other senses
    sliding: float = 0.25
    latency: float = 5e-4  # [s]
    lag: float = 5e-4  # [s]
    lag_probability: float = 0.3  # probability that the actuators lag
    # coordinates, in units of `coordinate_scale`; their rates ten times that
    state_start: float = 1e-2


USUAL = Uncertainty()


class Setting(NamedTuple):
    """Sensors and actuators of an estimator, besides its assumed model."""

    period: float  # [s] from one estimate to the next
    tension: ArrayLike  # (n_a,) [N] that hold the arm when an episode begins
    observed: tuple[str, ...]  # fields of Measurement that are there, besides the tip's pose
    # (s,) [m] arc lengths of the strain sensors, if strains or their rates are observed
    sensors: ArrayLike = ()
    noise: SensorNoise = SensorNoise()
    latency: float | None = None  # [s] of commands; None: it is not known
    lag: float | None = None  # [s] of actuators; None: it is not known
    uncertainty: Uncertainty = USUAL
