"""Target trajectories: a configuration class per kind, and its drawn course over time.

A target is one file, in this package or a user's own: a configuration class under
`@register("target", "name")` whose `draw` returns the motion as a function of time, the same
whatever other times are asked for with it. `examples/own_target.py` is one from outside.
"""

import importlib
import pkgutil
from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace
from soft_tendon_env.mechanics.types import Implicit
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, shown
from soft_tendon_env.tools.registry import TableRegistry
from soft_tendon_env.tools.types import Array

FARTHEST = 1e6
"""Largest coordinate [m] of a target: a thousand kilometres, whose square is a number still."""

Distance = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]


class Setting(NamedTuple):
    """The arms that targets are drawn for."""

    arms: Arms
    limits: Array  # (n_a, 2) [N]
    tension: Array  # (n_a,) [N] nearest to zero within them
    rest: Array  # (n,) coordinates in which that tension holds the arm
    # (n_a, n) that makes tensions the coordinates in which they hold the unloaded arm, to first
    # order
    response: Array
    # whose equilibria drawn targets are: that of the arms, without obstacles where there is a free
    # space
    model: Model
    # where drawn motions stay, if there are obstacles and the arm does not rest against one
    free: ObstacleFreeSpace | None = None


def make_setting(
    arms: Arms,
    limits: Array,
    tension: Array,
    rest: Array,
) -> Setting:
    """Setting of arms that have no obstacles, or rest against one.

    Args:
        arms: of an environment.
        limits: of tensions (n_a, 2) [N].
        tension: (n_a,) [N] nearest to zero within the limits.
        rest: coordinates (n,) in which that tension holds the arm.

    Returns:
        The setting.
    """
    response = _response(arms.model)
    return Setting(
        arms,
        limits,
        tension,
        rest,
        response,
        arms.model,
    )


def _response(model: Model) -> Array:
    """Coordinates (n_a, n) of the unloaded arm by tensions, to first order."""
    if isinstance(model.arm.strain, Implicit):
        units = np.eye(model.tendon_count)
        rows = [model.rest_coordinates(unit) for unit in units]
        return np.stack(rows)
    straight = np.zeros(model.coordinate_count)
    at_rest = np.zeros(model.coordinate_count)
    unloaded = model.terms(straight, at_rest)
    response = np.linalg.solve(unloaded.stiffness, unloaded.actuation)
    return np.asarray(response.T, dtype=np.float64)


class TargetSamples(NamedTuple):
    """A target at m times.

    Targets that are poses alone have coordinates, lengths and backbone of size 0.
    """

    tip_pose: Array  # (m, 4, 4)
    tip_twist: Array  # (m, 6) body twist
    q: Array  # (m, n)
    tendon_length: Array  # (m, n_a)
    backbone: Array  # (m, stations, 4, 4)


class PoseCourse(ABC):
    """A motion of the tip alone."""

    @abstractmethod
    def sample(self, times: Array) -> TargetSamples:
        """The target at times (m,) [s]."""


class ShapeCourse(ABC):
    """A motion of the whole arm, which its coordinates describe."""

    @abstractmethod
    def coordinates(self, times: Array) -> tuple[Array, Array]:
        """Coordinates q and rates q_dot, (m, n) each, at times (m,) [s]."""


Course = PoseCourse | ShapeCourse


class Target(Configuration):
    """Base of the targets' configurations.

    A class has a field `type: Literal["name"] = "name"`, the name that options use.

    What it may have otherwise:
        is_random: whether episodes differ in it; one that does not is drawn once for all of them.
        gives_shapes: whether its course is a ShapeCourse, which tasks that compare shapes need.
        repeats: time [s] after which a drawn course repeats; None: it does not.
        kinds: number of targets of which it is one.
        begins_at_rest: whether its courses begin where the arm rests, so that no other draw would
        begin elsewhere.
    """

    type: str  # name that options use
    begins_at_rest: ClassVar[bool] = False

    @property
    def is_random(self) -> bool:
        """Whether episodes differ in it."""
        return False

    @property
    def gives_shapes(self) -> bool:
        """Whether its course is a ShapeCourse."""
        return False

    @property
    def repeats(self) -> float | None:
        """Time [s] after which a drawn course repeats; None: it does not."""
        return None

    @property
    def kinds(self) -> int:
        """Number of targets of which it is one."""
        return 1

    def check(self, scene: Scene) -> None:
        """Raises an error where the target does not fit the scene.

        Args:
            scene: of an environment.

        Raises:
            ConfigurationError: with keys from `target` on.
        """

    @abstractmethod
    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """Draws the motion of one episode.

        Args:
            generator: of the episode.
            setting: of the arms.

        Returns:
            The course.

        Raises:
            ConfigurationError: where the arm can hold none.
        """


def drawn(value: float | tuple[float, float], generator: np.random.Generator) -> float:
    """A number, or one that is drawn from a range (least, greatest)."""
    if not isinstance(value, tuple):
        return value
    least, greatest = value
    return generator.uniform(least, greatest)


def _up_to(greatest: float) -> BeforeValidator:
    """Validator of positive numbers up to a greatest, and of ranges of them."""

    def checked(value: Any) -> Any:
        is_tuple = isinstance(value, tuple)
        is_range = is_tuple and len(value) == 2
        if is_range:
            ends = value
        else:
            ends = (value, value)
        are_numbers = all(type(end) in (int, float) for end in ends)
        least, most = ends
        if not are_numbers or not 0.0 < least <= most <= greatest:
            raise ValueError(
                f"should be a number greater than 0 and at most {greatest:g}, or (least, greatest)"
            )
        return value

    return BeforeValidator(checked)


Fraction = Annotated[float | tuple[float, float], _up_to(1.0)]
Amount = Annotated[float | tuple[float, float], _up_to(FARTHEST)]


class DrawnShapes(Target):
    """Base of targets that are shapes at rest, under random tensions.

    They are within `fraction` of their limits, which may be a range (least, greatest) from which
    every episode draws it.
    """

    fraction: Fraction = 0.25

    @property
    def is_random(self) -> bool:
        return True

    @property
    def gives_shapes(self) -> bool:
        return True


class GivenShapes(DrawnShapes):
    """Base of targets that are shapes at rest under a `tension` (n_a) [N], or else random ones."""

    tension: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _fraction_is_drawn_from(self) -> Self:
        usual = type(self).model_fields["fraction"].default
        if not self.is_random and self.fraction != usual:
            text = f"is {shown(self.fraction)}, and nothing is drawn: leave it out"
            raise ConfigurationError([Problem(("fraction",), text)])
        return self

    @property
    def is_random(self) -> bool:
        return self.tension is None

    def check(self, scene: Scene) -> None:
        if self.tension is None:
            return
        count = len(self.tension)
        tendons = len(scene.tendons)
        if count != tendons:
            text = f"has {count} entries: it should have one per tendon, {tendons}"
            raise ConfigurationError([Problem(("target", "tension"), text)], "environment")


TARGETS: TableRegistry[Target] = TableRegistry("target", Target)
"""Every registered target's configuration class, by its name."""


def _by_name(target: Any) -> Any:
    """The target of a name or a table; else itself. Raises ConfigurationError."""
    if isinstance(target, str):
        table = {"type": target}
    else:
        table = target
    return TARGETS.parse(table)


NamedTarget = Annotated[SerializeAsAny[Target], BeforeValidator(_by_name)]
"""A target, or its name, or a table with that as `type`."""


def pose_samples(pose: Array, twist: Array) -> TargetSamples:
    """Samples of a PoseCourse from poses (m, 4, 4) and body twists (m, 6), angular first."""
    count = len(pose)
    return TargetSamples(
        tip_pose=pose,
        tip_twist=twist,
        q=np.empty((count, 0)),
        tendon_length=np.empty((count, 0)),
        backbone=np.empty((count, 0, 4, 4)),
    )


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
