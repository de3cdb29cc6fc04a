"""A tendon routing of your own: a helix that narrows along a tapered arm.
`python examples/own_routing.py`"""

from typing import Literal

import numpy as np

import soft_tendon_env as ste
from soft_tendon_env.scene.routing import TendonRouting
from soft_tendon_env.tools.types import Length, Number


@ste.register("routing", "conical_helix")
class ConicalHelix(TendonRouting):
    """Helix of `angular_rate` [rad/m] whose radius goes from `start_radius` to `end_radius` [m]
    between the tendon's ends."""

    type: Literal["conical_helix"] = "conical_helix"
    start_radius: Length
    end_radius: Length
    angular_rate: Number

    def offset_and_slope(self, arc_length, radius, radius_slope, ends):
        start, end = ends
        narrowing = (self.end_radius - self.start_radius) / (end - start)
        distance = self.start_radius + narrowing * (arc_length - start)
        angle = self.angular_rate * arc_length
        outward = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        around = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        offset = distance[:, None] * outward
        slope = narrowing * outward + self.angular_rate * distance[:, None] * around
        return offset, slope

    def turn_rate(self):
        """So that the accuracy of coordinates is judged on parts that turn once."""
        return abs(self.angular_rate)

    def wavelength(self):
        """So that quadrature resolves each turn."""
        return 2.0 * np.pi / abs(self.angular_rate) if self.angular_rate else np.inf


SPIRAL = {
    "type": "conical_helix",
    "start_radius": 0.009,
    "end_radius": 0.005,
    "angular_rate": 20.0,
}
SCENE = ste.load_scene("three_tendon").replace(
    {
        "name": "spiral",
        "segments.0.radius": {"type": "linear", "base": 0.012, "tip": 0.007},
        "tendons.0.routing": SPIRAL,
    }
)

if __name__ == "__main__":
    model = ste.build_model(SCENE, fidelity="scene")
    tip = ste.static_equilibrium(model, [3.0, 0.0, 0.0]).tip_pose
    twist = np.degrees(np.arctan2(tip[2, 1], tip[1, 1]))
    print(f"3 N on the spiral twist the tip by {twist:.1f} degrees")
