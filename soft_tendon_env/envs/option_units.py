"""Plausibility of an environment's options.

There is a word where a number is most likely in another unit than SI's, and where rows take more
memory than there is.
"""

import contextlib
import os
import warnings
from collections.abc import Iterator
from typing import NamedTuple

from soft_tendon_env.envs.options import Options
from soft_tendon_env.scene.plausibility import ArmScales, Bound, implausible, scales_of
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.units import UnitsWarning
from soft_tendon_env.tools.configuration import ConfigurationError

BOUNDS = {
    "period": Bound(0.0, 5.0, "s", "is it ms?"),
    "preview": Bound(0.0, 10.0, "s, or 10 control periods", "is it ms?"),
    "latency": Bound(0.0, 2.0, "s", "is it ms?"),
    "position noise": Bound(0.0, 0.2, "of the arm's length", "is it mm?"),
    "rotation noise": Bound(0.0, 0.3, "rad", "is it deg?"),
    "curvature noise": Bound(0.0, 5.0, "rad along the arm", "is it deg/m?"),
    "stretch noise": Bound(0.0, 0.2, "of the unstretched arm", "is it %?"),
    "tension offset": Bound(0.0, 1.0, "of the greatest tension", "is it mN?"),
    "tension rate": Bound(1e-2, 1e5, "of the greatest tension in a second", "is it N/ms, or mN/s?"),
    "threshold": Bound(0.0, 1.0, "lengths of the arm", "is it mm?"),
    "tip speed": Bound(0.0, 300.0, "lengths of the arm in a second", "is it mm/s?"),
}
"""Plausible ranges of options by name, as shares of the arm where it says so."""

MUCH_MEMORY = 0.5
"""Share of the machine's memory above which rows get a word."""

GIBIBYTE = 2.0**30


class OptionQuantity(NamedTuple):
    """Number of an option, and the share that it is."""

    bound: str  # name in BOUNDS
    key: str
    value: float
    share: float


def warn_of_options(options: Options, scene: Scene) -> None:
    """Warns, once, of options that are likely to be in other units.

    Args:
        options: of an environment.
        scene: of the options.
    """
    unlikely_options = _unlikely_options(options, scales_of(scene))
    unlikely_draws = _unlikely_draws(options, scene)
    numbers = [*unlikely_options, *unlikely_draws]
    if numbers:
        text = (
            "the environment has options that look as if they were not in SI units (m, kg, s, N,"
            f" rad): {'; '.join(numbers)}"
        )
        warnings.warn(text, UnitsWarning, stacklevel=5)  # where the user makes it


def _unlikely_options(options: Options, arm: ArmScales) -> Iterator[str]:
    """Options outside of BOUNDS, in words."""
    for quantity in _quantities(options, arm):
        bound = BOUNDS[quantity.bound]
        if not bound.least <= quantity.share <= bound.greatest:
            yield (
                f"{quantity.key} is {quantity.value:g}, {quantity.share:.3g} {bound.share}:"
                f" {bound.question}"
            )


def _quantities(options: Options, arm: ArmScales) -> Iterator[OptionQuantity]:
    """Numbers of options that have a bound."""
    period = options.control_period
    yield OptionQuantity("period", "control_period", period, period)
    longest = max(options.preview, default=0.0)
    # a few slow control periods ahead may be long
    if longest > 10.0 * period:
        share = longest
    else:
        share = 0.0
    yield OptionQuantity("preview", "preview", longest, share)
    drawn = options.randomize
    latency = drawn.latency[1]
    yield OptionQuantity("latency", "randomize.latency", latency, latency)
    noise = drawn.noise
    for name in ("position", "length"):
        value = getattr(noise, name)
        share = value / arm.length
        yield OptionQuantity("position noise", f"randomize.noise.{name}", value, share)
    yield OptionQuantity(
        "rotation noise", "randomize.noise.rotation", noise.rotation, noise.rotation
    )
    bend = noise.curvature * arm.length
    yield OptionQuantity("curvature noise", "randomize.noise.curvature", noise.curvature, bend)
    yield OptionQuantity("stretch noise", "randomize.noise.stretch", noise.stretch, noise.stretch)
    if arm.pull:
        offset = max(map(abs, drawn.tension_offset))
        share = offset / arm.pull
        yield OptionQuantity("tension offset", "randomize.tension_offset", offset, share)
        share = options.tension_rate / arm.pull
        yield OptionQuantity("tension rate", "tension_rate", options.tension_rate, share)
        if options.rate_limit is not None:
            share = options.rate_limit / arm.pull
            yield OptionQuantity("tension rate", "rate_limit", options.rate_limit, share)
    threshold = options.threshold or 0.0
    yield OptionQuantity("threshold", "threshold", threshold, threshold / arm.length)
    speed = options.tip_speed_limit or 0.0
    yield OptionQuantity("tip speed", "tip_speed_limit", speed, speed / arm.length)


def _unlikely_draws(options: Options, scene: Scene) -> Iterator[str]:
    """Numbers of the scene that are drawn beyond what is plausible, in words."""
    ranges = options.randomize.ranges(scene)
    if not ranges:
        return
    of_scene = {*implausible(scene)}
    greatest: dict[str, float] = {}
    for drawn in ranges:
        greatest |= drawn.changes(drawn.greatest)
    # an end that cannot be is told with its key, when the arms are drawn
    with contextlib.suppress(ConfigurationError):
        for text in implausible(scene.replace(greatest)):
            if text not in of_scene:
                yield f"randomize: {text}"


def warn_of_memory(rows: int, per_row: int) -> None:
    """Tells of rows that take much of the machine's memory, before they take it.

    Args:
        rows: of an environment.
        per_row: memory [bytes] that a row takes at least.

    Raises:
        MemoryError: where they take more than there is.

    Warns:
        UnitsWarning: where they take more than MUCH_MEMORY of it.
    """
    memory = _memory()
    needed = rows * per_row
    if memory is None or needed <= MUCH_MEMORY * memory:
        return
    text = (
        f"{rows:,} rows take at least {needed / GIBIBYTE:.3g} GiB of memory, and this machine has"
        f" {memory / GIBIBYTE:.3g} GiB: make fewer, with a shorter preview or history"
    )
    warnings.warn(text, UnitsWarning, stacklevel=5)
    if needed > memory:
        raise MemoryError(text)


def _memory() -> float | None:
    """Memory of the machine [bytes]; None where the system does not say."""
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return None
    size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return float(size)
