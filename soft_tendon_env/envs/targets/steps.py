"""Set-point changes: poses or shapes to reach and hold, one after another, between which the target jumps (step responses)."""

from typing import Literal

import numpy as np
from pydantic import Field

from soft_tendon_env.envs.targets.base import Course, DrawnShapes, Setting, ShapeCourse, register_target
from soft_tendon_env.envs.targets.statics import StaticCourse, drawn_set_point
from soft_tendon_env.tools.types import Array, Positive

MOST_STEPS = 1_000


@register_target
class Steps(DrawnShapes):
    """`count` set points, each for `duration` [s], over and over: shapes at rest under random tensions within `fraction` of their
    limits."""

    type: Literal["steps"] = "steps"
    duration: Positive = 2.0
    count: int = Field(default=5, ge=2, le=MOST_STEPS)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm can hold none."""
        held = [drawn_set_point(self.fraction, generator, setting) for _ in range(self.count)]
        return Stepped(held, self.duration)


class Stepped(ShapeCourse):
    """Shapes that are held one after another, over and over."""

    def __init__(self, held: list[StaticCourse], duration: float) -> None:
        self._q = np.concatenate([course.coordinates(np.zeros(1))[0] for course in held])
        self._duration = duration

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        q = self._q[np.floor(times / self._duration + 1e-9).astype(int) % len(self._q)]
        return q, np.zeros_like(q)
