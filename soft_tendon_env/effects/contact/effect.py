"""Contact of a whole arm with obstacles as an effect: the table of the scene, its internal states and its potential energy."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, Solid, register_effect
from soft_tendon_env.effects.contact.distance import read_distances
from soft_tendon_env.effects.contact.obstacles import AnyObstacle
from soft_tendon_env.effects.contact.rows import ContactParameters
from soft_tendon_env.effects.contact.samples import make_samples
from soft_tendon_env.effects.contact.wrench import contact_energy
from soft_tendon_env.effects.nodes import nodes_with
from soft_tendon_env.mechanics.effect_parameters import Matrix
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.types import NotNegative, Positive


@register_effect("contact")
class Contact(Effect):
    """`[effects.contact]` with `[[effects.contact.obstacles]]`: planes, spheres, capsules, cylinders and boxes, fixed or moving, which the
    whole arm cannot enter.

    `obstacles` are tables with a `type`, "plane", "sphere", "capsule", "cylinder" or "box", see Plane, Sphere, Capsule, Cylinder and Box;
    `friction` is the coefficient mu [-] of those that have none of their own. `stiffness` is force per length and depth [N/m^2]; none:
    E A / (2 r)^2, about that of the rod's material pressed flat, pi E / 4. `dissipation` is c [s/m] of the normal force: an impact at a
    speed v returns it times about 1 - 2/3 c v where c v is small. `spacing` is the largest distance [m] between neighbouring samples; none:
    the rod's radius there. What is thinner than that and meets the arm between samples sinks in a little.
    """

    is_encountered: ClassVar[bool] = True

    obstacles: tuple[AnyObstacle, ...] = Field(min_length=1)
    friction: NotNegative = 0.0
    stiffness: Positive | None = None
    dissipation: NotNegative = 1.0
    spacing: Positive | None = None

    def parameters(self, rod: Discretisation) -> ContactParameters:
        intervals, samples, _ = make_samples(rod, self.stiffness, self.spacing)
        return ContactParameters(Matrix(intervals), Matrix(samples), Matrix(self._rows()))

    def sample_places(self, rod: Discretisation) -> Array:
        """Arc lengths (samples,) [m] at which contact is looked for."""
        return make_samples(rod, self.stiffness, self.spacing)[2]

    def state(self, rod: Discretisation) -> Array:
        if not self._has_friction:
            return np.zeros(0)
        return np.zeros(3 * len(self.obstacles) * self.sample_places(rod).size)

    def bodies(self) -> tuple[tuple[str, bool], ...]:
        return tuple((f"obstacles[{i}], a {obstacle.type}", obstacle.moves) for i, obstacle in enumerate(self.obstacles))

    def state_of(self) -> str:
        return f"of {', '.join(obstacle.type for obstacle in self.obstacles)}"

    def potential_energy(self, arm: Configured) -> float:
        if self._has_friction or any(obstacle.moves for obstacle in self.obstacles):
            raise ValueError("contact with friction or with obstacles that move has no potential energy")
        pose = node_field(np.concatenate([arm.pose[:, :3, :3].reshape(-1, 9), arm.pose[:, :3, 3]], axis=1))
        base = np.concatenate([np.eye(3).ravel(), np.zeros(15)])
        energy = np.zeros(1)
        contact_energy(self.parameters(arm.rod), nodes_with(pose, np.zeros(pose.size // 2), base, np.zeros(0), 0.0), energy)
        return float(energy[0])

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        return tuple(obstacle.solid(time) for obstacle in self.obstacles)

    def distances(self, positions: Array, time: float = 0.0) -> Array:
        """Signed distances (obstacles, m) [m] from the obstacles' surfaces to positions (m, 3) [m] at a time [s], negative inside."""
        out = np.empty((len(self.obstacles), len(positions)))
        read_distances(self._rows(), positions, time, out)
        return out

    def _rows(self) -> Array:
        return np.array([obstacle.row(self.friction, self.dissipation) for obstacle in self.obstacles])

    @property
    def _has_friction(self) -> bool:
        return any(self.friction if obstacle.friction is None else obstacle.friction for obstacle in self.obstacles)
