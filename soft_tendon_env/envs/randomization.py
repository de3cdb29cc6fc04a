"""Domain randomisation per episode: material, payload, effects, actuators, sensors, latency. All off by default."""

from copy import deepcopy
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from soft_tendon_env.control.sensor_noise import SensorNoise
from soft_tendon_env.envs.arms import Indices, Material
from soft_tendon_env.envs.effect_ranges import checked_ranges
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.mechanics.motion.pose_errors import perturb_poses
from soft_tendon_env.tools.configuration import Configuration, plain
from soft_tendon_env.tools.types import Array

GREATEST = 1e9
"""Largest absolute value that can be drawn, and for factors that must not vanish the inverse of the smallest."""
CHUNK = 128
"""Samples of noise drawn at a time."""
RANGE = "should be a number, or (least, greatest)"


def _as_range(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value, value
    if not (isinstance(value, tuple) and len(value) == 2):
        raise ValueError(RANGE)
    return value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError(RANGE)
    if max(-value[0], value[1]) > GREATEST:
        raise ValueError(f"should lie within ±{GREATEST:g}")
    return value


def _at_least(least: float, said: str) -> AfterValidator:
    def check(value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < least:
            raise ValueError(f"should be {said}")
        return value

    return AfterValidator(check)


Range = Annotated[tuple[float, float], BeforeValidator(_as_range), AfterValidator(_ordered)]
Factor = Annotated[Range, _at_least(1.0 / GREATEST, f"greater than 0, at least {1.0 / GREATEST:g}")]
Amount = Annotated[Range, _at_least(0.0, "at least 0")]


class Randomization(Configuration):
    """Drawn at every reset, uniformly from (least, greatest); a plain number is always taken.

    Attributes:
        stiffness, damping, density: factors of the scene's, for the whole rod.
        payload: mass fixed to the tip [kg].
        tension_gain, tension_offset: of every tendon's actuator, factor and [N].
        latency: delay of the commands [s], of any length.
        noise: of sensors.
        effects: parameters of the scene's effects, by keys such as "fluid.density" or "contact.obstacles.0.position": a number or a range;
            of a vector a list with one of these for each entry; or {"factor": a number or a range} of what the scene says.
    """

    stiffness: Factor = (1.0, 1.0)
    damping: Amount = (1.0, 1.0)
    density: Factor = (1.0, 1.0)
    payload: Amount = (0.0, 0.0)
    tension_gain: Amount = (1.0, 1.0)
    tension_offset: Range = (0.0, 0.0)
    latency: Amount = (0.0, 0.0)
    noise: SensorNoise = Field(default=SensorNoise())
    effects: dict[str, Any] = Field(default_factory=dict)

    @field_validator("effects", mode="before")
    @classmethod
    def _are_ranges(cls, effects: Any) -> Any:
        if not isinstance(effects, dict):
            raise ValueError("should be a table from keys such as 'fluid.density' to ranges")
        return checked_ranges(plain(effects))

    @property
    def of_arm(self) -> bool:
        """Whether rows can differ from the scene's arm, or from its effects."""
        return self.of_material or bool(self.effects)

    @property
    def of_material(self) -> bool:
        """Whether the material of rows can differ from the scene's."""
        return (self.stiffness, self.damping, self.density, self.payload) != ((1.0, 1.0),) * 3 + ((0.0, 0.0),)

    @property
    def heaviest(self) -> Material:
        """The material that can be drawn under which an arm hangs most: soft, dense and with the greatest payload."""
        return Material(stiffness=self.stiffness[0], density=self.density[1], payload=self.payload[1])

    @property
    def of_actuators(self) -> bool:
        """Whether applied tensions can differ from commanded ones, apart from latency."""
        return (self.tension_gain, self.tension_offset) != ((1.0, 1.0), (0.0, 0.0))

    @property
    def of_sensors(self) -> bool:
        """Whether observations can differ from what is."""
        return self.noise != SensorNoise()


class Draw(NamedTuple):
    """Parameters drawn for one episode."""

    material: Material
    gain: Array  # (n_a,)
    offset: Array  # (n_a,) [N]
    latency: float  # [s]


def own_stream(generator: np.random.Generator, *purpose: int) -> np.random.Generator:
    """A generator that another one seeds, without moving it on; another one for every purpose."""
    return np.random.default_rng([*deepcopy(generator).integers(2**63, size=4), *purpose])


def drawn(randomization: Randomization, tendons: int, generator: np.random.Generator) -> Draw:
    """Draw an episode, always in the same order."""
    material = Material(*(generator.uniform(*getattr(randomization, name)) for name in Material._fields))
    gain = generator.uniform(*randomization.tension_gain, tendons)
    offset = generator.uniform(*randomization.tension_offset, tendons)
    return Draw(material, gain, offset, generator.uniform(*randomization.latency))


class Measured(NamedTuple):
    """Sensor readings of every row, noise and all; see Reading."""

    tip_pose: Array  # (rows, 4, 4)
    tendon_length: Array  # (rows, n_a) [m]
    strain: Array  # (rows, sensors, 6)
    strain_rate: Array  # (rows, sensors, 6)


class Sensors:
    """Rows of noisy sensors."""

    def __init__(self, noise: SensorNoise, rows: int, tendons: int, sensors: int) -> None:
        of_pose, of_lengths = np.repeat([noise.position, noise.rotation], 3), np.full(tendons, noise.length)
        self._deviation = np.concatenate([of_pose, of_lengths, noise.of_strains(sensors), noise.of_strain_rates(sensors)])
        ends = np.cumsum([3, 3, tendons, 6 * sensors, 6 * sensors]).tolist()
        self._parts = [slice(start, end) for start, end in pairwise([0, *ends])]
        self._noise = np.zeros((rows, CHUNK, self._deviation.size))
        self._generator = [np.random.default_rng(0) for _ in range(rows)]

    def begin(self, row: int, seed: int) -> None:
        """A new episode of a row."""
        self._generator[row] = np.random.default_rng(seed)

    def measured(self, reading: Reading, step_count: Indices, members: Indices) -> Measured:
        """Sensor readings of true ones; `members` have moved on."""
        for row in members[step_count[members] % CHUNK == 0]:
            self._noise[row] = self._generator[row].standard_normal(self._noise.shape[1:]) * self._deviation
        noise = self._noise[np.arange(len(step_count)), step_count % CHUNK]
        position, rotation, length, strain, rate = (noise[:, part] for part in self._parts)
        pose = np.empty_like(reading.tip_pose)
        perturb_poses(reading.tip_pose, rotation.copy(), position.copy(), pose)
        strain, rate = strain.reshape(reading.strain.shape), rate.reshape(reading.strain_rate.shape)
        return Measured(pose, reading.tendon_length + length, reading.strain + strain, reading.strain_rate + rate)
