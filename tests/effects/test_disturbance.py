"""Disturbances and moving bases: virtual work of loads, their functions of time, inertia forces,
and the pose of what moves along."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import soft_tendon_env as ste
from soft_tendon_env import Simulation, simulate, static_equilibrium
from soft_tendon_env.mechanics.terms.evaluate import evaluate
from soft_tendon_env.mechanics.workspace import make_workspace

LENGTH = 0.3  # [m]
RADIUS = 0.01  # [m]
YOUNG = 5e5  # [Pa]
Q = np.random.default_rng(0).uniform(0.0, 5.0, 10)
FORCE = [0.1, 0.2, 0.3]
STIFF = {"integrator.step": 0.01, "quadrature.intervals": 12, "integrator.columns": 4}


def loads(*tables):
    return {"effects.disturbance.loads": list(tables)}


@pytest.mark.no_jit
@pytest.mark.parametrize("place", [0.0, 0.001, 0.12, 0.225, 0.2999, 0.3])
def test_the_work_is_that_of_a_force_where_it_acts(uniform, slope, place):
    """F = d(force . r)/dq of the backbone itself, to fourth order in the distance of the nodes, in
    the first interval too."""
    changes = {"quadrature.intervals": 8, **loads({"at": place, "force": FORCE})}
    model = uniform(("torsion", "bend_y", "bend_z"), 0, changes)
    q = np.array([1.0, 4.0, -3.0])
    work = slope(lambda at: model.backbone_at(at, [place])[0, :3, 3], q, 1e-5).T @ FORCE
    np.testing.assert_allclose(
        model.terms(q, 0 * q).external_force, work, rtol=0.0, atol=1e-4 * 0.024
    )  # of the largest, that at the tip


def test_a_pulse_is_there_from_its_start_to_its_end(build):
    """At borders of steps it begins and ends as a constant load does that is put on and taken off;
    at rest it is not there."""
    load = {"at": 0.21, "force": [0.0, 0.1, 0.0], "moment": [0.0, 0.0, 0.01]}
    plain = build(
        "three_tendon", loads({**load, "force": [0.0, 0.0, 0.0], "moment": [0.0, 0.0, 0.0]})
    )
    signal = {"type": "pulse", "start": 0.1, "duration": 0.06}
    pushed = build("three_tendon", loads(load))
    signalled = {**load, "signal": signal}
    pulse = build("three_tendon", loads(signalled))
    state = Simulation(plain).state
    for model, duration in ((plain, 0.1), (pushed, 0.06), (plain, 0.14)):
        state = simulate(model, [1.0, 0.0, 2.0], duration, 0.02, initial=state).final
    whole = simulate(pulse, [1.0, 0.0, 2.0], 0.3, 0.02)
    np.testing.assert_allclose(whole.final.q, state.q, rtol=1e-12)
    rest = static_equilibrium(pulse, [1.0, 0.0, 2.0])
    expected_q = static_equilibrium(plain, [1.0, 0.0, 2.0]).q
    np.testing.assert_allclose(rest.q, expected_q, atol=1e-12)


def test_a_sine_swings_as_a_forced_oscillator(uniform):
    """One coordinate: the amplitude of M q'' + D q' + K q = F sin(omega t) once it has settled."""
    frequency = 1.5
    force = 2e-4
    signal = {"type": "sine", "frequency": frequency, "phase": 40.0}
    model = uniform(
        ("bend_z",),
        0,
        {
            **loads({"at": LENGTH, "force": [0.0, force, 0.0], "signal": signal}),
            "integrator.step": 2e-3,
        },
    )
    constant = uniform(("bend_z",), 0, loads({"at": LENGTH, "force": [0.0, force, 0.0]}))
    terms = constant.terms([0.0], [0.0])
    omega = 2 * np.pi * frequency
    expected = terms.external_force / np.abs(
        terms.stiffness - omega**2 * terms.mass + 1j * omega * terms.damping
    )
    motion = simulate(model, np.zeros(3), 40.0, 0.01)
    settled = motion.q[motion.time > 35.0, 0]
    np.testing.assert_allclose(0.5 * np.ptp(settled), expected.item(), rtol=5e-3)
    start = np.sin(np.deg2rad(40.0)) * terms.external_force
    np.testing.assert_allclose(model.terms([0.0], [0.0]).external_force, start, rtol=1e-12)


def moving(build, name="three_tendon", **motion):
    return build(
        name, {**STIFF, **{f"effects.moving_base.{key}": value for key, value in motion.items()}}
    )


def motion_of(model, tension=None, seconds=0.4):
    """From the stress-free shape."""
    if tension is None:
        u = np.zeros(model.tendon_count)
    else:
        u = tension
    return ste.simulate(model, u, seconds, 0.02, initial=ste.Simulation(model).state)


def test_constant_acceleration_is_gravity_the_other_way(build):
    """Einstein's lift: relative to a base with acceleration a the arm moves as it does at rest
    under gravity -a."""
    a = np.array([0.0, -2.0, 5.0])
    tension = np.array([2.0, 0.0, 1.0])
    accelerated = motion_of(moving(build, acceleration=a.tolist()), tension)
    heavy = motion_of(
        build("three_tendon", {**STIFF, "effects.gravity.acceleration": (-a).tolist()}), tension
    )
    lift = 0.5 * a * accelerated.time[:, None] ** 2
    np.testing.assert_allclose(
        accelerated.tip_pose[:, :3, 3] - lift, heavy.tip_pose[:, :3, 3], atol=1e-9
    )
    np.testing.assert_allclose(
        accelerated.tip_pose[:, :3, :3], heavy.tip_pose[:, :3, :3], atol=1e-9
    )


SWINGING = {
    "velocity": [0.1, 0.2, -0.3],
    "acceleration": [1.0, -0.5, 2.0],
    "amplitude": [0.1, 0.0, 0.2],
    "axis": [1.0, 2.0, -1.0],
    "angular_velocity": 3.0,
    "angular_amplitude": 0.4,
    "frequency": 0.7,
}


def tip_at(model, q, time):
    """Pose (4, 4) of the last node at a time, its twist and the twist's rate, of coordinates that
    stand still."""
    still = np.zeros(model.coordinate_count)
    work = make_workspace(model.arm)
    work.strain.xi[:] = model.arm.rod.reference_strain
    work.inputs.clock[0] = time
    slack = np.zeros(3)
    failed_node = evaluate(model.arm, slack, q, still, 1e-12, work)
    assert failed_node == -1
    nodes = work.kinematics
    pose = of_last_node(nodes.pose, 12)
    g = np.eye(4)
    g[:3, :3] = pose[:9].reshape(3, 3)
    g[:3, 3] = pose[9:]
    twist = of_last_node(nodes.eta, 6)
    rate = of_last_node(nodes.eta_bias, 6)
    return g, twist, rate


def of_last_node(packs, size):
    """Numbers (size,) of the last node, of packs of four nodes each."""
    by_pack = packs.reshape(-1, size, 4)
    return by_pack[-1, :, -1].copy()


@pytest.mark.no_jit
@pytest.mark.parametrize("time", [0.0, 0.3, 1.1])
def test_the_base_carries_the_arm_to_where_its_motion_leads(build, time):
    """r0 + v t + a t^2 / 2 + s sin(2 pi f t), turned by w t + b sin(2 pi f t) about the axis."""
    model = moving(build, **SWINGING)
    q = np.array([1.0, 0.5, 2.0])
    rest = model.tip_pose(q)
    phase = 2.0 * np.pi * 0.7 * time
    swing = np.sin(phase)
    way = time * np.array(SWINGING["velocity"])
    way += 0.5 * time**2 * np.array(SWINGING["acceleration"])
    way += swing * np.array(SWINGING["amplitude"])
    axis = np.array(SWINGING["axis"]) / np.sqrt(6.0)
    angle = 3.0 * time + 0.4 * swing
    turn = Rotation.from_rotvec(angle * axis).as_matrix()
    g, _, _ = tip_at(model, q, time)
    expected_rotation = turn @ rest[:3, :3]
    np.testing.assert_allclose(g[:3, :3], expected_rotation, atol=1e-12)
    base = np.array(model.scene.base.position)
    from_base = rest[:3, 3] - base
    expected = base + way + turn @ from_base
    np.testing.assert_allclose(g[:3, 3], expected, atol=1e-12)


@pytest.mark.no_jit
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(build):
    """eta at the nodes, by differences of the poses in time of an arm whose coordinates stand
    still."""
    model = moving(build, **SWINGING)
    q = np.array([1.0, 0.5, 2.0])
    h = 1e-4
    before, eta_before, _ = tip_at(model, q, 0.3 - h)
    g, eta, eta_bias = tip_at(model, q, 0.3)
    after, eta_after, _ = tip_at(model, q, 0.3 + h)
    g_dot = (after - before) / (2.0 * h)
    twist = np.linalg.inv(g) @ g_dot
    angular = [twist[2, 1], twist[0, 2], twist[1, 0]]
    linear = twist[:3, 3]
    np.testing.assert_allclose(eta, [*angular, *linear], rtol=1e-6, atol=1e-6)
    eta_dot = (eta_after - eta_before) / (2.0 * h)
    np.testing.assert_allclose(eta_bias, eta_dot, rtol=1e-6, atol=1e-5)
