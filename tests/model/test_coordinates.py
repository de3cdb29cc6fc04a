"""Which coordinates a scene gets: independent tensions, orthogonal or raw passive fields, Legendre fields."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.coordinates import actuation_columns, independent_tensions, make_strain, mode_fields
from soft_tendon_env.model.grid import STRAIGHT, at_points, make_grid, screw_matrices
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.strain import Modes

ANGULAR = ("torsion", "bend_y", "bend_z")


def scene_and_grid(name, **changes):
    scene = load_scene(name).replace(changes)
    return scene, make_grid(scene, 4)


def inner(left, right, scene, grid):
    """int left^T Sigma^-1 right dX."""
    compliance = 1 / screw_matrices(scene, grid.points.ravel())[0].reshape(*grid.points.shape, 6)
    return np.einsum("imzc,mzc,jmzc->ij", left, compliance * grid.weights[..., None], right)


def tendon_fields(scene, grid):
    here = at_points(scene, grid)
    return actuation_columns(here.geometry, here.curvature, STRAIGHT)


def passive_fields(strain, grid):
    return strain.passive.reshape(-1, grid.packs, 2, 6, LANES).transpose(0, 1, 4, 2, 3).reshape(-1, *grid.points.shape, 6)


def test_redundant_tendons_get_as_many_coordinates_as_they_strain():
    """Four tendons at 90 degrees: a moment each and the same thrust."""
    columns = np.array([[1.0, 0, -1], [0, 1, -1], [-1, 0, -1], [0, -1, -1]]) * [0.3, 0.3, 2.0]
    mixing = independent_tensions(columns @ columns.T, 1e-4)
    assert mixing.shape == (4, 3)
    np.testing.assert_allclose(mixing.T @ mixing, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(mixing.T @ [1, -1, 1, -1], 0.0, atol=1e-13)  # the combination that strains nothing
    np.testing.assert_allclose(columns.T @ mixing @ mixing.T, columns.T, atol=1e-13)  # nothing else is lost


@pytest.mark.parametrize("name", ("paper_16dof", "paper_19dof", "paper_22dof"))
def test_orthogonal_passive_fields(name):
    """Orthogonal to every actuation field and to each other in compliance, each of unit energy."""
    scene, grid = scene_and_grid(name)
    strain, actuation = make_strain(scene, grid, at_points(scene, grid)), tendon_fields(scene, grid)
    passive = passive_fields(strain, grid)
    assert len(passive) == strain.size - strain.active == int(name[6:8]) - 10
    np.testing.assert_allclose(inner(passive, passive, scene, grid), np.eye(len(passive)), atol=1e-11)
    sizes = np.sqrt(np.diag(inner(actuation, actuation, scene, grid)))
    np.testing.assert_allclose(inner(actuation, passive, scene, grid) / sizes[:, None], 0.0, atol=1e-11)


def test_passive_fields_that_the_tendons_span_are_dropped():
    """Three straight tendons span constant bending and stretch exactly; torsion is left."""
    modes = [{"strains": list(ANGULAR), "order": 0, "span": "rod"}]
    scene, grid = scene_and_grid("three_tendon", **{"strain.passive": modes})
    strain = make_strain(scene, grid, at_points(scene, grid))
    assert strain.size == 4
    field = passive_fields(strain, grid)[0][grid.real]
    assert field[..., 0].all() and np.abs(field[..., 1:]).max() < 1e-10 * np.abs(field[..., 0]).max()


def test_mode_fields_are_legendre_polynomials_on_their_span():
    scene, grid = scene_and_grid("paper")
    over_rod = mode_fields((Modes(strains=("stretch",), order=2, span="rod"),), grid)
    x = 2 * grid.points - 1
    np.testing.assert_allclose(over_rod[:, ..., 3], [np.ones_like(x), x, (3 * x**2 - 1) / 2], atol=1e-15)
    assert not over_rod[..., [0, 1, 2, 4, 5]].any()
    by_piece = mode_fields((Modes(strains=("bend_y", "torsion"), order=1, span="piece"),), grid)
    assert len(by_piece) == 8  # piece, then strain, then order
    second_half = grid.points > 0.5
    np.testing.assert_allclose(by_piece[7][..., 0], np.where(second_half, 4 * grid.points - 3, 0.0), atol=1e-15)
    np.testing.assert_array_equal(by_piece[4][..., 1], second_half)
