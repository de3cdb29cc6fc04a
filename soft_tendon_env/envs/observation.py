"""The observation's layout: one flat float32 vector of groups, each scaled to about one and clipped
to finite bounds, and their history.

`docs/reference/environments.md` has this table with sizes. Groups for every task stand in GROUPS; a
task brings others in `Task.groups`.
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
from soft_tendon_env.tools.types import Array

CLIP = 10.0  # largest absolute value of a scaled entry, unless its group says otherwise
FAR = 100.0  # largest absolute value of a scaled way to the target: ten lengths of the rod


class RestValues(NamedTuple):
    """Rest values that are subtracted from measured tendon lengths and strains."""

    tendon_length: Array  # (n_a,) [m] without tension
    strain: Array  # (sensors, 6) stress-free


@dataclass(slots=True)
class Observed:
    """Quantities that observation groups are computed from, rows first; measured ones carry the
    sensors' noise.

    Made of these: `q` and `q_dot` (rows, n), `tip_pose` (rows, 4, 4) as measured, `tip_twist`
    (rows, 6) in its frame, and `tendon_length` (rows, n_a) [m] as measured, and `target_length` of
    the target, less those at rest without tension.
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

    q = property(lambda self: self.arms.rows.q)
    q_dot = property(lambda self: self.arms.rows.q_dot)
    tip_pose = property(lambda self: self.measured.tip_pose)
    tip_twist = property(lambda self: self.arms.reading.tip_twist)
    tendon_length = property(lambda self: self.measured.tendon_length - self.rest.tendon_length)
    target_length = property(lambda self: self.target.tendon_length[:, 0] - self.rest.tendon_length)


class Units(NamedTuple):
    """Units of length, coordinates and tensions, by which entries are divided."""

    length: float  # [m], the rod's
    q: Array  # (n,) the coordinates that bend the arm by about a radian each
    tension: Array  # (n_a,) [N] the largest allowed
    away: float = 0.0  # [m], largest coordinate of the base in the world


@dataclass(frozen=True)
class Group:
    """An observation group: what it is, its values (rows, size), and the units that they are
    divided by, as many or a part that repeats.

    of_shape: it is of targets that are shapes; of_target: of a target that goal-conditioned tasks
    give as a goal instead; of_arm: measured of the arm, or asked of it, which is what a history
    keeps; of_world: places in the world in lengths of the rod, whose bound is so much larger as the
    base is away from the origin.
    """

    description: str
    values: Callable[[Observed], Array]
    unit: Callable[[Units], Any] = lambda units: 1.0
    bound: float = CLIP
    of_shape: bool = False
    of_target: bool = False
    of_arm: bool = False
    of_world: bool = False


def _flat(values: Array) -> Array:
    return values.reshape(len(values), -1)


def _pairs(angular: float, linear: float) -> Callable[[Units], Array]:
    """Units of twists and logarithms: angular, and linear in lengths of the rod."""
    return lambda units: np.repeat([angular, linear * units.length], 3)


def _strain_unit(units: Units) -> Array:
    return np.repeat([1.0 / units.length, 0.1], 3)


_twist_unit, _error_unit = _pairs(5.0, 5.0), _pairs(0.5, 0.1)


GROUPS: dict[str, Group] = {
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
        "SE(3) logarithm from tip to target",
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
"""The groups that every task has, by the name that options use; one of your own can be added before
environments are made."""

HISTORY = "history"  # the slice of an observation after all groups, if it has a history
CHANGE = 0.1  # unit of a group's changes in a history, as a share of the group's own


class Layout:
    """The chosen groups side by side, and after them those of the arm as they were in the last
    control periods, less what they are now.

    `slices` of all groups by name; of what is observed now `scale` and `bound` (m,), factors and
    bounds of entries, and `kept`, the columns that a history keeps.
    """

    def __init__(
        self, groups: Mapping[str, Group], units: Units, observed: Observed, history: int = 0
    ) -> None:
        """groups: by name, in their order; observed: of which groups take their sizes; history:
        control periods that are looked back.

        Raises ValueError where a group's values are not (rows, size).
        """
        shapes = {name: np.shape(group.values(observed)) for name, group in groups.items()}
        for name, shape in shapes.items():
            if len(shape) != 2 or shape[0] != len(observed.q):
                raise ValueError(
                    f"the observation group {name!r} should have values of shape"
                    f" ({len(observed.q)}, size), not {shape}"
                )
        self.groups, size = groups, [shape[1] for shape in shapes.values()]
        ends = np.cumsum(size).tolist()
        self.slices = {
            name: slice(end - width, end)
            for name, end, width in zip(groups, ends, size, strict=True)
        }
        unit = np.concatenate(
            [
                np.resize(group.unit(units), width)
                for group, width in zip(groups.values(), size, strict=True)
            ]
        )
        bounds = [
            group.bound + group.of_world * units.away / units.length for group in groups.values()
        ]
        self.scale, self.bound = 1.0 / unit, np.repeat(bounds, size)
        self.kept = np.flatnonzero(np.repeat([group.of_arm for group in groups.values()], size))
        if history:
            self.slices[HISTORY] = slice(ends[-1], ends[-1] + history * self.kept.size)
        self._units = np.concatenate([unit, np.tile(CHANGE * unit[self.kept], history)])
        high = np.concatenate(
            [self.bound, np.tile(2.0 / CHANGE * self.bound[self.kept], history)]
        ).astype(np.float32)
        self.space = Box(-high, high, dtype=np.float32)

    def present(self, observed: Observed) -> NDArray[np.float32]:
        """The groups' observation now, a new array (rows, size of the groups)."""
        values = np.concatenate([group.values(observed) for group in self.groups.values()], axis=1)
        present = np.empty(values.shape, dtype=np.float32)
        scale_and_clip(values, self.scale, self.bound, present)
        return present

    def values(self, observation: NDArray[Any]) -> dict[str, Array]:
        """Observations (rows, size) unscaled: by group (rows, size of the group), in the units of
        `Observed`."""
        observation = observation * self._units
        return {name: observation[:, where] for name, where in self.slices.items()}


class History:
    """Rows of past observations: what was measured of the arm and asked of it, noise and all. At
    reset it has always been so.

    `frames` (rows, 1 + periods, m) are what was observed, the latest first; observed are their
    differences from now, in a tenth of their units: what an arm does in a period would hardly show
    beside where it is.
    """

    def __init__(self, rows: int, periods: int, kept: NDArray[np.int64]) -> None:
        """periods: control periods that are kept besides the present one; kept: (m,) columns of
        what is observed."""
        self._kept, self.frames = kept, np.zeros((rows, 1 + periods, kept.size), dtype=np.float32)

    def keep(
        self,
        present: NDArray[np.float32],
        step_count: NDArray[np.int64],
        members: NDArray[np.int64],
    ) -> None:
        """Take what is observed now (rows, ..) of the rows `members`, which have moved on, or begun
        where their `step_count` is 0."""
        begun, moved = (members[of] for of in (step_count[members] == 0, step_count[members] > 0))
        self.frames[moved, 1:] = self.frames[moved, :-1]
        self.frames[moved, 0] = present[moved][:, self._kept]
        self.frames[begun] = present[begun][:, None, self._kept]

    def correct(
        self, present: NDArray[np.float32], step_count: NDArray[np.int64], row: int
    ) -> None:
        """Take what is observed now of a row in place of what was observed before in this control
        period."""
        self.frames[row, : 1 if step_count[row] else None] = present[row, self._kept]

    @property
    def changes(self) -> NDArray[np.float32]:
        """Past less present, a new array (rows, periods * m), the latest period first."""
        changes = (self.frames[:, 1:] - self.frames[:, :1]) / np.float32(CHANGE)
        return changes.reshape(len(changes), -1)


def stress_free_strain(scene: Scene, arc_length: Array) -> Array:
    """Strains (m, 6) of the stress-free rod at arc lengths (m,) [m]."""
    curvature = np.array([segment.curvature for segment in scene.segments])[
        segment_index(scene, arc_length)
    ]
    return np.concatenate([curvature, np.tile([1.0, 0.0, 0.0], (arc_length.size, 1))], axis=1)


def of_row(observation: Any, row: int) -> Any:
    """A row of observations."""
    return (
        {key: value[row] for key, value in observation.items()}
        if isinstance(observation, dict)
        else observation[row]
    )
