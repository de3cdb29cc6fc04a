"""A cross-section of your own: a hollow rectangle, as of an extruded profile.
`python examples/own_section.py`"""

from typing import ClassVar, Literal

import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.scene.routing import Size
from soft_tendon_env.scene.sections import Rectangle
from soft_tendon_env.tools.configuration import Problem


@ste.register("section", "hollow_rectangle")
class HollowRectangle(Rectangle):
    """Rectangle of outer `width` along y and `height` along z, around a hole, with a thin `wall`
    [m]."""

    type: Literal["hollow_rectangle"] = "hollow_rectangle"
    sizes: ClassVar[tuple[str, ...]] = ("width", "height", "wall")

    wall: Size

    def integrals(self, sizes):
        """A, Iy, Iz and J: the hole is taken off, and torsion is that of a thin closed wall."""
        width, height, wall = sizes
        hole_width = width - 2.0 * wall
        hole_height = height - 2.0 * wall
        area = width * height - hole_width * hole_height
        about_y = (width * height**3 - hole_width * hole_height**3) / 12.0
        about_z = (height * width**3 - hole_height * hole_width**3) / 12.0
        # Bredt: J = 4 A^2 t / s of the middle line of the wall, A the area within, s its length
        middle_width = width - wall
        middle_height = height - wall
        enclosed = middle_width * middle_height
        length = 2.0 * (middle_width + middle_height)
        torsion = 4.0 * enclosed**2 * wall / length
        return area, about_y, about_z, torsion

    def misfits(self, length):
        """Problems of the sizes: also a wall without a hole."""
        yield from super().misfits(length)
        width, height, wall = self.sizes_along(length)
        if (2.0 * wall >= np.minimum(width, height)).any():
            yield Problem(("wall",), "is too thick: a hole should be left")


SECTION = {"type": "hollow_rectangle", "width": 0.02, "height": 0.012, "wall": 0.002}
SCENE = ste.load_scene("four_tendon").replace(
    {"name": "profile", "segments.0.radius": None, "segments.0.section": SECTION}
)

if __name__ == "__main__":
    model = ste.build_model(SCENE, fidelity="scene")
    for tendon, axis in ((0, "z"), (1, "y")):
        tension = np.zeros(4)
        tension[tendon] = 1.0
        tip = ste.static_equilibrium(model, tension).tip_pose
        angle = np.degrees(np.arccos(tip[0, 0]))
        print(f"1 N on tendon {tendon} bends it about {axis} by {angle:.2f} degrees")
