"""Circular tip trajectory: the task of the paper's Section IV-B."""

from typing import Literal

import numpy as np
from pydantic import Field

from soft_tendon_env.envs.targets.base import (
    FARTHEST,
    Course,
    Distance,
    PoseCourse,
    Setting,
    Target,
    TargetSamples,
    pose_samples,
    register_target,
)
from soft_tendon_env.tools.types import Array, Positive


@register_target
class Circle(Target):
    """The tip runs along a circle parallel to the y-z plane, its x axis leaning outward: the task of the paper's Section IV-B.

    `radius` [m], `centre` [m], `tilt` [degrees]; `period` [s] of one turn, which the paper does not give.
    """

    type: Literal["circle"] = "circle"
    radius: float = Field(default=0.25, gt=0, le=FARTHEST)
    centre: tuple[Distance, Distance, Distance] = (0.95, 0.0, 0.0)
    tilt: float = Field(default=37.8, ge=-90, le=90)
    period: Positive = 4.0

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode."""
        return CircleCourse(self)


class CircleCourse(PoseCourse):
    """The circle; its body twist follows from R(a) = Rx(a) R(0) Rx(-a), with a the angle and Rx turns about x."""

    def __init__(self, circle: Circle) -> None:
        self.circle = circle

    def sample(self, times: Array) -> TargetSamples:
        rate = 2.0 * np.pi / self.circle.period
        angle = rate * np.mod(times, self.circle.period)
        c, s = np.cos(angle), np.sin(angle)
        lean = np.radians(self.circle.tilt)
        outward = np.stack([0.0 * c, c, s], axis=-1)
        x_axis = np.cos(lean) * np.array([1.0, 0.0, 0.0]) + np.sin(lean) * outward
        radial = np.cos(lean) * outward - np.sin(lean) * np.array([1.0, 0.0, 0.0])
        across = np.stack([0.0 * c, -s, c], axis=-1)
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, 0] = x_axis
        pose[:, :3, 1] = c[:, None] * radial - s[:, None] * across  # no roll: the axes of the base, carried by the shortest turn
        pose[:, :3, 2] = s[:, None] * radial + c[:, None] * across
        pose[:, :3, 3] = np.array(self.circle.centre) + self.circle.radius * outward
        rotation = pose[:, :3, :3]
        angular = rate * (rotation[:, 0, :] - np.array([1.0, 0.0, 0.0]))
        linear = (rotation * (rate * self.circle.radius * across)[:, :, None]).sum(axis=1)
        return pose_samples(pose, np.concatenate([angular, linear], axis=1))
