"""Obstacles: which starts and targets keep clear of them."""

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects.contact.samples import sample_radius
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

# depth in an obstacle, in radii of the rod, from which an arm counts as inside: ten times what its
# own weight makes
INSIDE = 0.1


def deepest(
    model: Model, positions: Array, radius: Array, standing: bool = False
) -> tuple[float, int, str]:
    """Depth [m] of the ball, of radius (m,) [m] about positions (m, 3) [m], that is deepest in an
    obstacle at time 0, its number, and the obstacle as messages name it. standing: of those that
    stand still alone."""
    contact, found = model.scene.effects.contact, [(-np.inf, 0, "")]
    for (i, obstacle), gap in zip(
        enumerate(contact.obstacles), contact.distances(positions) - radius, strict=True
    ):
        if not (standing and obstacle.moves):
            found.append(
                (
                    float(-gap.min()),
                    int(gap.argmin()),
                    f"effects.contact.obstacles[{i}], a {obstacle.type}",
                )
            )
    return max(found)


def why_inside(model: Model, q: Array) -> str:
    """Obstacle that an arm at rest at q (n,) is inside of, as the end of a sentence; "": none."""
    if model.scene.effects.contact is None:
        return ""
    places = model.scene.effects.contact.sample_places(model.discretisation)
    radius = sample_radius(model.discretisation, places)
    depth, sample, name = deepest(
        model, np.ascontiguousarray(model.backbone_at(q, places)[:, :3, 3]), radius
    )
    where = f"{1e3 * depth:.3g} mm deep in {name}, at {places[sample]:.3g} m along it"
    return f"the arm begins {where}" if depth > INSIDE * radius[sample] else ""


class ObstacleFreeSpace:
    """The space that obstacles which stand still leave free; `model` is of the arm without
    obstacles, with the same coordinates."""

    def __init__(self, arms: Arms) -> None:
        model, scene, self._arms = arms.model, arms.model.scene, arms
        self.model = model.with_scene(
            scene.model_copy(update={"effects": scene.effects.everywhere()})
        )
        places = scene.effects.contact.sample_places(model.discretisation)
        self._places, self._radius = (
            model.grid.places(places, np.empty(0)),
            sample_radius(model.discretisation, places),
        )

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Whether the arm is clear of them at coordinates q (m, n): (m,)."""
        reading, good = self._arms.read_samples(q, np.zeros_like(q), self._places)
        positions = np.ascontiguousarray(reading.backbone[..., :3, 3])
        return good & np.array(
            [
                deepest(self._arms.model, places, self._radius, standing=True)[0] < 0.0
                for places in positions
            ]
        )
