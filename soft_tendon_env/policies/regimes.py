"""Information regimes: sensor sets of policies and state estimators.

To add one, add an entry to REGIMES.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from soft_tendon_env.envs.tasks import TIP

SENSORS = 8
"""Number of strain sensors in the regime "state", and of simulated robots unless options say
otherwise."""
NOISE = {
    "position": 1e-3,
    "rotation": math.radians(0.5),
    "length": 5e-4,
    "curvature": 0.05,
    "stretch": 1e-3,
}
"""Standard deviations of sensors that are noisy: 1 mm, half a degree, 0.5 mm of tendon, 0.05 1/m, a
thousandth."""
TARGET_GROUPS = (
    "target_error",
    "target_twist",
    "preview",
    "last_action",
    "command",
    "target_lengths",
)
"""Observation groups available in every information regime: target, last command."""
TARGET_GROUPS_BY_CHOICE = ("target_pose", "pose_preview")
"""Observation groups of the target that are allowed besides, to who chooses them."""


class Regime(NamedTuple):
    """Information regime: sensor set of policies and of a Kalman filter."""

    title: str  # in headings
    description: str
    measured: tuple[str, ...]  # observation groups, none of which depends on a discretisation
    sensors: int  # number of strain sensors
    noise: Mapping[str, float] = {}  # of the sensors, as in the option `randomize.noise`

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups that policies observe unless they choose others."""
        return *self.measured, *TARGET_GROUPS

    @property
    def allowed(self) -> tuple[str, ...]:
        """Groups that policies may observe."""
        return *self.groups, *TARGET_GROUPS_BY_CHOICE


REGIMES: Mapping[str, Regime] = {
    "state": Regime(
        "Exact sensors",
        "tip pose and twist, tendon displacements, strains and their rates at up to eight sensors,"
        " all exact",
        (*TIP, "tip_twist", "tendon_lengths", "strain", "strain_rate"),
        SENSORS,
    ),
    "sensors": Regime(
        "Noisy sensors",
        "tip pose, tendon displacements and three strain sensors, all with noise",
        (*TIP, "tendon_lengths", "strain"),
        3,
        NOISE,
    ),
    "tip": Regime(
        "Noisy sensors without strains",
        "tip pose and tendon displacements, with noise",
        (*TIP, "tendon_lengths"),
        0,
        NOISE,
    ),
}
"""Information regimes by name, each with less than the one before."""
