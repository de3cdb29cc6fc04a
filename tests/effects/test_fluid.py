"""Fluid: drag, added mass and buoyancy against closed forms, and the powers that they take and
give."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.file import load_scene

LENGTH = 0.3  # [m]
RADIUS = 0.01  # [m]
YOUNG = 5e5  # [Pa]
DENSITY = 1070.0  # [kg/m^3]
AREA = np.pi * RADIUS**2  # [m^2]
INERTIA = np.pi * RADIUS**4 / 4  # second moment of area [m^4]
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
NO_DRAG = {"effects.fluid.normal_drag": 0.0, "effects.fluid.tangential_drag": 0.0}
FLAT = {
    "segments.0.radius": None,
    "segments.0.section": {"type": "rectangle", "width": 0.004, "height": 0.02},
    "segments.0.discs": {"mass": 1e-3, "radius": 0.02, "thickness": 0.002, "number": 3},
}


@pytest.mark.no_jit
def test_deflection_in_a_cross_stream(uniform):
    """A uniform load w = 1/2 rho C_n 2 r U^2 bends a cantilever by w L^4 / (8 E I) at the tip."""
    speed = 0.01
    model = uniform(
        ("bend_y", "bend_z"),
        2,
        {"effects.fluid": {"density": 1000.0, "current": [0.0, 0.0, speed], "normal_drag": 1.2}},
    )
    tip = static_equilibrium(model, np.zeros(3)).tip_pose[:3, 3]
    load = 0.5 * 1000.0 * 1.2 * 2 * RADIUS * speed**2
    expected_deflection = load * LENGTH**4 / (8 * YOUNG * INERTIA)
    np.testing.assert_allclose(tip[2], expected_deflection, rtol=2e-3)
    assert abs(tip[1]) < 1e-12


@pytest.mark.no_jit
@pytest.mark.parametrize("shape", [{}, FLAT], ids=["round", "flat"])
def test_added_mass_in_a_current_follows_from_the_energy_of_the_relative_motion(
    uniform, workspace_at, slope, shape
):
    """Lagrange's equations of 1/2 s A s - 1/2 v A v = -v A U + 1/2 U A U, with U the current in the
    frame of the slice and A its added mass across the rod, by differences."""
    current = np.array([0.3, -0.2, 0.5])
    fluid = {
        "effects.fluid": {"density": 1000.0, "current": current.tolist(), "disc_drag": 0.0},
        **NO_DRAG,
        "quadrature.intervals": 4,
        **shape,
    }
    model = uniform(("torsion", "bend_y", "bend_z"), 0, fluid)
    n = 3
    q = np.array([1.0, 2.0, -3.0])
    v = np.array([2.0, 5.0, 3.0])
    added = model.scene.effects.fluid.added_inertia(model.discretisation)
    A = np.zeros((len(added), 3))
    A[:, 1:] = added[:, 4:]

    def parts(q):
        work = workspace_at(model, q)
        packed_pose = work.kinematics.pose.reshape(-1, 12, LANES)
        pose = np.moveaxis(packed_pose, 1, 2).reshape(-1, 12)
        packed_J = work.kinematics.J.reshape(n, -1, 6, LANES)
        J = np.moveaxis(packed_J, 2, 3).reshape(n, -1, 6)
        linear = J[..., 3:]
        # the fluid's velocity in the section's frame
        rotation = pose[:, :9].reshape(-1, 3, 3)
        U = np.einsum("iab,a->ib", rotation, current)
        momentum = -np.einsum("ia,nia,ia->n", A, linear, U)
        energy = 0.5 * np.einsum("ia,ia,ia->", A, U, U)
        return np.append(momentum, energy)

    gradient = slope(parts, q, 1e-5)
    momentum = gradient[:n]
    potential = gradient[n]
    expected = -(momentum @ v - v @ momentum - potential)
    found = model.terms(q, v).external_force
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8 * largest)


def test_a_flat_section_with_discs(uniform):
    """What moves along y is as wide as the height, and discs add their rims, faces and volume
    beyond the rod."""
    fluid = {"density": 1000.0, "normal_drag": 1.0, "tangential_drag": 0.0, "disc_drag": 1.0}
    model = uniform(changes={**FLAT, "effects.fluid": fluid, "quadrature.intervals": 6})
    found = model.scene.effects.fluid.parameters(model.discretisation)
    rod = model.discretisation.over_nodes(
        lambda arc_length: np.ones((arc_length.size, 1))
    ).sum()  # length, less the share of the base
    y, z = ((500.0 * (rod * width + 3 * (0.04 - width) * 0.002)) for width in (0.02, 0.004))
    for part, total in (
        (found.normal_y**1.5, y),
        (found.normal_z**1.5, z),
        (found.tangential, 1500.0 * (np.pi * 4e-4 - 8e-5)),
    ):
        np.testing.assert_allclose(part.sum(), total, rtol=1e-3)
    np.testing.assert_allclose(
        found.displaced.sum(), 1e3 * (8e-5 * rod + 3 * 0.002 * (np.pi * 4e-4 - 8e-5)), rtol=1e-3
    )
    np.testing.assert_allclose(
        found.added_y.sum(), 1e3 * np.pi * (1e-4 * rod + 3 * 0.002 * 3e-4), rtol=1e-3
    )
    np.testing.assert_allclose(
        found.added_z.sum(), 1e3 * np.pi * (4e-6 * rod + 3 * 0.002 * 3.96e-4), rtol=1e-3
    )


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param({}, marks=pytest.mark.no_jit, id="round"),
        pytest.param(FLAT, id="flat", marks=pytest.mark.slow),
    ],
)
def test_damping_is_the_derivative_of_the_drag(uniform, workspace_at, slope, shape):
    """-dF/dq_dot = J^T (node damping) J, symmetric and not negative; without the added mass, whose
    share is no damping."""
    changes = {
        "effects.fluid": {"density": 1000.0, "current": [0.2, -0.1, 0.3], "added_mass": 0.0},
        "quadrature.intervals": 4,
        **shape,
    }
    model = uniform(("torsion", "bend_y", "bend_z"), 0, changes)
    q = np.array([1.0, 2.0, -3.0])
    v = np.array([2.0, 5.0, 3.0])
    work = workspace_at(model, q, v)
    D = work.matrices.D.copy()
    add_implicit(model.arm, work)
    found = work.matrices.D - D
    expected = -slope(lambda rates: model.terms(q, rates).external_force, v, 1e-5)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-8 * largest)
    largest = np.abs(found).max()
    assert np.linalg.eigvalsh(found).min() > -1e-12 * largest


def test_potential_energy(build, slope):
    """Its gradient is the force on the arm at rest."""
    model = build("paper", {**GRAVITY, "effects.fluid.density": 300.0})
    q = np.linspace(0.0, 4.0, 10)
    gradient = slope(lambda at: model.energy(at, 0 * at).load, q, 1e-4)
    np.testing.assert_allclose(
        -gradient, model.terms(q, 0 * q).external_force, rtol=1e-6, atol=1e-9
    )


def straight_arm(changes):
    """The arm with three tendons on six intervals, with two constant curvatures and a stretch."""
    strains = ["bend_y", "bend_z", "stretch"]
    modes = [{"strains": strains, "order": 0, "span": "rod"}]
    strain = {"strain": {"type": "explicit", "modes": modes}}
    scene = load_scene("three_tendon").replace({**strain, **changes})
    return model_on(scene, 6)


@pytest.mark.no_jit
@pytest.mark.parametrize("velocity", [(0.3, 0.0, 0.0), (-0.2, 0.4, 0.0), (0.1, -0.3, 0.2)])
def test_drag_of_a_rod_that_is_carried_through_still_water_is_morisons(velocity):
    """-1/2 rho C_t 2 pi r |v_x| v_x along it and -1/2 rho C_n 2 r |v_n| v_n across, per length; a
    stream the other way does the same."""
    density = 1000.0
    fluid = {"density": density, "normal_drag": 1.2, "tangential_drag": 0.02, "added_mass": 0.0}
    x, y, z = velocity
    surface = 2.0 * np.pi * RADIUS
    width = 2.0 * RADIUS
    along = -0.5 * density * 0.02 * surface * abs(x) * x
    across = -0.5 * density * 1.2 * width * np.hypot(y, z)
    # displacements by a constant curvature are s^2 / 2, by a constant stretch s
    about_y = -across * z * LENGTH**3 / 6
    about_z = across * y * LENGTH**3 / 6
    stretch = along * LENGTH**2 / 2
    still = np.zeros(3)
    opposite = [-part for part in velocity]
    carried = {"effects.fluid": fluid, "effects.moving_base.velocity": list(velocity)}
    stream = {"effects.fluid": {**fluid, "current": opposite}}
    for changes in (carried, stream):
        force = straight_arm(changes).terms(still, still).external_force
        np.testing.assert_allclose(force, [about_y, about_z, stretch], rtol=1e-9, atol=1e-15)


@pytest.mark.no_jit
def test_buoyancy_and_added_mass_are_those_of_the_displaced_fluid():
    """(rho_rod - rho) A g; rho A across the rod where C_a is 1, and none along it."""
    fluid = {"effects.fluid": {"density": 800.0, "added_mass": 1.0}}
    gravity = {"effects.gravity.acceleration": [0.0, -3.0, 0.0]}
    still = np.zeros(3)
    dry = straight_arm(gravity).terms(still, still)
    both = {**gravity, **fluid}
    wet = straight_arm(both).terms(still, still)
    immersed = straight_arm(fluid).terms(still, still)
    share = 1.0 - 800.0 / DENSITY
    expected_external_force = share * dry.external_force
    np.testing.assert_allclose(wet.external_force, expected_external_force, atol=1e-12)
    np.testing.assert_allclose(immersed.external_force, 0.0, atol=1e-15)
    bending = 800.0 * AREA * LENGTH**5 / 20.0  # int (s^2 / 2)^2 ds
    np.testing.assert_allclose(
        np.diag(immersed.mass - dry.mass), [bending, bending, 0.0], rtol=1e-6, atol=1e-15
    )
