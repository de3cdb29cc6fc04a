"""Fields of a workspace over points and nodes, derivatives of the strain, and terms beside
reference numbers."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_rate
from soft_tendon_env.mechanics.workspace import make_workspace

TOLERANCE = 1e-12
PAIRS = {
    "mass": "mass",
    "bias": "coriolis_bias",
    "damping": "damping",
    "actuation": "actuation",
    "elastic_force": "elastic_force",
    "external_force": "gravity_force",
    "stiffness": "drive_stiffness",
    "tip_jacobian": "tip_jacobian",
}
"""Keys of the reference numbers, by the field of Terms."""


@pytest.fixture(scope="session")
def at_points():
    """at_points(model, field): a field over points as (..., points, 6), padding left out."""
    return lambda model, field: model.grid.unpacked(
        field.reshape(-1, model.arm.rod.weight.size * 6)
    )


@pytest.fixture(scope="session")
def check_derivatives(workspace_at, at_points):
    """check_derivatives(model, q, q_dot, rounding=0.0): Phi = d xi / d q, xi_dot = Phi q_dot,
    xi_bias = (d/dt Phi) q_dot, by central differences; and the rate alone."""

    def check(model, q, q_dot, rounding=0.0):
        unit = model.coordinate_scale()
        work = workspace_at(model, q, q_dot)
        Phi = at_points(model, work.strain.Phi)
        xi_dot = at_points(model, work.strain.xi_dot)[0]
        for j in range(0, q.size, 1 if q.size < 20 else 7):
            step = 1e-4 * unit[j] * np.eye(q.size)[j]
            _, xi_ahead = model.strain(q + step)
            _, xi_behind = model.strain(q - step)
            difference = (xi_ahead - xi_behind) / (2e-4 * unit[j])
            largest = np.abs(Phi[j]).max()
            np.testing.assert_allclose(Phi[j], difference, atol=1e-6 * largest)
        fastest = np.abs(xi_dot).max()
        np.testing.assert_allclose(
            xi_dot,
            np.einsum("j,jmi->mi", q_dot, Phi),
            rtol=1e-12,
            atol=1e-13 * fastest,
        )
        h = 1e-4 / np.abs(q_dot / unit).max()
        q_ahead = q + h * q_dot
        ahead = at_points(model, workspace_at(model, q_ahead).strain.Phi)
        q_behind = q - h * q_dot
        behind = at_points(model, workspace_at(model, q_behind).strain.Phi)
        change = np.einsum("j,jmi->mi", q_dot, ahead - behind)
        expected = change / (2 * h)
        round_off = rounding * fastest / h
        atol = 1e-6 * np.abs(expected).max() + round_off
        bias = at_points(model, work.strain.xi_bias)[0]
        np.testing.assert_allclose(bias, expected, atol=atol)
        alone = make_workspace(model.arm)
        strain = alone.strain
        strain.xi[:] = model.packed_strain(q)
        assert strain_from_guess(model.arm, q, TOLERANCE, strain, alone.kinematics) == -1
        strain_rate(model.arm, q_dot, strain)
        np.testing.assert_allclose(
            at_points(model, strain.xi_dot)[0],
            xi_dot,
            rtol=1e-10,
            atol=1e-11 * fastest,
        )

    return check


@pytest.fixture(scope="session")
def check_terms():
    """check_terms(found, expected, most): terms against reference numbers, to relative errors
    `most` by field, and the tip's pose."""

    def check(found, expected, most):
        for field, allowed in most.items():
            if field != "tip_pose":
                right = np.array(expected[PAIRS[field]])
                size = max(np.abs(right).max(), 1e-9)
                off = np.abs(getattr(found, field) - right)
                error = off.max() / size
                assert error < allowed, f"{field}: {error:.1e}"
        np.testing.assert_allclose(
            found.tip_pose[:3, 3], expected["tip_position"], atol=most["tip_pose"]
        )
        np.testing.assert_allclose(
            found.tip_pose[:3, :3], expected["tip_rotation"], atol=most["tip_pose"]
        )

    return check
