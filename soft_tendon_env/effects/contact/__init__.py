"""Contact with obstacles: penalty forces with damping and regularised Coulomb friction, on round samples along the whole arm.

Samples lie evenly along the axis, each a ball of the rod's radius that stands for its share of the length; the tip's stands for its round
cap too. obstacles.py says what all obstacles have and which shapes there are.
"""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, Solid, register_effect
from soft_tendon_env.effects.contact.forces import ContactParameters, read_contacts
from soft_tendon_env.effects.contact.obstacles import AnyObstacle, read_distances
from soft_tendon_env.effects.nodes import nodes_with
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.types import NotNegative, Positive

MOST_SAMPLES = 10_000
SMOOTHING = 0.01
"""Depth over which the stiffness grows to its full size, in radii of the rod."""
WALL_SPEED, WALL_MASS = 30.0, 8.0
"""Impact that the wall of a sample stops by itself within twice its width or so: this speed [m/s] of so many times the mass of its
share."""


@register_effect("contact")
class Contact(Effect):
    """`[effects.contact]` with `[[effects.contact.obstacles]]`: obstacles, fixed or moving, which the whole arm cannot enter.

    Obstacles are tables with a `type`, see `Obstacle` and the classes of obstacles.py. An impact at a speed v returns it times about
    1 - 2/3 c v where c v is small, with c the `dissipation`.
    """

    is_contact: ClassVar[bool] = True

    obstacles: tuple[AnyObstacle, ...] = Field(min_length=1, description="what the arm may touch")
    friction: NotNegative = Field(0.0, description="coefficient of friction mu [-] of obstacles without their own")
    stiction_speed: Positive = Field(1e-4, description="slip speed [m/s] below which friction falls, at which what it holds creeps")
    stiffness: Positive | None = Field(None, description="force per length and depth [N/m^2]; by default E A / (2 r)^2 of the rod")
    dissipation: NotNegative = Field(1.0, description="damping c [s/m] of the normal force")

    def parameters(self, rod: Discretisation) -> ContactParameters:
        intervals, samples, _ = make_samples(rod, self.stiffness)
        return ContactParameters(intervals, samples, self.rows(), self.stiction_speed)

    def rows(self) -> Array:
        """Rows of `ContactParameters.obstacles`."""
        return np.array([obstacle.row(self.friction, self.dissipation) for obstacle in self.obstacles])

    def sample_places(self, rod: Discretisation) -> Array:
        """Arc lengths (samples,) [m] at which contact is looked for."""
        return make_samples(rod, self.stiffness)[2]

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
        return tuple(solid for obstacle in self.obstacles for solid in obstacle.solids(time))

    def distances(self, positions: Array, time: float = 0.0) -> Array:
        """Signed distances (obstacles, m) [m] from the obstacles' surfaces to positions (m, 3) [m] at a time [s], negative inside."""
        out = np.empty((len(self.obstacles), len(positions)))
        read_distances(self.rows(), positions, time, out)
        return out


def make_samples(rod: Discretisation, stiffness: float | None) -> tuple[Array, Array, Array]:
    """Rows of `ContactParameters.intervals` and `.samples`, and the samples' arc lengths (samples,) [m], a radius apart at most."""
    start = np.concatenate([[0.0], rod.node[:-1]])
    h = rod.node - start
    counts = np.ceil(h / np.maximum(rod.radius(0.5 * (start + rod.node)), rod.length / MOST_SAMPLES)).astype(int)
    last = np.cumsum(counts)
    t = np.concatenate([np.arange(1, count + 1) / count for count in counts if count])
    own, share = np.repeat(h, counts), np.repeat(h / np.maximum(counts, 1), counts)
    place = np.repeat(start, counts) + t * own
    radius = rod.radius(place)
    share[-1] = 0.5 * share[-1] + radius[-1]  # the tip's round cap
    per_length = rod.elasticity(place)[:, 3] / (2.0 * radius) ** 2 if stiffness is None else np.full(place.size, stiffness)  # [N/m^2]
    wall = WALL_MASS * WALL_SPEED**2 * rod.line_mass(place) * share
    solid = radius if stiffness is None else np.full(place.size, math.inf)
    bases = (1 + 2 * t) * (1 - t) ** 2, own * t * (1 - t) ** 2, t**2 * (3 - 2 * t), own * t**2 * (t - 1)
    samples = np.stack([*bases, t, radius, per_length * share, SMOOTHING * radius, wall, solid], axis=1)  # in the order of Sample
    largest = [radius[end - count : end].max(initial=0.0) for end, count in zip(last, counts, strict=True)]
    return np.stack([h, last - counts, last, largest], axis=1), samples, place
