"""Which coordinates a scene gets: independent tensions, orthogonal or raw passive fields, Legendre fields."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.model.coordinates import actuation_fields, independent_tensions, make_strain, mode_fields
from soft_tendon_env.model.grid import at_points, make_grid, screw_matrices
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


def passive_fields(strain, grid):
    return strain.passive.reshape(-1, grid.packs, 2, 6, LANES).transpose(0, 1, 4, 2, 3).reshape(-1, *grid.points.shape, 6)


# tensions ---------------------------------------------------------------------------------------------------------------


def test_independent_tendons_are_their_own_coordinates():
    a = np.random.default_rng(0).normal(size=(4, 9))
    np.testing.assert_array_equal(independent_tensions(a @ a.T, 1e-4), np.eye(4))


def redundant_gram(rng=None):
    """Four tendons at 90 degrees: a moment each and the same thrust; with round-off from another machine, if wanted."""
    columns = np.array([[1.0, 0, -1], [0, 1, -1], [-1, 0, -1], [0, -1, -1]]) * [0.3, 0.3, 2.0]
    gram = columns @ columns.T
    if rng is not None:
        noise = 1e-14 * rng.normal(size=gram.shape)
        gram = gram + noise + noise.T
    return columns, gram


def test_redundant_tendons_get_as_many_coordinates_as_they_strain():
    columns, gram = redundant_gram()
    mixing = independent_tensions(gram, 1e-4)
    assert mixing.shape == (4, 3)
    np.testing.assert_allclose(mixing.T @ mixing, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(mixing.T @ [1, -1, 1, -1], 0.0, atol=1e-13)  # the combination that strains nothing
    np.testing.assert_allclose(columns.T @ mixing @ mixing.T, columns.T, atol=1e-13)  # nothing else is lost


def test_the_choice_of_coordinates_does_not_hang_on_round_off():
    expected = independent_tensions(redundant_gram()[1], 1e-4)
    for seed in range(10):
        found = independent_tensions(redundant_gram(np.random.default_rng(seed))[1], 1e-4)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_array_equal(independent_tensions(redundant_gram()[1], 1e-4), expected)


def test_rank_does_not_depend_on_units():
    """A tendon whose field is tiny, but independent, keeps its coordinate."""
    scale = np.diag([1.0, 1e-6, 1.0])
    a = np.random.default_rng(1).normal(size=(3, 5))
    np.testing.assert_array_equal(independent_tensions(scale @ a @ a.T @ scale, 1e-4), np.eye(3))


def test_a_tendon_that_strains_nothing_gets_no_coordinate():
    mixing = independent_tensions(np.diag([2.0, 0.0, 3.0]), 1e-4)
    np.testing.assert_array_equal(mixing, [[1, 0], [0, 0], [0, 1]])
    assert independent_tensions(np.zeros((2, 2)), 1e-4).shape == (2, 0)


# actuation fields -------------------------------------------------------------------------------------------------------


def test_actuation_fields_pull_towards_the_base_and_end_with_their_tendon():
    """-(d x t, t): at the straight arm a tendon on +y shortens it and bends it about +z, so that the tip moves towards the tendon."""
    scene, grid = scene_and_grid("three_tendon")
    fields = actuation_fields(at_points(scene, grid))
    np.testing.assert_allclose(fields[0], np.broadcast_to([0, 0, 0.008, -1, 0, 0], fields[0].shape), atol=1e-16)
    scene, grid = scene_and_grid("paper")
    fields = actuation_fields(at_points(scene, grid))
    past = grid.points > 0.5
    assert not fields[5:, past].any() and fields[5:, ~past].any(axis=-1).all() and fields[:5].any(axis=-1).all()


# passive fields ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ("paper_16dof", "paper_19dof", "paper_22dof"))
def test_orthogonal_passive_fields(name):
    """Orthogonal to every actuation field and to each other in compliance, each of unit energy."""
    scene, grid = scene_and_grid(name)
    strain, actuation = make_strain(scene, grid), actuation_fields(at_points(scene, grid))
    passive = passive_fields(strain, grid)
    assert len(passive) == strain.size - strain.active == int(name[6:8]) - 10
    np.testing.assert_allclose(inner(passive, passive, scene, grid), np.eye(len(passive)), atol=1e-11)
    sizes = np.sqrt(np.diag(inner(actuation, actuation, scene, grid)))
    np.testing.assert_allclose(inner(actuation, passive, scene, grid) / sizes[:, None], 0.0, atol=1e-11)


def test_orthogonal_passive_fields_span_what_the_raw_ones_do():
    """Together with the tendons'."""
    scene, grid = scene_and_grid("paper_16dof")
    actuation = actuation_fields(at_points(scene, grid))
    orthogonal = np.concatenate([actuation, passive_fields(make_strain(scene, grid), grid)])
    raw = mode_fields(scene.strain.passive, grid)
    flat = orthogonal[:, grid.real].reshape(len(orthogonal), -1).T
    target = raw[:, grid.real].reshape(len(raw), -1).T
    scale = np.linalg.norm(flat, axis=0)
    left = target - flat / scale @ np.linalg.lstsq(flat / scale, target, rcond=1e-13)[0]
    np.testing.assert_allclose(left, 0.0, atol=1e-8)


def test_raw_passive_fields_are_constant_moments_per_half():
    """(torsion, bend y, bend z) of the first half, then of the second; Phi_p = [I; 0]."""
    scene, grid = scene_and_grid("paper_16dof", **{"strain.passive_coordinates": "raw"})
    strain = make_strain(scene, grid)
    passive, first_half = passive_fields(strain, grid), grid.points < 0.5
    assert strain.size == 16 and strain.active == 10
    for j, field in enumerate(passive):
        here = first_half if j < 3 else ~first_half
        np.testing.assert_array_equal(field[here], np.broadcast_to(np.eye(6)[j % 3], field[here].shape))
        assert not field[~here].any()


def test_passive_fields_that_the_tendons_span_are_dropped():
    """Three straight tendons span constant bending and stretch exactly; torsion is left."""
    modes = [{"strains": list(ANGULAR), "order": 0, "span": "rod"}]
    scene, grid = scene_and_grid("three_tendon", **{"strain.passive": modes})
    strain = make_strain(scene, grid)
    assert strain.size == 4
    field = passive_fields(strain, grid)[0][grid.real]
    assert field[..., 0].all() and np.abs(field[..., 1:]).max() < 1e-10 * np.abs(field[..., 0]).max()


# Legendre fields --------------------------------------------------------------------------------------------------------


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


def test_explicit_stiffness_and_damping_are_the_integrals():
    scene, grid = scene_and_grid("paper_48dof")
    strain = make_strain(scene, grid)
    fields = strain.field.reshape(48, grid.packs, 2, 6, LANES).transpose(0, 1, 4, 2, 3).reshape(48, *grid.points.shape, 6)
    elasticity, damping, _ = (m.reshape(*grid.points.shape, 6) for m in screw_matrices(scene, grid.points.ravel()))
    for matrix, density in ((strain.stiffness, elasticity), (strain.damping, damping)):
        expected = np.einsum("imzc,mzc,jmzc->ij", fields, density * grid.weights[..., None], fields)
        np.testing.assert_allclose(matrix, expected, atol=1e-13 * np.abs(expected).max())
    assert (np.linalg.eigvalsh(strain.stiffness) > 0).all()


def test_borders_cut_the_rod_into_pieces():
    modes = [{"strains": ["bend_y"], "order": 0, "span": "piece"}]
    scene, grid = scene_and_grid("three_tendon", strain={"type": "explicit", "modes": modes, "borders": [0.1, 0.2]})
    strain = make_strain(scene, grid)
    assert strain.size == 3
    np.testing.assert_array_equal((strain.first, strain.last), ([0, 1, 2], [1, 2, 3]))
