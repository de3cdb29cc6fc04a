"""Obstacles: which starts and targets keep clear of them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.effects.contact.forces import read_gaps
from soft_tendon_env.effects.contact.samples import sample_outlines
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

INSIDE = 0.1
"""Depth in an obstacle, in radii of the rod, from which an arm counts as inside: ten times what its
own weight makes."""


class Depth(NamedTuple):
    """How deep a sample of the arm is in an obstacle."""

    depth: float  # [m], negative outside
    sample: int  # number of the sample
    name: str  # of the obstacle, as messages have it


def deepest(contact: Contact, gaps: Array, standing: bool = False) -> Depth:
    """Depth of the sample of the arm that is deepest in an obstacle at time 0.

    Args:
        contact: of the scene.
        gaps: (obstacles, m) [m] between obstacles and samples.
        standing: look at obstacles that stand still alone.

    Returns:
        The depth; minus infinity where there is no obstacle.
    """
    depths = [Depth(-np.inf, 0, "")]
    for i, obstacle in enumerate(contact.obstacles):
        if standing and obstacle.moves:
            continue
        name = f"effects.contact.obstacles[{i}], a {obstacle.type}"
        gap = gaps[i]
        deepest = float(-gap.min())
        sample = int(gap.argmin())
        depths.append(Depth(deepest, sample, name))
    return max(depths)


def why_inside(model: Model, q: Array) -> str:
    """Reason why an arm at rest at q (n,) begins inside of an obstacle, "" where it does not."""
    contact = model.scene.effects.contact
    if contact is None:
        return ""
    places = contact.sample_places(model.discretisation)
    radius = sample_outlines(model.discretisation, places).radius
    backbone = model.backbone_at(q, places)
    gaps = contact.gaps(model.discretisation, backbone)
    depth, sample, name = deepest(contact, gaps)
    allowed = INSIDE * radius[sample]
    if not depth > allowed:
        return ""
    place = f"{places[sample]:.3g} m along it"
    return f"the arm begins {1e3 * depth:.3g} mm deep in {name}, at {place}"


class ObstacleFreeSpace:
    """The space that obstacles which stand still leave free.

    `model` is of the arm without obstacles, with the same coordinates.
    """

    def __init__(self, arms: Arms) -> None:
        model = arms.model
        scene = model.scene
        self._arms = arms
        without_obstacles = {"effects": scene.effects.everywhere()}
        bare_scene = scene.model_copy(update=without_obstacles)
        self.model = model.with_scene(bare_scene)
        self._contact = scene.effects.contact
        self._parameters = self._contact.parameters(model.discretisation)  # once for all poses
        places = self._contact.sample_places(model.discretisation)
        no_sensors = np.empty(0)
        self._places = model.grid.places(places, no_sensors)

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Whether the arm is clear of standing obstacles at coordinates q (m, n): (m,)."""
        no_motion = np.zeros_like(q)
        reading, has_strain = self._arms.read_samples(q, no_motion, self._places)
        depths = []
        for poses in reading.backbone:
            shape = (len(self._contact.obstacles), len(poses))
            gaps = np.empty(shape)
            in_order = np.ascontiguousarray(poses)
            read_gaps(self._parameters, in_order, 0.0, gaps)
            deepest_place = deepest(self._contact, gaps, standing=True)
            depths.append(deepest_place.depth)
        is_clear = np.array(depths) < 0.0
        return has_strain & is_clear
