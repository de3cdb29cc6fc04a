"""One episode as arrays, and the buffer that collects them while an environment runs. Knows nothing of files."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Effects
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Array

NUMBERS = (bool, int, float, np.bool_, np.integer, np.floating)
FIRST_CAPACITY = 512


@dataclass(frozen=True, eq=False)
class Rollout:
    """An episode, or a stretch of one: sample 0 of an episode is what its reset left, sample k what its k-th step did.

    period [s] between samples; strain (samples, points, 6) as of `Model.strain`; tension (samples, n_a) [N] as applied;
    tip_pose, target_pose (samples, 4, 4); target_backbone (samples, m, 3) [m], m = 0 being as good as None; action (samples, k), the one
    that led to the sample; scalars (samples,) each, NaN where there is none;
    effects of the arm, None: those of its scene. Raises ValueError for other shapes.
    """

    model: Model
    period: float
    strain: Array
    tension: Array
    tip_pose: Array
    target_pose: Array | None = None
    target_backbone: Array | None = None
    action: Array | None = None
    scalars: Mapping[str, Array] = field(default_factory=dict)
    title: str = ""
    effects: Effects | None = None

    def __post_init__(self) -> None:
        samples = len(self.strain)
        _check_shape("strain", self.strain, (samples, self.model.grid.point_count, 6))
        _check_shape("tension", self.tension, (samples, self.model.tendon_count))
        _check_shape("tip_pose", self.tip_pose, (samples, 4, 4))
        _check_shape("target_pose", self.target_pose, (samples, 4, 4))
        _check_shape("target_backbone", self.target_backbone, (samples, None, 3))
        _check_shape("action", self.action, (samples, None))
        for name, values in self.scalars.items():
            _check_shape(f"scalars[{name!r}]", values, (samples,))

    @property
    def samples(self) -> int:
        return len(self.strain)


class RolloutBuffer:
    """Collects samples one at a time; `append` copies arrays, so that the environment may reuse what it hands over."""

    def __init__(self, model: Model, period: float, target_stations: int = 0, action_size: int = 0) -> None:
        self.model, self.period = model, period
        points, pose = model.arm.rod.reference_strain.size, (4, 4)
        self._shapes = ((points,), (model.tendon_count,), pose, pose, (target_stations, 3), (action_size,))
        self._scalars: list[dict[str, object]] = []
        self._count = self._capacity = 0
        self._grow()

    def __len__(self) -> int:
        return self._count

    def append(
        self,
        strain: Array,
        tension: Array,
        tip_pose: Array,
        target_pose: Array,
        target_backbone: Array,
        action: ArrayLike,
        scalars: dict[str, object],
    ) -> None:
        """Add a sample, shapes as in `Rollout` less the first axis, but for the strain (m,), as the kernels have it.

        Numbers and bools count as scalars; their dict is kept, not copied.
        """
        k = self._count
        if k == self._capacity:
            self._grow()
        # an assignment each: a loop over the fields takes twice as long, and this runs in every step
        self._strain[k] = strain
        self._tension[k] = tension
        self._tip_pose[k] = tip_pose
        self._target_pose[k] = target_pose
        self._target_backbone[k] = target_backbone
        self._action[k] = action
        self._scalars.append(scalars)
        self._count = k + 1

    def clear(self) -> None:
        """Forget the samples and keep the memory."""
        self._count = 0
        self._scalars.clear()

    def rollout(self, title: str = "", effects: Effects | None = None) -> Rollout:
        """A copy of what was collected since the last `clear`; `effects` of the arm, None: those of its scene."""
        strain, tension, tip_pose, target_pose, target_backbone, action = (array[: self._count].copy() for array in self._arrays())
        return Rollout(
            self.model,
            self.period,
            self.model.grid.unpacked(strain),
            tension,
            tip_pose,
            target_pose,
            target_backbone,
            action,
            scalar_columns(self._scalars),
            title,
            effects,
        )

    def _arrays(self) -> tuple[Array, ...]:
        return self._strain, self._tension, self._tip_pose, self._target_pose, self._target_backbone, self._action

    def _grow(self) -> None:
        self._capacity = max(FIRST_CAPACITY, 2 * self._capacity)
        larger = [np.empty((self._capacity, *shape)) for shape in self._shapes]
        if self._count:
            for new, old in zip(larger, self._arrays(), strict=True):
                new[: self._count] = old[: self._count]
        self._strain, self._tension, self._tip_pose, self._target_pose, self._target_backbone, self._action = larger


def scalar_columns(records: list[dict[str, object]]) -> dict[str, Array]:
    """The numbers and bools of one record per sample as columns (samples,), NaN where a record has none of that name."""
    names = {name: None for record in records for name, value in record.items() if isinstance(value, NUMBERS)}  # in order of appearance
    return {name: np.array([_number(record.get(name)) for record in records]) for name in names}


def _number(value: object) -> float:
    return float(value) if isinstance(value, NUMBERS) else np.nan


def _check_shape(name: str, given: Array | None, wanted: tuple[int | None, ...]) -> None:
    if given is None or given.ndim == len(wanted) and all(w in (None, g) for w, g in zip(wanted, given.shape, strict=True)):
        return
    shape = ", ".join("any" if size is None else str(size) for size in wanted)
    raise ValueError(f"{name} should have shape ({shape}), not {given.shape}")
