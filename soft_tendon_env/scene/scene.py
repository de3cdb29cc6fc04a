"""Scene: configuration of an arm, with its rod, tendons, strain parametrisation, quadrature,
integrator and effects.

SI units throughout. Every class raises `ConfigurationError` for unknown keys, wrong types and wrong
ranges.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field, field_validator, model_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.scene.routing import Ends, Routing, Size
from soft_tendon_env.scene.sections import PLACES, AnySection, Discs, Section, Stiffness, Tube
from soft_tendon_env.scene.strain import ExplicitStrain, StaticsBased
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    override,
    shown,
)
from soft_tendon_env.tools.types import (
    Array,
    Length,
    NotNegative,
    Positive,
    Quaternion,
    TimeStep,
    Triple,
)

GREATEST_TENSION = 1e9  # [N], of limits


def _is_range(limits: tuple[float, float]) -> tuple[float, float]:
    if not -GREATEST_TENSION <= limits[0] < limits[1] <= GREATEST_TENSION:
        raise ValueError(
            f"should be (least, greatest) with least < greatest, within ±{GREATEST_TENSION:g} N"
        )
    return limits


TensionLimits = Annotated[tuple[float, float], AfterValidator(_is_range)]
# share of the rod's length, error of a step that may be asked for: ten times what strains are good
# to
LEAST_TOLERANCE = 1e-11
SAME_PLACE = 1e-9  # share of the rod's length: arc lengths closer than this are one place
SHORTEST = 4 * SAME_PLACE  # share of the rod's length that a tendon covers at least
MOST_INTERVALS = 512  # quadrature intervals per piece of the rod
MOST_COLUMNS = 6  # of extrapolation: 16 evaluations a step
# lengths of the rod, largest coordinate of the base: beyond it float32 rounds observed positions by
# more than 1e-4
FARTHEST_BASE = 1e3
TIP_TOLERANCE = (
    2.5e-3  # share of the rod's length, displacement of the tip by quadrature that counts as small
)


Angle = Annotated[float, Field(ge=-360, le=360)]


class Base(Configuration):
    """Pose of the arm's base in the world, by default at its origin; the straight rod runs along
    the base's x axis."""

    position: Triple = (0.0, 0.0, 0.0)  # [m]
    quaternion: Quaternion = (
        1.0,
        0.0,
        0.0,
        0.0,
    )  # from the base's axes to the world's, (w, x, y, z)
    rotation: tuple[Angle, Angle, Angle] = (
        0.0,
        0.0,
        0.0,
    )  # further turn about the world's axes, a rotation vector [deg]

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the base: [[R, position], [0, 0, 0, 1]]."""
        turn, angle = np.radians(self.rotation), math.radians(math.hypot(*self.rotation))
        a, (b, c, d) = math.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * turn
        product = (
            np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
            @ self.quaternion
        )
        w, *v = product / math.hypot(*product)
        skew, pose = np.cross(np.eye(3), v), np.eye(4)
        pose[:3, :3] += 2.0 * (w * skew + skew @ skew)
        pose[:3, 3] = self.position
        return pose


class Segment(Configuration):
    """Segment of the rod with one material and one kind of section; segments follow each other from
    the base.

    It is a solid circle of a `radius`, or has another `section`: Tube, Rectangle, Ellipse, or
    Stiffness, which needs no material.
    """

    elsewhere: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("inner_radius", "outer_radius", "width", "height", "diameter"),
        'a solid circle has a radius, and a tube is written section = {type = "tube", radius ='
        " 0.005, inner_radius = 0.004} in its place, see soft_tendon_env.scene.sections",
    )

    length: Length  # [m]
    section: AnySection | None = None  # in place of radius
    young_modulus: Positive | None = Field(default=None, validate_default=True)  # [Pa]
    poisson_ratio: float | None = Field(
        default=None, gt=-1, le=0.5, validate_default=True
    )  # above -1, up to 0.5 (incompressible)
    density: Positive | None = Field(default=None, validate_default=True)  # [kg/m^3]
    damping: NotNegative | None = Field(
        default=None, validate_default=True
    )  # Kelvin-Voigt viscosity eta [Pa s]
    radius: Size | None = Field(
        default=None, validate_default=True
    )  # of a solid circle [m], a number or a LinearTaper or TaperTable
    curvature: Triple = (0.0, 0.0, 0.0)  # stress-free (torsion, bend_y, bend_z) [1/m]
    discs: Discs | None = None  # spacer discs

    @field_validator("young_modulus", "poisson_ratio", "density", "damping", "radius")
    @classmethod
    def _said_once(cls, value: Any, info: ValidationInfo) -> Any:
        section: Any = info.data.get("section")
        instead = isinstance(section, Section if info.field_name == "radius" else Stiffness)
        if instead and value is not None:
            raise ValueError(
                f"should be left out: the section, of type {section.type!r}, takes its place"
            )
        if not instead and value is None and "section" in info.data:
            or_section = ", or a section" if info.field_name == "radius" else ""
            raise ConfigurationError([Problem((), f"is missing: it is required{or_section}")])
        return value

    @model_validator(mode="after")
    def _parts_fit_its_length(self) -> Self:
        place: tuple[str, ...] = () if self.section is None else ("section",)
        problems = [Problem((*place, *key), text) for key, text in self.shape.misfits(self.length)]
        if self.discs is not None and not problems:
            places = self.discs.rows(self.length)[:, 0]
            widest = self.shape.outer_radius(places, self.length)[0].max()
            if places.max() > self.length * (1 + SAME_PLACE):
                problems.append(
                    Problem(
                        ("discs", "places"),
                        f"go to {places.max():g}: they should be at most the length,"
                        f" {self.length:g}",
                    )
                )
            elif self.discs.radius <= widest:
                text = (
                    f"is {self.discs.radius:g}: it should be greater than that of the rod there,"
                    f" {widest:g}"
                )
                problems.append(Problem(("discs", "radius"), text))
        if problems:
            raise ConfigurationError(problems)
        return self

    @property
    def shape(self) -> Section:
        """Its section: a circle is a tube without a hole."""
        return (
            Tube.model_construct(radius=self.radius, inner_radius=0.0)
            if self.section is None
            else self.section
        )  # type: ignore[arg-type]

    def screw_matrices(self, arc_length: Array) -> Array:
        """Diagonals (3, 6, m) of Sigma, Upsilon and the screw inertia per length at arc lengths
        (m,) [m] from its start."""
        return self.shape.screw_matrices(
            arc_length,
            self.length,
            self.young_modulus,
            self.poisson_ratio,
            self.density,
            self.damping,
        )


class Tendon(Configuration):
    """Tendon (threadlike actuator) that acts between two arc lengths of the rod. Positive tension
    pulls."""

    # its offset from the axis along the rod: StraightRouting, ConvergingRouting, SurfaceRouting,
    # ...
    routing: Routing
    start: NotNegative = 0.0  # arc length [m]
    end: Positive | None = None  # arc length [m]; None: the rod's tip
    tension_limits: TensionLimits = (
        0.0,
        50.0,
    )  # (least, greatest) [N] of the actuator; a negative least allows it to push

    @field_validator("end")
    @classmethod
    def _after_start(cls, end: float | None, info: ValidationInfo) -> float | None:
        if end is not None and end <= info.data.get("start", 0.0):
            raise ValueError(f"should be greater than start, {info.data['start']:g}")
        return end


class Quadrature(Configuration):
    """Quadrature along the rod: Magnus intervals (fourth order, two Gauss points each) per piece
    between neighbouring `breakpoints`."""

    intervals: int | None = Field(
        default=None, ge=1, le=MOST_INTERVALS
    )  # None: `least`, or as many as the scene needs for `tolerance`
    # by which the tip may be off at rest under tensions within limits, as a share of the rod's
    # length
    tolerance: Positive = TIP_TOLERANCE
    least: int = Field(
        default=6, ge=1, le=MOST_INTERVALS
    )  # fewest intervals where the scene needs fewer


class Integrator(Configuration):
    """Time integration: linearly implicit Euler, extrapolated, with steps of `step` [s].

    The order is the number of `columns` of the extrapolation (None: see `extrapolation_columns`); k
    columns cost 1 + k (k - 1) / 2 evaluations. A step that fails is halved up to `max_halvings`
    times.

    With a `tolerance` [m] the order adapts, and then the step. Each step begins with 2 columns and
    adds one at a time, up to `columns`, until its estimated error is below the tolerance: the root
    mean square displacement of the rod. If that fails, the step is shortened.
    """

    step: TimeStep = 0.02
    columns: int | None = Field(default=None, ge=1, le=MOST_COLUMNS)
    tolerance: Annotated[float, Field(gt=0)] | None = None
    max_halvings: int = Field(default=10, ge=0, le=20)
    quasi_static: bool = (
        False  # leaves inertia out: damping and elasticity alone balance tensions and loads
    )

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
        """Copy of the scene with dotted keys set, `{"segments.*.density": 5.0}`; same checks.
        Raises `ConfigurationError`."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        heads = (
            {re.split(r"[.\[]", key)[0] for key in changes if isinstance(key, str)}
            if isinstance(changes, Mapping)
            else set()
        )
        values |= scene_to_dict(
            self, heads & {*values}
        )  # what is not changed need not be checked again
        override(values, changes)
        return Scene.parse(values, "scene")

    def __repr__(self) -> str:
        counts = [
            f"{len(parts)} {name}{'s' * (len(parts) > 1)}"
            for name, parts in (("segment", self.segments), ("tendon", self.tendons))
        ]
        parts = [repr(self.name), f"{rod_length(self):g} m", *counts, *self.effects.chosen()]
        return f"Scene({', '.join(parts)})"

    @model_validator(mode="after")
    def _parts_fit_the_rod(self) -> Self:
        if problems := list(_misfits(self)):
            raise ConfigurationError(problems)
        return self


def scene_to_dict(scene: Scene, tables: set[str] | None = None) -> dict[str, Any]:
    """Scene, or these tables of it, as plain tables fit for JSON and TOML; absent (None) entries
    are left out."""
    return scene.model_dump(mode="json", exclude_none=True, include=tables)


def rod_length(scene: Scene) -> float:
    """Length of the rod [m]."""
    return float(segment_borders(scene)[-1])


def segment_borders(scene: Scene) -> Array:
    """Arc lengths [m] where segments begin, and the tip: (segments + 1,)."""
    return np.cumsum([0.0, *(segment.length for segment in scene.segments)])


def segment_index(scene: Scene, arc_length: ArrayLike) -> NDArray[np.intp]:
    """Index of the segment that each arc length [m] lies in. A border belongs to the segment that
    begins there, the tip to the last."""
    return np.searchsorted(segment_borders(scene)[1:-1], arc_length, side="right")


def tendon_ends(scene: Scene, tendon: Tendon) -> Ends:
    """First and last arc length [m] of a tendon."""
    return tendon.start, rod_length(scene) if tendon.end is None else tendon.end


def breakpoints(scene: Scene) -> Array:
    """Sorted unique arc lengths [m] between which everything is smooth: base, tip, ends of tendons,
    borders of segments and strain."""
    length = rod_length(scene)
    ends = [end for tendon in scene.tendons for end in tendon_ends(scene, tendon)]
    places = [0.0]
    for place in sorted([*ends, *segment_borders(scene), *scene.strain.borders]):
        if (
            place - places[-1] > SAME_PLACE * length and length - place > SAME_PLACE * length
        ):  # from the last one that counts
            places.append(float(place))
    return np.array([*places, length])


def along_rod(
    scene: Scene, arc_length: ArrayLike, values: Callable[[Segment, Array], ArrayLike]
) -> Array:
    """Values (k, m) of the segments at arc lengths [m] from the start of each, put together at
    those (..) from the rod's base: (k, ..)."""
    arc_length = np.atleast_1d(np.asarray(arc_length, dtype=float))
    index, starts = segment_index(scene, arc_length), segment_borders(scene)
    parts = [
        (index == i, values(segment, arc_length[index == i] - starts[i]))
        for i, segment in enumerate(scene.segments)
    ]
    found = np.empty((len(np.asarray(parts[0][1])), *arc_length.shape))
    for here, part in parts:
        found[:, here] = part
    return found


def rod_radius(scene: Scene, arc_length: ArrayLike) -> tuple[Array, Array]:
    """Outer radius [m] and its slope d radius/dX [-] at arc lengths [m] from the rod's base, each
    (m,). Borders: see `segment_index`."""
    radius, slope = along_rod(
        scene,
        arc_length,
        lambda segment, places: segment.shape.outer_radius(places, segment.length),
    )
    return radius, slope


def disc_rows(scene: Scene) -> Array:
    """Arc length [m], mass [kg], radius and thickness [m], 0 for thin ones, of every spacer disc:
    (d, 4)."""
    parts = zip(scene.segments, segment_borders(scene), strict=False)
    rows = [
        segment.discs.rows(segment.length) + [start, 0.0, 0.0, 0.0]
        for segment, start in parts
        if segment.discs is not None
    ]
    return np.concatenate([np.zeros((0, 4)), *rows])


def tendon_offset(scene: Scene, tendon: Tendon, arc_length: ArrayLike) -> tuple[Array, Array]:
    """Offset (y, z) of a tendon from the axis [m] and its slope d/dX [-] at arc lengths [m], each
    (m, 2)."""
    arc_length = np.atleast_1d(np.asarray(arc_length, dtype=float))
    return tendon.routing.offset_and_slope(
        arc_length, *rod_radius(scene, arc_length), tendon_ends(scene, tendon)
    )


def extrapolation_columns(scene: Scene) -> int:
    """Number of columns (order) of the extrapolated integrator, with a tolerance the most: the
    scene's, or what its damping allows.

    On undamped oscillations 2 columns are stable, and more grow by up to 0.95 % a step (stability
    function). A damping ratio of 0.0029 at omega h = 0.64 outweighs that. Where every segment has
    0.01 there, 3 columns are chosen, or up to 6 with a tolerance; elsewhere 2.
    """
    if scene.integrator.columns is not None:
        return scene.integrator.columns
    omega = 0.64 / scene.integrator.step
    parts = [segment.screw_matrices(np.zeros(1))[:2, 1, 0] for segment in scene.segments]
    ratios = [0.5 * omega * damping / stiffness for stiffness, damping in parts]  # in bending
    if min(ratios) < 0.01:
        return 2
    return 3 if scene.integrator.tolerance is None else MOST_COLUMNS


def _misfits(scene: Scene) -> Iterator[Problem]:
    length, least = rod_length(scene), LEAST_TOLERANCE * rod_length(scene)
    for i, tendon in enumerate(scene.tendons):
        start, end = tendon_ends(scene, tendon)
        if start >= length:
            yield Problem(
                ("tendons", i, "start"),
                f"is {start}: it should be less than the rod's length, {length:g}",
            )
        elif end > length * (1 + SAME_PLACE):
            yield Problem(
                ("tendons", i, "end"),
                f"is {end}: it should be at most the rod's length, {length:g}",
            )
        elif (
            min(end, length) - start <= SHORTEST * length
        ):  # no point of the rod might lie between its ends, see breakpoints()
            text = (
                f"runs from {start} to {end}: it should cover more than {SHORTEST:g} of the rod's"
                f" length, {length:g}"
            )
            yield Problem(("tendons", i), text)
        elif misfit := tendon.routing.misfit((start, end)):
            yield Problem(("tendons", i, "routing"), misfit)
    if (away := max(map(abs, scene.base.position))) > (most := FARTHEST_BASE * length):
        text = (
            f"is {shown(scene.base.position)}: coordinates should be within ±{most:g} m,"
            f" {FARTHEST_BASE:g} lengths of the rod"
        )
        yield Problem(
            ("base", "position"), f"{text}{'; is it in mm?' if away < 1e3 * most else ''}"
        )
    if (scene.integrator.tolerance or least) < least:
        text = (
            f"is {scene.integrator.tolerance:g}: it should be at least {least:g} m,"
            f" {LEAST_TOLERANCE:g} of the rod's length"
        )
        yield Problem(("integrator", "tolerance"), text)
    for i, border in enumerate(scene.strain.borders):
        if border >= length:
            yield Problem(
                ("strain", "borders", i),
                f"is {border}: it should be less than the rod's length, {length:g}",
            )
    law = scene.effects.nonlinear_elasticity
    for i, segment in enumerate(scene.segments):
        if law is not None and law.bending is not None:
            about_y, about_z = segment.screw_matrices(segment.length * PLACES)[0, 1:3]
            if np.abs(about_y - about_z).max() > 1e-9 * about_y.max():
                text = (
                    "has one e0 for both curvatures: it needs sections that bend alike about y and"
                    " z, and that of segments"
                )
                yield Problem(
                    ("effects", "nonlinear_elasticity", "bending"), f"{text}[{i}] does not"
                )
        if (
            scene.effects.fluid is not None
            and segment.discs is not None
            and segment.discs.thickness is None
        ):
            yield Problem(
                ("segments", i, "discs", "thickness"), "is missing: in a fluid it is required"
            )
