"""Parameters to estimate: numbers of a scene by dotted keys, and numbers of the measurement (mount, markers, commands).

Of a scene: see scene.parameters; `segments.*.young_modulus` is one parameter, by which the numbers of all matches change together. Numbers
other than zero are estimated as a factor (in logarithm), others as a difference. Of the measurement, where a wildcard is a parameter for
each match: `mount.rotation` (rotation vector of the real base [deg]) and `mount.shift` [m] in the scene's frame, `markers.NAME.offset` [m],
`commands.I.gain`, `commands.I.offset` and `commands.delay` [s].

`KEY=LOW..HIGH` bounds a parameter; `KEY~SIGMA` gives the standard deviation of a normal prior around the scene's number, in parts of it for
factors.
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

MEASUREMENT = ("mount", "markers", "commands")
"""Tables of the measurement."""
FACTOR = 30.0
"""How far a factor may go either way, where no bounds are given."""
WIDE = 5.0
"""Standard deviations of a prior that a difference may go either way, where no bounds are given."""
ROTATION, GAIN = 3.0, 0.1
"""Standard deviations of the priors of mount rotation [deg] and gains."""
SHIFT, OFFSET = 0.0125, 0.025
"""Standard deviations of the priors of the mount's shift and of marker offsets, as shares of the rod's length."""
COMMAND_OFFSET = 0.05
"""Standard deviation of the prior of a command's offset, as a share of the range of the tendon's commands, in their unit."""
DELAY, LONGEST_DELAY = "commands.delay", 0.5
"""Name of the delay of commands, which the scene has as effects.actuators.delay, and its upper bound [s]."""
DISTANCES = ("offset", "start_offset", "end_offset", "fraction", "radius", "y", "z")
"""Numbers of a routing in proportion to the tendon's distance from the axis."""
HALVINGS = 40
Bounds = tuple[float, float]


@dataclass(frozen=True)
class Parameter:
    """Number to estimate.

    value: the scene's, around which a prior is. low, high: bounds. prior: standard deviation, None for none; of factors in parts of the
    value. of_scene: the numbers of the scene that it stands for, None for one of the measurement.
    """

    name: str
    of_scene: SceneParameter | None
    value: float
    low: float
    high: float
    prior: float | None
    is_factor: bool

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the numbers that change with it."""
        return (self.name,) if self.of_scene is None else self.of_scene.keys

    def changes(self, value: float) -> dict[str, float]:
        """Changes of the scene that a value comes to; none for a parameter of the measurement."""
        return {} if self.of_scene is None else self.of_scene.changes(value)

    @property
    def scale(self) -> float:
        """Change that counts as 1: of factors e, else the prior's standard deviation, or half of the distance of the bounds."""
        return 1.0 if self.is_factor else self.prior or 0.5 * (self.high - self.low)

    def coordinate(self, value: float) -> float:
        """Dimensionless coordinate of a value, 0 at the scene's own."""
        return math.log(value / self.value) if self.is_factor else (value - self.value) / self.scale

    def at(self, coordinate: float) -> float:
        """Value at a coordinate."""
        return self.value * math.exp(coordinate) if self.is_factor else self.value + self.scale * coordinate

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest coordinate."""
        low, high = sorted((self.coordinate(self.low), self.coordinate(self.high)))
        return low, high


def read_parameters(asked: Sequence[str], scene: Scene, markers: MarkerSet) -> tuple[Parameter, ...]:
    """Parameters of what is asked for, `KEY`, `KEY=LOW..HIGH` or `KEY~SIGMA`. Raises ValueError in one line."""
    measured, found = _of_measurement(scene, markers), list[Parameter]()
    for key, bounds, prior in map(_parsed, asked):
        if key.split(".")[0] not in MEASUREMENT:
            found.append(_of_scene(key, bounds, prior, scene))
        elif usual := [own for name, own in measured.items() if _begins(name, key)]:
            found += [_given(own, bounds, prior) for own in usual]
        else:
            raise ValueError(f"parameter {key!r} is none of the measurement: {not_among(key, measured)}")
    keys = [key for parameter in found for key in parameter.keys]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise ValueError(f"parameters name {twice} twice")
    if not found:
        raise ValueError("parameters should name at least one number, such as segments.*.young_modulus")
    return tuple(found)


def _parsed(text: str) -> tuple[str, Bounds | None, float | None]:
    """Key, and bounds or the standard deviation of a prior, of a written text. Raises ValueError."""
    key, sign, rest = re.fullmatch(r"([^=~]*)([=~]?)(.*)", text.strip(), re.DOTALL).groups()  # type: ignore[union-attr] # matches all
    with contextlib.suppress(ValueError):
        numbers = [float(part) for part in rest.split("..")] if sign else []
        if key and all(map(math.isfinite, numbers)):
            if not sign:
                return key, None, None
            if sign == "=" and len(numbers) == 2 and numbers[0] < numbers[1]:
                return key, (numbers[0], numbers[1]), None
            if sign == "~" and len(numbers) == 1 and numbers[0] > 0.0:
                return key, None, numbers[0]
    raise ValueError(f"parameter {text!r} should be KEY, KEY=LOW..HIGH with LOW < HIGH, or KEY~SIGMA with SIGMA > 0")


def command_limits(scene: Scene) -> Array:
    """Limits (n_a, 2) of commands in their unit."""
    return scene.effects.command_limits(np.array([tendon.tension_limits for tendon in scene.tendons]))


def distance_parameter(scene: Scene) -> Parameter | None:
    """Common factor of the distances of all tendons from the axis; None where all of them lie on it."""
    values = {
        ".".join(map(str, ("tendons", i, "routing", name, *place))): float(number)
        for i, tendon in enumerate(scene.tendons)
        for name, numbers in tendon.routing
        if name in DISTANCES
        for place, number in np.ndenumerate(np.array(numbers))
        if number
    }
    if not values:
        return None
    own = SceneParameter("tendons.*.routing", tuple(values), tuple(values.values()), max(map(abs, values.values())))
    low, high = sorted((own.value / FACTOR, own.value * FACTOR))
    return Parameter(own.name, own, own.value, low, high, None, True)


def _begins(key: str, pattern: str) -> bool:
    """Whether a key begins as a pattern says, in which `*` stands for any part."""
    parts, own = pattern.split("."), key.split(".")
    return len(parts) <= len(own) and all(part in ("*", name) for part, name in zip(parts, own, strict=False))


def _of_measurement(scene: Scene, markers: MarkerSet) -> dict[str, Parameter]:
    """Every parameter of the measurement, with its usual prior, by its key."""

    def difference(key: str, value: float, prior: float) -> Parameter:
        return Parameter(key, None, value, value - WIDE * prior, value + WIDE * prior, prior, False)

    length = rod_length(scene)
    found = [difference(f"mount.rotation.{axis}", 0.0, ROTATION) for axis in range(3)]
    found += [difference(f"mount.shift.{axis}", 0.0, SHIFT * length) for axis in range(3)]
    for name, marker in markers.markers.items():
        found += [difference(f"markers.{name}.offset.{axis}", value, OFFSET * length) for axis, value in enumerate(marker.offset)]
    for i, span in enumerate(np.ptp(command_limits(scene), axis=1)):
        found.append(Parameter(f"commands.{i}.gain", None, 1.0, 1.0 / FACTOR, FACTOR, GAIN, True))
        found.append(difference(f"commands.{i}.offset", 0.0, COMMAND_OFFSET * float(span)))
    actuators = scene.effects.chosen().get("actuators")
    found.append(Parameter(DELAY, None, getattr(actuators, "delay", 0.0), 0.0, LONGEST_DELAY, None, False))
    return {parameter.name: parameter for parameter in found}


def _of_scene(key: str, bounds: Bounds | None, prior: float | None, scene: Scene) -> Parameter:
    """Parameter of the scene that is asked for. Raises ValueError where bounds or a prior must be given, ConfigurationError."""
    (own,) = scene_parameters(scene, [key])
    value, is_factor = own.value, all(own.values)
    if not is_factor and bounds is None and prior is None:
        raise ValueError(f"parameter {own.name!r} is {value:g}: zero has no usual range, give {own.name}=LOW..HIGH or {own.name}~SIGMA")
    low, high = sorted((value / FACTOR, value * FACTOR)) if is_factor else (value - WIDE * (prior or 0.0), value + WIDE * (prior or 0.0))
    found = _given(Parameter(own.name, own, value, low, high, None, is_factor), bounds, prior)
    low, high = (_allowed(bound, found, scene, bounds is not None) for bound in (found.low, found.high))
    return replace(found, low=low, high=high)


def _given(usual: Parameter, bounds: Bounds | None, prior: float | None) -> Parameter:
    """A parameter with the bounds or the prior that are given. Raises ValueError for bounds that leave out the scene's own number."""
    if bounds is None:
        return replace(usual, prior=prior or usual.prior)
    low, high = bounds
    if not low <= usual.value <= high or (usual.is_factor and low * high <= 0.0):
        what = "of one sign around" if usual.is_factor else "around"
        raise ValueError(f"parameter {usual.name!r} is bounded to {low:g}..{high:g}: bounds should be {what} its number, {usual.value:g}")
    return replace(usual, low=low, high=high, prior=None)


def _allowed(bound: float, parameter: Parameter, scene: Scene, given: bool) -> float:
    """A bound that the scene's own checks pass, as near to this one as they let. Raises ValueError for one that was given."""
    least = 0.0
    part, step = 1.0, 0.5
    for _ in range(HALVINGS):
        at = parameter.at(part * parameter.coordinate(bound))
        try:
            scene_with_numbers(scene, parameter.changes(at))
        except ConfigurationError as error:
            if given:
                raise ValueError(f"parameter {parameter.name!r} cannot be {bound:g}: {error}") from None
            part -= step
        else:
            least = part
            if part == 1.0:
                return bound
            part += step
        step *= 0.5
    return parameter.at(least * parameter.coordinate(bound))
