"""Cross-sections by themselves: integrals over their areas, outlines, and rows of discs."""

import numpy as np
import pytest
from scipy.special import ellipe

from soft_tendon_env.scene.routing import LinearTaper
from soft_tendon_env.scene.sections import Discs, Ellipse, Rectangle, Stiffness, Tube

LENGTH = 0.4
"""Length of the segment [m]."""
PLACE = np.array([0.1])
"""Arc length [m] from the start of the segment."""
WIDTH = 0.012
"""Width along y [m]."""
HEIGHT = 0.005
"""Height along z [m]."""
SIZES = np.array([[WIDTH], [HEIGHT]])
FLAT = {"width": WIDTH, "height": HEIGHT}
FLAT_SECTIONS = [Rectangle(**FLAT), Ellipse(**FLAT)]


def points_within(section):
    """Midpoints y and z of small squares within a flat section [m], and the area of each [m^2]."""
    count = 1000
    order = np.arange(count)
    shares = (order + 0.5) / count - 0.5
    along_y = WIDTH * shares
    along_z = HEIGHT * shares
    y, z = np.meshgrid(along_y, along_z)
    area = WIDTH * HEIGHT / count**2
    if isinstance(section, Rectangle):
        return y, z, area
    part_y = 2.0 * y / WIDTH
    part_z = 2.0 * z / HEIGHT
    is_inside = np.hypot(part_y, part_z) < 1.0
    return y[is_inside], z[is_inside], area


@pytest.mark.parametrize("section", FLAT_SECTIONS)
def test_area_and_second_moments_are_integrals_over_the_section(section):
    y, z, area = points_within(section)
    A, Iy, Iz, _ = section.integrals(SIZES)
    # the ellipse's border passes through squares
    near = 3e-4
    whole = area * y.size
    about_y = area * np.sum(z**2)
    about_z = area * np.sum(y**2)
    np.testing.assert_allclose(A, whole, rtol=near)
    np.testing.assert_allclose(Iy, about_y, rtol=near)
    np.testing.assert_allclose(Iz, about_z, rtol=near)


@pytest.mark.parametrize(
    ("ratio", "factor"),
    [
        (1.0, 0.1406),
        (1.5, 0.1958),
        (2.0, 0.229),
        (4.0, 0.281),
        (10.0, 0.312),
    ],
)
def test_torsion_of_rectangles_is_tabled(ratio, factor):
    """Timoshenko and Goodier, Theory of Elasticity, section 109: J = factor long short^3."""
    short = HEIGHT
    long = ratio * short
    sizes = np.array([[short], [long]])
    section = Rectangle(**FLAT)
    *_, J = section.integrals(sizes)
    expected_j = factor * long * short**3
    assert J[0] == pytest.approx(expected_j, rel=2e-3)


@pytest.mark.parametrize("width", [WIDTH, HEIGHT])
def test_torsion_of_an_ellipse_is_saint_venant_s(width):
    """J = 4 Iy Iz / (Iy + Iz), which of a circle is Iy + Iz."""
    section = Ellipse(**FLAT)
    sizes = np.array([[width], [HEIGHT]])
    _, Iy, Iz, J = section.integrals(sizes)
    polar = Iy + Iz
    expected_j = 4.0 * Iy * Iz / polar
    np.testing.assert_allclose(J, expected_j)


def test_the_hull_of_an_ellipse_has_its_perimeter_and_area():
    """The perimeter is a complete elliptic integral, which Ramanujan's formula meets to 1e-4."""
    a = 0.5 * WIDTH
    b = 0.5 * HEIGHT
    squared_ratio = (b / a) ** 2
    perimeter = 4.0 * a * ellipe(1.0 - squared_ratio)
    area = np.pi * a * b
    section = Ellipse(**FLAT)
    hull = section.hull(PLACE, LENGTH)
    expected = [WIDTH, HEIGHT, perimeter, area]
    np.testing.assert_allclose(hull[:, 0], expected, rtol=1e-4)


def test_hulls_of_rectangles_and_tubes_have_perimeter_and_area():
    rectangle = Rectangle(**FLAT)
    hull = rectangle.hull(PLACE, LENGTH)
    perimeter = 2.0 * (WIDTH + HEIGHT)
    expected = [WIDTH, HEIGHT, perimeter, WIDTH * HEIGHT]
    np.testing.assert_allclose(hull[:, 0], expected)

    radius = 0.006
    tube = Tube(radius=radius, inner_radius=0.001)
    hull = tube.hull(PLACE, LENGTH)
    perimeter = 2.0 * np.pi * radius
    area = np.pi * radius**2
    expected = [2.0 * radius, 2.0 * radius, perimeter, area]
    np.testing.assert_allclose(hull[:, 0], expected)


@pytest.mark.parametrize("shape", [Rectangle, Ellipse])
def test_the_circle_around_a_taper_has_the_derivative_of_its_radius(shape):
    width = LinearTaper(base=0.02, tip=0.012)
    height = LinearTaper(base=0.01, tip=0.004)
    section = shape(width=width, height=height)
    h = 1e-6
    radius, slope = section.outer_radius(PLACE, LENGTH)
    before, _ = section.outer_radius(PLACE - h, LENGTH)
    after, _ = section.outer_radius(PLACE + h, LENGTH)
    difference = (after - before) / (2.0 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-6)

    # at a quarter of the segment
    half_width = 0.5 * 0.018
    half_height = 0.5 * 0.0085
    if shape is Rectangle:
        farthest = np.hypot(half_width, half_height)
    else:
        farthest = half_width
    np.testing.assert_allclose(radius, farthest)


def test_matrices_of_a_material_are_moduli_times_integrals():
    """Bending and stretch by E and 3 eta, torsion and shear by G and eta."""
    correction = 0.5
    section = Tube(radius=0.006, inner_radius=0.004, shear_correction=correction)
    E = 4e5
    nu = 0.45
    rho = 1100.0
    eta = 3e3
    matrices = section.screw_matrices(PLACE, LENGTH, E, nu, rho, eta)
    stiffness, viscosity, inertia = matrices[..., 0]

    area = np.pi * (0.006**2 - 0.004**2)
    bending = np.pi / 4.0 * (0.006**4 - 0.004**4)
    torsion = 2.0 * bending
    shear = correction * area
    G = E / (2.0 * (1.0 + nu))
    expected = [
        G * torsion,
        E * bending,
        E * bending,
        E * area,
        G * shear,
        G * shear,
    ]
    np.testing.assert_allclose(stiffness, expected)
    expected = [
        eta * torsion,
        3.0 * eta * bending,
        3.0 * eta * bending,
        3.0 * eta * area,
        eta * shear,
        eta * shear,
    ]
    np.testing.assert_allclose(viscosity, expected)
    moving = np.array([torsion, bending, bending, area, area, area])
    np.testing.assert_allclose(inertia, rho * moving)


def test_stiffnesses_are_those_of_the_table_and_damping_is_a_time_of_them():
    section = Stiffness(
        bending=(0.3, 0.7),
        torsion=0.4,
        stretch=4e4,
        shear=2e4,
        mass_per_length=0.05,
        retardation_time=0.01,
        radius=0.006,
    )
    matrices = section.screw_matrices(PLACE, LENGTH)
    stiffness, viscosity, inertia = matrices[..., 0]
    np.testing.assert_allclose(stiffness, [0.4, 0.3, 0.7, 4e4, 2e4, 2e4])
    np.testing.assert_allclose(viscosity, 0.01 * stiffness)
    # of a solid circle of that radius
    about_axis = 0.5 * 0.05 * 0.006**2
    across = 0.5 * about_axis
    expected = [about_axis, across, across, 0.05, 0.05, 0.05]
    np.testing.assert_allclose(inertia, expected)


def test_discs_stand_evenly_to_the_end_or_where_they_are_put():
    evenly = Discs(mass=2e-3, radius=0.015, thickness=0.003, number=4)
    place, *size = evenly.rows(LENGTH).T
    np.testing.assert_allclose(place, [0.1, 0.2, 0.3, 0.4])
    for values, expected in zip(size, (2e-3, 0.015, 0.003), strict=True):
        assert values.tolist() == [expected] * 4
    thin = Discs(mass=2e-3, radius=0.015, places=(0.05, 0.3))
    expected = [
        [0.05, 2e-3, 0.015, 0.0],
        [0.3, 2e-3, 0.015, 0.0],
    ]
    np.testing.assert_array_equal(thin.rows(LENGTH), expected)
