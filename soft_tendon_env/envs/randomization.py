"""Domain randomisation per episode: numbers of the scene, actuators, sensors, latency. All off by
default."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from soft_tendon_env.control.protocol import SensorNoise
from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.mechanics.motion.pose_errors import move_poses
from soft_tendon_env.scene.parameters import TABLES, Range, dotted_ranges, ranges_of
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.sections import Stiffness
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    plain,
    shown,
)
from soft_tendon_env.tools.types import Array

GREATEST = 1e9  # largest absolute value of gains, offsets and latencies that can be drawn
DRAWN = "drawn"  # key in `info`, after resets, of what was drawn
CHUNK = 128  # samples of noise drawn at a time
SHORT = {
    "stiffness": ("segments.*.young_modulus", "factor"),
    "damping": ("segments.*.damping", "factor"),
    "density": ("segments.*.density", "factor"),
    "payload": ("effects.tip_load.mass", "offset"),
}
"""Short names of numbers of the scene: their keys, and how they are drawn."""
OF_STIFFNESS = {
    "segments.*.young_modulus": ("bending.*", "torsion", "stretch", "shear.*"),
    "segments.*.damping": ("retardation_time",),
    "segments.*.density": ("mass_per_length", "rotary_inertia.*"),
}
"""Numbers of a section that has the stiffnesses themselves, which a factor of these changes too."""


def _as_range(value: Any) -> Any:
    ends = value if isinstance(value, tuple) else (value, value)
    if (
        len(ends) != 2
        or not all(type(end) in (int, float) for end in ends)
        or not -GREATEST <= ends[0] <= ends[1] <= GREATEST
    ):
        raise ValueError(f"should be a number, or (least, greatest), within ±{GREATEST:g}")
    return ends


def _not_negative(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] < 0.0:
        raise ValueError("should be at least 0")
    return ends


Interval = Annotated[tuple[float, float], BeforeValidator(_as_range)]
Amount = Annotated[Interval, AfterValidator(_not_negative)]


class Randomization(Configuration):
    """Drawn at every reset, uniformly from (least, greatest); a plain number is a constant.

    Attributes:
        numbers: of the scene by dotted keys, see `scene_parameters`, which can stand beside the
            other attributes: `{"segments.*.young_modulus": ...}`. A value is a number or a range;
            `{"factor": ...}` or `{"offset": ...}`, with one, of what the scene says; of a vector a
            list with one for each entry. All that a `*` stands for changes together. `stiffness`,
            `damping` and `density` are short for factors of the whole rod, `payload` for a mass
            that is added to that of the tip [kg].
        tension_gain, tension_offset: of every tendon's actuator, factor and [N].
        latency: delay of the commands [s], of any length.
        noise: of sensors.
        omit: probability with which an episode leaves out each of the above: a number is as the
            scene says, gains are 1, offsets, latency and noise 0. Without it nearly all arms differ
            in every way.
    """

    numbers: dict[str, Any] = Field(default_factory=dict)
    tension_gain: Amount = (1.0, 1.0)
    tension_offset: Interval = (0.0, 0.0)
    latency: Amount = (0.0, 0.0)
    noise: SensorNoise = Field(default=SensorNoise())
    omit: Annotated[float, Field(ge=0, le=1)] = 0.0

    def __init__(self, /, **values: Any):
        valid = [*type(self).model_fields, *SHORT, *TABLES]
        fields = {name: value for name, value in values.items() if name in type(self).model_fields}
        table = {name: value for name, value in values.items() if name not in fields}
        problems = [
            Problem((name,), f"is an unknown key (given {shown(value)}): {not_among(name, valid)}")
            for name, value in table.items()
            if name not in SHORT and name.replace("[", ".").split(".")[0] not in TABLES
        ]
        if problems:
            raise ConfigurationError(problems, type(self).__name__)
        super().__init__(
            **fields
            | {"numbers": _in_full(dotted_ranges(plain({**fields.get("numbers", {}), **table})))}
        )

    def ranges(self, scene: Scene) -> tuple[Range, ...]:
        """The ranges of numbers of a scene, in the order of their keys. Raises
        ConfigurationError."""
        try:
            return ranges_of(
                scene,
                {_whole_rod(scene, *drawn): drawn[1] for drawn in sorted(self.numbers.items())},
            )
        except ConfigurationError as error:
            raise ConfigurationError(
                [Problem(("randomize", *key), text) for key, text in error.problems], "environment"
            ) from None

    @property
    def of_actuators(self) -> bool:
        """Whether applied tensions can differ from commanded ones, apart from latency."""
        return (self.tension_gain, self.tension_offset) != ((1.0, 1.0), (0.0, 0.0))


def _in_full(numbers: dict[str, Any]) -> dict[str, Any]:
    """Ranges by the keys that short names stand for, without those that change nothing. Raises
    ConfigurationError."""
    found: dict[str, Any] = {}
    for name, value in numbers.items():
        key, kind = SHORT.get(name, (name, ""))
        if key in found:
            raise ConfigurationError(
                [Problem((name,), f"is {key}, which is drawn already: leave one of them out")]
            )
        found[key] = {kind: value} if kind else value
    return found


def _whole_rod(scene: Scene, name: str, value: Any) -> str:
    """The key of a number, with the others that a factor of it means in some segments."""
    mixed = (
        isinstance(value, dict)
        and "factor" in value
        and any(isinstance(part.section, Stiffness) for part in scene.segments)
    )
    return "|".join(
        [name, *(f"segments.*.section.{key}" for key in OF_STIFFNESS.get(name, ()) if mixed)]
    )


def drawn_in_rows(
    infos: Sequence[Mapping[str, Any]], members: Indices, rows: int
) -> dict[str, Any]:
    """Infos of what was drawn for `members` as one of all rows, as Gymnasium has tables in it:
    arrays (rows, ..), each beside its mask."""
    if not any(infos):
        return {}
    found, of_row = (
        dict[str, Any](),
        {int(row): info[DRAWN] for row, info in zip(members, infos, strict=True)},
    )
    for key in dict.fromkeys(
        key for drawn in of_row.values() for key in drawn
    ):  # some rows may leave it out
        mask = np.array([key in of_row.get(row, ()) for row in range(rows)])
        values = np.array([of_row[row][key] for row in np.flatnonzero(mask).tolist()])
        found |= {key: np.zeros((rows, *values.shape[1:])), f"_{key}": mask}
        found[key][mask] = values
    return {DRAWN: found, f"_{DRAWN}": np.isin(np.arange(rows), members)}


class Measured(NamedTuple):
    """Sensor readings of every row, noise and all; see Reading."""

    tip_pose: Array  # (rows, 4, 4)
    tendon_length: Array  # (rows, n_a) [m]
    strain: Array  # (rows, sensors, 6)
    strain_rate: Array  # (rows, sensors, 6)


class Sensors:
    """Rows of noisy sensors."""

    def __init__(
        self, noise: SensorNoise, rows: int, tendons: int, sensors: int, omit: float
    ) -> None:
        """omit: probability with which an episode has no noise."""
        of_pose, of_lengths = (
            np.repeat([noise.position, noise.rotation], 3),
            np.full(tendons, noise.length),
        )
        self._deviation = np.concatenate(
            [of_pose, of_lengths, noise.of_strains(sensors), noise.of_strain_rates(sensors)]
        )
        ends = np.cumsum([3, 3, tendons, 6 * sensors, 6 * sensors]).tolist()
        self._parts = [slice(start, end) for start, end in pairwise([0, *ends])]
        self._noise = np.zeros((rows, CHUNK, self._deviation.size))
        self._generator = [np.random.default_rng(0) for _ in range(rows)]
        self._omit, self._is_noisy = omit, np.ones((rows, 1), dtype=bool)

    def begin(self, row: int, seed: int) -> None:
        """A new episode of a row."""
        self._generator[row] = generator = np.random.default_rng(seed)
        self._is_noisy[row] = not self._omit or generator.random() >= self._omit

    def measured(self, reading: Reading, step_count: Indices, members: Indices) -> Measured:
        """Sensor readings of true ones; `members` have moved on."""
        for row in members[step_count[members] % CHUNK == 0]:
            self._noise[row] = (
                self._generator[row].standard_normal(self._noise.shape[1:]) * self._deviation
            )
        noise = self._noise[np.arange(len(step_count)), step_count % CHUNK] * self._is_noisy
        position, rotation, length, strain, rate = (noise[:, part] for part in self._parts)
        pose, turn = np.empty_like(reading.tip_pose), np.zeros((len(rotation), 1, 6))
        turn[:, 0, :3] = rotation
        move_poses(reading.tip_pose, turn, pose[:, None])
        pose[:, :3, 3] += position
        strain, rate = strain.reshape(reading.strain.shape), rate.reshape(reading.strain_rate.shape)
        return Measured(
            pose,
            reading.tendon_length + length,
            reading.strain + strain,
            reading.strain_rate + rate,
        )
