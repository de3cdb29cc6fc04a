"""Parameters to estimate: numbers of a scene by dotted keys, and numbers of the measurement (mount, markers, commands).

`segments.*.young_modulus`: a wildcard in a scene's key is one parameter, by which the numbers of all matches change together. Numbers
without zeros among them are estimated as a factor (in logarithm), others as a difference. A key of a table or a vector is a parameter per
number in it. Keys of the measurement, whose wildcards are parameters apiece: `mount.rotation` (rotation vector of the real base [deg]) and
`mount.shift` [m] in the scene's frame, `markers.NAME.offset` [m], `commands.I.gain`, `commands.I.offset` and `commands.delay` [s].

`KEY=LOW..HIGH` bounds a parameter; `KEY~SIGMA` gives the standard deviation of a normal prior around the scene's number, in parts of it for
factors.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError, not_among

TABLES = ("segments", "tendons", "effects")
"""Tables of a scene whose numbers are the arm's own."""
FACTOR = 30.0
"""How far a factor may go either way, where no bounds are given."""
WIDE = 5.0
"""Standard deviations of a prior that a difference may go either way, where no bounds are given."""
ROTATION, SHIFT, OFFSET, GAIN = 3.0, 5e-3, 1e-2, 0.1
"""Standard deviations of the priors of mount rotation [deg], shift [m], marker offsets [m] and gains."""
COMMAND_OFFSET = 0.05
"""Standard deviation of the prior of a command's offset, as a share of the tendon's range of tensions."""
DELAY, LONGEST_DELAY = "commands.delay", 0.5
"""Name of the delay of commands, which the scene has as effects.actuators.delay, and its upper bound [s]."""
HALVINGS = 40


@dataclass(frozen=True)
class Parameter:
    """Number to estimate.

    value: the scene's, around which a prior is. low, high: bounds. prior: standard deviation, None for none; of factors in parts of the
    value. keys: of the numbers that change with it, the first of which is `value`.
    """

    name: str
    keys: tuple[str, ...]
    value: float
    low: float
    high: float
    prior: float | None
    is_factor: bool

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


@dataclass(frozen=True)
class _Asked:
    """Written text: a key, and bounds or the standard deviation of a prior."""

    key: str
    bounds: tuple[float, float] | None
    prior: float | None


def read_parameters(asked: Sequence[str], scene: Scene, markers: MarkerSet) -> tuple[Parameter, ...]:
    """Parameters of what is asked for, `KEY`, `KEY=LOW..HIGH` or `KEY~SIGMA`. Raises ValueError in one line."""
    numbers, own = scene_numbers(scene), _of_measurement(scene, markers)
    found = list[Parameter]()
    for one in map(_parsed, asked):
        matches = _measured(one, own) or _of_scene(one, numbers, scene)
        if not matches:
            raise ValueError(f"parameter {one.key!r} matches no number: {not_among(one.key, [*numbers, *own])}")
        found += matches
    keys = [key for parameter in found for key in parameter.keys]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise ValueError(f"parameters name {twice} twice")
    if not found:
        raise ValueError("parameters should name at least one number, such as segments.*.young_modulus")
    return tuple(found)


def scene_numbers(scene: Scene) -> dict[str, float]:
    """Numbers of the arm by dotted key; whole numbers and switches are none."""
    return dict(_leaves(scene_to_dict(scene, set(TABLES))))


def _parsed(text: str) -> _Asked:
    key, sign, rest = re.fullmatch(r"([^=~]*)([=~]?)(.*)", text.strip(), re.DOTALL).groups()  # type: ignore[union-attr] # matches all
    try:
        numbers = [float(part) for part in rest.split("..")] if sign else []
    except ValueError:
        numbers = [math.nan]
    bounded, prior = sign == "=" and len(numbers) == 2, sign == "~" and len(numbers) == 1
    fine = all(map(math.isfinite, numbers)) and (not sign or bounded or prior)
    if not (fine and key) or (bounded and numbers[0] >= numbers[1]) or (prior and numbers[0] <= 0.0):
        raise ValueError(f"parameter {text!r} should be KEY, KEY=LOW..HIGH with LOW < HIGH, or KEY~SIGMA with SIGMA > 0")
    return _Asked(key, (numbers[0], numbers[1]) if bounded else None, numbers[0] if prior else None)


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, float]]:
    """Numbers of nested tables with their dotted keys."""
    if isinstance(value, Mapping | list):
        pairs = value.items() if isinstance(value, Mapping) else enumerate(value)
        for name, own in pairs:
            yield from _leaves(own, f"{key}.{name}" if key else str(name))
    elif isinstance(value, float):
        yield key, value


def _rest(pattern: str, key: str) -> str | None:
    """Rest of a key behind a pattern that its first parts match; None where they do not."""
    parts, own = re.sub(r"\[(\d+)\]", r".\1", pattern).split("."), key.split(".")
    matches = len(parts) <= len(own) and all(part in ("*", name) for part, name in zip(parts, own, strict=False))
    return ".".join(own[len(parts) :]) if matches else None


def _of_measurement(scene: Scene, markers: MarkerSet) -> dict[str, Parameter]:
    """Every parameter of the measurement, with its usual prior, by its key."""

    def difference(key: str, value: float, prior: float) -> Parameter:
        return Parameter(key, (key,), value, value - WIDE * prior, value + WIDE * prior, prior, False)

    found = [difference(f"mount.rotation.{axis}", 0.0, ROTATION) for axis in range(3)]
    found += [difference(f"mount.shift.{axis}", 0.0, SHIFT) for axis in range(3)]
    for name, marker in markers.markers.items():
        found += [difference(f"markers.{name}.offset.{axis}", value, OFFSET) for axis, value in enumerate(marker.offset)]
    for i, tendon in enumerate(scene.tendons):
        span = tendon.tension_limits[1] - tendon.tension_limits[0]
        found.append(Parameter(f"commands.{i}.gain", (f"commands.{i}.gain",), 1.0, 1.0 / FACTOR, FACTOR, GAIN, True))
        found.append(difference(f"commands.{i}.offset", 0.0, COMMAND_OFFSET * span))
    actuators = scene.effects.chosen().get("actuators")
    found.append(Parameter(DELAY, (DELAY,), getattr(actuators, "delay", 0.0), 0.0, LONGEST_DELAY, None, False))
    return {parameter.name: parameter for parameter in found}


def _measured(asked: _Asked, own: Mapping[str, Parameter]) -> list[Parameter]:
    """Parameters of the measurement that are asked for."""
    return [_given(asked, parameter) for key, parameter in own.items() if _rest(asked.key, key) is not None]


def _of_scene(asked: _Asked, numbers: Mapping[str, float], scene: Scene) -> list[Parameter]:
    """Parameters of the scene that are asked for: one for each ending behind the key, of all matches together."""
    groups = dict[str, list[str]]()
    for key in numbers:
        if (rest := _rest(asked.key, key)) is not None:
            groups.setdefault(rest, []).append(key)
    return [_grouped(asked, f"{asked.key}.{rest}".removesuffix("."), keys, numbers, scene) for rest, keys in groups.items()]


def _grouped(asked: _Asked, name: str, keys: Sequence[str], numbers: Mapping[str, float], scene: Scene) -> Parameter:
    """Parameter of numbers that change together. Raises ValueError where bounds or a prior must be given."""
    value, is_factor = numbers[keys[0]], all(numbers[key] for key in keys)
    if not is_factor and asked.bounds is None and asked.prior is None:
        raise ValueError(f"parameter {name!r} is {value:g}: zero has no usual range, give {name}=LOW..HIGH or {name}~SIGMA")
    low, high = sorted((value / FACTOR, value * FACTOR)) if is_factor else (value, value)
    if not is_factor and asked.prior is not None:
        low, high = value - WIDE * asked.prior, value + WIDE * asked.prior
    found = _given(asked, Parameter(name, tuple(keys), value, low, high, None, is_factor))
    low, high = (_allowed(bound, found, numbers, scene, asked.bounds is not None) for bound in (found.low, found.high))
    return Parameter(name, found.keys, value, low, high, found.prior, is_factor)


def _given(asked: _Asked, usual: Parameter) -> Parameter:
    """A parameter with the bounds or the prior that are given. Raises ValueError for bounds that leave out the scene's own number."""
    if asked.bounds is None:
        low, high, prior = usual.low, usual.high, asked.prior or usual.prior
    else:
        (low, high), prior = asked.bounds, None
        if not low <= usual.value <= high or (usual.is_factor and low * high <= 0.0):
            what = "of one sign around" if usual.is_factor else "around"
            raise ValueError(
                f"parameter {usual.name!r} is bounded to {low:g}..{high:g}: bounds should be {what} its number, {usual.value:g}"
            )
    return Parameter(usual.name, usual.keys, usual.value, low, high, prior, usual.is_factor)


def changes_of(parameter: Parameter, value: float, numbers: Mapping[str, float]) -> dict[str, float]:
    """Numbers by key that a value of a parameter comes to."""
    if parameter.is_factor:
        return {key: numbers[key] * (value / parameter.value) for key in parameter.keys}
    return {key: numbers[key] + (value - parameter.value) for key in parameter.keys}


def _allowed(bound: float, parameter: Parameter, numbers: Mapping[str, float], scene: Scene, given: bool) -> float:
    """A bound that the scene's own checks pass, as near to this one as they let. Raises ValueError for one that was given."""
    least = 0.0
    part, step = 1.0, 0.5
    for _ in range(HALVINGS):
        at = parameter.at(part * parameter.coordinate(bound))
        try:
            scene.replace(changes_of(parameter, at, numbers))
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
