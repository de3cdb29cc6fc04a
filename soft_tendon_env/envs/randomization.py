"""Domain randomisation per episode: numbers of the scene, actuators, sensors, latency.

All off by default.
"""

from collections.abc import Mapping, Sequence
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

GREATEST = 1e9
"""Largest absolute value of gains, offsets and latencies that can be drawn."""

DRAWN = "drawn"
"""Key in `info`, after resets, of what was drawn."""

CHUNK = 128
"""Samples of noise that are drawn at a time."""

SHORT = {
    "stiffness": ("segments.*.young_modulus", "factor"),
    "damping": ("segments.*.damping", "factor"),
    "density": ("segments.*.density", "factor"),
    "payload": ("effects.tip_load.mass", "offset"),
}
"""Short names of numbers of the scene: their keys, and how they are drawn."""

OF_ACTUATORS = ("tension_gain", "tension_offset", "latency")
"""Names of the draws of actuators, in their order."""

OTHERS = "others"
"""Key in `omit` of all that it does not name."""

OF_STIFFNESS = {
    "segments.*.young_modulus": ("bending.*", "torsion", "stretch", "shear.*"),
    "segments.*.damping": ("retardation_time",),
    "segments.*.density": ("mass_per_length", "rotary_inertia.*"),
}
"""Numbers of a section that has the stiffnesses themselves, which a factor of these changes too."""


def _as_range(value: Any) -> Any:
    """The ends of a range, twice the number where there is one alone.

    Raises ValueError.
    """
    if isinstance(value, tuple):
        ends = value
    else:
        ends = (value, value)
    is_pair = len(ends) == 2
    are_numbers = is_pair and all(type(end) in (int, float) for end in ends)
    if not are_numbers or not -GREATEST <= ends[0] <= ends[1] <= GREATEST:
        raise ValueError(f"should be a number, or (least, greatest), within ±{GREATEST:g}")
    return ends


def _not_negative(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] < 0.0:
        raise ValueError("should be at least 0")
    return ends


Probability = Annotated[float, Field(ge=0, le=1)]
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
        noise: deviations of the sensors' noise; of strains where there are strain sensors.
        omit: probability with which an episode leaves out each of the above: a number is as the
            scene says, gains are 1, offsets, latency and noise 0. Without it nearly all arms differ
            in every way. A table has it by name, `{"latency": 0.5, "others": 0.85}`: the others'
            is 0 unless it says so.
    """

    numbers: dict[str, Any] = Field(default_factory=dict)
    tension_gain: Amount = (1.0, 1.0)
    tension_offset: Interval = (0.0, 0.0)
    latency: Amount = (0.0, 0.0)
    noise: SensorNoise = Field(default=SensorNoise())
    omit: Probability | dict[str, Probability] = 0.0

    def __init__(self, /, **values: Any):
        """Take numbers of the scene beside the other attributes.

        Raises ConfigurationError.
        """
        names = type(self).model_fields
        fields: dict[str, Any] = {}
        numbers: dict[str, Any] = {}
        for name, value in values.items():
            if name in names:
                fields[name] = value
            else:
                numbers[name] = value
        valid = [*names, *SHORT, *TABLES]
        problems = list[Problem]()
        for name, value in numbers.items():
            table = name.replace("[", ".").split(".")[0]
            if name not in SHORT and table not in TABLES:
                hint = not_among(name, valid)
                text = f"is an unknown key (given {shown(value)}): {hint}"
                problems.append(Problem((name,), text))
        if problems:
            raise ConfigurationError(problems, type(self).__name__)
        # numbers of the scene stand beside the other attributes, or in `numbers`
        every_number = {**fields.get("numbers", {}), **numbers}
        in_dots = dotted_ranges(plain(every_number))
        fields["numbers"] = _in_full(in_dots)
        if isinstance(fields.get("omit"), Mapping):
            fields["omit"] = _omissions(fields["omit"], fields["numbers"])
        super().__init__(**fields)

    def ranges(self, scene: Scene) -> tuple[Range, ...]:
        """Ranges of the drawn numbers of a scene, in the order of their keys.

        Args:
            scene: whose numbers they are.

        Returns:
            The ranges.

        Raises:
            ConfigurationError: for keys that the scene does not have, and for other values.
        """
        values: dict[str, Any] = {}
        for name, value in sorted(self.numbers.items()):
            values[_whole_rod(scene, name, value)] = value
        try:
            return ranges_of(scene, values)
        except ConfigurationError as error:
            problems = [Problem(("randomize", *key), text) for key, text in error.problems]
            raise ConfigurationError(problems, "environment") from None

    @property
    def omits(self) -> bool:
        """Whether episodes can leave out anything."""
        if isinstance(self.omit, Mapping):
            return any(self.omit.values())
        return self.omit > 0.0

    def omission(self, name: str) -> float:
        """Computes the probability with which an episode leaves out one of the draws.

        Args:
            name: of a range of `ranges`, or one of the other attributes.

        Returns:
            The probability, 0 to 1.
        """
        if not isinstance(self.omit, Mapping):
            return self.omit
        first = name.partition("|")[0]  # of numbers that change together
        keys = [key for key in self.omit if _is_of(first, key)]
        closest = max(keys, key=len, default=OTHERS)
        return self.omit.get(closest, 0.0)

    @property
    def of_actuators(self) -> bool:
        """Whether applied tensions can differ from commanded ones, apart from latency."""
        has_gains = self.tension_gain != (1.0, 1.0)
        return has_gains or self.tension_offset != (0.0, 0.0)


def _in_full(numbers: dict[str, Any]) -> dict[str, Any]:
    """Ranges by the keys that short names stand for, without those that change nothing.

    Raises ConfigurationError.
    """
    ranges: dict[str, Any] = {}
    for name, value in numbers.items():
        key, kind = SHORT.get(name, (name, ""))
        if key in ranges:
            text = f"is {key}, which is drawn already: leave one of them out"
            raise ConfigurationError([Problem((name,), text)])
        if kind:
            ranges[key] = {kind: value}
        else:
            ranges[key] = value
    return ranges


def _is_of(name: str, key: str) -> bool:
    """Whether a number of that name is what a key means: it alone, or an entry of its vector."""
    return name == key or name.startswith(f"{key}.")


def _omissions(given: Mapping[str, Any], numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Probabilities of omission by the keys that names stand for.

    Raises ConfigurationError where a name is nothing that is drawn.
    """
    drawn = [*numbers, *OF_ACTUATORS, "noise", OTHERS]
    omissions: dict[str, Any] = {}
    problems = list[Problem]()
    for name, probability in dotted_ranges(given).items():
        key, _ = SHORT.get(name, (name, ""))
        if not any(_is_of(number, key) for number in drawn):
            text = f"is nothing that is drawn: {not_among(name, drawn)}"
            problems.append(Problem(("omit", name), text))
        if key in omissions:
            text = f"is {key}, which the table has already: leave one of them out"
            problems.append(Problem(("omit", name), text))
        omissions[key] = probability
    if problems:
        raise ConfigurationError(problems, "randomize")
    return omissions


def _whole_rod(scene: Scene, name: str, value: Any) -> str:
    """The key of a number, with the others that a factor of it means in some segments."""
    is_factor = isinstance(value, dict) and "factor" in value
    is_stiffness = (isinstance(part.section, Stiffness) for part in scene.segments)
    has_stiffnesses = any(is_stiffness)
    keys = [name]
    if is_factor and has_stiffnesses:
        for key in OF_STIFFNESS.get(name, ()):
            keys.append(f"segments.*.section.{key}")
    return "|".join(keys)


def drawn_in_rows(
    infos: Sequence[Mapping[str, Any]], members: Indices, rows: int
) -> dict[str, Any]:
    """Infos of what was drawn for rows as one info, as Gymnasium has tables in it.

    Args:
        infos: of what was drawn, of each of `members`.
        members: rows that have begun.
        rows: of the environment.

    Returns:
        Under DRAWN arrays (rows, ..) by key, each beside its mask; nothing where nothing was drawn.
    """
    if not any(infos):
        return {}
    drawn_of: dict[int, Mapping[str, Any]] = {}
    for row, info in zip(members.tolist(), infos, strict=True):
        drawn_of[row] = info[DRAWN]
    keys: dict[str, None] = {}  # in the order in which rows have them
    for drawn in drawn_of.values():
        keys |= dict.fromkeys(drawn)
    table: dict[str, Any] = {}
    for key in keys:
        # some rows may leave it out
        rows_with_key = [row for row in sorted(drawn_of) if key in drawn_of[row]]
        mask = np.zeros(rows, dtype=bool)
        mask[rows_with_key] = True
        row_values = [drawn_of[row][key] for row in rows_with_key]
        values = np.array(row_values)
        shape = (rows, *values.shape[1:])
        column = np.zeros(shape)
        column[rows_with_key] = values
        table[key] = column
        table[f"_{key}"] = mask
    has_begun = np.isin(np.arange(rows), members)
    return {DRAWN: table, f"_{DRAWN}": has_begun}


class Measured(NamedTuple):
    """Sensor readings of every row, noise and all; see Reading."""

    tip_pose: Array  # (rows, 4, 4)
    tendon_length: Array  # (rows, n_a) [m]
    strain: Array  # (rows, sensors, 6)
    strain_rate: Array  # (rows, sensors, 6)


class Sensors:
    """Rows of noisy sensors.

    Noise of a sample stands side by side: position and rotation of the tip, tendon lengths, strains
    and their rates.
    """

    def __init__(
        self,
        noise: SensorNoise,
        rows: int,
        tendons: int,
        sensors: int,
        omit: float,
    ) -> None:
        """Make sensors that begin with the first episodes.

        Args:
            noise: standard deviations.
            rows: of arms.
            tendons: whose lengths are measured.
            sensors: of strain.
            omit: probability with which an episode has no noise.
        """
        deviations = {
            "position": np.full(3, noise.position),
            "rotation": np.full(3, noise.rotation),
            "length": np.full(tendons, noise.length),
            "strain": noise.of_strains(sensors),
            "strain_rate": noise.of_strain_rates(sensors),
        }
        every_deviation = [*deviations.values()]
        self._deviation = np.concatenate(every_deviation)
        # columns of each part
        self._columns: dict[str, slice] = {}
        start = 0
        for part, deviation in deviations.items():
            end = start + deviation.size
            self._columns[part] = slice(start, end)
            start = end
        shape = (rows, CHUNK, self._deviation.size)
        self._noise = np.zeros(shape)
        self._generator = [np.random.default_rng(0) for _ in range(rows)]
        self._omit = omit
        self._is_noisy = np.ones((rows, 1), dtype=bool)

    def begin(self, row: int, seed: int) -> None:
        """Begin a new episode of a row, whose noise follows from the seed."""
        generator = np.random.default_rng(seed)
        self._generator[row] = generator
        self._is_noisy[row] = not self._omit or generator.random() >= self._omit

    def measured(
        self,
        reading: Reading,
        step_count: Indices,
        members: Indices,
    ) -> Measured:
        """Sensor readings of all rows: the true ones with noise.

        Args:
            reading: the true readings.
            step_count: (rows,) control periods since the episodes began.
            members: rows that have moved on.

        Returns:
            The measured values.
        """
        is_end = step_count[members] % CHUNK == 0
        at_end = members[is_end]
        for row in at_end:
            self._draw_chunk(row)
        noise = self._noise_now(step_count)
        strain_noise = noise["strain"].reshape(reading.strain.shape)
        rate_noise = noise["strain_rate"].reshape(reading.strain_rate.shape)
        return Measured(
            tip_pose=_moved(reading.tip_pose, noise["position"], noise["rotation"]),
            tendon_length=reading.tendon_length + noise["length"],
            strain=reading.strain + strain_noise,
            strain_rate=reading.strain_rate + rate_noise,
        )

    def _draw_chunk(self, row: int) -> None:
        """Draw the noise of a row's next CHUNK control periods."""
        shape = CHUNK, self._deviation.size
        samples = self._generator[row].standard_normal(shape)
        self._noise[row] = samples * self._deviation

    def _noise_now(self, step_count: Indices) -> dict[str, Array]:
        """Noise (rows, size) by part, 0 in episodes without noise."""
        rows = np.arange(len(step_count))
        sample = step_count % CHUNK
        drawn = self._noise[rows, sample]
        noise = drawn * self._is_noisy
        slices = self._columns.items()
        return {part: noise[:, columns] for part, columns in slices}


def _moved(pose: Array, position: Array, rotation: Array) -> Array:
    """Poses (rows, 4, 4) that are turned by vectors (rows, 3) [rad], in their frames, and moved.

    They are moved by others (rows, 3) [m], in the world.
    """
    twist = np.zeros((len(pose), 1, 6))
    twist[:, 0, :3] = rotation
    moved = np.empty_like(pose)
    move_poses(pose, twist, moved[:, None])
    moved[:, :3, 3] += position
    return moved
