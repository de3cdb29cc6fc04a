"""Parameters to estimate: numbers of a scene by dotted keys, and of the measurement.

Those of the measurement are of markers and commands.

`segments.*.young_modulus` is one parameter, by which the numbers of all matches change together,
see scene.parameters. Numbers other than zero are estimated as a factor (in logarithm), others and
angles of tendons as a difference. Where the arm stands and how it is measured are others, of which
a wildcard is a parameter for each match: `base.rotation` [deg] and `base.position` [m] of the
scene, `markers.NAME.offset` [m], `commands.I.gain`, `commands.I.offset`, `commands.delay` [s] and
`commands.backlash` [m or N]; all but the last two have a normal prior, which bounds take the place
of.
"""

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.scene.parameters import Parameter as SceneParameter
from soft_tendon_env.scene.parameters import scene_parameters, scene_with_numbers
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, not_among
from soft_tendon_env.tools.types import Array

MEASUREMENT = ("base", "markers", "commands")  # tables whose parameters are of the measurement
FACTOR = 30.0  # how far a factor may go where no bounds are given
WIDE = 5.0  # how far a difference may, in standard deviations of its prior
TURN = 30.0  # how far angles of tendons may, to either side [deg]
ROTATION = 3.0  # standard deviation of the prior of the base's rotation [deg]
GAIN = 0.1  # of that of a command's gain, in parts of it
SHIFT = 0.0125  # of that of the base's position, as a share of the rod's length
OFFSET = 0.025  # of that of a marker's offset, as a share of the rod's length
COMMAND_OFFSET = 0.05  # of that of a command's offset, as a share of the tendon's range
DELAY = "commands.delay"  # name of the delay, which the scene has as effects.actuators.delay
LONGEST_DELAY = 0.5  # its upper bound [s]
BACKLASH = "commands.backlash"  # name of the half-width of the play of all commands
WIDEST_BACKLASH = 0.05  # its upper bound, as a share of the least of the tendons' ranges
HALVINGS = 40  # by which the scene's own bounds are sought, to 1e-12 of the distance


class Quantity(Enum):
    """Kinds of parameters: of the scene, or of one quantity of the measurement."""

    SCENE = auto()  # also the base's rotation
    BASE_POSITION = auto()
    MARKER_OFFSET = auto()
    COMMAND_GAIN = auto()
    COMMAND_OFFSET = auto()
    COMMAND_DELAY = auto()
    COMMAND_BACKLASH = auto()  # one for all tendons


@dataclass(frozen=True)
class Parameter:
    """Number to estimate."""

    name: str
    # the numbers of the scene that it stands for, None for one of the measurement
    of_scene: SceneParameter | None
    value: float  # the scene's, around which a prior is
    low: float  # bounds
    high: float
    prior: float | None  # standard deviation, of factors in parts of the value; None: no prior
    is_factor: bool
    quantity: Quantity = Quantity.SCENE
    # entry of the quantity's array: (axis,) of the base, (marker, axis), or (tendon,) of commands;
    # () stands for all entries
    index: tuple[int, ...] = ()

    @property
    def scale(self) -> float:
        """Change of the parameter that counts as 1.

        It is that of factors e, else the prior's standard deviation, or half of the distance of the
        bounds.
        """
        if self.is_factor:
            return 1.0
        return self.prior or 0.5 * (self.high - self.low)

    def coordinate(self, value: float) -> float:
        """Dimensionless coordinate of a value, 0 at the scene's own."""
        if self.is_factor:
            return math.log(value / self.value)
        return (value - self.value) / self.scale

    def at(self, coordinate: float) -> float:
        """Value at a coordinate."""
        if self.is_factor:
            return self.value * math.exp(coordinate)
        return self.value + self.scale * coordinate

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest coordinate."""
        # a factor of a negative number turns the order of the bounds around
        first = self.coordinate(self.low)
        last = self.coordinate(self.high)
        ends = first, last
        return min(ends), max(ends)


def command_limits(scene: Scene) -> Array:
    """Limits (n_a, 2) of commands in their unit."""
    limits_of_tendons = [tendon.tension_limits for tendon in scene.tendons]
    tension_limits = np.array(limits_of_tendons)
    return scene.effects.command_limits(tension_limits)


def read_parameters(
    asked: Sequence[str], scene: Scene, markers: MarkerSet
) -> tuple[Parameter, ...]:
    """Reads the parameters to estimate from their written keys and bounds.

    Args:
        asked: `KEY` or `KEY=LOW..HIGH` of each, with wildcards, see the module.
        scene: the arm, whose numbers the parameters begin at.
        markers: its markers.

    Returns:
        The parameters, those of a wildcard of the measurement one by one.

    Raises:
        ValueError: in one line, for a key that is no number or is named twice, and for bounds that
            leave out the scene's number, or are needed and missing.
    """
    measured = _of_measurement(scene, markers)
    parameters = list[Parameter]()
    for text in asked:
        key, bounds = _parse(text)
        table = key.split(".")[0]
        if table not in MEASUREMENT:
            parameters.append(_of_scene(key, scene, bounds))
            continue
        # a key names a whole array too: "base.position" has three numbers
        pattern = rf"{re.escape(key)}(\.|$)".replace(r"\*", r"[^.]+")
        matches = [usual for name, usual in measured.items() if re.match(pattern, name)]
        if not matches:
            raise ValueError(
                f"parameter {key!r} is none of the measurement: {not_among(key, measured)}"
            )
        parameters += [_with_bounds(usual, bounds, scene) for usual in matches]
    if not parameters:
        raise ValueError(
            "parameters should name at least one number, such as segments.*.young_modulus"
        )
    _check_once(parameters)
    return tuple(parameters)


def _check_once(parameters: Sequence[Parameter]) -> None:
    """Raises ValueError where two parameters stand for the same number."""
    keys = list[str]()
    for parameter in parameters:
        if parameter.of_scene is not None:
            keys += parameter.of_scene.keys
        else:
            keys.append(parameter.name)
    for key in keys:
        if keys.count(key) > 1:
            raise ValueError(f"parameters name {key} twice")


def _parse(text: str) -> tuple[str, tuple[float, float] | None]:
    """Key, and bounds of a written text.

    Raises ValueError.
    """
    key, _, ends = text.partition("=")
    name = key.strip()
    if not ends:
        return name, None
    with contextlib.suppress(ValueError):  # of text that is no number: it is told below
        low, high = map(float, ends.split(".."))
        if low < high:
            return name, (low, high)
    raise ValueError(f"parameter {text!r} should be KEY or KEY=LOW..HIGH with LOW < HIGH")


def _of_measurement(scene: Scene, markers: MarkerSet) -> dict[str, Parameter]:
    """Every parameter of the base and of the measurement, with its usual prior, by its key."""
    parameters = [
        *_of_base(scene),
        *_of_markers(markers, rod_length(scene)),
        *_of_commands(scene),
    ]
    return {parameter.name: parameter for parameter in parameters}


def _of_base(scene: Scene) -> list[Parameter]:
    """Rotation and position of the base about and along the world's axes."""
    parameters = list[Parameter]()
    farthest = SHIFT * rod_length(scene)
    for name, quantity, prior in (
        ("rotation", Quantity.SCENE, ROTATION),
        ("position", Quantity.BASE_POSITION, farthest),
    ):
        keys = [f"base.{name}.{axis}" for axis in range(3)]
        for axis, numbers in enumerate(scene_parameters(scene, keys)):
            key = keys[axis]
            value = numbers.value
            parameter = _difference(key, value, prior, quantity, (axis,), numbers)
            parameters.append(parameter)
    return parameters


def _of_markers(markers: MarkerSet, length: float) -> list[Parameter]:
    """Offsets of the markers of a rod of a length [m]."""
    return [
        _difference(
            f"markers.{name}.offset.{axis}",
            value,
            OFFSET * length,
            Quantity.MARKER_OFFSET,
            (row, axis),
        )
        for row, (name, marker) in enumerate(markers.markers.items())
        for axis, value in enumerate(marker.offset)
    ]


def _of_commands(scene: Scene) -> list[Parameter]:
    """Offsets, gains, the delay and the backlash of the commands."""
    spans = np.ptp(command_limits(scene), axis=1)
    offsets = [
        _difference(
            f"commands.{i}.offset",
            0.0,
            COMMAND_OFFSET * float(span),
            Quantity.COMMAND_OFFSET,
            (i,),
        )
        for i, span in enumerate(spans)
    ]
    gains = [
        Parameter(
            f"commands.{i}.gain",
            of_scene=None,
            value=1.0,
            low=1.0 / FACTOR,
            high=FACTOR,
            prior=GAIN,
            is_factor=True,
            quantity=Quantity.COMMAND_GAIN,
            index=(i,),
        )
        for i in range(len(spans))
    ]
    actuators = scene.effects.chosen().get("actuators")
    delay = Parameter(
        DELAY,
        of_scene=None,
        value=getattr(actuators, "delay", 0.0),
        low=0.0,
        high=LONGEST_DELAY,
        prior=None,
        is_factor=False,
        quantity=Quantity.COMMAND_DELAY,
    )
    backlash = Parameter(
        BACKLASH,
        of_scene=None,
        value=0.0,
        low=0.0,
        high=WIDEST_BACKLASH * float(spans.min()),
        prior=None,
        is_factor=False,
        quantity=Quantity.COMMAND_BACKLASH,
    )
    return [*offsets, *gains, delay, backlash]


def _difference(
    name: str,
    value: float,
    prior: float,
    quantity: Quantity,
    index: tuple[int, ...],
    of_scene: SceneParameter | None = None,
) -> Parameter:
    """Parameter with a normal prior around a value, and bounds far outside of it."""
    return Parameter(
        name,
        of_scene,
        value,
        low=value - WIDE * prior,
        high=value + WIDE * prior,
        prior=prior,
        is_factor=False,
        quantity=quantity,
        index=index,
    )


def _of_scene(key: str, scene: Scene, bounds: tuple[float, float] | None) -> Parameter:
    """Parameter of the scene that is asked for.

    Raises ValueError where bounds must be given, ConfigurationError.
    """
    (numbers,) = scene_parameters(scene, [key])
    value = numbers.value
    # angles that differ among the tendons have a common factor, as other numbers
    has_name = key.endswith((".angle", ".phase"))
    is_angle = has_name and not numbers.is_factor
    is_factor = all(numbers.values) and not is_angle
    if is_angle:
        low = value - TURN
        high = value + TURN
    elif is_factor or bounds is not None:
        unordered = (value / FACTOR, value * FACTOR)
        low, high = sorted(unordered)
    else:
        raise ValueError(
            f"parameter {key!r} is {value:g}: zero has no usual range, give {key}=LOW..HIGH"
        )
    usual = Parameter(
        key,
        of_scene=numbers,
        value=value,
        low=low,
        high=high,
        prior=None,
        is_factor=is_factor,
    )
    return _with_bounds(usual, bounds, scene)


def _with_bounds(usual: Parameter, bounds: tuple[float, float] | None, scene: Scene) -> Parameter:
    """A parameter with given bounds in place of its own and of its prior.

    Raises ValueError where they leave out the scene's number.
    """
    low, high = bounds or (usual.low, usual.high)
    is_inside = low <= usual.value <= high
    # a factor does not reach a number of the other sign
    is_unreachable = usual.is_factor and low * high <= 0.0
    if not is_inside or is_unreachable:
        if usual.is_factor:
            what = "of one sign around"
        else:
            what = "around"
        raise ValueError(
            f"parameter {usual.name!r} is bounded to {low:g}..{high:g}: bounds should be {what} its"
            f" number, {usual.value:g}"
        )
    if bounds:
        prior = None
    else:
        prior = usual.prior
    bounded = replace(usual, low=low, high=high, prior=prior)
    if bounded.of_scene is None:
        return bounded
    allowed_low = _nearest_allowed(low, bounded, bounded.of_scene, scene)
    allowed_high = _nearest_allowed(high, bounded, bounded.of_scene, scene)
    return replace(bounded, low=allowed_low, high=allowed_high)


def _nearest_allowed(
    bound: float, parameter: Parameter, numbers: SceneParameter, scene: Scene
) -> float:
    """The value nearest to a bound that the scene's own checks let pass, by halving."""
    share = 0.0  # of the way from the scene's value to the bound that is allowed
    way = parameter.coordinate(bound)
    # the first step is the whole way, each other half of the one before
    for step in 0.5 ** np.arange(HALVINGS):
        value = parameter.at((share + step) * way)
        with contextlib.suppress(ConfigurationError):  # what is refused stays beyond the share
            scene_with_numbers(scene, numbers.changes(value))
            share += step
        if share == 1.0:
            return bound
    return parameter.at(share * way)
