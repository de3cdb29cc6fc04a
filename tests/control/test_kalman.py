"""Extended Kalman filter: it finds the state, errors of the inputs and the latency of arms that
move, from what there is."""

import numpy as np
import pytest

from soft_tendon_env.control import ExtendedKalmanFilter, Measurement, Setting
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
SENSORS = [0.1, 0.2]
EVERYTHING = ("tip_twist", "tendon_length", "strain", "strain_rate")


def measurement(model, state, sent, time, uses):
    """What exact sensors say."""
    strain, slope = model.strain_at(state.q, SENSORS)
    terms = model.terms(state.q, state.q_dot)
    values = {
        "tip_twist": terms.tip_jacobian @ state.q_dot,
        "tendon_length": model.tendon_lengths(state.q),
        "strain": strain,
        "strain_rate": slope @ state.q_dot,
    }
    return Measurement(
        terms.tip_pose, np.array(sent), time, **{name: values[name] for name in uses}
    )


def live(found, arm, periods, late=0, start=None):
    """Estimates that a filter makes in every period of an arm under smooth tensions, from rest or a
    start, and q and q_dot as they were."""
    simulation, n = Simulation(arm), arm.tendon_count
    sent, last = [np.zeros(n)] * 12, None
    if start is not None:
        simulation.reset(start, 0 * start)
    estimates, states = [], []
    for k in range(periods):
        told = measurement(arm, simulation.state, sent[-found.history :], k * PERIOD, found.needs)
        last = found.estimate(told, last)
        estimates.append(last)
        states.append(simulation.state)
        waves = 1.0 - np.cos(2.0 * k * PERIOD * (1.0 + 0.6 * np.arange(n)))
        sent.append(0.8 * waves)
        whole, rest = divmod(late, PERIOD)
        newest = len(sent) - 1 - int(whole)
        for tension, seconds in ((sent[newest - 1], rest), (sent[newest], PERIOD - rest)):
            simulation.step(tension, seconds)
    return (
        estimates,
        np.stack([state.q for state in states]),
        np.stack([state.q_dot for state in states]),
    )


@pytest.fixture
def arm(build):
    return build("three_tendon", {"quadrature.intervals": 4})


def filter_of(model, uses=("tendon_length",), greatest_latency=None, **more):
    return ExtendedKalmanFilter(
        model,
        Setting(PERIOD, np.zeros(model.tendon_count), uses, SENSORS, **more),
        greatest_latency,
    )


@pytest.mark.parametrize("uses", [("tendon_length",), ("tendon_length", "strain"), EVERYTHING])
def test_the_state_is_found_from_where_it_was_not_believed_to_be(uses, arm):
    start = arm.rest_coordinates(np.array([1.0, 0.0, 0.5]))
    scale = arm.coordinate_scale()
    assert np.abs(start / scale).max() > 0.1
    estimates, q, q_dot = live(filter_of(arm, uses), arm, 100, start=start)
    wrong = np.array(
        [
            [(one.q - at) / scale, (one.q_dot - v) / scale]
            for one, at, v in zip(estimates, q, q_dot, strict=True)
        ]
    )
    assert np.abs(wrong[-50:, 0]).max() < 0.01 < np.abs(q / scale).max()
    assert np.abs(wrong[-50:, 1]).max() < 0.1 < np.abs(q_dot / scale).max()


@pytest.mark.parametrize("late", [0.0, 0.013, 0.047, 0.07])
def test_a_latency_is_found(late, arm):
    estimates, *_ = live(filter_of(arm, latency=0.02, greatest_latency=0.08), arm, 200, late=late)
    assert estimates[0].latency == pytest.approx(0.02, abs=1e-6)
    assert np.abs(np.array([one.latency for one in estimates[-50:]]) - late).max() < 0.004


@pytest.mark.parametrize("size", [1e1, 1e4, 1e200])
def test_absurd_measurements_give_states_that_a_model_can_take(size, arm):
    found = filter_of(arm, EVERYTHING)
    told = measurement(arm, Simulation(arm).state, np.zeros((2, 3)), 0.0, EVERYTHING)
    absurd = told._replace(**{name: np.full_like(getattr(told, name), size) for name in EVERYTHING})
    with np.errstate(over="ignore", invalid="ignore"):
        last = found.estimate(absurd, found.estimate(told, None))
        assert np.isfinite(last.q).all()
        assert np.isfinite(last.q_dot).all()
        arm.tip_pose(last.q)
        for _ in range(30):
            last = found.estimate(told, last)
    assert np.abs(last.q / arm.coordinate_scale()).max() < 0.01  # it has come back
