"""Contact with obstacles: signed distances, balance of forces, sticking and sliding, energy, steps of 20 ms without tunnelling."""

import importlib
import json
import math
import os
import pickle
import subprocess
import sys
from typing import Literal

import numpy as np
import pytest
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact import Contact
from soft_tendon_env.effects.contact import SMOOTHING
from soft_tendon_env.effects.contact.obstacles import Directed, Geometry, body_at, distance, register_shape
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.contact_forces import contact_forces
from soft_tendon_env.model.simulation import Simulation, simulate
from soft_tendon_env.model.state import State
from soft_tendon_env.scene.scene import Scene

RADIUS = 0.01  # of the arm of three tendons
STICTION_SPEED = Contact.model_fields["stiction_speed"].default  # [m/s]
MU = 0.5
FLOOR = {"type": "plane", "position": [0.0, 0.0, -RADIUS]}  # which the straight arm just touches
KINDS = [
    {"type": "plane", "position": [0.1, 0.2, 0.3], "axis": [1.0, -2.0, 0.5]},
    {"type": "sphere", "position": [0.1, 0.2, 0.3], "radius": 0.2},
    {"type": "capsule", "position": [0.1, 0.2, 0.3], "axis": [1.0, -2.0, 0.5], "radius": 0.1, "length": 0.4},
    {"type": "cylinder", "position": [0.1, 0.2, 0.3], "axis": [1.0, -2.0, 0.5], "radius": 0.1, "length": 0.4},
    {"type": "box", "position": [0.1, 0.2, 0.3], "size": [0.2, 0.3, 0.4], "rotation": [20.0, -30.0, 40.0]},
]


def contact(obstacles, friction=0.0, **more):
    return {"effects.contact": {"obstacles": obstacles, "friction": friction, **more}}


def three_tendon(build, obstacles, friction=0.0, *, changes=(), **more):
    return build("three_tendon", {"quadrature.intervals": 6, **contact(obstacles, friction, **more), **dict(changes)})


def pressed(build, pull, friction, **changes):
    """An arm whose tip is pressed on the floor with 1 N and pulled along it."""
    return three_tendon(build, [FLOOR], friction, changes={"effects.tip_load.force": [0.0, pull, -1.0], **changes})


def rested(model, seconds=5.0, tension=None):
    """The simulation after this time."""
    simulation = Simulation(model)
    tension = np.zeros(model.tendon_count) if tension is None else tension
    for _ in range(round(seconds / 0.02)):
        simulation.step(tension, 0.02)
    return simulation


def body_of(obstacle, time=0.0):
    return body_at(Contact(obstacles=[obstacle]).rows(), 0, time)


@pytest.mark.no_jit
@pytest.mark.parametrize("obstacle", KINDS, ids=lambda obstacle: obstacle["type"])
def test_signed_distances_have_their_gradients(obstacle):
    body, rng, h = body_of(obstacle), np.random.default_rng(0), 1e-6
    differences = []
    for x in rng.uniform(-0.5, 0.5, (60, 3)):
        _, gradient = distance(body, tuple(x))
        assert np.linalg.norm(gradient) == pytest.approx(1.0, abs=1e-12)
        slope = [(distance(body, tuple(x + h * e))[0] - distance(body, tuple(x - h * e))[0]) / (2 * h) for e in np.eye(3)]
        differences.append(np.abs(np.array(gradient) - slope).max())
    assert np.sort(differences)[-3] < 1e-6  # two may lie next to an edge, where there are two gradients
    assert np.median(differences) < 1e-8


@pytest.mark.parametrize("obstacle", KINDS[1:], ids=lambda obstacle: obstacle["type"])
def test_signed_distances_are_those_to_the_surface(obstacle):
    """The point at -distance times gradient from x lies on the surface, and none of many others is nearer."""
    body, rng = body_of(obstacle), np.random.default_rng(1)
    points = rng.uniform(-0.4, 0.4, (4000, 3))
    found = [distance(body, tuple(x)) for x in points]
    surface = np.array([x - d * np.array(n) for x, (d, n) in zip(points, found, strict=True)])
    assert max(abs(distance(body, tuple(x))[0]) for x in surface) < 1e-12
    for x, (d, _) in zip(points[:100], found[:100], strict=True):
        assert abs(d) <= np.linalg.norm(surface - x, axis=1).min() + 1e-12


def test_an_obstacle_moves_as_it_is_told():
    obstacle = {**KINDS[4], "velocity": [0.1, 0.2, -0.3], "amplitude": [0.0, 0.05, 0.0], "frequency": 0.7, "phase": 30.0}
    time, h = 0.6, 1e-6
    here, before, after = (body_of(obstacle, t) for t in (time, time - h, time + h))
    swing = np.array([0.0, 0.05, 0.0]) * np.sin(2 * np.pi * 0.7 * time + np.radians(30.0))
    np.testing.assert_allclose(here.r, [0.1, 0.2, 0.3] + time * np.array([0.1, 0.2, -0.3]) + swing, atol=1e-14)
    np.testing.assert_allclose(here.velocity, np.subtract(after.r, before.r) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(Contact(obstacles=[obstacle]).solids(time)[0].pose[:3, 3], here.r, atol=1e-14)


def test_an_arm_rests_on_the_floor(build):
    """All forces balance: the floor and the base carry the weight; a sample sinks in by force over stiffness."""
    k, passive = 5e4, [{"strains": ["torsion", "bend_y", "bend_z"], "order": 3, "span": "rod"}]
    changes = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.passive": passive}
    model = three_tendon(build, [FLOOR], stiffness=k, changes=changes)
    found = contact_forces(model, rested(model).state)
    weight = 1070.0 * np.pi * RADIUS**2 * 9.81
    np.testing.assert_allclose(found.force[0], found.sample_force[0].sum(axis=0))
    np.testing.assert_allclose(found.sample_force[..., :2], 0.0, atol=1e-12)
    inner = found.sample_force[0, 5:-5, 2] / np.diff(found.arc_length)[4:-5]
    np.testing.assert_allclose(inner.mean(), weight, rtol=0.02)
    depth, e = -found.gap[0, 5:-5], SMOOTHING * RADIUS
    line = np.where(depth < e, k * depth**2 / (2 * e), k * (depth - e / 2))
    np.testing.assert_allclose(inner, line, rtol=1e-9)
    assert found.penetration[0] == pytest.approx(-found.gap.min()) and found.clearance[0] == -found.penetration[0]


def test_forces_are_those_of_a_potential(build):
    """F = -dV/dq at rest; the step's stiffness is at least V's own, and exceeds it by what the blocks between nodes would take away."""
    obstacles = [FLOOR, {"type": "sphere", "position": [0.25, 0.012, 0.105], "radius": 0.1}]
    model = three_tendon(build, obstacles, stiffness=1e4)
    n = model.coordinate_count
    q, h = np.zeros(n), 1e-4 * model.coordinate_scale()
    still = np.zeros(n)

    def potential(q):
        return model.energy(q, still).load

    def force(q):
        return model.terms(q, still).external_force

    slope = [(potential(q + h[i] * e) - potential(q - h[i] * e)) / (2 * h[i]) for i, e in enumerate(np.eye(n))]
    assert np.abs(force(q)).max() > 0.0
    np.testing.assert_allclose(force(q) * h, -np.array(slope) * h, rtol=1e-4, atol=1e-6 * np.abs(force(q) * h).max())

    hessian = -np.array([(force(q + h[i] * e) - force(q - h[i] * e)) / (2 * h[i]) for i, e in enumerate(np.eye(n))])
    added = model.terms(q, still).external_stiffness
    scale = 1.0 / np.sqrt(np.diag(added))
    values = np.linalg.eigvalsh(scale[:, None] * (added - 0.5 * (hessian + hessian.T)) * scale)
    assert values.min() > -0.02 * np.linalg.eigvalsh(scale[:, None] * added * scale).max()  # of the surfaces' curvature
    np.testing.assert_allclose(added, added.T, atol=1e-12 * np.abs(added).max())


def test_contact_pushes_and_never_pulls(build):
    model = three_tendon(build, [FLOOR, {**FLOOR, "type": "sphere", "position": [0.2, 0.0, 0.109], "radius": 0.1}], 0.5, dissipation=5.0)
    rng = np.random.default_rng(0)
    straight = Simulation(model).state
    for _ in range(20):
        speed = rng.normal(size=model.coordinate_count) * model.coordinate_scale() * 5.0
        state = State(0.0, straight.q, speed, straight.strain, straight.step, straight.effects)
        found = contact_forces(model, state)
        normal = found.sample_force[0, :, 2]
        assert normal.min() >= 0.0
        assert np.all(np.linalg.norm(found.sample_force[0, :, :2], axis=1) <= 0.5 * normal * (1 + 1e-12))


@pytest.mark.parametrize("step", [0.02, 0.005])
def test_friction_sticks_below_its_limit_and_slides_above(build, step):
    """The beam on the floor's stiffness carries nothing of the pull: it slides where that exceeds mu N."""
    mu = 0.5
    held = Simulation(pressed(build, 0.9 * mu, mu, **{"integrator.step": step}))
    places = []
    for _ in range(250):
        held.step(np.zeros(3), 0.02)
        places.append(held.tip_pose[:3, 3])
    assert abs(places[-1][1]) < 3e-3
    assert 0.0 < places[-1][1] - places[-51][1] < 3.0 * STICTION_SPEED  # creep in a second
    slid = rested(pressed(build, 1.1 * mu, mu, **{"integrator.step": step}))
    assert slid.tip_pose[1, 3] > 0.05


def on_an_incline(build, share, strains, **changes):
    """A weightless arm along a slope of tan(alpha) = share mu, which it touches, its tip loaded with 1 N: model, sine, cosine, downhill."""
    alpha = np.arctan(share * MU)
    s, c = np.sin(alpha), np.cos(alpha)
    plane = {"type": "plane", "position": [0.0, RADIUS * s, -RADIUS * c], "axis": [0.0, -s, c]}
    modes = [{"strains": strains, "order": 3, "span": "rod"}]
    load = {"effects.tip_load.force": [0.0, 0.0, -1.0], "strain": {"type": "explicit", "modes": modes}}
    return three_tendon(build, [plane], MU, changes={**load, **changes}), s, c, np.array([0.0, -c, -s])


def along_and_into(force, downhill):
    """Friction uphill and normal force [N] of a force on the arm, which lies across the slope."""
    return -force @ downhill, force @ np.cross(downhill, [1.0, 0.0, 0.0])


@pytest.mark.parametrize("step", [0.02, 0.005])
@pytest.mark.parametrize("share", [0.5, 0.98])
def test_a_loaded_tip_sticks_on_an_incline_less_steep_than_friction(build, share, step):
    """Friction and normal force are what carries the load, and the tip creeps as the law of friction says, or more slowly."""
    model, s, c, downhill = on_an_incline(build, share, ["bend_y", "bend_z"], **{"integrator.step": step})
    simulation = rested(model, 4.0)
    before = simulation.tip_pose[:3, 3]
    simulation.step(np.zeros(3), 1.0)
    friction, normal = along_and_into(contact_forces(model, simulation.state).force[0], downhill)
    assert (friction, normal) == pytest.approx((s, c), rel=0.03)
    assert friction <= MU * normal and before @ downhill < 7e-3
    creep = (simulation.tip_pose[:3, 3] - before) @ downhill
    assert 0.5 < creep / (STICTION_SPEED * share / np.sqrt(1.0 - share**2)) < 1.1


def test_a_loaded_tip_slides_on_a_steeper_incline_against_mu_times_the_normal_force(build):
    """Beyond where the arm, bent sideways, holds what friction does not, W sin - mu W cos = 3 E I y / l^3, and less than twice as far."""
    model, s, c, downhill = on_an_incline(build, 1.02, ["bend_y", "bend_z"], **{"integrator.step": 0.002})
    simulation, slid = Simulation(model), []
    for _ in range(100):
        simulation.step(np.zeros(3), 0.02)
        force = contact_forces(model, simulation.state).force[0]
        uphill, normal = along_and_into(force, downhill)
        slid.append((simulation.tip_pose[:3, 3] @ downhill, np.hypot(uphill, force[0]), normal))  # force[0]: the bent arm is drawn back
    way, friction, normal = np.array(slid)[5:].T
    going = np.diff(way) > 5e-4  # [m], in 20 ms: where it comes to rest, some of it sticks
    assert going.sum() > 15
    np.testing.assert_allclose(friction[1:][going], MU * normal[1:][going], rtol=1e-3)
    stiffness = 3.0 * 5e5 * np.pi * RADIUS**4 / 4 / 0.3**3
    assert 1.0 < way[-1] * stiffness / (s - MU * c) < 2.0


def test_a_loaded_tip_that_can_twist_rolls_down_an_incline_without_slipping(build):
    """By r theta, as far as the torque of friction F r twists the arm: theta = F r l / (G J)."""
    slow = {"effects.contact.stiction_speed": 1e-6}
    model, _, _, downhill = on_an_incline(build, 0.9, ["torsion", "bend_y", "bend_z"], **slow)
    simulation = rested(model)
    friction, normal = along_and_into(contact_forces(model, simulation.state).force[0], downhill)
    R, way = simulation.tip_pose[:3, :3], simulation.tip_pose[:3, 3] @ downhill
    theta = np.arctan2(R[2, 1], R[1, 1])
    assert friction < MU * normal
    assert theta == pytest.approx(friction * RADIUS * 0.3 / (5e5 / 3.0 * np.pi * RADIUS**4 / 2), rel=0.02)
    assert 0.0 < way - RADIUS * theta < 5e-4, "[m], by which it slides while it is first pressed on"


WRAPPED = {"young_modulus": 5e6, "poisson_ratio": 0.5, "density": 1070.0, "damping": 1e5, "radius": 0.002}
DRUM = 0.05  # [m]


def wrapped(mu, angle):
    """A thin arm made to lie on a drum unstrained, between straight ends of 40 mm; its tip is pulled along by 2 N sin(2 pi t / 10 s)."""
    ends, middle = 0.04, DRUM + WRAPPED["radius"]
    lengths = ends, angle * middle, ends
    segments = [{**WRAPPED, "length": length} for length in lengths]
    segments[1]["curvature"] = [0.0, 1.0 / middle, 0.0]
    direction = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    drum = {"type": "cylinder", "position": [ends, 0.0, -middle], "axis": [0.0, 1.0, 0.0], "radius": DRUM, "length": 0.1}
    pull = {"at": sum(lengths), "force": (2.0 * direction).tolist(), "signal": {"type": "sine", "frequency": 0.1}}
    model = build_model(
        Scene(
            name="wrapped",
            segments=segments,
            tendons=[{"routing": {"type": "straight", "offset": [0.001, 0.0]}, "tension_limits": [0.0, 1.0]}],
            strain={"type": "explicit", "modes": [{"strains": ["bend_y", "stretch"], "order": 3, "span": "piece"}]},
            quadrature={"intervals": 10},
            integrator={"step": 0.005},
            effects={"contact": {"obstacles": [drum], "friction": mu, "stiction_speed": 1e-6}, "disturbance": {"loads": [pull]}},
        )
    )
    return model, direction, np.array([0.5 * ends, sum(lengths) - 0.5 * ends])


@pytest.mark.parametrize(("mu", "angle"), [(0.3, 0.5 * np.pi), (0.3, np.pi), (0.6, 2.0)])
def test_an_arm_around_a_drum_holds_by_the_capstan_equation(mu, angle):
    """The tension resultant behind the drum over that before it, from the stretch of the arm, while it is pulled along and when let back.

    exp(mu angle) is that of a belt without thickness. Here friction acts at the drum's radius R, r nearer to the axis than the tension:
    moments about the axis and forces along the normal give exp(lambda angle) with lambda (1 + mu lambda r / (R + r)) = mu R / (R + r).
    """
    model, direction, places = wrapped(mu, angle)
    simulation, section = Simulation(model), WRAPPED["young_modulus"] * np.pi * WRAPPED["radius"] ** 2
    share = DRUM / (DRUM + WRAPPED["radius"])
    exponent = mu * share
    for _ in range(20):
        exponent = mu * share / (1.0 + mu * exponent * (1.0 - share))
    for time, sense in ((2.4, 1.0), (4.9, -1.0)):  # still growing; almost gone
        simulation.step(np.zeros(1), time - simulation.state.time)
        before, behind = section * (model.strain_at(simulation.state.q, places)[0][:, 3] - 1.0)
        pull = 2.0 * np.sin(0.2 * np.pi * time)
        forces = contact_forces(model, simulation.state)
        held = (pull * direction + forces.force[0])[0]
        assert pull / held == pytest.approx(np.exp(sense * exponent * angle), rel=0.02)
        assert np.log(pull / held) == pytest.approx(sense * mu * angle, rel=0.06)
        assert forces.penetration[0] < 0.05 * WRAPPED["radius"]
        if sense > 0.0:
            assert behind / before == pytest.approx(pull / held, rel=0.005), "the stretch of the arm"


@pytest.mark.parametrize("speed", [0.02, 0.5])
def test_a_belt_drags_the_arm_with_mu_times_the_normal_force(build, speed):
    mu = 0.02
    model = three_tendon(build, [{**FLOOR, "velocity": [0.0, speed, 0.0]}], mu, changes={"effects.tip_load.force": [0.0, 0.0, -1.0]})
    simulation = rested(model)
    force = contact_forces(model, simulation.state).force[0]
    assert np.hypot(force[0], force[1]) == pytest.approx(mu * force[2], rel=1e-4)
    assert force[1] > 0.0 and simulation.tip_pose[1, 3] > 0.02


def test_an_arm_wraps_around_a_cylinder(build):
    """The tendons would curl it up more closely: it lies on the cylinder, every sample that touches is pushed straight outwards."""
    place = np.array([0.03, 0.0, 0.11])
    cylinder = {"type": "cylinder", "position": place.tolist(), "axis": [0.0, 1.0, 0.0], "radius": 0.09, "length": 0.4}
    passive = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 3, "span": "rod"}]
    model = three_tendon(build, [cylinder], changes={"strain.passive": passive})
    for tension in ([2.0, 5.0, 0.0], [3.0, 5.0, 0.0]):
        found = contact_forces(model, rested(model, tension=np.array(tension)).state)
        middle = model.backbone(model.rest_coordinates(tension), 50)[:, :3, 3] - place
        assert np.hypot(middle[:, 0], middle[:, 2]).min() < 0.09  # without the cylinder
        assert 0.0 < found.penetration[0] < 0.1 * RADIUS
        touching = np.linalg.norm(found.sample_force[0], axis=1) > 0.0
        assert touching.sum() >= 2
        out = found.position[touching] - place
        out[:, 1] = 0.0
        directions = found.sample_force[0, touching] / np.linalg.norm(found.sample_force[0, touching], axis=1)[:, None]
        np.testing.assert_allclose(directions, out / np.linalg.norm(out, axis=1)[:, None], atol=1e-9)


SOLIDS = {
    "floor": {"type": "plane", "position": [0.0, 0.0, -0.05]},
    "incline": {"type": "plane", "position": [0.0, 0.0, -0.03], "axis": [0.0, -0.3, 1.0]},
    "ball": {"type": "sphere", "position": [0.2, 0.0, -0.08], "radius": 0.05},
}
RISE = {0.02: 1e-4, 0.005: 1e-3, 0.001: 1e-9}
"""Step [s]: largest part of the energy lost that 20 ms may bring back; extrapolated steps across the beginning of slip bring some."""


@pytest.mark.parametrize("step", RISE)
@pytest.mark.parametrize("solid", SOLIDS)
def test_energy_never_grows_with_friction(build, solid, step):
    """Of an arm thrown across what it falls on: kinetic, elastic, of gravity and of the obstacle pressed."""
    passive = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 3, "span": "rod"}]
    changes = {"effects.gravity.acceleration": [0.0, 0.0, -9.81], "strain.passive": passive, "integrator.step": step}
    model = three_tendon(build, [SOLIDS[solid]], 0.6, changes=changes)
    simulation, total = Simulation(model), []
    speed = np.zeros(model.coordinate_count)
    speed[1:3] = 40.0, -40.0  # [N/s]
    simulation.reset(None, speed)
    for _ in range(100):
        simulation.step(np.zeros(3), 0.02)
        state = simulation.state
        total.append(model.energy(state.q, state.q_dot).total)
    assert contact_forces(model, simulation.state).force[0, 2] > 0.1
    assert np.diff(total).max() < RISE[step] * (total[0] - total[-1])


@pytest.mark.parametrize("friction", [0.0, 0.6])
@pytest.mark.parametrize("step", [0.02, 0.01, 0.002])
def test_an_arm_that_falls_gains_no_energy(build, friction, step):
    """Kinetic, elastic, gravity's energy and that of the floor, sampled after every 20 ms."""
    floor = {"type": "plane", "position": [0.0, 0.0, -0.1], "friction": friction}
    changes = {"quadrature.intervals": 6, "integrator.step": step, "effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    model = build("paper", {**changes, **contact([floor])})
    simulation = Simulation(model)
    totals = [0.0]
    for _ in range(75):
        simulation.step(np.zeros(10), 0.02)
        q, v = simulation.state.q, simulation.state.q_dot
        totals.append(model.energy(q, v).total)
    assert contact_forces(model, simulation.state).force[0, 2] > 0.1
    fallen = -min(totals)
    assert np.diff(totals).max() < 0.02 * fallen
    assert max(totals) < 0.02 * fallen


def test_a_moving_sphere_pushes_the_arm(build):
    ball = {"type": "sphere", "position": [0.28, 0.0, 0.05], "radius": 0.03, "velocity": [0.0, 0.0, -0.02]}
    model = three_tendon(build, [ball], 0.3)
    simulation, pushed = Simulation(model), 0.0
    for _ in range(150):
        simulation.step(np.zeros(3), 0.02)
        found = contact_forces(model, simulation.state)
        assert found.force[0, 2] <= 0.0 and found.penetration[0] < 0.05 * RADIUS
        pushed += 0.02 * found.force[0, 2]
    bottom = 0.05 - 0.02 * 3.0 - 0.03
    assert simulation.tip_pose[2, 3] < bottom - 0.9 * RADIUS and pushed < -0.01


@pytest.mark.parametrize("tension", [20.0, 60.0])
def test_a_fast_arm_does_not_tunnel_through_a_thin_plate(build, tension):
    """At 20 ms, through 5 mm: without the plate the tip crosses its place at several metres a second."""
    changes, pull = {"quadrature.intervals": 6}, np.zeros(10)
    pull[0] = tension
    bare = Simulation(build("paper", changes))
    path = [bare.tip_pose[:3, 3]]
    for _ in range(60):
        bare.step(pull, 0.02)
        path.append(bare.tip_pose[:3, 3])
    path = np.array(path)
    crossing = np.argmax(np.abs(path[:, 1]) > 0.25)
    assert np.linalg.norm(path[crossing] - path[crossing - 1]) / 0.02 > 2.0
    side = np.sign(path[crossing, 1])
    plate = {"type": "box", "position": [0.5, 0.25 * side, 0.0], "size": [1.2, 0.005, 1.2]}
    stopped = Simulation(build("paper", {**changes, **contact([plate])}))
    for _ in range(60):
        stopped.step(pull, 0.02)
        assert (side * contact_forces(stopped.model, stopped.state).position[:, 1]).max() < 0.25
    assert (side * path[:, 1]).max() > 0.3


AMONG = [
    {"type": "sphere", "position": [0.6, 0.25, 0.2], "radius": 0.12},
    {"type": "box", "position": [0.7, -0.25, 0.0], "size": [0.4, 0.02, 0.4], "rotation": [0.0, 0.0, 30.0]},
    {"type": "capsule", "position": [0.8, 0.0, -0.25], "axis": [0.0, 1.0, 0.0], "radius": 0.02, "length": 0.8},
    {"type": "plane", "position": [0.0, 0.0, -0.5]},
]


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.6])
@pytest.mark.parametrize("seed", range(2))
def test_a_minute_of_random_saturated_actions_stays_finite(build, friction, seed):
    model = build("paper", {"quadrature.intervals": 6, **contact(AMONG, friction), "effects.gravity.acceleration": [0.0, 0.0, -9.81]})
    rng, simulation, deepest = np.random.default_rng(seed), Simulation(model), 0.0
    for _ in range(3000):
        simulation.step(60.0 * (rng.random(10) < 0.5), 0.02)
        assert np.isfinite(simulation.tip_pose).all() and np.linalg.norm(simulation.tip_pose[:3, 3]) < 1.2
        deepest = max(deepest, contact_forces(model, simulation.state).penetration.max())
    assert deepest < 0.08


def test_a_step_that_ends_too_deep_is_tried_again_shorter(build):
    """The arm falls on the floor: steps of 20 ms until then, shorter ones at the impact; with error control too."""
    floor = {"type": "plane", "position": [0.0, 0.0, -0.1]}
    for tolerance in ({}, {"integrator.tolerance": 1e-4}):
        model = build(
            "paper", {"quadrature.intervals": 6, **contact([floor]), "effects.gravity.acceleration": [0.0, 0.0, -9.81], **tolerance}
        )  # fmt: skip
        simulation, rejected = Simulation(model), []
        for _ in range(75):
            rejected.append(simulation.step(np.zeros(10), 0.02).rejected)
            assert contact_forces(model, simulation.state).penetration[0] < 2e-3
        assert sum(rejected[:4]) == 0 and sum(rejected) > 0 and sum(rejected[50:]) == 0


@pytest.mark.parametrize(("place", "friction", "order"), [(0.0, 0.0, 2.0), (-0.5, 0.0, 2.0), (-0.5, 5.0, 0.9), (-0.5, 0.1, 1.3)])
def test_order_of_steps_in_contact(build, place, friction, order):
    """From 20 to 0.6 ms, lying on a soft floor: second order, the law of contact being smooth to second order; less where the arm slides,
    begins to and stops, and first with a tiny error where it sticks, in a stiff drag."""

    def tip(step, columns):
        changes = {"effects.tip_load.force": [0.0, 0.1, -0.5], "integrator.step": step, "integrator.columns": columns}
        floor = {"type": "plane", "position": [0.0, 0.0, place * RADIUS]}
        model = three_tendon(build, [floor], friction, stiffness=500.0, changes=changes)
        return simulate(model, np.array([0.5, 0.0, 0.0]), 0.4, 0.1).tip_pose[-1, :3, 3]

    exact, steps = tip(2e-4, 4), 0.02 * 0.5 ** np.arange(6)
    errors = np.array([np.abs(tip(step, 3) - exact).max() for step in steps])
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > order
    assert errors[0] < 3e-4 and errors[-1] < (1e-6 if 0.0 < friction < 1.0 else 2e-8), "[m]"


@pytest.mark.no_jit
def test_interpreted_kernels_run(build):
    model = pressed(build, 0.3, 0.5)
    simulation = Simulation(model)
    simulation.step(np.zeros(3), 0.02)
    found = contact_forces(model, simulation.state)
    assert found.force[0, 2] > 0.0 > found.force[0, 1] and simulation.state.effects.size == 0


def test_what_has_no_contact_says_so(build):
    bare = build("three_tendon")
    with pytest.raises(ValueError, match="no table effects.contact"):
        contact_forces(bare, Simulation(bare).state)


@register_shape
class Torus(Directed):
    """A shape of a user's own: the points up to `tube` from a circle of radius `ring` [m]."""

    type: Literal["torus"] = "torus"
    ring: float = Field(description="radius of the circle [m]")
    tube: float = Field(description="radius of the tube [m]")

    def geometry(self):
        return Geometry((self.ring, self.tube), self.tube, (("cylinder", (self.ring, 2.0 * self.tube)),))

    @staticmethod
    @kernel
    def distance(sizes, x):
        size = max(math.sqrt(x[0] * x[0] + x[1] * x[1]), 1e-9)
        out, up = size - sizes[0], x[2]
        away = max(math.sqrt(out * out + up * up), 1e-12)
        return away - sizes[1], (out / away * x[0] / size, out / away * x[1] / size, up / away)


def test_a_shape_of_a_users_own_is_one_class(build):
    """A ring around the arm, which its tip is pulled through: it rests against the inside; and one shot across does not pass it."""
    ring = {"type": "torus", "position": [0.25, 0.0, 0.0], "axis": [1.0, 0.0, 0.0], "ring": 0.04, "tube": 0.01}
    body = body_of(ring)
    assert distance(body, (0.0, 0.0, 0.0))[0] == pytest.approx(0.03)
    pull = {"effects.tip_load.force": [0.0, 0.0, -0.2]}
    model = three_tendon(build, [ring], changes=pull)
    simulation = rested(model)
    found = contact_forces(model, simulation.state)
    assert found.force[0, 2] > 0.1 and 0.0 < found.penetration[0] < 0.1 * RADIUS
    assert model.backbone_at(simulation.state.q, [0.25])[0, 2, 3] == pytest.approx(-0.02, abs=2e-3)
    shot = three_tendon(build, [{**ring, "position": [0.25, 0.0, 0.2], "axis": [0.0, 1.0, 0.0], "velocity": [0.0, 0.0, -5.0]}])
    simulation = Simulation(shot)
    for _ in range(4):
        simulation.step(np.zeros(3), 0.02)
    found = contact_forces(shot, simulation.state)
    assert found.gap.min() > -RADIUS and simulation.tip_pose[2, 3] < -0.02
    again = pickle.loads(pickle.dumps(shot))
    np.testing.assert_array_equal(simulate(again, np.zeros(3), 0.04, 0.02).tip_pose, simulate(shot, np.zeros(3), 0.04, 0.02).tip_pose)


PILLOW = """
from typing import Literal
from soft_tendon_env.effects import kernel
from soft_tendon_env.effects.contact.obstacles import Directed, Geometry, register_shape

@register_shape
class Pillow(Directed):
    type: Literal["pillow"] = "pillow"

    def geometry(self):
        return Geometry((0.01,), 0.05, (("plane", ()),))

    @staticmethod
    @kernel
    def distance(sizes, x):
        return x[2] - sizes[0], (0, 0, 1)
"""
LOADED = """
import pickle, sys
import numpy as np
from soft_tendon_env.model.simulation import simulate
print(simulate(pickle.load(open(sys.argv[1], "rb")), np.zeros(3), 0.1, 0.1).tip_pose[-1, :3, 3].tolist())
"""


@pytest.mark.slow
def test_an_arm_among_a_users_own_shapes_is_loaded_by_another_process(build, tmp_path, monkeypatch):
    """Which finds the kernel anew; an arm on it lies as on a floor at its height."""
    (tmp_path / "pillows.py").write_text(PILLOW)
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("pillows")
    weight = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    arm = three_tendon(build, [{"type": "pillow", "position": [0.0, 0.0, -0.06]}], 0.3, changes=weight)
    floor = three_tendon(build, [{"type": "plane", "position": [0.0, 0.0, -0.05]}], 0.3, changes=weight)
    expected = simulate(floor, np.zeros(3), 0.1, 0.1).tip_pose[-1, :3, 3]
    (tmp_path / "arm.pickle").write_bytes(pickle.dumps(arm))
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    ran = subprocess.run([sys.executable, "-c", LOADED, "arm.pickle"], cwd=tmp_path, env=paths, capture_output=True, text=True, check=True)
    np.testing.assert_allclose(json.loads(ran.stdout), expected, atol=1e-9)
    assert abs(expected[2]) > 0.02


def test_two_shapes_have_two_names():
    with pytest.raises(ValueError, match="the shape 'torus' is registered twice: .*test_contact, .*test_contact"):

        @register_shape
        class Ring(Torus):
            pass
