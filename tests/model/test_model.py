"""Model: what its methods refuse, where the strain ends, strains at any place, and a mass matrix
that is singular."""

import numpy as np
import pytest

from soft_tendon_env import StrainLimitError, load_scene
from soft_tendon_env.model.build import build_model

TEN = np.zeros(10)
OF_Q = {  # every public method of coordinates
    "tip_pose(q)": lambda model, bad: model.tip_pose(bad),
    "backbone(q)": lambda model, bad: model.backbone(bad),
    "backbone_at(q)": lambda model, bad: model.backbone_at(bad, [0.5]),
    "strain(q)": lambda model, bad: model.strain(bad),
    "strain_at(q)": lambda model, bad: model.strain_at(bad, [0.5]),
    "tendon_lengths(q)": lambda model, bad: model.tendon_lengths(bad),
    "terms(q)": lambda model, bad: model.terms(bad, TEN),
    "energy(q)": lambda model, bad: model.energy(bad, TEN),
}


@pytest.fixture
def paper(build):
    return build("paper", {"quadrature.intervals": 2})


@pytest.mark.parametrize("method", OF_Q)
def test_every_method_names_bad_coordinates_and_says_where_the_strain_ends(method, paper):
    with pytest.raises(ValueError, match=r"^q should have shape \(10,\), not \(9,\)"):
        OF_Q[method](paper, np.zeros(9))
    with pytest.raises(StrainLimitError, match="tendon 6 at arc length 0.4"):
        OF_Q[method](paper, [0.0] * 6 + [-2000.0] + [0.0] * 3)


@pytest.mark.parametrize("name", ["paper_16dof", "paper_48dof", "four_tendon"])
def test_strains_at_places_are_those_at_the_points_and_their_derivative(name, build, random_state):
    model = build(name, {"quadrature.intervals": 4})
    q, q_dot = random_state(model, 2)
    points, strain = model.strain(q)
    np.testing.assert_allclose(model.strain_at(q, points)[0], strain, atol=1e-12)
    start, end = model.grid.start[1], model.grid.start[2]
    ends, middle = (
        model.strain_at(q, [start, np.nextafter(end, 0.0)])[0],
        model.strain_at(q, [(start + end) / 2])[0],
    )
    np.testing.assert_allclose(ends.mean(axis=0), middle[0], atol=1e-12)  # linear in between
    places, h = [0.0, 0.4 * model.length, model.length], 1e-6
    found, Phi = model.strain_at(q, places)
    difference = (
        model.strain_at(q + h * q_dot, places)[0] - model.strain_at(q - h * q_dot, places)[0]
    ) / (2 * h)
    assert found.shape == (3, 6)
    assert Phi.shape == (3, 6, q.size)
    assert np.abs(difference).max() > 1.0
    np.testing.assert_allclose(Phi @ q_dot, difference, atol=1e-6 * np.abs(difference).max())
    assert model.strain_at(q, [])[1].shape == (0, 6, q.size)


def test_a_singular_mass_matrix_is_warned_of():
    """The only node with mass is the tip, which the linear fields do not turn: they have no
    inertia, not even on the diagonal."""
    strain = {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}],
    }
    scene = load_scene("three_tendon").replace({"strain": strain, "quadrature.intervals": 1})
    with pytest.warns(
        UserWarning,
        match=(
            "6 coordinates are too many for 1 quadrature intervals per piece: the mass matrix is"
            " singular"
        ),
    ):
        model = build_model(scene)
    assert np.diag(model.terms(np.zeros(6), np.zeros(6)).mass).min() == 0.0
