"""Contact with obstacles: signed distances, balance of forces, sticking and sliding, energy, steps
of 20 ms without tunnelling."""

import numpy as np
import pytest

from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.effects.contact.forces import STICTION_SPEED
from soft_tendon_env.effects.contact.obstacles import body_at, distance
from soft_tendon_env.effects.contact.samples import SMOOTHING
from soft_tendon_env.model.contact_forces import contact_forces
from soft_tendon_env.model.simulation import Simulation

RADIUS = 0.01  # of the arm of three tendons
FLOOR = {"type": "plane", "position": [0.0, 0.0, -RADIUS]}  # which the straight arm just touches
KINDS = [
    {"type": "plane", "position": [0.1, 0.2, 0.3], "axis": [1.0, -2.0, 0.5]},
    {"type": "sphere", "position": [0.1, 0.2, 0.3], "radius": 0.2},
    {
        "type": "capsule",
        "position": [0.1, 0.2, 0.3],
        "axis": [1.0, -2.0, 0.5],
        "radius": 0.1,
        "length": 0.4,
    },
    {
        "type": "cylinder",
        "position": [0.1, 0.2, 0.3],
        "axis": [1.0, -2.0, 0.5],
        "radius": 0.1,
        "length": 0.4,
    },
    {
        "type": "box",
        "position": [0.1, 0.2, 0.3],
        "size": [0.2, 0.3, 0.4],
        "rotation": [20.0, -30.0, 40.0],
    },
]
SOLIDS = {
    "floor": {"type": "plane", "position": [0.0, 0.0, -0.05]},
    "incline": {"type": "plane", "position": [0.0, 0.0, -0.03], "axis": [0.0, -0.3, 1.0]},
    "ball": {"type": "sphere", "position": [0.2, 0.0, -0.08], "radius": 0.05},
}
RISE = {0.02: 1e-4, 0.005: 1e-3, 0.001: 1e-9}
"""Step [s]: largest part of the energy lost that 20 ms may bring back; extrapolated steps across
the beginning of slip bring some."""


def three_tendon(build, obstacles, friction=0.0, *, changes=()):
    table = {"obstacles": obstacles, "friction": friction}
    return build(
        "three_tendon", {"quadrature.intervals": 6, "effects.contact": table, **dict(changes)}
    )


def pressed_arm(build, pull, friction, **changes):
    """An arm whose tip is pressed on the floor with 1 N and pulled along it."""
    return three_tendon(
        build, [FLOOR], friction, changes={"effects.tip_load.force": [0.0, pull, -1.0], **changes}
    )


def simulate_to_rest(model, seconds=5.0, tension=None):
    """The simulation after this time."""
    simulation = Simulation(model)
    if tension is None:
        tension = np.zeros(model.tendon_count)
    for _ in range(round(seconds / 0.02)):
        simulation.step(tension, 0.02)
    return simulation


def body_of(obstacle, time=0.0):
    return body_at(Contact(obstacles=[obstacle]).rows(), 0, time)


@pytest.mark.no_jit
@pytest.mark.parametrize("obstacle", KINDS, ids=lambda obstacle: obstacle["type"])
def test_signed_distances_have_their_gradients(obstacle):
    body = body_of(obstacle)
    rng = np.random.default_rng(0)
    h = 1e-6
    differences = []
    for x in rng.uniform(-0.5, 0.5, (60, 3)):
        _, gradient = distance(body, tuple(x))
        assert np.linalg.norm(gradient) == pytest.approx(1.0, abs=1e-12)
        slope = [
            (distance(body, tuple(x + h * e))[0] - distance(body, tuple(x - h * e))[0]) / (2 * h)
            for e in np.eye(3)
        ]
        difference = np.array(gradient) - slope
        differences.append(np.abs(difference).max())
    assert (
        np.sort(differences)[-3] < 1e-6
    )  # two may lie next to an edge, where there are two gradients
    assert np.median(differences) < 1e-8


def test_an_obstacle_moves_as_it_is_told():
    obstacle = {
        **KINDS[4],
        "velocity": [0.1, 0.2, -0.3],
        "amplitude": [0.0, 0.05, 0.0],
        "frequency": 0.7,
        "phase": 30.0,
    }
    time = 0.6
    h = 1e-6
    times = (time, time - h, time + h)
    here, before, after = (body_of(obstacle, t) for t in times)
    amplitude = np.array([0.0, 0.05, 0.0])
    angle = 2 * np.pi * 0.7 * time + np.radians(30.0)
    swing = amplitude * np.sin(angle)
    np.testing.assert_allclose(
        here.r, [0.1, 0.2, 0.3] + time * np.array([0.1, 0.2, -0.3]) + swing, atol=1e-14
    )
    way = np.subtract(after.r, before.r)
    expected_velocity = way / (2 * h)
    np.testing.assert_allclose(here.velocity, expected_velocity, atol=1e-8)
    np.testing.assert_allclose(
        Contact(obstacles=[obstacle]).obstacles[0].pose(time)[:3, 3], here.r, atol=1e-14
    )


def test_an_arm_rests_on_the_floor(build):
    """All forces balance: the floor and the base carry the weight; a sample sinks in by force over
    stiffness."""
    passive = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 3, "span": "rod"}]
    changes = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.passive": passive}
    model = three_tendon(build, [FLOOR], changes=changes)
    contact = contact_forces(model, simulate_to_rest(model).state)
    sample_force = contact.sample_force[0]
    sum_of_samples = sample_force.sum(axis=0)
    np.testing.assert_allclose(contact.force[0], sum_of_samples)
    np.testing.assert_allclose(sample_force[:, :2], 0.0, atol=1e-12)
    # the middle of the arm carries the weight of its length
    inside = slice(5, -5)
    spacing = np.diff(contact.arc_length)[4:-5]
    force_per_length = sample_force[inside, 2] / spacing
    area = np.pi * RADIUS**2
    weight = 1070.0 * area * 9.81
    np.testing.assert_allclose(force_per_length.mean(), weight, rtol=0.02)
    # quadratic up to the smoothing depth e, then linear
    square = (2.0 * RADIUS) ** 2
    k = model.scene.segments[0].young_modulus * area / square
    e = SMOOTHING * RADIUS
    depth = -contact.gap[0, inside]
    quadratic = k * depth**2 / (2 * e)
    linear = k * (depth - e / 2)
    expected = np.where(depth < e, quadratic, linear)
    np.testing.assert_allclose(force_per_length, expected, rtol=1e-9)
    smallest_gap = contact.gap.min()
    assert contact.penetration[0] == pytest.approx(-smallest_gap)
    assert contact.clearance[0] == -contact.penetration[0]


def test_forces_are_those_of_a_potential(build):
    """F = -dV/dq at rest."""
    obstacles = [FLOOR, {"type": "sphere", "position": [0.25, 0.012, 0.105], "radius": 0.1}]
    model = three_tendon(build, obstacles)
    n = model.coordinate_count
    still = np.zeros(n)
    h = 1e-4 * model.coordinate_scale()
    falls = [
        0.5 * (model.energy(-way, still).load - model.energy(way, still).load) for way in np.diag(h)
    ]
    work = model.terms(still, still).external_force * h
    assert np.abs(work).max() > 0.0
    greatest = np.abs(work).max()
    np.testing.assert_allclose(work, falls, rtol=1e-4, atol=1e-6 * greatest)


@pytest.mark.parametrize("step", [0.02, 0.005])
def test_friction_sticks_below_its_limit_and_slides_above(build, step):
    """The beam on the floor's stiffness carries nothing of the pull: it slides where that exceeds
    mu N."""
    mu = 0.5
    arm = pressed_arm(build, 0.9 * mu, mu, **{"integrator.step": step})
    held = Simulation(arm)
    places = []
    for _ in range(250):
        held.step(np.zeros(3), 0.02)
        places.append(held.tip_pose[:3, 3])
    assert abs(places[-1][1]) < 3e-3
    last = places[-1][1]
    first = places[-51][1]
    assert 0.0 < last - first < 3.0 * STICTION_SPEED  # creep in a second
    arm = pressed_arm(build, 1.1 * mu, mu, **{"integrator.step": step})
    slid = simulate_to_rest(arm)
    assert slid.tip_pose[1, 3] > 0.05


@pytest.mark.parametrize("step", [0.02, pytest.param(0.005, marks=pytest.mark.slow), 0.001])
@pytest.mark.parametrize("solid", SOLIDS)
def test_energy_never_grows_with_friction(build, solid, step):
    """Of an arm thrown across what it falls on: kinetic, elastic, of gravity and of the obstacle
    pressed."""
    passive = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 3, "span": "rod"}]
    changes = {
        "effects.gravity.acceleration": [0.0, 0.0, -9.81],
        "strain.passive": passive,
        "integrator.step": step,
    }
    model = three_tendon(build, [SOLIDS[solid]], 0.6, changes=changes)
    simulation = Simulation(model)
    total = []
    speed = np.zeros(model.coordinate_count)
    speed[1:3] = 40.0, -40.0  # [N/s]
    simulation.reset(None, speed)
    for _ in range(100):
        simulation.step(np.zeros(3), 0.02)
        state = simulation.state
        total.append(model.energy(state.q, state.q_dot).total)
    assert contact_forces(model, simulation.state).force[0, 2] > 0.1
    loss = total[0] - total[-1]
    assert np.diff(total).max() < RISE[step] * loss


@pytest.mark.no_jit
def test_interpreted_kernels_run(build):
    model = pressed_arm(build, 0.3, 0.5)
    simulation = Simulation(model)
    simulation.step(np.zeros(3), 0.02)
    found = contact_forces(model, simulation.state)
    upwards = found.force[0, 2]
    backwards = found.force[0, 1]
    assert upwards > 0.0 > backwards
    assert simulation.state.effects.size == 0
