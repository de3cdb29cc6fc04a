"""A strain parametrisation of your own: bending by cosines, a Fourier series.
`python examples/own_strain.py`"""

from typing import Literal

import numpy as np
from pydantic import Field

import soft_tendon_env as ste
from soft_tendon_env.scene.strain import STRAINS, ExplicitBasis


@ste.register("strain", "cosines")
class Cosines(ExplicitBasis):
    """Curvatures about y and z are sums of cos(k pi X / L), k = 0 to `order`; all else is rigid."""

    type: Literal["cosines"] = "cosines"
    order: int = Field(ge=0, le=12)

    @property
    def free(self):
        """The rod bends alone."""
        return ("bend_y", "bend_z")

    @property
    def highest_order(self):
        """A polynomial of twice the order has as many waves."""
        return 2 * self.order

    def fields(self, points, borders):
        shares = points / borders[-1]
        fields = []
        for strain in self.free:
            for k in range(self.order + 1):
                field = np.zeros((*points.shape, len(STRAINS)))
                field[..., STRAINS.index(strain)] = np.cos(k * np.pi * shares)
                fields.append(field)
        return np.array(fields)


if __name__ == "__main__":
    scene = ste.load_scene("three_tendon").replace(
        {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    )
    fine = {"type": "explicit", "modes": [{"strains": ["bend_y", "bend_z"], "order": 8}]}
    fine["modes"][0]["span"] = "rod"
    reference = ste.build_model(scene.replace({"strain": fine}), "scene")
    expected = ste.static_equilibrium(reference, [2.0, 0.0, 0.0]).tip_pose[:3, 3]
    for order in (1, 3, 6):
        strain = {"type": "cosines", "order": order}
        model = ste.build_model(scene.replace({"strain": strain}), "scene")
        tip = ste.static_equilibrium(model, [2.0, 0.0, 0.0]).tip_pose[:3, 3]
        error = 1e3 * np.linalg.norm(tip - expected)
        print(f"{model.coordinate_count} coordinates: the tip is {error:.2f} mm off")
