"""Goals of goal-conditioned tasks: what is achieved and desired, their distance, and the reward, which hindsight replay computes anew."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.envs.kernels import closeness
from soft_tendon_env.tools.types import Array

GoalReward = Literal["sparse", "dense"]
HALF = 5.0
"""Thresholds at which the dense reward is 1/2: near enough that the last of them still counts."""


class TipGoal:
    """Positions of the tip (..., 3) [m] as goals."""

    def distance(self, achieved: ArrayLike, desired: ArrayLike) -> Array:
        """Distances (...) [m] of goals (..., 3), component by component so that one goal and many give the same bits. Raises ValueError."""
        shapes = np.shape(achieved), np.shape(desired)
        if shapes[0] != shapes[1] or shapes[0][-1:] != (3,):
            raise ValueError(f"achieved_goal and desired_goal should have the same shape (..., 3), not {shapes[0]} and {shapes[1]}")
        x, y, z = np.moveaxis(np.asarray(achieved, dtype=np.float64) - np.asarray(desired, dtype=np.float64), -1, 0)
        return np.asarray(np.sqrt(x * x + y * y + z * z))

    def reward(self, achieved: ArrayLike, desired: ArrayLike, kind: GoalReward, threshold: float) -> Array:
        """Rewards (...) of goals (..., 3) [m]: "sparse" 1 within the threshold [m], else 0; "dense" the closeness, 1/2 at 5 thresholds."""
        distance = self.distance(achieved, desired)
        return (distance <= threshold).astype(np.float64) if kind == "sparse" else closeness(distance, HALF * threshold)
