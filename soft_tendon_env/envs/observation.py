"""The observation's layout: one flat float32 vector of groups, each scaled to about one and clipped to finite bounds, and their history.

`docs/reference/environments.md` has this table with sizes. Groups for every task stand in GROUPS; a task brings others in `Task.groups`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.kernels import ContactReading, scale_and_clip
from soft_tendon_env.envs.randomization import Measured
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Scene, segment_index
from soft_tendon_env.tools.types import Array

CLIP = 10.0
"""Largest absolute value of a scaled entry, unless its group says otherwise."""
FAR = 100.0
"""Largest absolute value of a scaled way to the target: ten lengths of the rod."""


class RestValues(NamedTuple):
    """Rest values that are subtracted from measured tendon lengths and strains."""

    tendon_length: Array  # (n_a,) [m] without tension
    strain: Array  # (sensors, 6) stress-free


@dataclass(slots=True)
class Observed:
    """Quantities that observation groups are computed from, rows first; measured quantities carry the sensors' noise.

    Of what is made of others nothing is computed that no group asks for.
    """

    arms: Arms
    measured: Reading | Measured  # the arms' reading itself where sensors have no noise
    error: Array  # (rows, 1 + previews, 6) SE(3) logarithms from the measured tip pose to the target now and at each preview
    target: TargetSamples  # (rows, 1 + previews, ..), its q for targets made of tensions
    action: Array  # (rows, n_a) the last one, in [-1, 1]
    command: Array  # (rows, n_a) [N] asked for last, before actuators err
    contact: ContactReading  # no rows without obstacles
    rest: RestValues

    @property
    def q(self) -> Array:
        """(rows, n)."""
        return self.arms.rows.q

    @property
    def q_dot(self) -> Array:
        """(rows, n)."""
        return self.arms.rows.q_dot

    @property
    def tip_pose(self) -> Array:
        """(rows, 4, 4) measured."""
        return self.measured.tip_pose

    @property
    def tip_twist(self) -> Array:
        """(rows, 6) body twist."""
        return self.arms.reading.tip_twist

    @property
    def tendon_length(self) -> Array:
        """(rows, n_a) [m] measured, less the length at rest without tension."""
        return self.measured.tendon_length - self.rest.tendon_length

    @property
    def target_length(self) -> Array:
        """(rows, n_a) [m] of targets made of tensions, likewise."""
        return self.target.tendon_length[:, 0] - self.rest.tendon_length


class Sizes(NamedTuple):
    """Numbers of coordinates, tendons, sensors, previews and contact sections, on which the sizes of groups depend."""

    coordinates: int
    tendons: int
    sensors: int
    previews: int
    sections: int


class Units(NamedTuple):
    """Units of length, coordinates, tensions and forces, by which entries are divided."""

    length: float  # [m], the rod's
    q: Array  # (n,) the coordinates that bend the arm by about a radian each
    tension: Array  # (n_a,) [N] the largest allowed
    force: float  # [N] that bends the arm by about a radian, where it acts on the tip


@dataclass(frozen=True)
class Group:
    """An observation group: what it is, its size, its values (rows, size), and the units (size) or () that they are divided by.

    of_shape: it is of targets that are shapes; of_target: of a target that goal-conditioned tasks give as a goal instead; of_contact: of
    obstacles, which the scene then needs; of_arm: measured of the arm, or asked of it, which is what a history keeps.
    """

    description: str
    size: Callable[[Sizes], int]
    values: Callable[[Observed], Array]
    unit: Callable[[Units, Sizes], Array | float]
    bound: float = CLIP
    of_shape: bool = False
    of_target: bool = False
    of_contact: bool = False
    of_arm: bool = False


def _twist_unit(units: Units, sizes: Sizes) -> Array:
    return np.repeat([5.0, 5.0 * units.length], 3)


def _error_unit(units: Units, sizes: Sizes) -> Array:
    return np.repeat([0.5, 0.1 * units.length], 3)


def _strain_unit(units: Units, sizes: Sizes) -> Array:
    return np.tile(np.repeat([1.0 / units.length, 0.1], 3), sizes.sensors)


def _flat(values: Array) -> Array:
    return values.reshape(len(values), -1)


GROUPS: Mapping[str, Group] = {
    "coordinates": Group("generalised coordinates q", lambda s: s.coordinates, lambda o: o.q, lambda u, s: u.q, of_arm=True),
    "rates": Group("their rates", lambda s: s.coordinates, lambda o: o.q_dot, lambda u, s: 10.0 * u.q, of_arm=True),
    "tip_position": Group("tip position, world frame", lambda s: 3, lambda o: o.tip_pose[:, :3, 3], lambda u, s: u.length, of_arm=True),
    "tip_rotation": Group(
        "first two columns of the tip's rotation matrix: continuous, unlike angles and quaternions",
        lambda s: 6,
        lambda o: _flat(o.tip_pose[:, :3, :2].swapaxes(1, 2)),
        lambda u, s: 1.0,
        of_arm=True,
    ),
    "tip_twist": Group("tip twist, angular then linear, tip frame", lambda s: 6, lambda o: o.tip_twist, _twist_unit, of_arm=True),
    "tendon_lengths": Group(
        "tendon displacements: lengths less those at rest",
        lambda s: s.tendons,
        lambda o: o.tendon_length,
        lambda u, s: 0.1 * u.length,
        of_arm=True,
    ),
    "strain": Group(
        "strains at the sensors less the stress-free ones: torsion, bending, stretch, shear",
        lambda s: 6 * s.sensors,
        lambda o: _flat(o.measured.strain - o.rest.strain),
        _strain_unit,
        of_arm=True,
    ),
    "strain_rate": Group(
        "their rates", lambda s: 6 * s.sensors, lambda o: _flat(o.measured.strain_rate), lambda u, s: 10.0 * _strain_unit(u, s), of_arm=True
    ),
    "target_error": Group(
        "SE(3) logarithm from tip to target, angular then linear", lambda s: 6, lambda o: o.error[:, 0], _error_unit, FAR, of_target=True
    ),
    "target_twist": Group(
        "twist of the target, target frame", lambda s: 6, lambda o: o.target.tip_twist[:, 0], _twist_unit, of_target=True
    ),
    "preview": Group(
        "SE(3) logarithms from the tip to the target at each preview time",
        lambda s: 6 * s.previews,
        lambda o: _flat(o.error[:, 1:]),
        lambda u, s: np.tile(_error_unit(u, s), s.previews),
        FAR,
        of_target=True,
    ),
    "target_coordinates": Group(
        "coordinates of the target less the arm's",
        lambda s: s.coordinates,
        lambda o: o.target.q[:, 0] - o.q,
        lambda u, s: u.q,
        of_shape=True,
    ),
    "coordinate_preview": Group(
        "the same at each preview time",
        lambda s: s.coordinates * s.previews,
        lambda o: _flat(o.target.q[:, 1:] - o.q[:, None]),
        lambda u, s: np.tile(u.q, s.previews),
        of_shape=True,
    ),
    "wanted_coordinates": Group(
        "coordinates of the target, now and at each preview time: for policies that do not observe the arm's",
        lambda s: s.coordinates * (1 + s.previews),
        lambda o: _flat(o.target.q),
        lambda u, s: np.tile(u.q, 1 + s.previews),
        of_shape=True,
    ),
    "target_lengths": Group(
        "tendon lengths of the target less the arm's",
        lambda s: s.tendons,
        lambda o: o.target_length - o.tendon_length,
        lambda u, s: 0.1 * u.length,
        of_shape=True,
    ),
    "last_action": Group("the last action", lambda s: s.tendons, lambda o: o.action, lambda u, s: 1.0, 1.0, of_arm=True),
    "command": Group("tensions asked for last", lambda s: s.tendons, lambda o: o.command, lambda u, s: u.tension, 1.0, of_arm=True),
    "contact_force": Group(
        "contact forces on equal sections of the arm, base to tip, world frame",
        lambda s: 3 * s.sections,
        lambda o: _flat(o.contact.force),
        lambda u, s: u.force,
        FAR,
        of_contact=True,
        of_arm=True,
    ),
    "clearance": Group(
        "clearance of equal sections of the arm, base to tip: least distance from its surface to obstacles, negative inside",
        lambda s: s.sections,
        lambda o: o.contact.clearance,
        lambda u, s: 0.1 * u.length,
        of_contact=True,
        of_arm=True,
    ),
}
"""The groups that every task has, by the name that options use."""

HISTORY = "history"
"""The slice of an observation after all groups, if it has a history."""
CHANGE = 0.1
"""Unit of a group's changes in a history, as a share of the group's own."""


class Layout:
    """The chosen groups side by side, and after them those of the arm as they were in the last control periods, less what they are now."""

    def __init__(self, groups: Mapping[str, Group], sizes: Sizes, units: Units, history: int = 0) -> None:
        """`groups` by name, in their order; `history`: control periods that are looked back.

        Attributes made here: `groups`, `slices` of all groups, and of what is observed now `scale` and `bound` (m,), factors and bounds of
        entries, and `kept`, the columns that a history keeps.
        """
        size = {name: group.size(sizes) for name, group in groups.items()}
        ends = np.cumsum([*size.values()]).tolist()
        self.slices = {name: slice(end - size[name], end) for name, end in zip(groups, ends, strict=True)}
        unit = np.concatenate([np.broadcast_to(group.unit(units, sizes), size[name]) for name, group in groups.items()])
        self.bound = np.repeat([group.bound for group in groups.values()], [*size.values()])
        self.kept = np.flatnonzero(np.repeat([group.of_arm for group in groups.values()], [*size.values()]))
        self.groups, self._checked, self.scale = groups, False, 1.0 / unit
        if history:
            self.slices[HISTORY] = slice(ends[-1], ends[-1] + history * self.kept.size)
        self._units = np.concatenate([unit, np.tile(CHANGE * unit[self.kept], history)])
        self._bounds = np.concatenate([self.bound, np.tile(2.0 / CHANGE * self.bound[self.kept], history)])

    @property
    def space(self) -> Box:
        """Space of one observation."""
        high = self._bounds.astype(np.float32)
        return Box(-high, high, dtype=np.float32)

    def present(self, observed: Observed) -> NDArray[np.float32]:
        """The groups' observation now, a new array (rows, size of the groups); `kept` (m,) are its columns that a history keeps.

        Raises ValueError at the first call where a group's values are not of the size that it says.
        """
        values, parts = np.empty((len(observed.q), self.scale.size)), [group.values(observed) for group in self.groups.values()]
        if not self._checked:
            for (name, where), part in zip(self.slices.items(), parts, strict=False):  # the history comes after the groups
                if np.shape(part) != (allowed := (len(values), where.stop - where.start)):
                    raise ValueError(f"the observation group {name!r} should have values of shape {allowed}, not {np.shape(part)}")
            self._checked = True
        np.concatenate(parts, axis=1, out=values)
        present = np.empty(values.shape, dtype=np.float32)
        scale_and_clip(values, self.scale, self.bound, present)
        return present

    def values(self, observation: NDArray[Any]) -> dict[str, Array]:
        """Observations (rows, size) unscaled: by group (rows, size of the group), in the units of `Observed`."""
        observation = observation * self._units
        return {name: observation[:, where] for name, where in self.slices.items()}


class History:
    """Rows of past observations: what was measured of the arm and asked of it, noise and all. At reset it has always been so.

    They are observed as differences from now, in a tenth of their units: what an arm does in a period would hardly show beside where it is.
    """

    def __init__(self, rows: int, periods: int, kept: NDArray[np.int64]) -> None:
        """periods: control periods that are kept besides the present one; kept: (m,) columns of what is observed.

        `frames` (rows, 1 + periods, m) are what was observed, the latest first.
        """
        self._kept, self.frames = kept, np.zeros((rows, 1 + periods, kept.size), dtype=np.float32)

    def keep(self, present: NDArray[np.float32], step_count: NDArray[np.int64], members: NDArray[np.int64]) -> None:
        """Take what is observed now (rows, ..) of the rows `members`, which have moved on, or begun where their `step_count` is 0."""
        begun, moved = (members[of] for of in (step_count[members] == 0, step_count[members] > 0))
        self.frames[moved, 1:] = self.frames[moved, :-1]
        self.frames[moved, 0] = present[moved][:, self._kept]
        self.frames[begun] = present[begun][:, None, self._kept]

    @property
    def changes(self) -> NDArray[np.float32]:
        """Past less present, a new array (rows, periods * m), the latest period first."""
        changes = (self.frames[:, 1:] - self.frames[:, :1]) / np.float32(CHANGE)
        return changes.reshape(len(changes), -1)


def units_of(model: Model, tension: Array) -> Units:
    """The units of a model, for tensions up to `tension` (n_a,) [N]."""
    return Units(model.length, model.coordinate_scale(), tension, 2.0 * model.bending_energy / model.length)


def stress_free_strain(scene: Scene, arc_length: Array) -> Array:
    """Strains (m, 6) of the stress-free rod at arc lengths (m,) [m]."""
    curvature = np.array([segment.curvature for segment in scene.segments])[segment_index(scene, arc_length)]
    return np.concatenate([curvature, np.tile([1.0, 0.0, 0.0], (arc_length.size, 1))], axis=1)
