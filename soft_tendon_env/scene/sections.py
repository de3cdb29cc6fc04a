"""Cross-sections of a segment, their integrals and outer shape at arc lengths; spacer discs.

Sections give stiffness, damping and inertia per length.

y and z are principal axes, and the rod's axis runs through the centroid. With the area A, the
second moments Iy = int z^2 dA and Iz = int y^2 dA, and Saint-Venant's torsion constant J (S. P.
Timoshenko and J. N. Goodier, Theory of Elasticity, 1970, chapter 10):

- elasticity Sigma = diag(G J, E Iy, E Iz, E A, k G A, k G A),
- viscosity Upsilon = eta diag(J, 3 Iy, 3 Iz, 3 A, k A, k A), and
- inertia per length rho diag(Iy + Iz, Iy, Iz, A, A, A).

The shear correction factor k is 1 unless a section says otherwise: a solid circle has none, and a
tube without a hole is one. A section is a class under `@register("section", "name")`, here or in a
user's own file as `examples/own_section.py`.
"""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny, field_validator
from pydantic_core.core_schema import ValidationInfo

from soft_tendon_env.scene.routing import Size, Taper
from soft_tendon_env.tools.configuration import Configuration, Problem
from soft_tendon_env.tools.registry import TableRegistry, register
from soft_tendon_env.tools.types import Array, Length, NotNegative, Positive

# viscosity of the six strains in eta, (6, 1): 3 along the rod (Trouton's ratio)
VISCOUS = np.array([[1.0], [3.0], [3.0], [3.0], [1.0], [1.0]])
# n of the series of a rectangle's torsion, (4, 1): what the others add is less than round-off
ODD = np.array([[1.0], [3.0], [5.0], [7.0]])
ZETA_OF_5 = 1.0369277551433699  # Riemann's zeta function, the sum of 1 / n^5 over all n
SUM_OF_ODD = 31.0 / 32.0 * ZETA_OF_5  # of 1 / n^5 over all odd n
THINNEST = 1e-6  # wall of a tube in radii, with six digits of the difference of fourth powers left
PLACES = np.linspace(0.0, 1.0, 65)  # along a segment, in lengths, at which what varies is compared


class Section(Configuration):
    """Base of the cross-sections.

    Its `sizes` are numbers or tapers; round on the outside, with the first of them as radius.

    Arc lengths (m,) [m] count from the start of the segment, which has a `length` [m].

    Attributes:
        sizes: names of the fields that are sizes.
        has_material: whether it is of one material, whose numbers the segment has then.
        has_corners: whether the outline is the rectangle of its widths, else it is their ellipse.
    """

    sizes: ClassVar[tuple[str, ...]] = ("radius",)
    has_material: ClassVar[bool] = True
    has_corners: ClassVar[bool] = False

    @abstractmethod
    def screw_matrices(self, arc_length: Array, length: float, *material: Any) -> Array:
        """Computes the diagonals of stiffness, viscosity and inertia per length.

        Args:
            arc_length: (m,) [m].
            length: of the segment [m].
            material: Young's modulus [Pa], Poisson's ratio, density [kg/m^3] and viscosity [Pa s],
                where it is of one.

        Returns:
            Sigma [N m^2, N], Upsilon and the screw inertia per length [kg m, kg/m], (3, 6, m).
        """

    def tapers(self) -> dict[str, Taper]:
        """Returns those of the sizes that vary.

        Returns:
            Tapers by name of the size.
        """
        tapers = {}
        for name in self.sizes:
            size = getattr(self, name)
            if isinstance(size, Taper):
                tapers[name] = size
        return tapers

    def at(self, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Computes the sizes at arc lengths, and their derivatives along the rod.

        Args:
            arc_length: (m,) [m] from the start of the segment.
            length: of the segment [m].

        Returns:
            Sizes [m] and derivatives [-], each (sizes, m).
        """
        shape = (len(self.sizes), arc_length.size)
        values = np.zeros(shape)
        slopes = np.zeros_like(values)
        for i, name in enumerate(self.sizes):
            size = getattr(self, name)
            if isinstance(size, Taper):
                value, slope = size.size_and_slope(arc_length, length)
                values[i] = value
                slopes[i] = slope
            else:
                values[i] = size
        return values, slopes

    def sizes_along(self, length: float) -> Array:
        """Computes the sizes at many places of a segment, all extremes of tables among them.

        Args:
            length: of the segment [m].

        Returns:
            The sizes [m], (sizes, m).
        """
        # between the points of a table a size has no other extremes
        tapers = self.tapers().values()
        tables = [getattr(taper, "arc_length", ()) for taper in tapers]
        parts = [length * PLACES, *tables]
        places = np.concatenate(parts)
        values, _ = self.at(places, length)
        return values

    def outer_radius(self, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Computes the radius of the circle around the section, and its derivative along the rod.

        Args:
            arc_length: (m,) [m] from the start of the segment.
            length: of the segment [m].

        Returns:
            Radius [m] and derivative [-], each (m,).
        """
        values, slopes = self.at(arc_length, length)
        return values[0], slopes[0]

    def outline_radius(self, angle: float, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Returns how far the outline is from the axis in a direction.

        Args:
            angle: From y towards z [rad].
            arc_length: From the start of the segment (m,) [m].
            length: Of the segment [m].

        Returns:
            Distance [m], and its derivative along the rod [-], each (m,).
        """
        return self.outer_radius(arc_length, length)

    def hull(self, arc_length: Array, length: float) -> Array:
        """Computes widths, perimeter and area of the outline.

        Args:
            arc_length: (m,) [m] from the start of the segment.
            length: of the segment [m].

        Returns:
            Widths along y and z [m], perimeter [m] and area [m^2], (4, m).
        """
        radius, _ = self.outer_radius(arc_length, length)
        width = 2.0 * radius
        perimeter = 2.0 * np.pi * radius
        area = np.pi * radius**2
        return np.stack([width, width, perimeter, area])

    def outline(self, circle: Array) -> Array:
        """Returns points of the outline around points of the unit circle.

        Args:
            circle: points (2, k) of the unit circle.

        Returns:
            Points (2, k) in parts of half the outline's widths.
        """
        return circle

    def misfits(self, length: float) -> Iterator[Problem]:
        """Yields the problems of sizes that do not fit the segment, or each other.

        Args:
            length: of the segment [m].

        Yields:
            Problems by keys of the section.
        """
        for name, taper in self.tapers().items():
            text = taper.misfit(length)
            if text:
                yield Problem((name,), text)


SECTIONS: TableRegistry[Section] = TableRegistry("section", Section)
"""Registered cross-sections, by the `type` that tables name."""


class Solid(Section):
    """Base of the sections of one material."""

    # k, shear stiffness over G A (G. R. Cowper 1966: thin tube 0.53)
    shear_correction: Annotated[float, Field(gt=0, le=1)] = 1.0

    @abstractmethod
    def integrals(self, sizes: Array) -> tuple[Array, Array, Array, Array]:
        """Computes the area and second moments of sections.

        Args:
            sizes: (sizes, m) [m].

        Returns:
            A [m^2], Iy, Iz and Saint-Venant's J [m^4], each (m,).
        """

    def screw_matrices(self, arc_length: Array, length: float, *material: Any) -> Array:
        """Computes stiffness, viscosity and inertia of the material and the section's integrals."""
        E, nu, rho, eta = material
        G = E / (2 * (1 + nu))
        sizes, _ = self.at(arc_length, length)
        A, Iy, Iz, J = self.integrals(sizes)
        kA = self.shear_correction * A
        moduli_of_strains = [G, E, E, E, G, G]
        moduli = np.array(moduli_of_strains)
        # what a modulus is multiplied by, and a density
        resisting_rows = [J, Iy, Iz, A, kA, kA]
        resisting = np.stack(resisting_rows)
        polar = Iy + Iz
        moving_rows = [polar, Iy, Iz, A, A, A]
        moving = np.stack(moving_rows)
        elasticity = moduli[:, None] * resisting
        viscosity = eta * (VISCOUS * resisting)
        inertia = rho * moving
        return np.stack([elasticity, viscosity, inertia])


@register("section", "tube")
class Tube(Solid):
    """Round tube; without a hole it is the solid circle.

    In a fluid its ends are closed: its hole displaces fluid, and holds none.
    """

    sizes: ClassVar[tuple[str, ...]] = ("radius", "inner_radius")

    type: Literal["tube"] = "tube"
    radius: Size  # outer radius [m]
    inner_radius: Size  # radius of the hole [m]

    def integrals(self, sizes: Array) -> tuple[Array, Array, Array, Array]:
        """Computes area and second moments of the annulus."""
        area_outer, area_inner = np.pi * sizes**2
        second_outer, second_inner = np.pi * sizes**4 / 4
        area = area_outer - area_inner
        second = second_outer - second_inner
        polar = 2 * second
        return area, second, second, polar

    def misfits(self, length: float) -> Iterator[Problem]:
        """Yields the problems of the sizes: the hole is smaller than the tube everywhere."""
        yield from super().misfits(length)
        if not self.inner_radius:
            return
        outer, inner = self.sizes_along(length)
        wall = outer - inner
        thickest = (1.0 - THINNEST) * outer
        if (inner > thickest).any():
            i = int(np.argmin(wall))
            text = (
                f"is {inner[i]:g}: it should be less than the radius there, {outer[i]:g}, by"
                f" {THINNEST:g} of it"
            )
            yield Problem(("inner_radius",), text)


class Flat(Solid):
    """Base of the sections with a `width` along y and a `height` along z, their first sizes."""

    sizes: ClassVar[tuple[str, ...]] = ("width", "height")

    width: Size  # along y [m]
    height: Size  # along z [m]


@register("section", "rectangle")
class Rectangle(Flat):
    """Solid rectangle with a `width` along y and a `height` along z [m], numbers or tapers.

    Torsion is Timoshenko and Goodier's (170), summed to round-off.
    """

    has_corners: ClassVar[bool] = True

    type: Literal["rectangle"] = "rectangle"

    def integrals(self, sizes: Array) -> tuple[Array, Array, Array, Array]:
        """Computes area and second moments of the rectangle."""
        width, height = sizes
        A = width * height
        Iy = A * height**2 / 12
        Iz = A * width**2 / 12
        short, long = np.sort(sizes, axis=0)
        ratio = short / long
        # sum of tanh(n pi long / (2 short)) / n^5 over odd n, as what it lacks to that of 1 / n^5
        scaled_orders = 0.5 * np.pi * ODD
        argument = scaled_orders / ratio
        remainder = 1.0 - np.tanh(argument)
        lacking = remainder / ODD**5
        series = SUM_OF_ODD - lacking.sum(axis=0)
        # of a thin rectangle the shape factor is 1/3
        factor_of_series = 64.0 / np.pi**5
        correction = factor_of_series * ratio * series
        shape_factor = 1.0 / 3.0 - correction
        J = long * short**3 * shape_factor
        return A, Iy, Iz, J

    def outer_radius(self, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Computes half the diagonal, and its derivative along the rod."""
        values, slopes = self.at(arc_length, length)
        width, height = values[:2]
        diagonal = np.hypot(width, height)
        # d^2 = w^2 + h^2: d' = (w w' + h h') / d
        products = values[:2] * slopes[:2]
        diagonal_slope = products.sum(axis=0) / diagonal
        return 0.5 * diagonal, 0.5 * diagonal_slope

    def hull(self, arc_length: Array, length: float) -> Array:
        """Computes widths, perimeter and area of the rectangle."""
        values, _ = self.at(arc_length, length)
        width, height = values[:2]
        perimeter = 2.0 * (width + height)
        area = width * height
        return np.stack([width, height, perimeter, area])

    def outline_radius(self, angle: float, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Computes the way from the axis to the side that a direction meets."""
        values, slopes = self.at(arc_length, length)
        half_y, half_z = 0.5 * values[:2]
        slope_y, slope_z = 0.5 * slopes[:2]
        along_y = abs(np.cos(angle))
        along_z = abs(np.sin(angle))
        # the direction leaves through a side across y where its slope is below the diagonal's
        meets_y = half_z * along_y >= half_y * along_z
        half = np.where(meets_y, half_y, half_z)
        half_slope = np.where(meets_y, slope_y, slope_z)
        along = np.where(meets_y, along_y, along_z)
        return half / along, half_slope / along

    def outline(self, circle: Array) -> Array:
        """Returns points of the square that the outline is in parts of half its widths."""
        scaled = np.sqrt(2.0) * circle
        return np.clip(scaled, -1.0, 1.0)


@register("section", "ellipse")
class Ellipse(Flat):
    """Solid ellipse with a `width` along y and a `height` along z [m], numbers or tapers."""

    type: Literal["ellipse"] = "ellipse"

    def integrals(self, sizes: Array) -> tuple[Array, Array, Array, Array]:
        """Computes area and second moments of the ellipse."""
        a, b = 0.5 * sizes  # half axes
        A = np.pi * a * b
        Iy = A * b**2 / 4
        Iz = A * a**2 / 4
        # pi a^3 b^3 / (a^2 + b^2)
        sum_of_squares = a**2 + b**2
        J = A * a**2 * b**2 / sum_of_squares
        return A, Iy, Iz, J

    def outer_radius(self, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Computes the greater half axis, and its derivative along the rod."""
        values, slopes = self.at(arc_length, length)
        width, height = values
        width_slope, height_slope = slopes
        is_wider = width >= height
        diameter = np.where(is_wider, width, height)
        slope = np.where(is_wider, width_slope, height_slope)
        return 0.5 * diameter, 0.5 * slope

    def hull(self, arc_length: Array, length: float) -> Array:
        """Computes widths, perimeter and area of the ellipse."""
        sizes, _ = self.at(arc_length, length)
        width, height = sizes
        a, b = 0.5 * sizes
        # S. Ramanujan 1914: pi (3 (a + b) - sqrt((3 a + b) (a + 3 b)))
        first_factor = 3 * a + b
        second_factor = a + 3 * b
        mixed = first_factor * second_factor
        sum_term = 3 * (a + b)
        difference = sum_term - np.sqrt(mixed)
        perimeter = np.pi * difference
        area = np.pi * a * b
        return np.stack([width, height, perimeter, area])

    def outline_radius(self, angle: float, arc_length: Array, length: float) -> tuple[Array, Array]:
        """Computes the radius of the ellipse in a direction."""
        values, slopes = self.at(arc_length, length)
        a, b = 0.5 * values
        a_slope, b_slope = 0.5 * slopes
        # 1 / r^2 = (cos / a)^2 + (sin / b)^2
        cosine = np.cos(angle)
        along_y = cosine**2 / a**2
        sine = np.sin(angle)
        along_z = sine**2 / b**2
        reciprocal = np.sqrt(along_y + along_z)
        radius = 1.0 / reciprocal
        # r' = r^3 ((cos / a)^2 a' / a + (sin / b)^2 b' / b)
        of_a = along_y * a_slope / a
        of_b = along_z * b_slope / b
        slope = radius**3 * (of_a + of_b)
        return radius, slope


def _both(value: Any) -> Any:
    """A pair, also of one number for both."""
    if isinstance(value, list | tuple):
        return value
    return (value, value)


@register("section", "stiffness")
class Stiffness(Section):
    """Stiffnesses themselves, as measured or from a finite element model.

    They are the same along the segment.

    The segment then has no `young_modulus`, `poisson_ratio`, `density` and `damping`. Damping is
    Kelvin-Voigt with one time constant, Upsilon = `retardation_time` Sigma.
    """

    has_material: ClassVar[bool] = False

    type: Literal["stiffness"] = "stiffness"
    bending: tuple[Positive, Positive]  # (E Iy, E Iz) [N m^2]
    torsion: Positive  # G J [N m^2]
    stretch: Positive  # E A [N]
    # along y and z [N], or one number for both
    shear: Annotated[tuple[Positive, Positive], BeforeValidator(_both)]
    mass_per_length: Positive  # mass of the rod per length [kg/m]
    # viscosity over stiffness [s], in bending 2 zeta / omega of a mode of damping ratio zeta and
    # frequency omega [rad/s]
    retardation_time: NotNegative
    radius: Size  # of the outer circle [m], for contact, fluids, drawing and tendons on the surface
    # about x, y, z per length [kg m]; None: a solid circle's
    rotary_inertia: tuple[Positive, Positive, Positive] | None = None

    def screw_matrices(self, arc_length: Array, length: float, *material: Any) -> Array:
        """Returns the stiffnesses of the table, with viscosity and inertia of its other entries."""
        ones = np.ones_like(arc_length)
        stiffnesses = [self.torsion, *self.bending, self.stretch, *self.shear]
        elasticity = np.outer(stiffnesses, ones)
        viscosity = self.retardation_time * elasticity
        mass = self.mass_per_length
        if self.rotary_inertia is not None:
            rotary = np.outer(self.rotary_inertia, ones)
        else:
            # of a solid circle: r^2 / 2 about the axis, r^2 / 4 about the others
            radius, _ = self.outer_radius(arc_length, length)
            shares = [0.5 * mass, 0.25 * mass, 0.25 * mass]
            unit_rotary = np.outer(shares, ones)
            rotary = unit_rotary * radius**2
        masses = [mass, mass, mass]
        moving = np.outer(masses, ones)
        inertia = np.concatenate([rotary, moving])
        return np.stack([elasticity, viscosity, inertia])


AnySection = Annotated[SerializeAsAny[Section], BeforeValidator(SECTIONS.parse)]
"""A cross-section, also as a table with its `type`."""


class Discs(Configuration):
    """Spacer discs of a segment, all alike: they have inertia, weight and drag.

    Drag acts where there is a fluid. They add no stiffness.

    Their `places` are arc lengths [m] from the start of the segment; a `number` puts them evenly,
    the last one at its end.
    """

    mass: Positive  # of each [kg]
    radius: Length  # outer radius [m]; their inertia is that of full cylinders
    thickness: Length | None = None  # along the rod [m]; None: thin
    # how many, evenly, the last one at the end of the segment; None: `places` says where
    number: int | None = Field(default=None, ge=1, le=1000)
    # arc lengths from the start of the segment [m], in place of a number
    places: tuple[NotNegative, ...] | None = Field(
        default=None, min_length=1, validate_default=True
    )

    @field_validator("places")
    @classmethod
    def _or_number(cls, places: Any, info: ValidationInfo) -> Any:
        if "number" not in info.data:  # it is wrong itself
            return places
        has_number = info.data["number"] is not None
        if has_number == (places is not None):
            raise ValueError(
                "should be arc lengths from the start of the segment, or a number of discs be given"
                " in their place"
            )
        return places

    def rows(self, length: float) -> Array:
        """Returns place and size of each disc.

        Args:
            length: of the segment [m].

        Returns:
            Arc length from the start of the segment [m], mass [kg], radius and thickness [m] of
            each: (d, 4).
        """
        if self.number is not None:
            # at equal distances, the last one at the segment's end
            order = np.arange(1, self.number + 1)
            places = length * order / self.number
        else:
            places = np.array(self.places)
        thickness = self.thickness or 0.0
        disc = [self.mass, self.radius, thickness]
        repeats = (places.size, 1)
        discs = np.tile(disc, repeats)
        return np.column_stack([places, discs])
