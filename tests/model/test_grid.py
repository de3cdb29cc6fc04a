"""From a scene to the rod's arrays: intervals and points, their layout, quadrature weights, sections, tendon geometry."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.grid import GAUSS, at_points, make_grid, make_rod, newton_cotes
from soft_tendon_env.scene.file import load_scene, scene_names
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.scene.strain import STRAINS


def rod_of(scene, grid, free):
    return make_rod(scene, grid, free, at_points(scene, grid))


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


@pytest.mark.cases("name", ("paper", "three_tendon"))
@pytest.mark.cases("lead", ((), (3,), (2, 3)))
def test_packed_and_unpacked_are_inverse(name, lead):
    """Strains at the points survive the kernels' layout, whatever axes lead; empty intervals get the last point's."""
    _, grid = grid_of(name, 3)
    strain = np.random.default_rng(0).normal(size=(*lead, 2 * grid.real.sum(), 6))
    packed = grid.packed(strain)
    assert packed.shape == (*lead, 2 * grid.length.size * 6)
    np.testing.assert_array_equal(grid.unpacked(packed), strain)
    empty = grid.at_points(packed, 6)[..., ~grid.real, :, :]
    np.testing.assert_array_equal(empty, np.broadcast_to(strain[..., None, -1:, :], empty.shape))
