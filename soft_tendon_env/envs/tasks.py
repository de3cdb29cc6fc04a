"""The tasks: what is observed, which errors count, what is rewarded. An environment is an arm and a task.

To add a task, add it here, its two classes to single.py and vector.py, and its id to registration.py.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.envs.rewards import closeness
from soft_tendon_env.scene.scene import Array

STATIONS = 20
"""Places along the backbone at which shapes are compared, the tip the last."""


class Tracking(NamedTuple):
    """The arm and its target now, rows first, without noise."""

    q: Array  # (rows, n) as the scene's material would have for the same shape
    target_q: Array  # (rows, n)
    tip_pose: Array  # (rows, 4, 4)
    target_pose: Array  # (rows, 4, 4)
    error: Array  # (rows, 6) SE(3) logarithm from tip to target
    backbone: Array  # (rows, stations, 3) [m]
    target_backbone: Array  # (rows, stations, 3) [m]


def norm(vectors: Array) -> Array:
    """Of the last axis."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


ERRORS: Mapping[str, Callable[[Tracking], Array]] = {
    "position_error": lambda t: norm(t.target_pose[:, :3, 3] - t.tip_pose[:, :3, 3]),
    "angle_error": lambda t: norm(t.error[:, :3]),
    "backbone_error": lambda t: np.sqrt(np.mean(norm(t.target_backbone - t.backbone) ** 2, axis=1)),
    "coordinate_error": lambda t: norm(t.target_q - t.q),
}
"""Every error, (rows,): [m], [rad], [m], in the unit of the coordinates (newton for tensions)."""


class Task(NamedTuple):
    """One task.

    observations: the groups of each named choice. reward: default weights by term. shapes: compares whole shapes, and so needs
    targets that are made of tensions. goal: goal-conditioned, see Reach.
    """

    name: str
    target: str
    observations: Mapping[str, tuple[str, ...]]
    errors: tuple[str, ...]
    reward: Mapping[str, float]
    shapes: bool = False
    goal: bool = False

    @property
    def terms(self) -> tuple[str, ...]:
        """The reward terms that the task has."""
        return (*(name.removesuffix("_error").replace("coordinate", "coordinates") for name in self.errors), "effort", "smoothness")


TIP = ("tip_position", "tip_rotation")

TIP_POSE = Task(
    name="TipPose",
    target="random",
    observations={
        "full": ("coordinates", "rates", *TIP, "tip_twist", "target_error", "target_twist", "preview", "last_action"),
        "measurable": (*TIP, "tendon_lengths", "strain", "target_error", "target_twist", "preview", "last_action"),
    },
    errors=("position_error", "angle_error"),
    reward={"position": 1.0, "angle": 0.5, "effort": 0.05, "smoothness": 0.05},
)
SHAPE = Task(
    name="Shape",
    target="random",
    observations={
        "full": ("coordinates", "rates", *TIP, "target_coordinates", "coordinate_preview", "last_action"),
        "measurable": (*TIP, "tendon_lengths", "strain", "target_error", "target_lengths", "preview", "last_action"),
    },
    errors=("backbone_error", "coordinate_error", "position_error"),
    reward={"backbone": 1.0, "effort": 0.05, "smoothness": 0.05},
    shapes=True,
)
REACH = Task(
    name="Reach",
    target="hold",
    observations={
        "full": ("coordinates", "rates", *TIP, "tip_twist", "last_action"),
        "measurable": (*TIP, "tendon_lengths", "strain", "last_action"),
    },
    errors=("position_error",),
    reward={},
    goal=True,
)


def goal_reward(achieved: ArrayLike, desired: ArrayLike, kind: str, threshold: float) -> Array:
    """Reward (...) of goals (..., 3) [m]: "sparse" 1 within the threshold, else 0; "dense" the closeness, 1/2 at 5 thresholds."""
    distance = goal_distance(achieved, desired)
    return (distance <= threshold).astype(np.float64) if kind == "sparse" else closeness(distance, 5.0 * threshold)


def goal_distance(achieved: ArrayLike, desired: ArrayLike) -> Array:
    """Distances (...) [m] of goals (..., 3), component by component so that one goal and many give the same bits. Raises ValueError."""
    shapes = np.shape(achieved), np.shape(desired)
    if shapes[0] != shapes[1] or shapes[0][-1:] != (3,):
        raise ValueError(f"achieved_goal and desired_goal should have the same shape (..., 3), not {shapes[0]} and {shapes[1]}")
    x, y, z = np.moveaxis(np.asarray(achieved, dtype=np.float64) - np.asarray(desired, dtype=np.float64), -1, 0)
    return np.asarray(np.sqrt(x * x + y * y + z * z))
