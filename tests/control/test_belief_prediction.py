"""Prediction of the Kalman filter: its transition is the slope of its motion."""

import numpy as np
import pytest

from soft_tendon_env.control import ExtendedKalmanFilter, Measurement, Setting
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
COMMAND = np.array([2.0, 0.5, 1.0])  # [N]


@pytest.fixture(scope="module")
def estimator(build):
    model = build("three_tendon", {"quadrature.intervals": 4})
    return ExtendedKalmanFilter(model, Setting(PERIOD, np.zeros(3), ("tendon_length",)))


@pytest.fixture(scope="module")
def moving(estimator):
    """A belief in motion without a bank of timings, and the commands that were sent."""
    model = estimator.model
    sent = np.zeros((estimator.history, 3))
    sent[-4:] = COMMAND
    sent[-2:] *= 1.5
    still = Simulation(model).state
    measured = Measurement(
        model.tip_pose(still.q), sent, 0.0, tendon_length=model.tendon_lengths(still.q)
    )
    belief = estimator.estimate(measured, None).memory
    layout = estimator.space.layout
    mean = belief.mean.copy()
    mean[layout.z] = [0.3, -0.2, 0.1]
    mean[layout.v] = [2.0, 1.0, -1.0]
    mean[layout.load] = 0.01
    mean[layout.payload] = 0.1 * estimator.space.mass
    mean[layout.friction] = 0.1
    mean[layout.latency] = 0.03
    mean[layout.lag] = 0.01
    locality = estimator.space.locality(*estimator.space.coordinates(mean))
    belief = belief._replace(mean=mean, bank=None, locality=locality)
    return belief, measured._replace(time=PERIOD)


def predicted(estimator, belief, measured, point):
    """Mean after a period, linearised about a point."""
    prediction = estimator._prediction.predict(belief, measured, None, point)
    return prediction.belief.mean


PARTS = {
    "z": 0.02,
    "v": 0.5,
    "offset": 0.2,
    "gain": 0.1,
    "load": 0.02,
    "stiffness": 0.1,
    "damping": 0.3,
    "payload": 0.003,
    "friction": 0.1,
    "latency": 0.001,
    "lag": 0.001,
}
"""Changes of the parts of the state, each in its unit."""


@pytest.mark.parametrize("part", PARTS)
def test_a_prediction_about_another_state_is_its_tangent(part, estimator, moving):
    """It leaves out a part of the change at most, and less of a smaller one."""
    belief, measured = moving
    layout = estimator.space.layout
    rows = slice(layout.v.stop)
    left_out, moved = [], []
    for share in (1.0, 0.5):
        mean = belief.mean.copy()
        mean[getattr(layout, part)] += share * PARTS[part]
        changed = belief._replace(mean=mean)
        exact = predicted(estimator, changed, measured, mean)[rows]
        tangent = predicted(estimator, changed, measured, belief.mean)[rows]
        before = predicted(estimator, belief, measured, belief.mean)[rows]
        left_out.append(np.linalg.norm(tangent - exact))
        moved.append(np.linalg.norm(exact - before))
    assert moved[0] > 0.0
    assert left_out[0] < 0.25 * moved[0]
    assert left_out[1] < 0.13 * moved[1]


def test_what_is_not_moved_is_predicted_alike_about_any_state(estimator, moving):
    """Walks stay where they are believed to be."""
    belief, measured = moving
    layout = estimator.space.layout
    point = belief.mean.copy()
    point[layout.payload] *= 2.0
    point[layout.damping] = 0.2
    about_mean = predicted(estimator, belief, measured, belief.mean)
    about_point = predicted(estimator, belief, measured, point)
    still = slice(layout.v.stop, None)
    np.testing.assert_allclose(about_point[still], about_mean[still], rtol=1e-12, atol=1e-15)


def test_friction_takes_a_share_of_the_tensions_that_are_pulled_in(estimator, moving):
    """By the coefficient and the turns of the tendons; what slides outwards has more at its end.
    However large the coefficient, a part of every tension is left."""
    space = estimator.space
    belief, _ = moving
    mean = belief.mean.copy()
    terms = belief.locality.terms
    _, q_dot = space.coordinates(mean)
    pulled_in = terms.actuation.T @ q_dot
    loss = belief.locality.loss
    np.testing.assert_array_equal(np.sign(loss), np.sign(pulled_in))
    assert np.abs(loss).max() > 0.1
    np.testing.assert_allclose(space.kept(mean, belief.locality), 1.0 - 0.1 * loss, rtol=1e-12)
    mean[space.layout.friction] = 1.0
    steep = belief.locality._replace(loss=10.0 * np.ones_like(loss))
    assert (space.kept(mean, steep) > 0.0).all()


def test_an_arm_at_rest_has_no_friction_to_tell(estimator, moving):
    belief, _ = moving
    q, q_dot = estimator.space.coordinates(belief.mean)
    resting = estimator.space.locality(q, 0.0 * q_dot)
    np.testing.assert_array_equal(resting.loss, 0.0)
