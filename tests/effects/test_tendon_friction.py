"""Tendon friction: what it takes is never negative, wherever a tendon slides; pull and release of
stiff guides against a distributed Coulomb tendon."""

import numpy as np
import pytest

from soft_tendon_env import ConfigurationError, Scene, Simulation, build_model, load_scene
from soft_tendon_env.mechanics.motion.extrapolation import evaluate_force
from soft_tendon_env.mechanics.motion.implicit_euler import start_matrices
from soft_tendon_env.mechanics.motion.scratch import make_scratch
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.terms.external_forces import effect_loads
from soft_tendon_env.mechanics.types import StaticsBased
from soft_tendon_env.model.step_control import step_method

STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
EXPLICIT = {"type": "explicit", "modes": [{"strains": STRAINS, "order": 2, "span": "rod"}]}
MOMENTS = [{"strains": STRAINS[:3], "order": 2, "span": "rod"}]
STATICS = {"type": "statics_based", "passive": MOMENTS}


def random_scene(seed, strain, coefficient=None, elastic=False):
    """A random arm of one to three segments with straight and helical tendons, commands (n_a,), and
    the stiffness [N/m] and the strength [N] of its tendons, if they are elastic."""
    random = np.random.default_rng(seed)
    segments = int(random.integers(1, 4))
    length = random.uniform(0.1, 0.5)
    radius = random.uniform(0.004, 0.015)
    modulus = 10.0 ** random.uniform(5.0, 6.5)
    segment = {
        "length": length / segments,
        "young_modulus": modulus,
        "poisson_ratio": 0.45,
        "density": 1100.0,
        "damping": modulus * 10.0 ** random.uniform(-3.0, -1.5),
        "radius": radius,
    }
    offset = 0.7 * radius
    # the tension that bends the arm by about a radian
    unit = modulus * np.pi * radius**4 / 4.0 / (offset * length)
    tendons = []
    for i in range(int(random.integers(1, 5))):
        phase = random.uniform(0.0, 2.0 * np.pi)
        straight = {
            "type": "straight",
            "offset": [offset * np.cos(phase), offset * np.sin(phase)],
        }
        helix = {
            "type": "helix",
            "radius": offset,
            "angular_rate": random.uniform(3.0, 15.0) / length,
            "phase": phase,
        }
        if random.random() < 0.5:
            routing = helix
        else:
            routing = straight
        tendon = {"routing": routing, "tension_limits": [0.0, 4.0 * unit]}
        if segments > 1 and i % 2:
            tendon["end"] = length / segments
        tendons.append(tendon)
    tension = unit * random.uniform(0.0, 1.5, len(tendons))
    stiffness = unit / (0.02 * length) * 10.0 ** random.uniform(-0.5, 1.5)
    if coefficient is None:
        coefficient = random.uniform(0.05, 1.0)
    speed = 10.0 ** random.uniform(-6.0, -3.0)
    effects = {"tendon_friction": {"coefficient": coefficient, "stiction_speed": speed}}
    command = tension
    if elastic:
        command = tension / stiffness
        effects["tendon_elasticity"] = {
            "stiffness": stiffness,
            "displacement_limits": [-length, length],
            "strength": 4.0 * unit,
        }
    table = {
        "name": "random",
        "segments": [segment] * segments,
        "tendons": tendons,
        "strain": strain,
        "quadrature": {"intervals": 6},
        "integrator": {"tolerance": 1e-7 * length},
        "effects": effects,
    }
    return Scene.model_validate(table), command, stiffness, 4.0 * unit


def stored(command, model, q, stiffness, strength):
    """Energy [J] of elastic tendons under displacements (n_a,)."""
    slack_length = model.tendon_lengths(0.0 * q)
    shortening = slack_length - model.tendon_lengths(q)
    stretched = np.maximum(command - shortening, 0.0)
    # beyond its strength a drive gives way
    within = np.minimum(stretched, strength / stiffness)
    given_way = stretched - within
    energies = 0.5 * stiffness * within**2 + strength * given_way
    return float(np.sum(energies))


def energies(scene, command, stiffness, strength, duration):
    """Energies H (samples,) and kinetic ones [J] every 10 ms, of an arm from its stress-free state
    under commands that are held."""
    model = build_model(scene, "scene")
    # the same arm without effects has an energy
    bare = build_model(scene.replace({"effects": {}}), "scene")
    is_elastic = model.command_unit == "m"
    simulation = Simulation(model)
    simulation.reset(np.zeros(model.coordinate_count))
    totals = []
    kinetic = []
    for _ in range(round(duration / 0.01)):
        simulation.step(command, 0.01)
        q = simulation.state.q
        energy = bare.energy(q, simulation.state.q_dot)
        pulled = command @ model.tendon_lengths(q)
        if is_elastic:
            pulled = stored(command, model, q, stiffness, strength)
        total = energy.kinetic + energy.elastic + pulled
        totals.append(total)
        kinetic.append(energy.kinetic)
    return np.array(totals), np.array(kinetic)


def arms(count):
    """Seed, strain and whether tendons are elastic, of random arms; all but four are slow."""
    cases = []
    for seed in range(count):
        if seed < 4:
            marks = []
        else:
            marks = [pytest.mark.slow]
        strain = (EXPLICIT, STATICS)[seed % 2]
        case = pytest.param(seed, strain, seed % 4 > 1, marks=marks)
        cases.append(case)
    return cases


@pytest.mark.parametrize(("seed", "strain", "elastic"), arms(40))
def test_energy_never_grows_and_arms_come_to_rest_sooner(seed, strain, elastic):
    """H = kinetic + elastic + T L, or with elastic tendons the energy in them, falls under commands
    that are held; the arm has less kinetic energy for good sooner than without friction. An
    overdamped one does not swing: it creeps to its rest, later where friction takes pull away."""
    random_arm = random_scene(seed, strain, elastic=elastic)
    totals, kinetic = energies(*random_arm, duration=0.6)
    assert np.diff(totals).max() <= 1e-9 * np.ptp(totals)
    smooth = random_scene(seed, strain, coefficient=0.0, elastic=elastic)
    _, without = energies(*smooth, duration=0.6)
    threshold = 0.05 * without.max()
    inner = without[1:-1]
    is_peak = (inner > without[:-2]) & (inner > without[2:])
    swings = is_peak & (inner > threshold)
    if swings.any():
        assert np.sum(kinetic > threshold) <= np.sum(without > threshold)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("strain", [EXPLICIT, STATICS])
def test_power_of_friction_is_what_slides_times_what_the_tension_falls(strain, sign):
    """sum_k (T_k - T_k-1) v_k of the borders is the power of the stresses, and negative at every
    border, at random states and for tendons that push too."""
    friction = {"coefficient": 0.7, "stiction_speed": 1e-3}
    changes = {"strain": strain, "effects.tendon_friction": friction}
    scene = load_scene("helical").replace(changes)
    model = build_model(scene, "scene")
    random = np.random.default_rng(0)
    method = step_method(model)
    scratch = make_scratch(model.arm, method.columns)
    work = scratch.work
    tension = sign * random.uniform(0.5, 1.0, model.tendon_count)
    for _ in range(5):
        unit = model.coordinate_scale()
        q = unit * random.normal(size=unit.size)
        if isinstance(model.arm.strain, StaticsBased):
            q = 0.3 * np.abs(q)
        q_dot = unit * random.normal(size=unit.size)
        work.strain.xi[:] = model.arm.rod.reference_strain
        state = np.zeros(0)
        assert evaluate_force(model.arm, method, tension, q, q_dot, state, 0.0, scratch) == OK
        start_matrices(model.arm, scratch)
        effect_loads(model.arm, True, work)
        power = np.sum(work.loads.stress * work.strain.xi_dot)

        borders = scratch.first.borders
        points = borders.turn.size // model.tendon_count
        rows = borders.row.reshape(model.tendon_count, points, -1)[..., : q.size]
        sliding = rows @ q_dot
        directions = sliding / np.hypot(sliding, friction["stiction_speed"])
        turns = sign * borders.turn.reshape(sliding.shape)
        left = tension[:, None] * np.exp(-np.cumsum(turns * directions, axis=1))
        falls = np.diff(left, axis=1, prepend=tension[:, None])
        assert (falls * sliding <= 0.0).all()
        assert np.sum(falls * sliding) < 0.0
        np.testing.assert_allclose(np.sum(falls * sliding), power, rtol=1e-9)
        np.testing.assert_allclose(work.friction.rate.reshape(sliding.shape), sliding, atol=1e-9)


LENGTH = 0.3
OFFSET = 0.008
RADIUS = 0.01
MODULUS = 5e9


def guide(coefficient, turn, stiction_speed):
    """A stiff guide of two equal parts with one tendon, bent by an angle [rad] to begin with."""
    bent = {"strains": ["bend_z"], "order": 9, "span": "piece"}
    segment = {
        "length": 0.5 * LENGTH,
        "young_modulus": MODULUS,
        "poisson_ratio": 0.45,
        "density": 1000.0,
        "damping": 1e6,
        "radius": RADIUS,
        "curvature": [0.0, 0.0, turn / LENGTH],
    }
    tendon = {
        "routing": {"type": "straight", "offset": [OFFSET, 0.0]},
        "tension_limits": [0.0, 8.0],
    }
    friction = {"coefficient": coefficient, "stiction_speed": stiction_speed}
    table = {
        "name": "guide",
        "segments": [segment, segment],
        "tendons": [tendon],
        "strain": {"type": "explicit", "modes": [bent]},
        "quadrature": {"intervals": 12},
        "effects": {"tendon_friction": friction},
    }
    return build_model(Scene.model_validate(table), "scene")


def coulomb_angles(coefficient, turn, pulls):
    """Angles [rad] by which a guide bends under slow pulls, by a tendon of 1,000 elements that each
    stick until they slide."""
    angle = turn * (np.arange(1000) + 0.5) / 1000
    tension = np.zeros(1000)
    angles = []
    for pull in pulls:
        least = pull * np.exp(-coefficient * angle)
        most = pull * np.exp(coefficient * angle)
        tension = np.clip(tension, least, most)
        bending = MODULUS * np.pi * RADIUS**4 / 4.0
        angles.append(tension.mean() * LENGTH * OFFSET / bending)
    return np.array(angles)


@pytest.mark.parametrize(
    ("coefficient", "turn", "stiction_speed"),
    [(0.3, 1.8, 1e-10), (1.0, 1.8, 1e-12), (0.3, 3.6, 1e-12), (1.0, 3.6, 1e-10)],
)
def test_stiff_guide_is_pulled_and_released(coefficient, turn, stiction_speed):
    """Bending within 2 % of that by a distributed Coulomb tendon, at 5e-7 m/s and less."""
    pulls = (2.0, 4.0, 2.0, 1.0)
    simulation = Simulation(guide(coefficient, turn, stiction_speed))
    simulation.reset_at_rest()

    def angle():
        pose = simulation.tip_pose
        return np.unwrap([turn, np.arctan2(pose[1, 0], pose[0, 0])])[1]

    start = angle()
    before = 0.0
    angles = []
    for pull in pulls:
        for i in range(40):
            simulation.step([before + (pull - before) * (i + 1) / 40], 0.05)
        before = pull
        angles.append(angle() - start)
    expected_angles = coulomb_angles(coefficient, turn, pulls)
    np.testing.assert_allclose(angles, expected_angles, rtol=0.02)


MOTIONS_BY_FIXED_STEPS = [
    ("helical", 0.4, 0.01, 11),
    pytest.param("helical", 0.9, 0.002, 12, marks=pytest.mark.slow),
    pytest.param("three_tendon", 0.6, 0.004, 13, marks=pytest.mark.slow),
    pytest.param("four_tendon", 0.9, 0.004, 13, marks=pytest.mark.slow),
    pytest.param("two_segment_six", 0.7, 0.005, 11, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "coefficient", "step", "seed"), MOTIONS_BY_FIXED_STEPS)
def test_fixed_steps_estimate_what_directions_that_turn_within_them_err(
    name, coefficient, step, seed
):
    """No less than the rod's root mean square displacement from a converged motion, under tensions
    that jump within their limits."""
    scene = load_scene(name)
    changes = {"strain": STATICS, "effects.tendon_friction.coefficient": coefficient}
    simulations = []
    for tolerance in (None, 1e-6 * scene.segments[0].length):
        integrator = {"step": step, "tolerance": tolerance, "max_halvings": 18}
        model = build_model(scene.replace({**changes, "integrator": integrator}), "scene")
        simulations.append(Simulation(model))
    fixed, converged = simulations
    random = np.random.default_rng(seed)
    greatest = np.array([tendon.tension_limits[1] for tendon in scene.tendons])
    estimate = 0.0
    largest = 0.0
    for _ in range(30):
        tension = greatest * random.uniform(size=greatest.size)
        estimate += fixed.step(tension, 0.02).error
        converged.step(tension, 0.02)
        curves = [one.model.backbone(one.state.q, points=20) for one in simulations]
        offset = (curves[0] - curves[1])[:, :3, 3]
        largest = max(largest, np.sqrt(np.mean(np.sum(offset**2, axis=1))))
    assert largest <= estimate


@pytest.mark.parametrize(("name", "coefficient"), [("helical", 0.5), ("two_segment_six", 0.8)])
def test_steps_hold_the_least_stiction_speed_while_tensions_jump(name, coefficient):
    """Steps of 20 ms stay whole but for some, and what they lead to is what a larger speed has."""
    scene = load_scene(name)
    tips = []
    for speed in (1e-12, 1e-9):
        friction = {"coefficient": coefficient, "stiction_speed": speed}
        model = build_model(scene.replace({"effects.tendon_friction": friction}), "scene")
        simulation = Simulation(model)
        simulation.reset_at_rest()
        random = np.random.default_rng(0)
        greatest = np.array([tendon.tension_limits[1] for tendon in scene.tendons])
        rejected = 0
        for _ in range(10):
            tension = greatest * random.uniform(size=greatest.size)
            for _ in range(5):
                rejected += simulation.step(tension, 0.02).rejected
        assert rejected <= 20
        tips.append(simulation.tip_pose[:3, 3])
    np.testing.assert_allclose(tips[0], tips[1], atol=0.01 * model.length)


def test_a_stiction_speed_below_round_off_is_refused():
    changes = {"effects.tendon_friction": {"coefficient": 0.1, "stiction_speed": 1e-13}}
    with pytest.raises(ConfigurationError, match=r"stiction_speed.*greater than or equal to"):
        load_scene("three_tendon").replace(changes)
