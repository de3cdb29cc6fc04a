"""Tension ramp from rest to static tensions, then held: the task of the paper's Section IV-A."""

from typing import Literal

import numpy as np

from soft_tendon_env.envs.targets.base import Course, DrawnShapes, Setting, register_target
from soft_tendon_env.envs.targets.statics import Tensions, check_tension, drawn_course, given_course, nearest_to_zero
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array, Positive


@register_target
class Ramp(DrawnShapes):
    """From rest to static tensions within `duration` [s], then held: the task of the paper's Section IV-A.

    `tension` (n_a) [N], by default random ones within `fraction` of their limits.
    """

    type: Literal["ramp"] = "ramp"
    duration: Positive = 2.5
    tension: tuple[float, ...] | None = None

    @property
    def is_random(self) -> bool:
        """Whether tensions are drawn."""
        return self.tension is None

    def check(self, scene: Scene) -> None:
        """Raises ConfigurationError unless there is a tension per tendon."""
        check_tension(self.tension, scene)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm cannot hold the tensions, or those on the way."""
        start = nearest_to_zero(setting.limits)
        if self.tension is not None:
            return given_course(self.tension, setting, lambda end: Rise(start, end, self.duration))
        return drawn_course(1, self.fraction, generator, setting, lambda points: Rise(start, points[0], self.duration))


class Rise(Tensions):
    """Tensions that go from `start` to `end` with the polynomial of least degree that is twice differentiable."""

    def __init__(self, start: Array, end: Array, duration: float) -> None:
        self.start, self.change, self.duration = start, end - start, duration
        self.knots = np.linspace(0.0, duration, 5)

    def within(self, times: Array) -> Array:
        return np.clip(times, 0.0, self.duration)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        x = (self.within(times) / self.duration)[:, None]
        part = x * x * x * (10.0 + x * (6.0 * x - 15.0))
        rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / self.duration
        return self.start + part * self.change, rate * self.change
