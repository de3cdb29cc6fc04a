"""Scene: configuration of an arm, its rod, tendons, solver settings and effects.

SI units throughout. Every class raises `ConfigurationError` for unknown keys, wrong types and wrong
ranges.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field, field_validator, model_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.scene.routing import Ends, Routing, Size
from soft_tendon_env.scene.sections import PLACES, AnySection, Discs, Section, Tube
from soft_tendon_env.scene.strain import STRAINS, AnyStrain, StaticsBased
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
    least, greatest = limits
    if not -GREATEST_TENSION <= least < greatest <= GREATEST_TENSION:
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
# of extrapolation
MOST_COLUMNS = 6  # 16 evaluations a step
SAFE_COLUMNS = 2  # which no motion makes unstable, damped or not
DAMPED_COLUMNS = 3  # of an arm whose damping outweighs how more columns than 2 grow
GROWTH_ANGLE = 0.64  # omega h at which they grow most, for an undamped oscillation
ENOUGH_DAMPING = 0.01  # damping ratio there that outweighs it: 0.0029 would
# lengths of the rod, largest coordinate of the base: beyond it float32 rounds observed positions by
# more than 1e-4
FARTHEST_BASE = 1e3
# share of the rod's length, displacement of the tip by quadrature that counts as small
TIP_TOLERANCE = 2.5e-3
ALIKE = 1e-9  # relative difference of the bending stiffnesses about y and z: of round-off


Angle = Annotated[float, Field(ge=-360, le=360)]


class Base(Configuration):
    """Pose of the arm's base in the world, by default at its origin.

    The straight rod runs along the base's x axis.
    """

    position: Triple = (0.0, 0.0, 0.0)  # of the base in the world [m]
    # from the base's axes to the world's, (w, x, y, z)
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    # further turn about the world's axes, a rotation vector [deg]
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the base: [[R, position], [0, 0, 0, 1]]."""
        # quaternion (a, b, c, d) of the further turn: cos and sin of half of the angle
        turn = np.radians(self.rotation)
        rotation_degrees = math.hypot(*self.rotation)
        angle = math.radians(rotation_degrees)
        half = 0.5 * angle
        a = math.cos(half)
        # sin(angle / 2) / angle, also where the angle is 0
        sinc = np.sinc(half / np.pi)
        share = 0.5 * sinc
        b, c, d = share * turn
        left_product = np.array(
            [
                [a, -b, -c, -d],
                [b, a, -d, c],
                [c, d, a, -b],
                [d, -c, b, a],
            ]
        )
        product = left_product @ self.quaternion
        # quaternions are given with a few digits
        size = math.hypot(*product)
        w, *v = product / size
        # rotation matrix of a unit quaternion: R = I + 2 (w v~ + v~ v~)
        identity = np.eye(3)
        skew = np.cross(identity, v)
        pose = np.eye(4)
        half_change = w * skew + skew @ skew
        pose[:3, :3] += 2.0 * half_change
        pose[:3, 3] = self.position
        return pose


class Segment(Configuration):
    """Segment of the rod with one material and one kind of section.

    Segments follow each other from the base.

    It is a solid circle of a `radius`, or has another `section`: Tube, Rectangle, Ellipse, one of
    the user's own, or Stiffness, which needs no material.
    """

    elsewhere: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("inner_radius", "outer_radius", "width", "height", "diameter"),
        'a solid circle has a radius, and a tube is written section = {type = "tube", radius ='
        " 0.005, inner_radius = 0.004} in its place, see soft_tendon_env.scene.sections",
    )

    length: Length  # along the axis [m]
    section: AnySection | None = None  # in place of a radius, with its `type`
    # of the material [Pa]
    young_modulus: Positive | None = Field(default=None, validate_default=True)
    # of the material, above -1, up to 0.5 (incompressible)
    poisson_ratio: float | None = Field(default=None, gt=-1, le=0.5, validate_default=True)
    # of the material [kg/m^3]
    density: Positive | None = Field(default=None, validate_default=True)
    # Kelvin-Voigt viscosity eta [Pa s]
    damping: NotNegative | None = Field(default=None, validate_default=True)
    # of a solid circle [m]
    radius: Size | None = Field(default=None, validate_default=True)
    curvature: Triple = (0.0, 0.0, 0.0)  # stress-free (torsion, bend_y, bend_z) [1/m]
    discs: Discs | None = None  # spacer discs on the segment

    @field_validator("young_modulus", "poisson_ratio", "density", "damping", "radius")
    @classmethod
    def _said_once(cls, value: Any, info: ValidationInfo) -> Any:
        section: Any = info.data.get("section")
        is_radius = info.field_name == "radius"
        # every section has its own size, and some their own material
        takes_its_place = section is not None and (is_radius or not section.has_material)
        if takes_its_place and value is not None:
            raise ValueError(
                f"should be left out: the section, of type {section.type!r}, takes its place"
            )
        # a section that is wrong is missing here: its own error is enough
        is_section_known = "section" in info.data
        if not takes_its_place and value is None and is_section_known:
            if is_radius:
                or_section = ", or a section"
            else:
                or_section = ""
            raise ConfigurationError([Problem((), f"is missing: it is required{or_section}")])
        return value

    @model_validator(mode="after")
    def _parts_fit_its_length(self) -> Self:
        # where the section is a table of its own, problems are of its keys
        place: tuple[str, ...] = ()
        if self.section is not None:
            place = ("section",)
        problems = []
        for key, text in self.shape.misfits(self.length):
            whole_key = (*place, *key)
            problems.append(Problem(whole_key, text))
        if self.discs is not None and not problems:
            problems = self._disc_problems(self.discs)
        if problems:
            raise ConfigurationError(problems)
        return self

    def _disc_problems(self, discs: Discs) -> list[Problem]:
        """Problem of discs that are beyond the segment, or inside of the rod."""
        rows = discs.rows(self.length)
        places = rows[:, 0]
        last = places.max()
        end = self.length * (1 + SAME_PLACE)
        if last > end:
            text = f"go to {last:g}: they should be at most the length, {self.length:g}"
            return [Problem(("discs", "places"), text)]
        radius, _ = self.shape.outer_radius(places, self.length)
        widest = radius.max()
        if discs.radius <= widest:
            text = (
                f"is {discs.radius:g}: it should be greater than that of the rod there, {widest:g}"
            )
            return [Problem(("discs", "radius"), text)]
        return []

    @property
    def shape(self) -> Section:
        """Its section: a circle is a tube without a hole."""
        if self.section is not None:
            return self.section
        # the validators saw to it that there is a radius
        return Tube.model_construct(radius=self.radius, inner_radius=0.0)  # type: ignore[arg-type]

    def screw_matrices(self, arc_length: Array) -> Array:
        """Computes the diagonals of stiffness, viscosity and inertia per length along the segment.

        Args:
            arc_length: (m,) [m] from its start.

        Returns:
            Sigma, Upsilon and the screw inertia per length, (3, 6, m).
        """
        return self.shape.screw_matrices(
            arc_length,
            self.length,
            self.young_modulus,
            self.poisson_ratio,
            self.density,
            self.damping,
        )


class Tendon(Configuration):
    """Tendon (threadlike actuator) that acts between two arc lengths of the rod.

    Positive tension pulls.
    """

    routing: Routing  # its offset from the axis along the rod, with its `type`
    start: NotNegative = 0.0  # arc length [m] where it enters the rod
    end: Positive | None = None  # arc length [m] where it is fixed; None: the rod's tip
    # (least, greatest) [N] of the actuator; a negative least allows it to push
    tension_limits: TensionLimits = (0.0, 50.0)

    @field_validator("end")
    @classmethod
    def _after_start(cls, end: float | None, info: ValidationInfo) -> float | None:
        start = info.data.get("start", 0.0)
        if end is not None and end <= start:
            raise ValueError(f"should be greater than start, {start:g}")
        return end


class Quadrature(Configuration):
    """Quadrature along the rod by Magnus intervals.

    They are of fourth order, with two Gauss points each; their number counts per piece between
    neighbouring `breakpoints`.
    """

    # Magnus intervals of each piece; None: `least`, or as many as the scene needs for
    # `tolerance`
    intervals: int | None = Field(default=None, ge=1, le=MOST_INTERVALS)
    # by which the tip may be off at rest under tensions within limits, as a share of the rod's
    # length
    tolerance: Positive = TIP_TOLERANCE
    # fewest intervals where the scene needs fewer
    least: int = Field(default=6, ge=1, le=MOST_INTERVALS)


class Integrator(Configuration):
    """Time integration: linearly implicit Euler, extrapolated, with steps of `step` [s].

    The order is the number of `columns` of the extrapolation (None: see `extrapolation_columns`); k
    columns cost 1 + k (k - 1) / 2 evaluations. A step that fails is halved up to `max_halvings`
    times.

    With a `tolerance` [m] the order adapts, and then the step. Each step begins with 2 columns and
    adds one at a time, up to `columns`, until its estimated error is below the tolerance: the root
    mean square displacement of the rod. If that fails, the step is shortened.
    """

    step: TimeStep = 0.02  # longest step [s]
    # columns of the extrapolation, which are its order; None: as many as the damping allows
    columns: int | None = Field(default=None, ge=1, le=MOST_COLUMNS)
    # error of a step that is allowed [m]; None: the order is fixed
    tolerance: Annotated[float, Field(gt=0)] | None = None
    # times by which a step that fails is halved
    max_halvings: int = Field(default=10, ge=0, le=20)
    # leaves inertia out: damping and elasticity alone balance tensions and loads
    quasi_static: bool = False

    @field_validator("tolerance")
    @classmethod
    def _has_an_estimate(cls, tolerance: float | None, info: ValidationInfo) -> float | None:
        if tolerance is not None and info.data.get("columns") == 1:
            raise ValueError("needs the error estimate of at least 2 columns")
        return tolerance


class Scene(Configuration):
    """Scene of one arm: everything that a user writes, in SI units (angles in degrees)."""

    name: str = Field(min_length=1)  # of the arm, in titles and messages
    description: str = ""  # one sentence, which `soft-tendon scenes` lists
    segments: tuple[Segment, ...] = Field(min_length=1)  # parts of the rod, from the base on
    tendons: tuple[Tendon, ...] = Field(min_length=1)  # in the order of the tensions
    base: Base = Base()  # pose of the rod's base in the world frame
    strain: AnyStrain = StaticsBased()  # strain parametrisation: what the coordinates are
    quadrature: Quadrature = Quadrature()  # intervals along the rod
    integrator: Integrator = Integrator()  # time integration
    effects: Effects = Effects()  # loads, contact, actuators: a table for each

    def replace(self, changes: Mapping[str, Any]) -> "Scene":
        """Returns a copy of the scene with other values, with the same checks.

        Args:
            changes: values by dotted keys, `{"segments.*.density": 5.0}`.

        Returns:
            The scene.

        Raises:
            ConfigurationError: for keys and values that are not allowed.
        """
        values = {name: getattr(self, name) for name in type(self).model_fields}
        changed_tables = set[str]()
        if isinstance(changes, Mapping):  # if not, `override` says so
            for key in changes:
                if isinstance(key, str):
                    table, *_ = re.split(r"[.\[]", key)
                    changed_tables.add(table)
        # what is not changed need not be checked again, and stays as it is
        known_tables = changed_tables.intersection(values)
        values |= scene_to_dict(self, known_tables)
        override(values, changes)
        return Scene.parse(values, "scene")

    def __repr__(self) -> str:
        parts = [
            repr(self.name),
            f"{rod_length(self):g} m",
            _count("segment", self.segments),
            _count("tendon", self.tendons),
            *self.effects.chosen(),
        ]
        return f"Scene({', '.join(parts)})"

    @model_validator(mode="after")
    def _parts_fit_the_rod(self) -> Self:
        problems = list(_misfits(self))
        if problems:
            raise ConfigurationError(problems)
        return self


def _count(name: str, parts: Sequence[Any]) -> str:
    """Number of parts, with their name in singular or plural."""
    if len(parts) == 1:
        ending = ""
    else:
        ending = "s"
    return f"{len(parts)} {name}{ending}"


def scene_to_dict(scene: Scene, tables: set[str] | None = None) -> dict[str, Any]:
    """Converts a scene to plain tables fit for JSON and TOML.

    Args:
        scene: to convert.
        tables: names of those to convert, None: all.

    Returns:
        The tables without absent (None) entries.
    """
    return scene.model_dump(mode="json", exclude_none=True, include=tables)


def rod_length(scene: Scene) -> float:
    """Returns the length of the rod.

    Args:
        scene: of the arm.

    Returns:
        Length of its segments together [m].
    """
    return float(segment_borders(scene)[-1])


def segment_borders(scene: Scene) -> Array:
    """Arc lengths [m] where segments begin, and the tip: (segments + 1,)."""
    lengths = (segment.length for segment in scene.segments)
    return np.cumsum([0.0, *lengths])


def segment_index(scene: Scene, arc_length: ArrayLike) -> NDArray[np.intp]:
    """Index of the segment that each arc length [m] lies in.

    A border belongs to the segment that begins there, the tip to the last.
    """
    inner_borders = segment_borders(scene)[1:-1]
    return np.searchsorted(inner_borders, arc_length, side="right")


def tendon_ends(scene: Scene, tendon: Tendon) -> Ends:
    """First and last arc length [m] of a tendon."""
    if tendon.end is None:
        end = rod_length(scene)
    else:
        end = tendon.end
    return tendon.start, end


def breakpoints(scene: Scene) -> Array:
    """Sorted unique arc lengths [m] between which everything is smooth.

    They are base, tip, ends of tendons, borders of segments and strain.
    """
    length = rod_length(scene)
    apart = SAME_PLACE * length
    borders = [*segment_borders(scene), *scene.strain.borders]
    for tendon in scene.tendons:
        borders += tendon_ends(scene, tendon)
    places = [0.0]
    for place in sorted(borders):
        from_last = place - places[-1]
        to_tip = length - place
        if from_last > apart and to_tip > apart:
            places.append(float(place))
    return np.array([*places, length])


def along_rod(
    scene: Scene, arc_length: ArrayLike, values: Callable[[Segment, Array], ArrayLike]
) -> Array:
    """Values of the segments put together along the rod.

    Args:
        scene: of the rod.
        arc_length: (...) [m] from the rod's base.
        values: of a segment, (k, m) at arc lengths (m,) [m] from its start.

    Returns:
        The values (k, ...).
    """
    arc_length = np.atleast_1d(np.asarray(arc_length, dtype=float))
    index = segment_index(scene, arc_length)
    starts = segment_borders(scene)
    parts = list[tuple[Array, Array]]()  # where a segment is, and its values there
    for i, segment in enumerate(scene.segments):
        is_inside = index == i
        from_start = arc_length[is_inside] - starts[i]
        own_values = np.asarray(values(segment, from_start))
        parts.append((is_inside, own_values))
    _, first_values = parts[0]
    count = len(first_values)
    shape = (count, *arc_length.shape)
    together = np.empty(shape)
    for is_inside, part in parts:
        together[:, is_inside] = part
    return together


def rod_radius(scene: Scene, arc_length: ArrayLike) -> tuple[Array, Array]:
    """Computes the outer radius of the rod and its slope at arc lengths.

    Borders: see `segment_index`.

    Args:
        scene: of the arm.
        arc_length: (m,) [m] from the rod's base.

    Returns:
        Radius [m], and its slope d radius/dX [-], each (m,).
    """
    radius, slope = along_rod(
        scene,
        arc_length,
        lambda segment, places: segment.shape.outer_radius(places, segment.length),
    )
    return radius, slope


def disc_rows(scene: Scene) -> Array:
    """Arc length [m], mass [kg], radius and thickness [m] of every spacer disc: (d, 4).

    The thickness is 0 for thin ones.
    """
    starts = segment_borders(scene)[:-1]
    no_row = np.zeros((0, 4))
    rows = [no_row]
    for segment, start in zip(scene.segments, starts, strict=True):
        if segment.discs is not None:
            own_rows = segment.discs.rows(segment.length)
            from_base = np.array([start, 0.0, 0.0, 0.0])
            rows.append(own_rows + from_base)
    return np.concatenate(rows)


def tendon_offset(scene: Scene, tendon: Tendon, arc_length: ArrayLike) -> tuple[Array, Array]:
    """Computes the offset of a tendon from the axis and its slope at arc lengths.

    Args:
        scene: of the arm.
        tendon: of the scene.
        arc_length: (m,) [m] from the rod's base.

    Returns:
        Offset (y, z) [m], and its slope d/dX [-], each (m, 2).
    """
    arc_length = np.atleast_1d(np.asarray(arc_length, dtype=float))
    direction = tendon.routing.direction
    if direction is None:
        radius, radius_slope = rod_radius(scene, arc_length)
    else:
        radius, radius_slope = along_rod(
            scene,
            arc_length,
            lambda segment, places: segment.shape.outline_radius(direction, places, segment.length),
        )
    ends = tendon_ends(scene, tendon)
    return tendon.routing.offset_and_slope(arc_length, radius, radius_slope, ends)


def extrapolation_columns(scene: Scene) -> int:
    """Number of columns (order) of the extrapolated integrator, with a tolerance the most.

    It is the scene's, or what its damping allows.

    On undamped oscillations 2 columns are stable, and more grow by up to 0.95 % a step (stability
    function). A damping ratio of 0.0029 at omega h = 0.64 outweighs that. Where every strain of
    every segment has 0.01 there, 3 columns are chosen, or up to 6 with a tolerance; elsewhere 2.
    """
    integrator = scene.integrator
    if integrator.columns is not None:
        return integrator.columns
    omega = GROWTH_ANGLE / integrator.step
    free = [STRAINS.index(strain) for strain in scene.strain.free]
    start = np.zeros(1)
    ratios = list[float]()
    for segment in scene.segments:
        # at the segment's start: Kelvin and Voigt's times are the same all along a segment, but of
        # torsion and shear others than of bending
        matrices = segment.screw_matrices(start)
        elasticity, viscosity, _ = matrices[..., 0]
        retardation = viscosity[free] / elasticity[free]
        shortest = float(retardation.min())
        ratios.append(0.5 * omega * shortest)
    if min(ratios) < ENOUGH_DAMPING:
        return SAFE_COLUMNS
    if integrator.tolerance is None:
        return DAMPED_COLUMNS
    return MOST_COLUMNS


def _misfits(scene: Scene) -> Iterator[Problem]:
    """Problems of parts that do not fit each other."""
    for i, tendon in enumerate(scene.tendons):
        yield from _tendon_misfits(scene, tendon, i)
    yield from _base_misfits(scene)
    length = rod_length(scene)
    tolerance = scene.integrator.tolerance
    least = LEAST_TOLERANCE * length
    if tolerance is not None and tolerance < least:
        text = (
            f"is {tolerance:g}: it should be at least {least:g} m, {LEAST_TOLERANCE:g} of the rod's"
            " length"
        )
        yield Problem(("integrator", "tolerance"), text)
    for i, border in enumerate(scene.strain.borders):
        if border >= length:
            text = f"is {border}: it should be less than the rod's length, {length:g}"
            yield Problem(("strain", "borders", i), text)
    for i, segment in enumerate(scene.segments):
        yield from _effect_misfits(scene, segment, i)


def _tendon_misfits(scene: Scene, tendon: Tendon, i: int) -> Iterator[Problem]:
    """Problem of tendon i beside the rod."""
    length = rod_length(scene)
    start, end = tendon_ends(scene, tendon)
    key = ("tendons", i)
    if start >= length:
        text = f"is {start}: it should be less than the rod's length, {length:g}"
        yield Problem((*key, "start"), text)
        return
    if end > length * (1 + SAME_PLACE):
        text = f"is {end}: it should be at most the rod's length, {length:g}"
        yield Problem((*key, "end"), text)
        return
    # no point of the rod might lie between ends that are closer, see breakpoints()
    piece_length = min(end, length) - start
    if piece_length <= SHORTEST * length:
        text = (
            f"runs from {start} to {end}: it should cover more than {SHORTEST:g} of the rod's"
            f" length, {length:g}"
        )
        yield Problem(key, text)
        return
    misfit = tendon.routing.misfit((start, end))
    if misfit:
        yield Problem((*key, "routing"), misfit)


def _base_misfits(scene: Scene) -> Iterator[Problem]:
    """Problem of a base that is too far from the world's origin."""
    position = scene.base.position
    distance = max(map(abs, position))
    most = FARTHEST_BASE * rod_length(scene)
    if distance > most:
        # a position in mm is a thousand times too large
        if distance < 1e3 * most:
            hint = "; is it in mm?"
        else:
            hint = ""
        text = (
            f"is {shown(position)}: coordinates should be within ±{most:g} m, {FARTHEST_BASE:g}"
            f" lengths of the rod{hint}"
        )
        yield Problem(("base", "position"), text)


def _effect_misfits(scene: Scene, segment: Segment, i: int) -> Iterator[Problem]:
    """Problems of segment i with the effects."""
    law = scene.effects.nonlinear_elasticity
    if law is not None and law.bending is not None:
        places = segment.length * PLACES
        elasticity = segment.screw_matrices(places)[0]
        about_y, about_z = elasticity[1:3]
        difference = np.abs(about_y - about_z)
        slack = ALIKE * about_y.max()
        if difference.max() > slack:
            text = (
                "has one e0 for both curvatures: it needs sections that bend alike about y and z,"
                f" and that of segments[{i}] does not"
            )
            yield Problem(("effects", "nonlinear_elasticity", "bending"), text)
    discs = segment.discs
    lacks_thickness = discs is not None and discs.thickness is None
    if scene.effects.fluid is not None and lacks_thickness:
        yield Problem(
            ("segments", i, "discs", "thickness"), "is missing: in a fluid it is required"
        )
