"""From a scene to the rod's arrays: intervals and points, their layout, quadrature weights, sections, tendon geometry."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.grid import (
    GAUSS,
    LARGEST_PANEL,
    at_points,
    discretisation,
    make_grid,
    make_rod,
    make_tendons,
    newton_cotes,
    node_field,
    point_field,
    screw_matrices,
)
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.scene.strain import STRAINS


def rod_of(scene, grid, free):
    return make_rod(scene, grid, free, at_points(scene, grid), discretisation(scene, grid))


def grid_of(name, intervals):
    scene = load_scene(name)
    return scene, make_grid(scene, intervals)


@pytest.mark.cases("intervals", (1, 2, 3, 6))
@pytest.mark.cases("name", scene_names())
def test_intervals_fill_the_rod_and_none_crosses_a_breakpoint(name, intervals):
    scene, grid = grid_of(name, intervals)
    start, end = grid.start[grid.real], (grid.start + grid.length)[grid.real]
    assert start[0] == 0 and grid.start.size % LANES == 0
    np.testing.assert_allclose(start[1:], end[:-1], rtol=1e-15)
    np.testing.assert_allclose(end[-1], rod_length(scene), rtol=1e-15)
    assert not grid.length[~grid.real].any() and grid.real.sum() == intervals * (grid.breakpoints.size - 1)
    for border in grid.breakpoints:
        assert not ((start < border - 1e-12) & (end > border + 1e-12)).any()
    assert ((grid.points[grid.real] > start[:, None]) & (grid.points[grid.real] < end[:, None])).all()
    assert ((grid.points >= 0) & (grid.points <= rod_length(scene))).all()


def test_points_integrate_cubics_exactly():
    _, grid = grid_of("paper", 3)
    for power in range(4):
        np.testing.assert_allclose((grid.weights * grid.points**power).sum(), 1 / (power + 1), rtol=1e-14)
    assert abs((grid.weights * grid.points**4).sum() - 0.2) > 1e-8
    np.testing.assert_allclose(GAUSS, 0.5 + 0.5 * np.polynomial.legendre.leggauss(2)[0], rtol=1e-15)


@pytest.mark.cases("intervals", (*range(1, 16), 24, 48, 512))
def test_newton_cotes_is_positive_and_exact_for_its_degree(intervals):
    weights, nodes = newton_cotes(intervals), np.linspace(0, 1, intervals + 1)
    assert (weights > 0).all()
    panels = -(-intervals // LARGEST_PANEL)
    smallest = intervals // panels
    for power in range(smallest + 2 - smallest % 2):  # even panels are exact for one degree more
        np.testing.assert_allclose(weights @ nodes**power, 1 / (power + 1), rtol=1e-13)


def test_fields_have_the_lane_running_fastest():
    """Block 2 p + z holds points z of the intervals of pack p."""
    intervals, components = 2 * LANES, 3
    values = np.arange(2.0 * intervals * 2 * components).reshape(2, intervals, 2, components)
    flat = point_field(values)
    for lead, interval, z, component in ((0, 0, 0, 0), (1, 5, 1, 2), (0, 3, 1, 1), (1, 4, 0, 0)):
        block = 2 * (interval // LANES) + z
        at = ((lead * 2 * 2 + block) * components + component) * LANES + interval % LANES
        assert flat[at] == values[lead, interval, z, component]
    nodes = values[0, :, 0]
    assert node_field(nodes)[(1 * components + 2) * LANES + 1] == nodes[LANES + 1, 2]


def test_screw_matrices_of_a_circular_section():
    """Sigma = diag(G Jx, E I, E I, E A, G A, G A), Upsilon = eta diag(Jx, 3 I, 3 I, 3 A, A, A), inertia rho diag(Jx, I, I, A, A, A)."""
    r, young, eta, rho = 0.025, 1e6, 1e4, 100.0
    A, I, shear = np.pi * r**2, np.pi * r**4 / 4, young / 3  # noqa: E741
    elasticity, damping, inertia = (m[0] for m in screw_matrices(load_scene("paper"), np.array([0.5])))
    np.testing.assert_allclose(elasticity, [shear * 2 * I, young * I, young * I, young * A, shear * A, shear * A], rtol=1e-14)
    np.testing.assert_allclose(damping, eta * np.array([2 * I, 3 * I, 3 * I, 3 * A, A, A]), rtol=1e-14)
    np.testing.assert_allclose(inertia, rho * np.array([2 * I, I, I, A, A, A]), rtol=1e-14)


def test_node_inertia_sums_to_the_rod_without_the_base_node_and_takes_up_the_payload():
    scene, grid = grid_of("paper", 6)
    payload = {"effects.tip_load.mass": 0.3, "effects.tip_load.inertia": [1e-3, 2e-3, 3e-3]}
    bare, loaded = (rod_of(s, grid, STRAINS) for s in (scene, scene.replace(payload)))
    base_share = 0.5 * newton_cotes(6)[0] * 100 * np.pi * 0.03**2
    mass = 100 * np.pi * (0.03**2 + 0.03 * 0.02 + 0.02**2) / 3  # a cone's frustum
    np.testing.assert_allclose(bare.mass + base_share, mass, rtol=1e-12)
    difference = (loaded.inertia - bare.inertia).reshape(grid.packs, 6, LANES)
    np.testing.assert_allclose(difference[-1, :, -1], [1e-3, 2e-3, 3e-3, 0.3, 0.3, 0.3], rtol=1e-12)
    assert np.count_nonzero(difference) == 6


def test_two_segments_share_the_node_between_them():
    """Where the radius jumps, the border's node takes its share from either side."""
    scene, grid = grid_of("two_segment_six", 4)
    rod = rod_of(scene, grid, STRAINS)
    mass = rod.inertia.reshape(grid.packs, 6, LANES)[:, 3].ravel()
    areas = np.pi * np.array([0.015**2, 0.012**2])
    np.testing.assert_allclose(mass[3], 1070 * 0.2 * newton_cotes(4)[0] * areas.sum(), rtol=1e-12)


def test_rigid_strains_have_neither_compliance_nor_stiffness():
    scene, grid = grid_of("paper", 2)
    rod = rod_of(scene, grid, ("bend_y", "stretch"))
    for field in (rod.root_compliance, rod.root_stiffness):
        values = field.reshape(-1, 6, LANES)
        assert (values[:, [1, 3]] > 0).all() and not values[:, [0, 2, 4, 5]].any()
    whole = rod_of(scene, grid, STRAINS)
    np.testing.assert_allclose(whole.root_compliance * whole.root_stiffness, 1.0, rtol=1e-15)


def test_presence_and_packs_of_tendons_that_end():
    scene, grid = grid_of("paper", 6)
    tendons = make_tendons(grid, at_points(scene, grid).shape.geometry)
    presence = tendons.geometry.reshape(10, grid.packs, 2, 5, LANES)[:, :, :, 4].swapaxes(2, 3).reshape(10, -1, 2)
    np.testing.assert_array_equal(presence[5:], np.tile(grid.points < 0.5, (5, 1, 1)))
    assert presence[:5, grid.real].all()
    np.testing.assert_array_equal(tendons.first, 0)
    np.testing.assert_array_equal(tendons.last, [3] * 5 + [2] * 5)  # 12 intervals, 6 of them before the border


@pytest.mark.no_jit
def test_places_are_intervals_and_distances():
    _, grid = grid_of("three_tendon", 2)
    interval, distance = grid.locate(np.array([0.0, 0.1, 0.15, 0.2, 0.3]))
    assert interval.tolist() == [0, 0, 1, 1, 1]
    np.testing.assert_allclose(distance, [0.0, 0.1, 0.0, 0.05, 0.15], atol=1e-15)


@pytest.mark.cases("name", ("paper", "three_tendon"))
@pytest.mark.cases("lead", ((), (3,), (2, 3)))
def test_packed_and_unpacked_are_inverse(name, lead):
    """Strains at the points survive the kernels' layout, whatever axes lead; empty intervals get the last point's."""
    _, grid = grid_of(name, 3)
    strain = np.random.default_rng(0).normal(size=(*lead, grid.point_count, 6))
    packed = grid.packed(strain)
    assert packed.shape == (*lead, 2 * grid.length.size * 6)
    np.testing.assert_array_equal(grid.unpacked(packed), strain)
    empty = grid.at_points(packed, 6)[..., ~grid.real, :, :]
    np.testing.assert_array_equal(empty, np.broadcast_to(strain[..., None, -1:, :], empty.shape))


def test_the_shape_on_a_grid_is_that_of_the_scene_at_hand():
    """The grid keeps the last one, for scenes that differ in other numbers."""
    straight = load_scene("three_tendon")
    bent, grid = straight.replace({"segments.0.curvature": [0.0, 5.0, 0.0]}), make_grid(straight, 6)
    for scene in (straight, bent, straight.replace({"segments.0.density": 900.0}), bent):
        found, fresh = (at_points(scene, own).shape for own in (grid, make_grid(scene, 6)))
        np.testing.assert_array_equal(found.curvature, fresh.curvature)
        np.testing.assert_array_equal(found.tendon_length, fresh.tendon_length)
        np.testing.assert_array_equal(found.tendons.geometry, fresh.tendons.geometry)
    assert at_points(bent, grid).shape is at_points(bent.replace({"segments.0.density": 900.0}), grid).shape
