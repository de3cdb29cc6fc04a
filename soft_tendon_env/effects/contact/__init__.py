"""Contact with obstacles: penalty forces with damping and regularised Coulomb friction, on round samples along the whole arm."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, Solid, register_effect
from soft_tendon_env.effects.contact.forces import ContactParameters, read_contacts
from soft_tendon_env.effects.contact.obstacles import AnyObstacle, read_distances, row_of, solid_of
from soft_tendon_env.effects.contact.samples import make_samples, nodes_with
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.types import NotNegative


@register_effect("contact")
class Contact(Effect):
    """`[effects.contact]` with `[[effects.contact.obstacles]]`: obstacles, fixed or moving, which the whole arm cannot enter.

    Obstacles are tables with a `type`, see the classes of obstacles.py. An impact at a speed v returns it times about 1 - 2/3 c v where
    c v is small, with c the `dissipation`.
    """

    is_contact: ClassVar[bool] = True

    obstacles: tuple[AnyObstacle, ...] = Field(min_length=1, description="what the arm may touch")
    friction: NotNegative = Field(0.0, description="coefficient of friction mu [-]")
    dissipation: NotNegative = Field(1.0, description="damping c [s/m] of the normal force")

    def parameters(self, rod: Discretisation) -> ContactParameters:
        return ContactParameters(*make_samples(rod)[:2], self.rows())

    def rows(self) -> Array:
        """Rows of `ContactParameters.obstacles`."""
        return np.array([row_of(obstacle, self.friction, self.dissipation) for obstacle in self.obstacles])

    def sample_places(self, rod: Discretisation) -> Array:
        """Arc lengths (samples,) [m] at which contact is looked for."""
        return make_samples(rod)[2]

    def bodies(self) -> tuple[tuple[str, bool], ...]:
        """Obstacles as messages name them, and whether they move."""
        return tuple((f"obstacles[{i}], a {obstacle.type}", obstacle.moves) for i, obstacle in enumerate(self.obstacles))

    def potential_energy(self, arm: Configured) -> float:
        """That of the normal forces: friction stores none."""
        if any(obstacle.moves for obstacle in self.obstacles):
            raise ValueError("contact with obstacles that move has no potential energy")
        pose = node_field(np.concatenate([arm.pose[:, :3, :3].reshape(-1, 9), arm.pose[:, :3, 3]], axis=1))
        base, own = np.concatenate([np.eye(3).ravel(), np.zeros(15)]), self.parameters(arm.rod)
        nodes, gap = nodes_with(pose, np.zeros(pose.size // 2), base, 0.0), np.empty((len(self.obstacles), len(own.samples)))
        return float(read_contacts(own, nodes, gap, np.empty((gap.shape[1], 3)), np.empty((*gap.shape, 3))))

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        return tuple(solid_of(obstacle, time) for obstacle in self.obstacles)

    def distances(self, positions: Array, time: float = 0.0) -> Array:
        """Signed distances (obstacles, m) [m] from the obstacles' surfaces to positions (m, 3) [m] at a time [s], negative inside."""
        out = np.empty((len(self.obstacles), len(positions)))
        read_distances(self.rows(), positions, time, out)
        return out
