"""Contact forces of a straight arm beside planes: gaps by where these are, forces that add up."""

import dataclasses

import numpy as np
import pytest

from soft_tendon_env import Simulation
from soft_tendon_env.model.contact_forces import contact_forces

RADIUS = 0.01  # [m]
DEPTH = 2e-4  # [m]
RISE = 0.003  # [m/s]
FLOOR = {"type": "plane", "position": [0.0, 0.0, DEPTH - RADIUS]}
CEILING = {
    "type": "plane",
    "position": [0.0, 0.0, 0.05],
    "axis": [0.0, 0.0, -1.0],
    "velocity": [0.0, 0.0, RISE],
}


@pytest.fixture(scope="module")
def lying(build):
    """A straight arm that lies in a floor, under a ceiling that rises."""
    obstacles = [FLOOR, CEILING]
    changes = {"quadrature.intervals": 2, "effects.contact.obstacles": obstacles}
    model = build("three_tendon", changes)
    return model, Simulation(model).state


def test_gaps_are_those_of_the_surfaces(lying):
    """At the time of the state; penetration is what is below none."""
    model, state = lying
    later = dataclasses.replace(state, time=2.0)
    for now in (state, later):
        contact = contact_forces(model, now)
        above = 0.05 - RADIUS + RISE * now.time
        np.testing.assert_allclose(contact.gap[0], -DEPTH, atol=1e-12)
        np.testing.assert_allclose(contact.gap[1], above, atol=1e-12)
        np.testing.assert_allclose(contact.clearance, [-DEPTH, above], atol=1e-12)
        np.testing.assert_allclose(contact.penetration, [DEPTH, 0.0], atol=1e-12)


def test_the_clearance_is_that_of_the_nearest_place(build):
    """Of a plane that comes nearer towards the tip: the distance from the axis less the radius."""
    slope = 0.1
    normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
    below = [0.0, 0.0, -0.1]
    plane = {"type": "plane", "position": below, "axis": normal.tolist()}
    changes = {"effects.contact.obstacles": [plane]}
    model = build("three_tendon", changes)
    contact = contact_forces(model, Simulation(model).state)
    distance = (contact.position - below) @ normal
    np.testing.assert_allclose(contact.gap[0], distance - RADIUS, atol=2e-3)
    assert np.ptp(contact.gap[0]) > 0.02
    assert contact.clearance[0] == contact.gap[0, -1]
    assert contact.penetration[0] == 0.0


def test_forces_are_sums_over_samples_along_the_arm(lying):
    model, state = lying
    contact = contact_forces(model, state)
    places = contact.arc_length
    assert places[-1] == pytest.approx(model.length)
    positions = np.zeros((places.size, 3))
    positions[:, 0] = places
    np.testing.assert_allclose(contact.position, positions, atol=1e-12)
    up = contact.sample_force[0, :, 2]
    assert (up > 0.0).all()
    expected_force = [0.0, 0.0, up.sum()]
    np.testing.assert_allclose(contact.force[0], expected_force, atol=1e-12)
    np.testing.assert_array_equal(contact.force[1], 0.0)


def test_an_arm_on_a_base_that_rises_leaves_the_floor(build):
    """Its samples are where the base has carried them by the time of the state."""
    velocity = [0.0, 0.0, RISE]
    changes = {
        "quadrature.intervals": 2,
        "effects.contact.obstacles": [FLOOR],
        "effects.moving_base.velocity": velocity,
    }
    model = build("three_tendon", changes)
    state = Simulation(model).state
    later = dataclasses.replace(state, time=2.0)
    contact = contact_forces(model, later)
    risen = RISE * later.time
    np.testing.assert_allclose(contact.position[:, 2], risen, atol=1e-12)
    np.testing.assert_allclose(contact.gap[0], risen - DEPTH, atol=1e-12)


def test_arms_without_contact_have_no_forces_of_it(build):
    model = build("three_tendon", {"quadrature.intervals": 2})
    with pytest.raises(ValueError, match=r"no table effects\.contact"):
        contact_forces(model, Simulation(model).state)
