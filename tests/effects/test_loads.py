"""Gravity, tip loads and payloads against virtual work, signals and weights against their
definitions."""

import numpy as np
import pytest

from soft_tendon_env.effects.contact.samples import nodes_with
from soft_tendon_env.effects.loads import (
    EDGE,
    MovingBaseParameters,
    limit_base_step,
    limit_disturbance_step,
    signal_at,
    weights,
)
from soft_tendon_env.mechanics.effects import TURN
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

ANGULAR = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": ["torsion", "bend_y", "bend_z"], "order": 0, "span": "rod"}],
    }
}
Q = np.array([1.0, 4.0, -3.0])
STILL = np.zeros(3)
FORCE = np.array([0.1, -0.2, 0.3])
MOMENT = np.array([0.01, 0.02, -0.03])
LENGTH = 0.3
RADIUS = 0.01
DENSITY = 1070.0


def arm_with(changes, intervals=6):
    scene = load_scene("three_tendon").replace({**ANGULAR, **changes})
    return model_on(scene, intervals)


def tip_load(**table):
    return {"effects.tip_load": {key: np.array(part).tolist() for key, part in table.items()}}


@pytest.mark.parametrize("frame", ["world", "tip"])
def test_a_wrench_at_the_tip_has_its_virtual_work(frame):
    """F = J^T of the wrench in the tip frame."""
    model = arm_with(
        {"effects.tip_load": {"force": FORCE.tolist(), "moment": MOMENT.tolist(), "frame": frame}}
    )
    terms = model.terms(Q, STILL)
    if frame == "world":
        R = terms.tip_pose[:3, :3]
    else:
        R = np.eye(3)
    wrench = np.concatenate([R.T @ MOMENT, R.T @ FORCE])
    expected_external_force = terms.tip_jacobian.T @ wrench
    np.testing.assert_allclose(terms.external_force, expected_external_force, rtol=1e-10)
    dead = model.scene.effects.dead_loads()
    if frame == "world":
        expected = FORCE, MOMENT
    else:
        expected = STILL, STILL
    np.testing.assert_array_equal((dead.force, dead.moment), expected)


def test_a_payload_is_inertia_and_weight_at_the_tip():
    acceleration = [1.0, -2.0, -9.0]
    gravity = {"effects.gravity.acceleration": acceleration}
    inertia = [1e-5, 2e-5, 3e-5]
    payload = tip_load(mass=0.02, inertia=inertia)
    bare = arm_with(gravity).terms(Q, STILL)
    loaded = arm_with({**gravity, **payload}).terms(Q, STILL)
    J = bare.tip_jacobian
    R = bare.tip_pose[:3, :3]
    added = J.T @ np.diag([*inertia, 0.02, 0.02, 0.02]) @ J
    more_mass = loaded.mass - bare.mass
    np.testing.assert_allclose(more_mass, added, rtol=1e-9, atol=1e-14)
    weight = 0.02 * np.array(acceleration)
    generalised = J[3:].T @ R.T @ weight
    more_force = loaded.external_force - bare.external_force
    np.testing.assert_allclose(more_force, generalised, rtol=1e-9)


def test_weight_and_forces_at_the_tip_are_gradients_of_their_energies():
    model = arm_with(
        {"effects.gravity.acceleration": [1.0, -2.0, -9.0], **tip_load(force=FORCE, mass=0.02)}
    )
    h = 1e-5
    falls = [
        (model.energy(Q - way, STILL).load - model.energy(Q + way, STILL).load) / (2 * h)
        for way in h * np.eye(3)
    ]
    np.testing.assert_allclose(model.terms(Q, STILL).external_force, falls, rtol=1e-6, atol=1e-9)


def test_the_weight_of_a_straight_rod_is_that_of_a_beam():
    """w L^3 / 6 on a constant curvature, with w = rho A g."""
    changes = {"effects.gravity.acceleration": [0.0, -3.0, 0.0]}
    model = arm_with(changes)
    load = -3.0 * DENSITY * np.pi * RADIUS**2
    expected = [0.0, 0.0, load * LENGTH**3 / 6.0]
    np.testing.assert_allclose(
        model.terms(STILL, STILL).external_force, expected, rtol=1e-9, atol=1e-12
    )


def rows_of(*signals):
    loads = [{"at": 0.1, "force": [0.0, 0.1, 0.0], "signal": signal} for signal in signals]
    scene = load_scene("three_tendon").replace({"effects.disturbance.loads": loads})
    model = model_on(scene.replace(ANGULAR), 2)
    return scene.effects.disturbance.parameters(model.discretisation)


PULSE = {"type": "pulse", "start": 0.1, "duration": 0.05}
SINE = {"type": "sine", "frequency": 2.0, "phase": 30.0}


def test_signals_are_pulses_sines_and_constants():
    pulse, sine, always = rows_of(PULSE, SINE, None).loads
    within_edge_of_start = 0.1 - 0.5 * EDGE
    before_edge_of_end = 0.15 - 2 * EDGE
    for time in (within_edge_of_start, 0.1, 0.14, before_edge_of_end):
        assert signal_at(pulse, time) == 1.0
    for time in (0.0, 0.0999, 0.15, 1.0):
        assert signal_at(pulse, time) == 0.0
    phase = np.radians(30.0)
    for time in (0.0, 0.07, 3.3):
        expected = np.sin(2.0 * np.pi * 2.0 * time + phase)
        assert signal_at(sine, time) == pytest.approx(expected, abs=1e-12)
        assert signal_at(always, time) == 1.0


def longest_at(limit, parameters, time):
    nothing = np.zeros(0)
    step = np.array([1.0])
    limit(parameters, nodes_with(nothing, nothing, nothing, time), step)
    return float(step[0])


def test_steps_end_where_pulses_do_and_are_short_beside_periods():
    pulse = rows_of(PULSE)
    sine = rows_of(SINE)
    for time, longest in ((0.0, 0.1), (0.1, 0.05), (0.12, 0.03), (0.15, 1.0), (9.0, 1.0)):
        assert longest_at(limit_disturbance_step, pulse, time) == pytest.approx(longest)
    assert longest_at(limit_disturbance_step, sine, 0.3) == pytest.approx(TURN / (4.0 * np.pi))
    zero = (0.0, 0.0, 0.0)
    for angular_velocity, omega in ((-30.0, 0.0), (0.0, 50.0), (30.0, 50.0)):
        base = MovingBaseParameters(zero, zero, zero, (0.0, 0.0, 1.0), angular_velocity, 0.1, omega)
        fastest = max(abs(angular_velocity), omega)
        assert longest_at(limit_base_step, base, 0.0) == pytest.approx(TURN / fastest)
    still = MovingBaseParameters(zero, zero, zero, (0.0, 0.0, 1.0), 0.0, 0.0, 0.0)
    assert longest_at(limit_base_step, still, 0.0) == 1.0


def test_weights_are_exact_for_cubics_between_borders():
    """Also where few nodes are near; of two nodes they are linear, and none is negative."""
    model = arm_with({"tendons.0.end": 0.2}, 5)
    rod = model.discretisation
    places = np.array([0.0, 0.003, 0.1, 0.19, 0.2, 0.21, 0.28, 0.3])

    def cubic(s):
        return s * (2.0 - 3.0 * s + 40.0 * s**2)

    four = weights(rod, places)
    interpolated = four @ cubic(rod.node)
    np.testing.assert_allclose(interpolated, cubic(places), atol=1e-14)
    linear = weights(rod, places, 2)
    np.testing.assert_allclose(linear @ rod.node, places, atol=1e-14)
    assert linear.min() > -1e-12
    is_used = np.abs(linear) > 1e-12
    nodes_per_place = np.count_nonzero(is_used, axis=1)
    assert (nodes_per_place <= 2).all()
    # none reaches beyond the end of a tendon
    before_end = places < 0.2
    beyond_end = places > 0.2
    nodes_before_end = rod.node < 0.2 - 1e-9
    nodes_beyond_end = rod.node > 0.2 + 1e-9
    reach_forwards = four[before_end][:, nodes_beyond_end]
    reach_backwards = four[beyond_end][:, nodes_before_end]
    assert np.abs(reach_forwards).max() < 1e-12
    assert np.abs(reach_backwards).max() < 1e-12
