"""Scene: configuration of an arm, with its rod, tendons, strain parametrisation, quadrature, integrator and effects.

SI units throughout. Every class raises `ConfigurationError` for unknown keys, wrong types and wrong ranges.
"""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field, field_validator, model_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.scene.routing import Ends, Radius, RadiusProfile, Routing
from soft_tendon_env.scene.strain import ExplicitStrain, StaticsBased
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, override, shown
from soft_tendon_env.tools.types import Array, Length, NotNegative, Positive, Quaternion, TimeStep, Triple

GREATEST_TENSION = 1e9  # [N], of limits


def _is_range(limits: tuple[float, float]) -> tuple[float, float]:
    if not -GREATEST_TENSION <= limits[0] < limits[1] <= GREATEST_TENSION:
        raise ValueError(f"should be (least, greatest) with least < greatest, within ±{GREATEST_TENSION:g} N")
    return limits


TensionLimits = Annotated[tuple[float, float], AfterValidator(_is_range)]
LEAST_TOLERANCE = 1e-11  # share of the rod's length, error of a step that may be asked for: ten times what strains are good to
SAME_PLACE = 1e-9  # share of the rod's length: arc lengths closer than this are one place
SHORTEST = 4 * SAME_PLACE  # share of the rod's length that a tendon covers at least
MOST_INTERVALS = 512  # quadrature intervals per piece of the rod
MOST_COLUMNS = 6  # of extrapolation: 16 evaluations a step
FARTHEST_BASE = 1e3  # lengths of the rod, largest coordinate of the base: beyond it float32 rounds observed positions by more than 1e-4
TIP_TOLERANCE = 2.5e-3  # share of the rod's length, displacement of the tip by quadrature that counts as small


Angle = Annotated[float, Field(ge=-360, le=360)]


class Base(Configuration):
    """Pose of the arm's base in the world, by default at its origin; the straight rod runs along the base's x axis."""

    position: Triple = (0.0, 0.0, 0.0)  # [m]
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)  # from the base's axes to the world's, (w, x, y, z)
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)  # further turn about the world's axes, a rotation vector [deg]

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the base: [[R, position], [0, 0, 0, 1]]."""
        turn, angle = np.radians(self.rotation), math.radians(math.hypot(*self.rotation))
        a, (b, c, d) = math.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * turn
        product = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]]) @ self.quaternion
        w, x, y, z = (product / math.hypot(*product)).tolist()
        pose = np.eye(4)
        pose[:3, 3] = self.position
        pose[:3, :3] = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
        return pose


class Segment(Configuration):
    """Segment of the rod with one material and a circular section; segments follow each other from the base."""

    length: Length  # [m]
    young_modulus: Positive  # [Pa]
    poisson_ratio: float = Field(gt=-1, le=0.5)  # above -1, up to 0.5 (incompressible)
    density: Positive  # [kg/m^3]
    damping: NotNegative  # Kelvin-Voigt viscosity eta [Pa s]
    radius: Radius  # [m], a number or a profile: LinearRadius, RadiusTable
    curvature: Triple = (0.0, 0.0, 0.0)  # stress-free (torsion, bend_y, bend_z) [1/m]

    @field_validator("radius")
    @classmethod
    def _fits_length(cls, radius: float | RadiusProfile, info: ValidationInfo) -> float | RadiusProfile:
        if isinstance(radius, RadiusProfile) and "length" in info.data and (misfit := radius.misfit(info.data["length"])):
            raise ValueError(misfit)
        return radius


class Tendon(Configuration):
    """Tendon (threadlike actuator) that acts between two arc lengths of the rod. Positive tension pulls."""

    routing: Routing  # its offset from the axis along the rod: StraightRouting, ConvergingRouting, SurfaceRouting, ...
    start: NotNegative = 0.0  # arc length [m]
    end: Positive | None = None  # arc length [m]; None: the rod's tip
    tension_limits: TensionLimits = (0.0, 50.0)  # (least, greatest) [N] of the actuator; a negative least allows it to push

    @field_validator("end")
    @classmethod
    def _after_start(cls, end: float | None, info: ValidationInfo) -> float | None:
        if end is not None and end <= info.data.get("start", 0.0):
            raise ValueError(f"should be greater than start, {info.data['start']:g}")
        return end


class Quadrature(Configuration):
    """Quadrature along the rod: Magnus intervals (fourth order, two Gauss points each) per piece between neighbouring `breakpoints`."""

    intervals: int | None = Field(default=None, ge=1, le=MOST_INTERVALS)  # None: `least`, or as many as the scene needs for `tolerance`
    tolerance: Positive = TIP_TOLERANCE  # by which the tip may be off at rest under tensions within limits, as a share of the rod's length
    least: int = Field(default=6, ge=1, le=MOST_INTERVALS)  # fewest intervals where the scene needs fewer


class Integrator(Configuration):
    """Time integration: linearly implicit Euler, extrapolated, with steps of `step` [s].

    The order is the number of `columns` of the extrapolation (None: see `extrapolation_columns`); k columns cost 1 + k (k - 1) / 2
    evaluations. A step that fails is halved up to `max_halvings` times.

    With a `tolerance` [m] the order adapts, and then the step. Each step begins with 2 columns and adds one at a time, up to `columns`,
    until its estimated error is below the tolerance: the root mean square displacement of the rod. If that fails, the step is shortened.
    """

    step: TimeStep = 0.02
    columns: int | None = Field(default=None, ge=1, le=MOST_COLUMNS)
    tolerance: Annotated[float, Field(gt=0)] | None = None
    max_halvings: int = Field(default=10, ge=0, le=20)
    quasi_static: bool = False  # leaves inertia out: damping and elasticity alone balance tensions and loads

    @field_validator("tolerance")
    @classmethod
    def _has_an_estimate(cls, tolerance: float | None, info: ValidationInfo) -> float | None:
        if tolerance is not None and info.data.get("columns") == 1:
            raise ValueError("needs the error estimate of at least 2 columns")
        return tolerance


class Scene(Configuration):
    """Scene of one arm: everything that a user writes, in SI units (angles in degrees)."""

    name: str = Field(min_length=1)
    description: str = ""
    segments: tuple[Segment, ...] = Field(min_length=1)
    tendons: tuple[Tendon, ...] = Field(min_length=1)
    base: Base = Base()
    strain: Annotated[StaticsBased | ExplicitStrain, Field(discriminator="type")] = StaticsBased()
    quadrature: Quadrature = Quadrature()
    integrator: Integrator = Integrator()
    effects: Effects = Effects()

    def replace(self, changes: Mapping[str, Any]) -> "Scene":
        """Copy of the scene with dotted keys set, `{"segments.*.density": 5.0}`; same checks. Raises `ConfigurationError`."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        heads = {re.split(r"[.\[]", key)[0] for key in changes if isinstance(key, str)} if isinstance(changes, Mapping) else set()
        values |= scene_to_dict(self, heads & {*values})  # what is not changed need not be checked again
        override(values, changes)
        return Scene.parse(values, "scene")

    def __repr__(self) -> str:
        counts = [f"{len(parts)} {name}{'s' * (len(parts) > 1)}" for name, parts in (("segment", self.segments), ("tendon", self.tendons))]
        return f"Scene({', '.join([repr(self.name), f'{rod_length(self):g} m', *counts, *self.effects.chosen()])})"

    @model_validator(mode="after")
    def _parts_fit_the_rod(self) -> Self:
        if problems := list(_misfits(self)):
            raise ConfigurationError(problems)
        return self


def scene_to_dict(scene: Scene, tables: set[str] | None = None) -> dict[str, Any]:
    """Scene, or these tables of it, as plain tables fit for JSON and TOML; absent (None) entries are left out."""
    return scene.model_dump(mode="json", exclude_none=True, include=tables)


def rod_length(scene: Scene) -> float:
    """Length of the rod [m]."""
    return float(segment_borders(scene)[-1])


def segment_borders(scene: Scene) -> Array:
    """Arc lengths [m] where segments begin, and the tip: (segments + 1,)."""
    return np.cumsum([0.0, *(segment.length for segment in scene.segments)])


def segment_index(scene: Scene, arc_length: ArrayLike) -> NDArray[np.intp]:
    """Index of the segment that each arc length [m] lies in. A border belongs to the segment that begins there, the tip to the last."""
    return np.searchsorted(segment_borders(scene)[1:-1], arc_length, side="right")


def tendon_ends(scene: Scene, tendon: Tendon) -> Ends:
    """First and last arc length [m] of a tendon."""
    return tendon.start, rod_length(scene) if tendon.end is None else tendon.end


def breakpoints(scene: Scene) -> Array:
    """Sorted unique arc lengths [m] between which everything is smooth: base, tip, ends of tendons, borders of segments and strain."""
    length = rod_length(scene)
    ends = [end for tendon in scene.tendons for end in tendon_ends(scene, tendon)]
    places = [0.0]
    for place in sorted([*ends, *segment_borders(scene), *scene.strain.borders]):
        if place - places[-1] > SAME_PLACE * length and length - place > SAME_PLACE * length:  # from the last one that counts
            places.append(float(place))
    return np.array([*places, length])


def rod_radius(scene: Scene, arc_length: ArrayLike) -> tuple[Array, Array]:
    """Radius [m] and its slope d radius/dX [-] at arc lengths [m] from the rod's base, each (m,). Borders: see `segment_index`."""
    arc_length = np.atleast_1d(np.asarray(arc_length, dtype=float))
    index, starts = segment_index(scene, arc_length), segment_borders(scene)
    radius, slope = np.zeros((2, *arc_length.shape))
    for i, segment in enumerate(scene.segments):
        here = index == i
        if isinstance(segment.radius, RadiusProfile):
            radius[here], slope[here] = segment.radius.radius_and_slope(arc_length[here] - starts[i], segment.length)
        else:
            radius[here] = segment.radius
    return radius, slope


def tendon_offset(scene: Scene, tendon: Tendon, arc_length: ArrayLike) -> tuple[Array, Array]:
    """Offset (y, z) of a tendon from the axis [m] and its slope d/dX [-] at arc lengths [m], each (m, 2)."""
    arc_length = np.atleast_1d(np.asarray(arc_length, dtype=float))
    return tendon.routing.offset_and_slope(arc_length, *rod_radius(scene, arc_length), tendon_ends(scene, tendon))


def extrapolation_columns(scene: Scene) -> int:
    """Number of columns (order) of the extrapolated integrator, with a tolerance the most: the scene's, or what its damping allows.

    On undamped oscillations 2 columns are stable, and more grow by up to 0.95 % a step (stability function). A damping ratio of 0.0029 at
    omega h = 0.64 outweighs that. Where every segment has 0.01 there, 3 columns are chosen, or up to 6 with a tolerance; elsewhere 2.
    """
    if scene.integrator.columns is not None:
        return scene.integrator.columns
    omega = 0.64 / scene.integrator.step
    ratios = [1.5 * segment.damping * omega / segment.young_modulus for segment in scene.segments]  # Kelvin-Voigt, bending
    if min(ratios) < 0.01:
        return 2
    return 3 if scene.integrator.tolerance is None else MOST_COLUMNS


def _misfits(scene: Scene) -> Iterator[Problem]:
    length, least = rod_length(scene), LEAST_TOLERANCE * rod_length(scene)
    for i, tendon in enumerate(scene.tendons):
        start, end = tendon_ends(scene, tendon)
        if start >= length:
            yield Problem(("tendons", i, "start"), f"is {start}: it should be less than the rod's length, {length:g}")
        elif end > length * (1 + SAME_PLACE):
            yield Problem(("tendons", i, "end"), f"is {end}: it should be at most the rod's length, {length:g}")
        elif min(end, length) - start <= SHORTEST * length:  # no point of the rod might lie between its ends, see breakpoints()
            text = f"runs from {start} to {end}: it should cover more than {SHORTEST:g} of the rod's length, {length:g}"
            yield Problem(("tendons", i), text)
        elif misfit := tendon.routing.misfit((start, end)):
            yield Problem(("tendons", i, "routing"), misfit)
    if (away := max(map(abs, scene.base.position))) > (most := FARTHEST_BASE * length):
        text = f"is {shown(scene.base.position)}: coordinates should be within ±{most:g} m, {FARTHEST_BASE:g} lengths of the rod"
        yield Problem(("base", "position"), f"{text}{'; is it in mm?' if away < 1e3 * most else ''}")
    if (scene.integrator.tolerance or least) < least:
        text = f"is {scene.integrator.tolerance:g}: it should be at least {least:g} m, {LEAST_TOLERANCE:g} of the rod's length"
        yield Problem(("integrator", "tolerance"), text)
    for i, border in enumerate(scene.strain.borders):
        if border >= length:
            yield Problem(("strain", "borders", i), f"is {border}: it should be less than the rod's length, {length:g}")
