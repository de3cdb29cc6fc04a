"""Stiffening material: uniform bending, stretch and torsion against the law itself, its energy and its derivative."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.model.statics import static_equilibrium

RADIUS, YOUNG, SHEAR = 0.01, 5e5, 5e5 / 3
AREA, INERTIA = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
ALL = ("torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z")
LAW = {"effects.nonlinear_elasticity": {"torsion": 6.0, "bending": 4.0, "stretch": 0.1, "shear": 0.2}}


def loaded(stiffness, strain, scale):
    """The load at which the law has this strain."""
    return stiffness * strain * (1.0 + (strain / scale) ** 2)


@pytest.mark.no_jit
@pytest.mark.parametrize("curvature", [0.5, 4.0, 12.0])
def test_uniform_bending(uniform, curvature):
    """M = E I k (1 + (k / k0)^2), under a moment that follows the tip."""
    moment = loaded(YOUNG * INERTIA, curvature, 4.0)
    load = {"effects.tip_load": {"moment": [0.0, 0.0, moment], "frame": "tip"}, "quadrature.intervals": 4}
    found = static_equilibrium(uniform(("bend_z", "stretch", "shear_y"), 0, {**LAW, **load}), np.zeros(3))
    assert found.converged
    np.testing.assert_allclose(found.q, [curvature, 0.0, 0.0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("strain", "size", "stiffness", "scale", "load"),
    [("torsion", 3.0, 2 * SHEAR * INERTIA, 6.0, "moment"), ("stretch", 0.15, YOUNG * AREA, 0.1, "force")],
)
def test_torsion_and_stretch(uniform, strain, size, stiffness, scale, load):
    changes = {**LAW, "effects.tip_load": {load: [loaded(stiffness, size, scale), 0.0, 0.0], "frame": "tip"}}
    np.testing.assert_allclose(static_equilibrium(uniform((strain,), 0, changes), np.zeros(3)).q, size, rtol=1e-9)


@pytest.mark.no_jit
def test_force_is_the_gradient_of_the_energy_and_stiffness_its_derivative(uniform, workspace_at, slope):
    model, q = uniform(ALL, 1, {**LAW, "quadrature.intervals": 4}), 0.3 * np.array([5, 3, 4, -2, 3, 1, 0.1, 0.05, -0.1, 0.1, 0.1, 0.05])
    force = model.terms(q, 0 * q).external_force
    gradient = slope(lambda at: model.energy(at, 0 * at).load, q, 1e-5)
    np.testing.assert_allclose(force, -gradient, rtol=1e-6, atol=1e-8 * np.abs(force).max())
    work = workspace_at(model, q)
    G = work.G.copy()
    add_implicit(model.arm, work)
    expected = -slope(lambda at: model.terms(at, 0 * at).external_force, q, 1e-5)
    np.testing.assert_allclose(work.G - G, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())
