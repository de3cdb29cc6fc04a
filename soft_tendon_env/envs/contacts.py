"""Contact of rows with what the arm comes upon: what observations, errors and rewards read of it, and which starts and targets keep clear.

Every effect that declares `is_encountered` counts, whatever its name: obstacles of `effects.contact`, or a user's own.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects import Effect
from soft_tendon_env.effects.contact.wrench import ContactReading, number_of_contact
from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import rod_radius
from soft_tendon_env.tools.types import Array

INSIDE = 0.1
"""Depth in an obstacle, in radii of the rod, from which an arm at rest counts as inside of it: ten times what its own weight makes."""


class RowContact(NamedTuple):
    """Contact of all rows as it is observed and rewarded."""

    force: Array  # (rows, sections, 3) [N] on the arm, world frame
    clearance: Array  # (rows, sections) [m] between the surfaces of arm and obstacles, negative where they overlap
    penetration: Array  # (rows,) [m] the deepest
    load: Array  # (rows,) [N] sum of the sizes of all contact forces


NO_CONTACT = RowContact(np.zeros((0, 0, 3)), np.zeros((0, 0)), np.zeros(0), np.zeros(0))


def encountered(model: Model) -> dict[str, Effect]:
    """The effects of a model that its arm comes upon in places, as upon obstacles, by name."""
    return {name: effect for name, effect in model.scene.effects.chosen().items() if effect.is_encountered}


class Contacts:
    """Contact of rows of arms with the obstacles of their scene."""

    def __init__(self, arms: Arms, sections: int) -> None:
        """`sections`: equal parts of the rod by which it is observed."""
        number, acting = number_of_contact(arms.model.arm.effects), [*arms.model.acting]
        kinds = {name: SampleReader if acting.index(name) == number else WrenchReader for name in encountered(arms.model)}
        self._readers = [kind(arms, name, sections) for name, kind in kinds.items()]

    def read(self, members: Indices) -> RowContact:
        """Contact now, after the rows `members` have moved on; new arrays."""
        first, *others = (reader.read(members) for reader in self._readers)
        force, clearance, load = (values.copy() for values in first)
        for other in others:
            force, clearance, load = force + other.force, np.minimum(clearance, other.clearance), load + other.load
        return RowContact(force, clearance, np.maximum(-clearance.min(axis=1), 0.0), load)


class SampleReader:
    """Contact of rows with the package's obstacles, whose kernels know the force on every sample of the arm."""

    def __init__(self, arms: Arms, name: str, sections: int) -> None:
        self._arms = arms
        self._section = _sections(encountered(arms.model)[name].sample_places(arms.model.discretisation), arms.model, sections)
        self._reading = _no_reading(arms.size, sections)

    def read(self, members: Indices) -> ContactReading:
        """Contact now, after the rows `members` have moved on; written in place."""
        self._arms.read_contact(members, self._section, self._reading)
        return self._reading


class WrenchReader:
    """Contact of rows with a user's own obstacles: forces by their wrenches at the nodes, clearance by their distances."""

    def __init__(self, arms: Arms, name: str, sections: int) -> None:
        model = arms.model
        self._arms, self._name, self._number = arms, name, [*model.acting].index(name)
        places = encountered(model)[name].sample_places(model.discretisation)
        self._radius = rod_radius(model.scene, places)[0]
        self._of_sample, self._of_node = (_sections(where, model, sections) for where in (places, model.discretisation.node))
        self._places, self._reading = model.grid.places(places, np.empty(0)), _no_reading(arms.size, sections)

    def read(self, members: Indices) -> ContactReading:
        """Contact now, after the rows `members` have moved on; written in place."""
        reading, positions = self._reading, self._arms.read_positions(members, self._places)
        for row, force, where in zip(members.tolist(), self._arms.read_wrenches(members, self._number), positions, strict=True):
            effect, time = self._arms.effects_of(row).chosen()[self._name], float(self._arms.rows.clock[row, 0])
            gap = effect.distances(where, time).min(axis=0) - self._radius
            reading.force[row], reading.clearance[row], reading.load[row] = 0.0, np.inf, np.linalg.norm(force, axis=1).sum()
            np.add.at(reading.force[row], self._of_node, force)
            np.minimum.at(reading.clearance[row], self._of_sample, gap)
        return reading


def _sections(places: Array, model: Model, sections: int) -> NDArray[np.int64]:
    """Number of the section in which each arc length (m,) [m] lies."""
    return np.minimum(sections * places / model.length, sections - 1).astype(np.int64)


def _no_reading(rows: int, sections: int) -> ContactReading:
    return ContactReading(np.zeros((rows, sections, 3)), np.zeros((rows, sections)), np.zeros(rows))


class Depth(NamedTuple):
    """The deepest that balls are in an obstacle, in their units."""

    share: float  # depth over the ball's unit, negative where it is clear
    depth: float  # [m]
    obstacle: str  # as "effects.contact.obstacles[0], a sphere"
    ball: int


def _deepest(model: Model, positions: Array, radius: Array, unit: Array, standing: bool = False) -> Depth:
    """How deep balls of radius (m,) [m] about positions (m, 3) [m] are, in parts of their unit (m,) [m], in what stands there at time 0;
    standing: in what stands still alone."""
    found = [Depth(-np.inf, -np.inf, "", 0)]
    for name, effect in encountered(model).items():
        for (body, moves), gap in zip(effect.bodies(), effect.distances(positions) - radius, strict=True):
            if not (standing and moves):
                ball = int(np.argmin(gap / unit))
                found.append(Depth(float(-gap[ball] / unit[ball]), float(-gap[ball]), f"effects.{name}.{body}", ball))
    return max(found)


def why_inside(model: Model, q: Array) -> str:
    """Obstacle that an arm at rest at q (n,) is inside of, as the end of a sentence; "": none."""
    for effect in encountered(model).values():
        places = effect.sample_places(model.discretisation)
        radius = rod_radius(model.scene, places)[0]
        found = _deepest(model, np.ascontiguousarray(model.backbone_at(q, places)[:, :3, 3]), radius, radius)
        if found.share > INSIDE:
            return _begins(found, places[found.ball])
    return ""


def why_base_inside(model: Model, q: Array) -> str:
    """Obstacle that the clamped base is so deep in that no motion frees the arm, which holds at q (n,), as the end of a sentence; "": none.

    It takes no search for an equilibrium. The first place where contact is looked for is then inside too, however the arm bends.
    """
    for effect in encountered(model).values():
        found = _deepest(model, np.ascontiguousarray(model.backbone_at(q, [0.0])[:, :3, 3]), np.zeros(1), np.ones(1))
        if found.depth > effect.sample_places(model.discretisation)[0]:
            return _begins(found._replace(depth=found.depth + rod_radius(model.scene, 0.0)[0][0]), 0.0)
    return ""


def why_target_inside(model: Model, positions: Array) -> str:
    """Obstacle standing still that the round tip would be inside of at one of its positions (m, 3) [m], as the end of a sentence; "":
    none."""
    radius = np.repeat(rod_radius(model.scene, np.array([model.length]))[0], len(positions))
    found = _deepest(model, positions, radius, radius, standing=True)
    return f"the tip would be {1e3 * found.depth:.3g} mm deep in {found.obstacle}" if found.share > INSIDE else ""


def _begins(found: Depth, place: float) -> str:
    return f"the arm begins {1e3 * found.depth:.3g} mm deep in {found.obstacle}, at {place:.3g} m along it"


class ObstacleFreeSpace:
    """The space that obstacles which stand still leave free; `model` is of the arm without obstacles, with the same coordinates."""

    def __init__(self, arms: Arms, among: Model) -> None:
        """`among`: the model of the arms among the obstacles that count."""
        scene = arms.model.scene
        self.model = arms.model.with_scene(scene.model_copy(update={"effects": scene.effects.everywhere()}))
        self._arms, self._effects = arms, [*encountered(among).values()]
        places = np.unique(np.concatenate([effect.sample_places(among.discretisation) for effect in self._effects]))
        self._places, self._radius = arms.model.grid.places(places, np.empty(0)), rod_radius(among.scene, places)[0]

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Whether the arm is clear of them at coordinates q (m, n): (m,)."""
        reading, good = self._arms.read_samples(q, np.zeros_like(q), self._places)
        positions = np.ascontiguousarray(reading.backbone[..., :3, 3].reshape(-1, 3))
        for effect in self._effects:
            stands = np.array([not moves for _, moves in effect.bodies()])
            gap = effect.distances(positions)[stands].reshape(-1, len(q), self._radius.size) - self._radius
            good = good & (gap > 0.0).all(axis=(0, 2))
        return good
