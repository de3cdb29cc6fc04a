"""Contact of rows with obstacles: what observations, errors and rewards read of it, and which starts and targets keep clear of it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects.contact import ContactForces, ContactReading, contact_forces, number_of_contact
from soft_tendon_env.envs.arms import Arms, Indices, model_with
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import State
from soft_tendon_env.scene.scene import Array, rod_radius

INSIDE = 0.1
"""Depth in an obstacle, in radii of the rod, from which an arm at rest counts as inside of it: ten times what its own weight makes."""


class Seen(NamedTuple):
    """Contact of all rows as it is observed and judged."""

    force: Array  # (rows, sections, 3) [N] on the arm, world frame
    clearance: Array  # (rows, sections) [m] between the surfaces of arm and obstacles, negative where they overlap
    penetration: Array  # (rows,) [m] the deepest
    load: Array  # (rows,) [N] sum of the sizes of all contact forces


class Contacts:
    """Contact of rows of arms with the obstacles of their scene."""

    def __init__(self, arms: Arms, sections: int) -> None:
        """`sections`: equal parts of the rod by which it is observed."""
        model = arms.model
        places = model.scene.effects.contact.sample_places(model.discretisation)
        self._arms = arms
        self._section = np.minimum(sections * places / model.length, sections - 1).astype(np.int64)
        self._reading = ContactReading(np.zeros((arms.size, sections, 3)), np.zeros((arms.size, sections)), np.zeros(arms.size))

    def look(self, members: Indices) -> Seen:
        """Contact now, after the rows `members` have moved on; new arrays."""
        self._arms.read_contact(members, self._section, self._reading)
        force, clearance, load = (values.copy() for values in self._reading)
        return Seen(force, clearance, np.maximum(-clearance.min(axis=1), 0.0), load)


def has_contact(model: Model) -> bool:
    """Whether the arm of a model meets obstacles."""
    return number_of_contact(model.arm.effects) is not None


def contact_at_rest(model: Model, q: Array) -> ContactForces:
    """Contact of an arm that is at rest at q (n,), at time 0."""
    strain = model.grid.unpacked(model.packed_strain(q))
    return contact_forces(model, State(0.0, q, np.zeros_like(q), strain, 0.0, model.arm.effects.state))


def why_inside(model: Model, q: Array) -> str:
    """What an arm that rests at q (n,) is inside of, as the end of a sentence; "": of nothing."""
    if not has_contact(model):
        return ""
    found = contact_at_rest(model, q)
    depth = -found.gap / rod_radius(model.scene, found.arc_length)[0]
    obstacle, sample = (int(i) for i in np.unravel_index(np.argmax(depth), depth.shape))
    if depth[obstacle, sample] <= INSIDE:
        return ""
    return _begins(model, -found.gap[obstacle, sample], obstacle, found.arc_length[sample])


def why_base_inside(model: Model, q: Array) -> str:
    """Obstacle that the clamped base is so deep in that no motion frees the arm, which holds at q (n,), as the end of a sentence; "": none.

    It takes no search for an equilibrium. The first place where contact is looked for is then inside too, however the arm bends.
    """
    if not has_contact(model):
        return ""
    contact, base = model.scene.effects.contact, model.backbone_at(q, [0.0])[:, :3, 3]
    within = -contact.distances(base)[:, 0]
    obstacle = int(np.argmax(within))
    if within[obstacle] <= contact.sample_places(model.discretisation)[0]:
        return ""
    return _begins(model, within[obstacle] + rod_radius(model.scene, 0.0)[0][0], obstacle, 0.0)


def _begins(model: Model, depth: float, obstacle: int, place: float) -> str:
    """Sentence that an arm begins at a depth [m] in an obstacle, at an arc length [m]."""
    kind = model.scene.effects.contact.obstacles[obstacle].type
    return f"the arm begins {1e3 * depth:.3g} mm deep in effects.contact.obstacles[{obstacle}], a {kind}, at {place:.3g} m along it"


class Clear:
    """The space that obstacles which stand still leave free, see targets.FreeSpace."""

    def __init__(self, arms: Arms, among: Model) -> None:
        """`among`: the model of the arms among the obstacles that count."""
        grid, contact = arms.model.grid, among.scene.effects.contact
        places = contact.sample_places(among.discretisation)
        self.model = model_with(arms.model, arms.model.scene.effects.everywhere())
        self._arms, self._contact = arms, contact
        self._places = grid.places(places, np.empty(0))
        self._radius = rod_radius(among.scene, places)[0]
        self._stands = np.array([not obstacle.moves for obstacle in contact.obstacles])

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Whether the arm is clear of them at coordinates q (m, n): (m,)."""
        reading, good = self._arms.read_samples(q, np.zeros_like(q), self._places)
        positions = np.ascontiguousarray(reading.backbone[..., :3, 3].reshape(-1, 3))
        gap = self._contact.distances(positions)[self._stands].reshape(-1, len(q), self._radius.size) - self._radius
        return good & (gap > 0.0).all(axis=(0, 2))


def tip_radius(model: Model) -> float:
    """Radius [m] of the round tip."""
    return float(rod_radius(model.scene, np.array([model.length]))[0][0])


def tip_depths(model: Model, positions: Array) -> tuple[float, str]:
    """How deep [m] the round tip would be, at the worst of positions (m, 3) [m], in obstacles that stand still, and in which of them."""
    contact = model.scene.effects.contact
    depth = tip_radius(model) - contact.distances(positions).min(axis=1)
    depth[[obstacle.moves for obstacle in contact.obstacles]] = -np.inf
    worst = int(np.argmax(depth))
    return float(depth[worst]), f"effects.contact.obstacles[{worst}], a {contact.obstacles[worst].type}"
