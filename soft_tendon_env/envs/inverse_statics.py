"""Inverse statics of target poses: the shapes in which the model of an arm would hold them, followed along the motion of the target.

What a policy that does not observe coordinates can compare its tendons with: of a pose alone it would have to learn the inverse.
"""

import numpy as np

from soft_tendon_env.control.feedforward import StaticFeedforward, StaticMemory
from soft_tendon_env.control.objectives import TipPose
from soft_tendon_env.control.protocol import Reference
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

ANGLE_WEIGHT = 0.1
"""Weight of a radian beside errors of position, as a share of the rod's length."""


class InverseStatics:
    """Inverse statics along the target poses of rows, with the least effort: several Gauss-Newton steps for the first pose of an episode
    and one for every other, so that poses that jump are reached after a few. What is out of reach is followed as near as the statics come.
    """

    def __init__(self, model: Model, limits: Array, period: float, rows: int) -> None:
        """`limits` (n_a, 2) [N] of tensions; poses are `period` [s] apart."""
        self._law, self._ahead = StaticFeedforward(model, limits, period, TipPose(ANGLE_WEIGHT * model.length)), np.array([0.0, period])
        self._at: list[StaticMemory | None] = [None] * rows

    def begin(self, row: int) -> None:
        """Another target for a row."""
        self._at[row] = None

    def coordinates(self, row: int, poses: Array) -> Array:
        """Coordinates (m, n) that hold the next poses (m, 4, 4) of a row's target."""
        found, at = [], self._at[row]
        for pose in poses:
            at, _ = self._law.followed(Reference(self._ahead, tip_pose=np.stack([pose, pose])), at)
            found.append(at.q)
        self._at[row] = at
        return np.stack(found)
