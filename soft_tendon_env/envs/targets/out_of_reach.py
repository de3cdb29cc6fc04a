"""A pose out of reach: farther from the base than the arm can extend."""

from typing import Literal

import numpy as np

from soft_tendon_env.envs.targets.base import Course, DrawnShapes, Setting, register_target
from soft_tendon_env.envs.targets.hold import FixedPose
from soft_tendon_env.envs.targets.statics import drawn_set_point
from soft_tendon_env.tools.types import Positive


@register_target
class OutOfReach(DrawnShapes):
    """The pose of a shape at rest under random tensions within `fraction` of their limits, moved away from the base along the line through
    both until it is `beyond` times the rod's length from the base, which should be more than the arm can stretch to."""

    type: Literal["out_of_reach"] = "out_of_reach"
    beyond: Positive = 1.2

    @property
    def gives_shapes(self) -> bool:
        """False: no shape has its pose."""
        return False

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The pose of one episode. Raises ConfigurationError where the arm can hold none of the shapes."""
        held = drawn_set_point(self.fraction, generator, setting)
        pose = setting.model.tip_pose(held.coordinates(np.zeros(1))[0][0])
        pose[:3, 3] *= self.beyond * setting.model.length / np.linalg.norm(pose[:3, 3])
        return FixedPose(pose)
