"""Parameters to estimate: numbers of a scene by dotted keys, and numbers of the measurement
(markers, commands).

`segments.*.young_modulus` is one parameter, by which the numbers of all matches change together,
see scene.parameters. Numbers other than zero are estimated as a factor (in logarithm), others and
angles of tendons as a difference. Where the arm stands and how it is measured are others, of which
a wildcard is a parameter for each match: `base.rotation` [deg] and `base.position` [m] of the
scene, `markers.NAME.offset` [m], `commands.I.gain`, `commands.I.offset` and `commands.delay` [s];
all but the delay have a normal prior, which bounds take the place of.
"""

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.scene.parameters import Parameter as SceneParameter
from soft_tendon_env.scene.parameters import scene_parameters, scene_with_numbers
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, not_among
from soft_tendon_env.tools.types import Array

MEASUREMENT = ("base", "markers", "commands")
FACTOR, WIDE = (
    30.0,
    5.0,
    # how far a factor may go where no bounds are given, and a difference, in standard deviations of
    # its prior
)
TURN = 30.0  # how far angles of tendons may go where no bounds are given [deg]
ROTATION, GAIN = (
    3.0,
    0.1,
)  # standard deviations of the priors of the base's rotation [deg] and gains
SHIFT, OFFSET = (
    0.0125,
    0.025,
)  # of those of the base's position and of marker offsets, as shares of the rod's length
COMMAND_OFFSET = (
    0.05  # of that of a command's offset, as a share of the range of the tendon's commands
)
DELAY, LONGEST_DELAY = (
    "commands.delay",
    0.5,
)  # name of the delay, which the scene has as effects.actuators.delay, and its upper bound [s]


@dataclass(frozen=True)
class Parameter:
    """Number to estimate."""

    name: str
    of_scene: (
        SceneParameter | None
    )  # the numbers of the scene that it stands for, None for one of the measurement
    value: float  # the scene's, around which a prior is
    low: float  # bounds
    high: float
    prior: float | None  # standard deviation, of factors in parts of the value; None: no prior
    is_factor: bool

    @property
    def scale(self) -> float:
        """Change that counts as 1: of factors e, else the prior's standard deviation, or half of
        the distance of the bounds."""
        return 1.0 if self.is_factor else self.prior or 0.5 * (self.high - self.low)

    def coordinate(self, value: float) -> float:
        """Dimensionless coordinate of a value, 0 at the scene's own."""
        return math.log(value / self.value) if self.is_factor else (value - self.value) / self.scale

    def at(self, coordinate: float) -> float:
        """Value at a coordinate."""
        return (
            self.value * math.exp(coordinate)
            if self.is_factor
            else self.value + self.scale * coordinate
        )

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest coordinate."""
        return tuple(sorted((self.coordinate(self.low), self.coordinate(self.high))))  # type: ignore[return-value] # two


def command_limits(scene: Scene) -> Array:
    """Limits (n_a, 2) of commands in their unit."""
    return scene.effects.command_limits(
        np.array([tendon.tension_limits for tendon in scene.tendons])
    )


def read_parameters(
    asked: Sequence[str], scene: Scene, markers: MarkerSet
) -> tuple[Parameter, ...]:
    """Parameters of what is asked for, `KEY` or `KEY=LOW..HIGH`. Raises ValueError in one line."""
    measured, found = _of_measurement(scene, markers), list[Parameter]()
    for text in asked:
        key, bounds = _parse(text)
        if key.split(".")[0] not in MEASUREMENT:
            found.append(_of_scene(key, scene, bounds))
        elif matches := [
            one
            for name, one in measured.items()
            if re.match(rf"{re.escape(key)}(\.|$)".replace(r"\*", r"[^.]+"), name)
        ]:
            found += [_with_bounds(one, bounds, scene) for one in matches]
        else:
            raise ValueError(
                f"parameter {key!r} is none of the measurement: {not_among(key, measured)}"
            )
    keys = [key for one in found for key in (one.of_scene.keys if one.of_scene else (one.name,))]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise ValueError(f"parameters name {twice} twice")
    if not found:
        raise ValueError(
            "parameters should name at least one number, such as segments.*.young_modulus"
        )
    return tuple(found)


def _parse(text: str) -> tuple[str, tuple[float, float] | None]:
    """Key, and bounds of a written text. Raises ValueError."""
    key, _, ends = text.partition("=")
    if not ends:
        return key.strip(), None
    with contextlib.suppress(ValueError):
        low, high = map(float, ends.split(".."))
        if low < high:
            return key.strip(), (low, high)
    raise ValueError(f"parameter {text!r} should be KEY or KEY=LOW..HIGH with LOW < HIGH")


def _of_measurement(scene: Scene, markers: MarkerSet) -> dict[str, Parameter]:
    """Every parameter of the base and of the measurement, with its usual prior, by its key."""
    length, commands, usual = (
        rod_length(scene),
        np.ptp(command_limits(scene), axis=1),
        dict[str, tuple[float, float]](),
    )
    base = {
        f"base.{name}.{axis}": prior
        for name, prior in (("rotation", ROTATION), ("position", SHIFT * length))
        for axis in range(3)
    }
    for name, marker in markers.markers.items():
        usual |= {
            f"markers.{name}.offset.{axis}": (at, OFFSET * length)
            for axis, at in enumerate(marker.offset)
        }
    usual |= {
        f"commands.{i}.offset": (0.0, COMMAND_OFFSET * float(span))
        for i, span in enumerate(commands)
    }
    stands = [
        (numbers.name, numbers, numbers.value, base[numbers.name])
        for numbers in scene_parameters(scene, base)
    ]
    placed = [*stands, *((key, None, *numbers) for key, numbers in usual.items())]
    found = [
        Parameter(key, of, at, at - WIDE * prior, at + WIDE * prior, prior, False)
        for key, of, at, prior in placed
    ]
    found += [
        Parameter(f"commands.{i}.gain", None, 1.0, 1.0 / FACTOR, FACTOR, GAIN, True)
        for i in range(len(commands))
    ]
    delay = getattr(scene.effects.chosen().get("actuators"), "delay", 0.0)
    found.append(Parameter(DELAY, None, delay, 0.0, LONGEST_DELAY, None, False))
    return {one.name: one for one in found}


def _of_scene(key: str, scene: Scene, bounds: tuple[float, float] | None) -> Parameter:
    """Parameter of the scene that is asked for. Raises ValueError where bounds must be given,
    ConfigurationError."""
    (numbers,) = scene_parameters(scene, [key])
    value, is_angle = numbers.value, key.endswith((".angle", ".phase")) and not numbers.is_factor
    is_factor = all(numbers.values) and not is_angle
    if not is_factor and not is_angle and bounds is None:
        raise ValueError(
            f"parameter {key!r} is {value:g}: zero has no usual range, give {key}=LOW..HIGH"
        )
    low, high = (
        (value - TURN, value + TURN) if is_angle else sorted((value / FACTOR, value * FACTOR))
    )
    return _with_bounds(Parameter(key, numbers, value, low, high, None, is_factor), bounds, scene)


def _with_bounds(usual: Parameter, bounds: tuple[float, float] | None, scene: Scene) -> Parameter:
    """A parameter with given bounds in place of its own and of its prior. Raises ValueError where
    they leave out the scene's number."""
    low, high = bounds or (usual.low, usual.high)
    if not low <= usual.value <= high or (usual.is_factor and low * high <= 0.0):
        what = "of one sign around" if usual.is_factor else "around"
        raise ValueError(
            f"parameter {usual.name!r} is bounded to {low:g}..{high:g}: bounds should be {what} its"
            f" number, {usual.value:g}"
        )
    found = replace(usual, low=low, high=high, prior=None if bounds else usual.prior)
    if found.of_scene is None:
        return found
    return replace(
        found, low=_nearest_allowed(low, found, scene), high=_nearest_allowed(high, found, scene)
    )


def _nearest_allowed(bound: float, parameter: Parameter, scene: Scene) -> float:
    """The value nearest to a bound that the scene's own checks let pass, by halving."""
    share, far = 0.0, parameter.coordinate(bound)
    for step in 0.5 ** np.arange(40):
        with contextlib.suppress(ConfigurationError):
            scene_with_numbers(
                scene, parameter.of_scene.changes(parameter.at((share + step) * far))
            )  # type: ignore[union-attr]
            share += step
        if share == 1.0:
            return bound
    return parameter.at(share * far)
