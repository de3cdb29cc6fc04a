"""Target trajectories: a configuration class per kind, its drawn course as a function of time, and
the table by which options name them.

A target is one file, in this package or a user's own: a configuration class under
`@register_target` whose `draw` returns the motion as a function of time, the same whatever other
times are asked for with it. `examples/own_target.py` is one from outside.
"""

import importlib
import pkgutil
from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace
from soft_tendon_env.mechanics.types import Implicit
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_registered,
    shown,
)
from soft_tendon_env.tools.types import Array

FARTHEST = (
    1e6  # largest coordinate [m] of a target: a thousand kilometres, whose square is a number still
)

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
    free: ObstacleFreeSpace | None = (
        # where drawn motions stay, if there are obstacles and the arm does not rest against one
        None
    )


def make_setting(arms: Arms, limits: Array, tension: Array, rest: Array) -> Setting:
    """The setting of these arms, see Setting."""
    model = arms.model
    if isinstance(model.arm.strain, Implicit):
        response = np.stack([model.rest_coordinates(unit) for unit in np.eye(model.tendon_count)])
    else:
        unloaded = model.terms(np.zeros(model.coordinate_count), np.zeros(model.coordinate_count))
        response = np.asarray(
            np.linalg.solve(unloaded.stiffness, unloaded.actuation).T, dtype=np.float64
        )
    return Setting(arms, limits, tension, rest, response, model)


class TargetSamples(NamedTuple):
    """A target at m times. Targets that are poses alone have coordinates, lengths and backbone of
    size 0."""

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
        """q and q_dot, (m, n) each, at times (m,) [s]."""


Course = PoseCourse | ShapeCourse


class Target(Configuration):
    """Base of the targets' configurations. A class has a field `type: Literal["name"] = "name"`,
    the name that options use.

    What a class may have otherwise:
        is_random: whether episodes differ in it; one that does not is drawn once for all of them.
        gives_shapes: whether its course is a ShapeCourse, which tasks that compare shapes need.
        repeats: time [s] after which a drawn course repeats; None: it does not.
        kinds: number of targets of which it is one.
        begins_at_rest: whether its courses begin where the arm rests, so that no other draw would
        begin elsewhere.
    """

    type: str
    begins_at_rest: ClassVar[bool] = False

    @property
    def is_random(self) -> bool:
        return False

    @property
    def gives_shapes(self) -> bool:
        return False

    @property
    def repeats(self) -> float | None:
        return None

    @property
    def kinds(self) -> int:
        return 1

    def check(self, scene: Scene) -> None:
        """Raises ConfigurationError with keys from `target` on, where the target does not fit the
        scene."""

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm can hold none."""
        raise NotImplementedError(f"{type(self).__name__} needs a method draw()")


def drawn(value: float | tuple[float, float], generator: np.random.Generator) -> float:
    """A number, or one that is drawn from a range (least, greatest)."""
    return generator.uniform(*value) if isinstance(value, tuple) else value


def _up_to(greatest: float) -> BeforeValidator:
    """Validator of positive numbers up to a greatest, and of ranges of them."""

    def checked(value: Any) -> Any:
        ends = value if isinstance(value, tuple) and len(value) == 2 else (value, value)
        if (
            not all(type(end) in (int, float) for end in ends)
            or not 0.0 < ends[0] <= ends[1] <= greatest
        ):
            raise ValueError(
                f"should be a number greater than 0 and at most {greatest:g}, or (least, greatest)"
            )
        return value

    return BeforeValidator(checked)


Fraction = Annotated[float | tuple[float, float], _up_to(1.0)]
Amount = Annotated[float | tuple[float, float], _up_to(FARTHEST)]


class DrawnShapes(Target):
    """Base of targets that are shapes at rest, under random tensions within `fraction` of their
    limits, which may be a range (least, greatest) from which every episode draws it."""

    fraction: Fraction = 0.25

    @property
    def is_random(self) -> bool:
        return True

    @property
    def gives_shapes(self) -> bool:
        return True


class GivenShapes(DrawnShapes):
    """Base of targets that are shapes at rest under a given `tension` (n_a) [N], or else random
    ones."""

    tension: tuple[float, ...] | None = None

    @property
    def is_random(self) -> bool:
        return self.tension is None

    def check(self, scene: Scene) -> None:
        if self.tension is not None and len(self.tension) != len(scene.tendons):
            text = (
                f"has {len(self.tension)} entries: it should have one per tendon,"
                f" {len(scene.tendons)}"
            )
            raise ConfigurationError([Problem(("target", "tension"), text)], "environment")


Class = TypeVar("Class", bound=type[Target])

TARGETS: dict[str, type[Target]] = {}
"""Every registered target's configuration class, by its name."""


def register_target(target: Class) -> Class:
    """Class decorator: make a `Target` available to options, by its name or as a table with that
    `type`.

    A second class of the same module and name replaces the first. Raises ValueError for a name that
    is taken.
    """
    kind = target.__pydantic_fields__["type"].default
    present = TARGETS.get(kind, target)
    if (present.__module__, present.__qualname__) != (target.__module__, target.__qualname__):
        raise ValueError(
            f"the target {kind!r} is registered twice: {present.__module__}, {target.__module__}"
        )
    TARGETS[kind] = target
    return target


def _by_name(target: Any) -> Any:
    settings = {"type": target} if isinstance(target, str) else target
    if not isinstance(settings, dict):
        return target
    if (kind := str(settings.get("type"))) not in TARGETS:
        raise ConfigurationError(
            [
                Problem(
                    ("type",), f"is {shown(settings.get('type'))}: {not_registered(kind, TARGETS)}"
                )
            ]
        )
    return TARGETS[kind](**settings)


NamedTarget = Annotated[SerializeAsAny[Target], BeforeValidator(_by_name)]
"""A target, or its name, or a table with that as `type`."""


def pose_samples(pose: Array, twist: Array) -> TargetSamples:
    """The samples of a PoseCourse from poses (m, 4, 4) and body twists (m, 6), angular before
    linear."""
    m = len(pose)
    return TargetSamples(pose, twist, np.empty((m, 0)), np.empty((m, 0)), np.empty((m, 0, 4, 4)))


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
