"""Model: what its methods refuse, where the strain ends, strains at any place, and a mass matrix
that is singular."""

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, StrainLimitError, load_scene
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.model import is_singular, model_on
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.statics import commanded_equilibrium

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
        first_seven = [0.0] * 6 + [-2000.0]
        OF_Q[method](paper, first_seven + [0.0] * 3)


@pytest.mark.parametrize("name", ["paper_16dof", "paper_48dof", "four_tendon"])
def test_strains_at_places_are_those_at_the_points_and_their_derivative(name, build, random_state):
    model = build(name, {"quadrature.intervals": 4})
    q, q_dot = random_state(model, 2)
    points, strain = model.strain(q)
    at_points, _ = model.strain_at(q, points)
    np.testing.assert_allclose(at_points, strain, atol=1e-12)
    start = model.grid.start[1]
    end = model.grid.start[2]
    ends = model.strain_at(q, [start, np.nextafter(end, 0.0)])[0]
    place = (start + end) / 2
    middle = model.strain_at(q, [place])[0]
    np.testing.assert_allclose(ends.mean(axis=0), middle[0], atol=1e-12)  # linear in between
    places = [0.0, 0.4 * model.length, model.length]
    h = 1e-6
    found, Phi = model.strain_at(q, places)
    ahead, _ = model.strain_at(q + h * q_dot, places)
    behind, _ = model.strain_at(q - h * q_dot, places)
    difference = (ahead - behind) / (2 * h)
    assert found.shape == (3, 6)
    assert Phi.shape == (3, 6, q.size)
    assert np.abs(difference).max() > 1.0
    largest = np.abs(difference).max()
    np.testing.assert_allclose(Phi @ q_dot, difference, atol=1e-6 * largest)
    slopes = model.strain_at(q, [])[1]
    assert slopes.shape == (0, 6, q.size)


def test_a_singular_mass_matrix_is_warned_of():
    """The only node with mass is the tip, which the linear fields do not turn: they have no
    inertia, not even on the diagonal."""
    strain = {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 1, "span": "rod"}],
    }
    changes = {"strain": strain, "quadrature.intervals": 1}
    scene = load_scene("three_tendon").replace(changes)
    with pytest.warns(
        UserWarning,
        match=(
            "6 coordinates are too many for 1 quadrature intervals per piece: the mass matrix is"
            " singular"
        ),
    ):
        model = build_model(scene)
    terms = model.terms(np.zeros(6), np.zeros(6))
    assert np.diag(terms.mass).min() == 0.0


LENGTH = 0.3  # [m]
RADIUS = 0.01  # [m]
YOUNG = 5e5  # [Pa]
BENDING = YOUNG * np.pi * RADIUS**4 / 4


def test_energies_are_those_of_a_bent_rod(bent):
    """1/2 EI k^2 L stored, 1/2 q_dot M q_dot in motion, and the weight's."""
    q = np.array([1.0, -2.0])
    q_dot = np.array([3.0, 0.5])
    energy = bent.energy(q, q_dot)
    stored = 0.5 * BENDING * LENGTH * (q @ q)
    assert energy.elastic == pytest.approx(stored)
    mass = bent.terms(q, q_dot).mass
    moving = 0.5 * q_dot @ mass @ q_dot
    assert energy.kinetic == pytest.approx(moving)
    parts = energy.kinetic + energy.elastic + energy.load
    assert energy.total == pytest.approx(parts)
    nodes = bent.grid.start + bent.grid.length
    heights = bent.backbone_at(q, nodes)[:, 2, 3]
    weight = 9.81 * bent.arm.rod.node_mass
    assert energy.load == pytest.approx(weight @ heights)


def test_units_of_coordinates_bend_the_arm_by_a_radian(bent):
    """EI / L, in which the metric has its scale and its orthonormal coordinates."""
    assert bent.bending_energy == pytest.approx(BENDING / LENGTH)
    expected = BENDING * LENGTH * np.eye(2)
    np.testing.assert_allclose(bent.metric, expected, rtol=1e-12)
    np.testing.assert_allclose(bent.coordinate_scale(), 1.0 / LENGTH, rtol=1e-12)
    unit = bent.metric_unit
    product = unit.T @ bent.metric @ unit
    np.testing.assert_allclose(product, np.eye(2), atol=1e-12)


def test_places_beyond_the_rod_are_refused(bent):
    for places in ([-1e-9], [0.3 * (1 + 1e-9)]):
        with pytest.raises(ValueError, match="places should lie between 0 and 0.3"):
            bent.arc_lengths("places", places)
    just_beyond = 0.3 * (1 + 1e-13)
    assert bent.arc_lengths("places", [0.0, just_beyond]).size == 2
    assert bent.backbone([0.0, 0.0], 7).shape == (7, 4, 4)
    backbone = bent.backbone([0.0, 0.0], 4)
    np.testing.assert_allclose(backbone[:, 0, 3], [0.0, 0.1, 0.2, 0.3])


def test_singular_matrices_are_told_by_their_scaled_eigenvalues():
    """Whatever the units of their rows."""
    scale = np.diag([1e-6, 1.0, 1e6])
    for correlation, singular in ((0.999, False), (1.0, True)):
        matrix = np.eye(3)
        matrix[0, 1] = matrix[1, 0] = correlation
        assert is_singular(scale @ matrix @ scale) == singular
    assert is_singular(np.diag([1.0, 0.0]))


def test_models_of_other_numbers_fit_and_others_say_why_not(bent):
    """Sizes decide: an effect more, or loads inside of the strain, is another arm."""
    heavier = bent.with_numbers({"segments.0.density": 900.0})
    assert bent.misfit(heavier) == ""
    ratio = heavier.arm.rod.mass / bent.arm.rod.mass
    assert ratio == pytest.approx(900.0 / 1070.0)
    without = bent.with_scene(bent.scene.replace({"effects": {}}))
    assert "which effects act, from gravity to none" in bent.misfit(without)
    assert without.misfit(bent) == ""


def test_evaluations_begin_at_rest_and_at_time_zero_whatever_was_evaluated_before(build):
    """A base that has moved on, and a memory that remembers, are of that evaluation alone."""
    model = build(
        "three_tendon",
        {
            "effects.moving_base": {"amplitude": [0.0, 0.01, 0.0], "frequency": 2.0},
            "effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}],
        },
    )
    q = model.rest_coordinates([2.0, 0.0, 1.0])
    first = model.terms(q, np.zeros(3))
    later = model.terms(q, np.zeros(3), time=0.1)
    assert np.abs(later.tip_pose - first.tip_pose).max() > 1e-3
    with model.workspace() as work:
        work.inputs.state[:] = 1.0
        work.inputs.clock[:] = 0.1
    tip_pose = model.tip_pose(q)
    np.testing.assert_array_equal(tip_pose, first.tip_pose)
    again = model.terms(q, np.zeros(3))
    np.testing.assert_array_equal(again.tip_pose, first.tip_pose)
    np.testing.assert_array_equal(again.external_force, first.external_force)


def test_an_arm_with_memory_that_is_set_to_rest_stays(build):
    """Its branches have relaxed at the strain that it is set to."""
    branches = [{"modulus": 0.5, "relaxation_time": 0.1}]
    model = build("three_tendon", {"effects.viscoelastic_memory.branches": branches})
    tension = [2.0, 0.0, 1.0]
    simulation = Simulation(model)
    q = model.rest_coordinates(tension)
    simulation.reset(q)
    simulation.step(tension, 0.1)
    np.testing.assert_allclose(simulation.state.q, q, rtol=1e-9)


def test_states_are_named_by_what_gives_them_a_meaning(build):
    """Effects with internal states, and those that take other commands than tensions: a state of
    one arm is none of another that has others."""
    no_states = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "effects.fluid.density": 1e3}
    elastic = {"stiffness": 800.0, "displacement_limits": [0.0, 0.05]}
    lag = {"time_constant": 0.03}
    assert build("three_tendon", no_states).state_names == ()
    changes = {**no_states, "effects.tendon_elasticity": elastic, "effects.actuators": lag}
    model = build("three_tendon", changes)
    # a tension and a command that has arrived of each tendon, with the time of that
    rows = model.arm.effects.state.size
    assert rows > 3
    assert set(model.state_names) == {"tendon_elasticity:0", f"actuators:{rows}"}


def test_commands_of_elastic_tendons_are_their_stretch_and_what_the_arm_leaves_of_their_way(build):
    """u / k, and the way along the straight arm less that along the bent one. They lead there."""
    tension = np.array([3.0, 0.5, 1.0])
    elasticity = {"stiffness": 800.0, "displacement_limits": [0.0, 0.05]}
    model = build("three_tendon", {"effects.tendon_elasticity": elasticity})
    q = model.rest_coordinates(tension)
    way = model.tendon_lengths(np.zeros(3)) - model.tendon_lengths(q)
    assert way.max() > 1e-3
    command = model.command(tension, q)
    expected_command = tension / 800.0 + way
    np.testing.assert_allclose(command, expected_command, rtol=1e-12)
    equilibrium, held = commanded_equilibrium(model, command)
    np.testing.assert_allclose(held, tension, rtol=1e-6)
    np.testing.assert_allclose(equilibrium.q, q, rtol=1e-5)
    stiff = build("three_tendon")
    np.testing.assert_array_equal(stiff.command(tension, q), tension)


def test_each_of_many_places_has_to_be_on_the_rod(bent):
    for places in ([0.1, 0.31], [-0.01, 0.2], [0.31, 0.1, 0.2]):
        with pytest.raises(ValueError, match="arc_length should lie between 0 and 0.3"):
            bent.backbone_at([0.0, 0.0], places)
        with pytest.raises(ValueError, match="arc_length should lie between 0 and 0.3"):
            bent.strain_at([0.0, 0.0], places)


def test_the_elastic_force_of_fields_is_their_own_whatever_pulls(build):
    """q . K is twice the energy stored, also where tendons that pull soften the sheared arm."""
    modes = [{"strains": ["bend_z", "shear_y"], "order": 0, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    changes = {"quadrature.intervals": 2, "strain": strain}
    model = build("three_tendon", changes)
    q = np.array([1.0, 0.1])
    still = np.zeros(2)
    pulled = model.terms(q, still, [3.0, 0.0, 1.0])
    stored = model.energy(q, still).elastic
    assert q @ pulled.elastic_force == pytest.approx(2.0 * stored)
    slack = model.terms(q, still)
    np.testing.assert_array_equal(pulled.elastic_force, slack.elastic_force)
    softening = slack.stiffness - pulled.stiffness
    assert np.abs(softening).max() > 1e-3 * np.abs(slack.stiffness).max()


@pytest.mark.parametrize(
    "changes",
    [
        {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}]},
        {"effects.gravity.acceleration": [0.0, 0.0, -9.81]},
    ],
    ids=["memory", "gravity"],
)
def test_models_with_other_scenes_are_those_that_are_built(build, changes):
    """What an evaluation needs is as large as their own effects say."""
    bare = build("three_tendon", {"quadrature.intervals": 2})
    q = bare.rest_coordinates([2.0, 0.0, 1.0])
    q_dot = np.array([3.0, -1.0, 2.0])
    bare.terms(q, q_dot)
    other = bare.with_scene(bare.scene.replace(changes))
    built = build("three_tendon", {"quadrature.intervals": 2, **changes})
    assert other.misfit(built) == ""
    for found, expected in zip(other.terms(q, q_dot), built.terms(q, q_dot), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    back = other.with_scene(bare.scene)
    np.testing.assert_array_equal(back.terms(q, q_dot).mass, bare.terms(q, q_dot).mass)


def test_coordinates_and_rates_that_are_absurd_are_told(build):
    """No rod can be placed there, or no energy be computed."""
    modes = [{"strains": ["bend_y", "stretch"], "order": 0, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    changes = {"quadrature.intervals": 2, "strain": strain}
    model = build("three_tendon", changes)
    still = np.zeros(2)
    with pytest.raises(StrainLimitError, match="too large to place the rod, up to 1e\\+200"):
        model.terms([1e200, 0.0], still)
    with pytest.raises(StrainLimitError, match="too large to place the rod"):
        model.tip_pose([-1e200, 0.0])
    # a rod that is as long has a place, and an infinite mass
    with pytest.raises(StrainLimitError, match="too large to place the rod, up to 1e\\+300"):
        model.terms([0.0, 1e300], still)
    with pytest.raises(OverflowError, match="q_dot are too large to compute with, up to 1e\\+200"):
        model.terms(still, [-1e200, 0.0])


def test_loads_inside_of_a_strain_need_a_base_that_stands_still():
    """Whatever else acts."""
    changes = {
        "strain.include_loads": True,
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "effects.moving_base": {"amplitude": [0.0, 0.01, 0.0], "frequency": 2.0},
        "effects.fluid.density": 1000.0,
    }
    scene = load_scene("three_tendon").replace(changes)
    with pytest.raises(ConfigurationError, match="loads inside of a strain have to stand still"):
        model_on(scene, 2)
