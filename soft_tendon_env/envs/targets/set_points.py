"""Set points: poses or shapes to reach and hold, one after another, or out of reach."""

from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from soft_tendon_env.envs.targets import (
    FARTHEST,
    Course,
    Distance,
    DrawnShapes,
    PoseCourse,
    Setting,
    ShapeCourse,
    TargetSamples,
    pose_samples,
    register_target,
)
from soft_tendon_env.envs.targets.statics import shape_course
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.types import Array, Positive


@register_target
class Hold(DrawnShapes):
    """One pose to reach and hold: the pose at which `tension` (n_a) [N] holds the arm, a given `pose` (4 x 4), for Reach a given
    `position` (3) [m] alone, or by default a pose from random tensions within `fraction` of their limits."""

    type: Literal["hold"] = "hold"
    tension: tuple[float, ...] | None = None
    pose: tuple[tuple[float, float, float, float], ...] | None = Field(default=None, min_length=4, max_length=4)
    position: tuple[Distance, Distance, Distance] | None = None

    @field_validator("pose", mode="before")
    @classmethod
    def _rows(cls, pose: Any) -> Any:
        return tuple(tuple(row) if isinstance(row, list) else row for row in pose) if isinstance(pose, tuple) else pose

    @model_validator(mode="after")
    def _one_of(self) -> "Hold":
        given = [name for name in ("tension", "pose", "position") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"should give {given[0]} or {given[1]}, not both")
        if self.pose is not None:
            g = np.array(self.pose)
            R, r = g[:3, :3], g[:3, 3]
            is_rotation = np.abs(R).max() < 1.1 and np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0
            if not (is_rotation and (g[3] == [0, 0, 0, 1]).all() and np.abs(r).max() <= FARTHEST):
                allowed = f"a homogeneous matrix [[R, r], [0, 0, 0, 1]] with a rotation R and coordinates r within ±{FARTHEST:g} m"
                raise ConfigurationError([Problem(("pose",), f"is {shown(g.tolist())}: it should be {allowed}")])
        return self

    @property
    def given(self) -> Array | None:
        """The given pose (4, 4), of a position alone with the base's axes; None where it is made of tensions."""
        if self.position is None:
            return None if self.pose is None else np.array(self.pose)
        pose = np.eye(4)
        pose[:3, 3] = self.position
        return pose

    @property
    def is_random(self) -> bool:
        return self.tension is None and self.gives_shapes

    @property
    def gives_shapes(self) -> bool:
        return self.pose is None and self.position is None

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return shape_course(self, generator, setting) if self.given is None else FixedPose(self.given)


class FixedPose(PoseCourse):
    """A pose that stays."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose

    def sample(self, times: Array) -> TargetSamples:
        return pose_samples(np.tile(self.pose, (times.size, 1, 1)), np.zeros((times.size, 6)))


@register_target
class OutOfReach(DrawnShapes):
    """The pose of a shape at rest under random tensions within `fraction` of their limits, moved away from the base along the line through
    both until it is `beyond` times the rod's length from the base, which should be more than the arm can stretch to."""

    type: Literal["out_of_reach"] = "out_of_reach"
    beyond: Positive = 1.2

    @property
    def gives_shapes(self) -> bool:
        return False  # no shape has its pose

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        pose = setting.model.tip_pose(shape_course(self, generator, setting).coordinates(np.zeros(1))[0][0])
        pose[:3, 3] *= self.beyond * setting.model.length / np.linalg.norm(pose[:3, 3])
        return FixedPose(pose)


@register_target
class Steps(DrawnShapes):
    """`count` set points, each for `duration` [s], over and over: shapes at rest under random tensions within `fraction` of their
    limits."""

    type: Literal["steps"] = "steps"
    duration: Positive = 2.0
    count: int = Field(default=5, ge=2, le=1_000)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        held = [shape_course(self, generator, setting).coordinates(np.zeros(1))[0][0] for _ in range(self.count)]
        return Stepped(np.array(held), self.duration)


class Stepped(ShapeCourse):
    """Shapes (k, n) that are held one after another, over and over."""

    def __init__(self, held: Array, duration: float) -> None:
        self._held, self._duration = held, duration

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        q = self._held[np.floor(times / self._duration + 1e-9).astype(int) % len(self._held)]
        return q, np.zeros_like(q)
