"""Observations: one flat float32 vector of groups, scaled to about one, clipped, with history.

`docs/reference/environments.md` has this table with sizes. Every task has the groups of GROUPS, and
`register("observation_group", name, Group(...))` adds one of a user's own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.kernels import scale_and_clip
from soft_tendon_env.envs.randomization import Measured
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.scene.scene import Scene, segment_index
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.registry import Registry, register
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
    """Quantities that observation groups are computed from, rows first.

    Measured ones carry the sensors' noise.
    """

    arms: Arms
    measured: Reading | Measured  # the arms' reading itself where sensors have no noise
    # (rows, 1 + previews, 6) SE(3) logarithms from the measured tip pose to the target now and at
    # each preview
    error: Array
    target: TargetSamples  # (rows, 1 + previews, ..), its q for targets made of tensions
    action: Array  # (rows, n_a) the last one, in [-1, 1]
    command: Array  # (rows, n_a) [N] asked for last, before actuators err
    rest: RestValues

    @property
    def q(self) -> Array:
        """Coordinates (rows, n)."""
        return self.arms.rows.q

    @property
    def q_dot(self) -> Array:
        """Rates (rows, n) of the coordinates."""
        return self.arms.rows.q_dot

    @property
    def tip_pose(self) -> Array:
        """Poses of the tips (rows, 4, 4), as measured."""
        return self.measured.tip_pose

    @property
    def tip_twist(self) -> Array:
        """Twists of the tips (rows, 6), angular before linear, in their frames."""
        return self.arms.reading.tip_twist

    @property
    def tendon_length(self) -> Array:
        """Tendon lengths (rows, n_a) [m], as measured, less those at rest without tension."""
        return self.measured.tendon_length - self.rest.tendon_length

    @property
    def target_length(self) -> Array:
        """Tendon lengths (rows, n_a) [m] of the target, less those at rest without tension."""
        target_length = self.target.tendon_length[:, 0]
        return target_length - self.rest.tendon_length


class Units(NamedTuple):
    """Units of length, coordinates and tensions, by which entries are divided."""

    length: float  # [m], the rod's
    q: Array  # (n,) the coordinates that bend the arm by about a radian each
    tension: Array  # (n_a,) [N] the largest allowed
    away: float = 0.0  # [m], largest coordinate of the base in the world


def _no_unit(units: Units) -> float:
    return 1.0


@dataclass(frozen=True)
class Group:
    """An observation group: what it is, its values, and their units.

    Attributes:
        description: what it is, in a few words.
        values: (rows, size) of observed quantities.
        unit: that values are divided by, one for each or a part that repeats.
        bound: largest absolute value of a scaled entry.
        of_shape: whether it is of targets that are shapes.
        of_target: whether it is of a target that goal-conditioned tasks give as a goal instead.
        of_arm: whether it is measured of the arm, or asked of it, which is what a history keeps.
        of_world: whether it has places in the world in lengths of the rod, whose bound is so much
            larger as the base is away from the origin.
    """

    description: str
    values: Callable[[Observed], Array]
    unit: Callable[[Units], Any] = _no_unit
    bound: float = CLIP
    of_shape: bool = False
    of_target: bool = False
    of_arm: bool = False
    of_world: bool = False

    def bound_in(self, units: Units) -> float:
        """Largest absolute value of a scaled entry, of a base away from the origin."""
        if not self.of_world:
            return self.bound
        return self.bound + units.away / units.length


def _flat(values: Array) -> Array:
    """Values (rows, ..) as (rows, size)."""
    return values.reshape(len(values), -1)


def _twist_unit(units: Units) -> Array:
    """Units of twists: angular [rad/s], and linear in lengths of the rod."""
    return np.repeat([5.0, 5.0 * units.length], 3)


def _error_unit(units: Units) -> Array:
    """Units of SE(3) logarithms: angular [rad], and linear in lengths of the rod."""
    return np.repeat([0.5, 0.1 * units.length], 3)


def _strain_unit(units: Units) -> Array:
    """Units of strains: a radian along the rod, and a tenth of stretch and shear."""
    return np.repeat([1.0 / units.length, 0.1], 3)


def _checked_group(name: str, group: Any) -> Group:
    """The group itself. Raises TypeError, ValueError where it lacks something."""
    if not isinstance(group, Group):
        raise TypeError(f"the observation group {name!r} should be a Group, not {shown(group)}")
    for key in ("values", "unit"):
        if not callable(getattr(group, key)):
            raise TypeError(
                f"the observation group {name!r} has {key} = {shown(getattr(group, key))}: it"
                " should be a function"
            )
    if not group.bound > 0.0:
        raise ValueError(f"the observation group {name!r} has bound = {group.bound}, not above 0")
    if name == HISTORY:
        raise ValueError(
            f"the observation group {name!r} has the name of an option: choose another"
        )
    return group


POSITION_AND_COLUMNS = [3, 0, 1]
"""Columns of a pose [R, r]: its position, and the first two of its rotation."""


def _target_from_tip(observed: Observed) -> Array:
    """Targets as the tip sees them, now and at each preview time, (rows, 1 + previews, 9).

    They are position and first two columns of the rotation, in the tip's frame, by operations that
    tensors of PyTorch and ONNX have too.
    """
    R = observed.tip_pose[:, None, :3, :3]
    r = observed.tip_pose[:, None, :3, 3:]
    target = observed.target.tip_pose
    # g^-1 g_bar = R^T [R_bar, r_bar] - R^T r [0, 0, 0, 1]; products as sums over rows of R
    factors = R[..., None]
    axes = target[:, :, :3, None, :]
    products = factors * axes
    turned = products.sum(2)
    place_of_tip = (R * r).sum(2)
    place = place_of_tip[..., None]
    last_row = target[:, :, 3:, :]
    offset = place * last_row
    seen = turned - offset
    columns = seen[..., POSITION_AND_COLUMNS].swapaxes(2, 3)
    return columns.reshape(*columns.shape[:2], 9)


def _pose_unit(units: Units) -> Array:
    """Units of positions, in lengths of the rod, and columns of rotations."""
    sizes = [0.1 * units.length, 1.0, 1.0]
    return np.repeat(sizes, 3)


HISTORY = "history"
"""Name of the slice of an observation after all groups, if it has a history."""

CHANGE = 0.1
"""Unit of a group's changes in a history, as a share of the group's own."""

GROUPS: Registry[Group] = Registry("observation_group", _checked_group)
"""The groups that every task has, by the name that options use."""

_SHIPPED: dict[str, Group] = {
    "coordinates": Group("generalised coordinates q", lambda o: o.q, lambda u: u.q, of_arm=True),
    "rates": Group("their rates", lambda o: o.q_dot, lambda u: 10.0 * u.q, of_arm=True),
    "tip_position": Group(
        "tip position, world frame",
        lambda o: o.tip_pose[:, :3, 3],
        lambda u: u.length,
        of_arm=True,
        of_world=True,
    ),
    "tip_rotation": Group(  # continuous, unlike angles and quaternions
        "first two columns of the tip's rotation matrix",
        lambda o: _flat(o.tip_pose[:, :3, :2].swapaxes(1, 2)),
        of_arm=True,
    ),
    "tip_twist": Group(
        "tip twist, angular then linear, tip frame", lambda o: o.tip_twist, _twist_unit, of_arm=True
    ),
    "tendon_lengths": Group(
        "tendon lengths minus those at rest",
        lambda o: o.tendon_length,
        lambda u: 0.1 * u.length,
        of_arm=True,
    ),
    "strain": Group(  # torsion, bending, stretch, shear
        "strains at the sensors minus the stress-free ones",
        lambda o: _flat(o.measured.strain - o.rest.strain),
        _strain_unit,
        of_arm=True,
    ),
    "strain_rate": Group(
        "their rates",
        lambda o: _flat(o.measured.strain_rate),
        lambda u: 10.0 * _strain_unit(u),
        of_arm=True,
    ),
    "target_error": Group(
        "SE(3) logarithm from tip to target, which jumps where they are half a turn apart",
        lambda o: o.error[:, 0],
        _error_unit,
        FAR,
        of_target=True,
    ),
    "target_twist": Group(
        "twist of the target, target frame",
        lambda o: o.target.tip_twist[:, 0],
        _twist_unit,
        of_target=True,
    ),
    "preview": Group(
        "target_error at each preview time",
        lambda o: _flat(o.error[:, 1:]),
        _error_unit,
        FAR,
        of_target=True,
    ),
    "target_pose": Group(  # continuous, unlike the logarithm, which jumps at half a turn
        "position of the target and first two columns of its rotation, tip frame",
        lambda o: _target_from_tip(o)[:, 0],
        _pose_unit,
        FAR,
        of_target=True,
    ),
    "pose_preview": Group(
        "target_pose at each preview time",
        lambda o: _flat(_target_from_tip(o)[:, 1:]),
        _pose_unit,
        FAR,
        of_target=True,
    ),
    "target_coordinates": Group(
        "the target's coordinates minus the arm's",
        lambda o: o.target.q[:, 0] - o.q,
        lambda u: u.q,
        of_shape=True,
    ),
    "coordinate_preview": Group(
        "the same at each preview time",
        lambda o: _flat(o.target.q[:, 1:] - o.q[:, None]),
        lambda u: u.q,
        of_shape=True,
    ),
    "wanted_coordinates": Group(  # for policies that do not observe the arm's
        "coordinates of the target, now and at each preview time",
        lambda o: _flat(o.target.q),
        lambda u: u.q,
        of_shape=True,
    ),
    "target_lengths": Group(
        "tendon lengths of the target minus the arm's",
        lambda o: o.target_length - o.tendon_length,
        lambda u: 0.1 * u.length,
        of_shape=True,
    ),
    "last_action": Group("the last action", lambda o: o.action, bound=1.0, of_arm=True),
    "command": Group(
        "the commands sent last, before actuator errors",
        lambda o: o.command,
        lambda u: u.tension,
        1.0,
        of_arm=True,
    ),
}

for _name, _group in _SHIPPED.items():
    register("observation_group", _name, _group)


class Layout:
    """The chosen groups side by side, and after them the arm's past less what it is now.

    Attributes:
        groups: by name, in their order.
        slices: columns of all groups by name, and of the history.
        scale: (m,) factors of the entries that are observed now.
        bound: (m,) largest absolute values of those.
        kept: columns that a history keeps.
        space: Gymnasium's space of an observation.
    """

    def __init__(
        self,
        groups: Mapping[str, Group],
        units: Units,
        observed: Observed,
        history: int = 0,
    ) -> None:
        """Lay out groups.

        Args:
            groups: by name, in their order.
            units: of lengths, coordinates and tensions.
            observed: of which groups take their sizes.
            history: control periods that are looked back.

        Raises:
            ValueError: where a group's values are not (rows, size).
        """
        self.groups = groups
        # columns of each group, side by side
        sizes = _sizes(groups, observed)
        self.slices: dict[str, slice] = {}
        end = 0
        for name, size in sizes.items():
            self.slices[name] = slice(end, end + size)
            end += size

        every_unit = []
        bounds = []
        is_kept = []
        for name, group in groups.items():
            size = sizes[name]
            unit_of_group = group.unit(units)
            every_unit.append(np.resize(unit_of_group, size))
            bound_of_group = group.bound_in(units)
            bounds.append(np.full(size, bound_of_group))
            is_kept.append(np.full(size, group.of_arm))
        unit = np.concatenate(every_unit)
        self.scale = 1.0 / unit
        self.bound = np.concatenate(bounds)
        self.kept = np.flatnonzero(np.concatenate(is_kept))

        # after them the changes of each past period, the latest first
        if history:
            history_end = end + history * self.kept.size
            self.slices[HISTORY] = slice(end, history_end)
        scaled = CHANGE * unit[self.kept]
        unit_of_changes = np.tile(scaled, history)
        kept_bound = self.bound[self.kept]
        scaled_bound = 2.0 / CHANGE * kept_bound
        bound_of_changes = np.tile(scaled_bound, history)
        self._units = np.concatenate([unit, unit_of_changes])
        every_bound = np.concatenate([self.bound, bound_of_changes])
        high = every_bound.astype(np.float32)
        self.space = Box(-high, high, dtype=np.float32)

    def present(self, observed: Observed) -> NDArray[np.float32]:
        """The groups' observation now, a new array (rows, size of the groups)."""
        groups = self.groups.values()
        parts = [group.values(observed) for group in groups]
        values = np.concatenate(parts, axis=1)
        present = np.empty(values.shape, dtype=np.float32)
        scale_and_clip(values, self.scale, self.bound, present)
        return present

    def values(self, observation: NDArray[Any]) -> dict[str, Array]:
        """Unscaled values of observations, by group.

        Args:
            observation: (rows, size).

        Returns:
            By group (rows, size of the group), in the units of `Observed`.
        """
        unscaled = observation * self._units
        slices = self.slices.items()
        return {name: unscaled[:, columns] for name, columns in slices}


def _sizes(groups: Mapping[str, Group], observed: Observed) -> dict[str, int]:
    """Entries of each group.

    Raises ValueError where its values are not (rows, size).
    """
    rows = len(observed.q)
    sizes: dict[str, int] = {}
    for name, group in groups.items():
        shape = np.shape(group.values(observed))
        is_no_table = len(shape) != 2
        if is_no_table or shape[0] != rows:
            raise ValueError(
                f"the observation group {name!r} should have values of shape ({rows}, size), not"
                f" {shape}"
            )
        sizes[name] = shape[1]
    return sizes


class History:
    """Rows of past observations: what was measured of the arm and asked of it, noise and all.

    At reset it has always been so. `frames` (rows, 1 + periods, m) are what was observed, the
    latest first; observed are their differences from now, in a tenth of their units: what an arm
    does in a period would hardly show beside where it is.
    """

    def __init__(
        self,
        rows: int,
        periods: int,
        kept: NDArray[np.int64],
    ) -> None:
        """Make a history of rows.

        Args:
            rows: of episodes.
            periods: control periods that are kept besides the present one.
            kept: (m,) columns of what is observed.
        """
        self._kept = kept
        shape = (rows, 1 + periods, kept.size)
        self.frames = np.zeros(shape, dtype=np.float32)

    def keep(
        self,
        present: NDArray[np.float32],
        step_count: NDArray[np.int64],
        members: NDArray[np.int64],
    ) -> None:
        """Take what is observed now of rows that have moved on or begun.

        Args:
            present: (rows, ..) the groups' observation now.
            step_count: (rows,) control periods since the episodes began, 0 for those that begin.
            members: the rows.
        """
        counts = step_count[members]
        begun = members[counts == 0]
        moved = members[counts > 0]
        frames = self.frames
        values = present[:, self._kept]
        frames[moved, 1:] = frames[moved, :-1]
        frames[moved, 0] = values[moved]
        # at reset it has always been so
        frames[begun] = values[begun, None]

    def correct(
        self,
        present: NDArray[np.float32],
        step_count: NDArray[np.int64],
        row: int,
    ) -> None:
        """Take what is observed now of a row in place of what was in this control period.

        Args:
            present: (rows, ..) the groups' observation now.
            step_count: (rows,) control periods since the episodes began.
            row: that is observed anew.
        """
        values = present[row, self._kept]
        if step_count[row] == 0:  # it has always been so
            self.frames[row] = values
        else:
            self.frames[row, 0] = values

    @property
    def changes(self) -> NDArray[np.float32]:
        """Past less present, a new array (rows, periods * m), the latest period first."""
        return changes_of(self.frames)


def changes_of(frames: NDArray[Any]) -> NDArray[Any]:
    """Past less present of frames (rows, 1 + periods, m), in a tenth of their units.

    It is (rows, periods * m), the latest period first.
    """
    past = frames[:, 1:]
    present = frames[:, :1]
    unit = frames.dtype.type(CHANGE)
    changes = (past - present) / unit
    return changes.reshape(len(changes), -1)


def stress_free_strain(scene: Scene, arc_length: Array) -> Array:
    """Strains (m, 6) of the stress-free rod at arc lengths (m,) [m]."""
    segment_curvatures = [segment.curvature for segment in scene.segments]
    curvatures = np.array(segment_curvatures)
    curvature = curvatures[segment_index(scene, arc_length)]
    shape = (arc_length.size, 1)
    straight = np.tile([1.0, 0.0, 0.0], shape)
    return np.concatenate([curvature, straight], axis=1)


def of_row(observation: Any, row: int) -> Any:
    """A row of observations, also of those that are dictionaries."""
    if isinstance(observation, dict):
        return {key: value[row] for key, value in observation.items()}
    return observation[row]
