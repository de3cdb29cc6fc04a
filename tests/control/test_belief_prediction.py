"""Prediction of the Kalman filter: its transition is the slope of its motion."""

import numpy as np
import pytest

from soft_tendon_env.control import ExtendedKalmanFilter, Measurement, Setting, Uncertainty
from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.timing_bank import Bank
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
COMMAND = np.array([2.0, 0.5, 1.0])  # [N]


@pytest.fixture(scope="module")
def estimator(model):
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
    left_out = []
    moved = []
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


def test_friction_takes_a_share_of_tensions_by_its_coefficient_and_their_turns(estimator, moving):
    """However large the coefficient, a part of every tension is left."""
    space = estimator.space
    belief, _ = moving
    mean = belief.mean.copy()
    loss = belief.locality.loss
    assert (loss > 0.0).all()
    friction = space.friction(mean, belief.locality)
    np.testing.assert_allclose(friction.loss, 0.1 * loss, rtol=1e-12)
    mean[space.layout.friction] = 1.0
    steep = belief.locality._replace(loss=10.0 * np.ones_like(loss))
    assert (space.friction(mean, steep).loss < 1.0).all()


WALKS = Uncertainty(
    force=0.0,
    inertial=0.0,
    tension=0.0,
    sliding=0.0,
    offset=0.3,
    offset_share=0.0,
    offset_time=2.0,
    gain=0.04,
    gain_share=0.0,
    gain_time=5.0,
    tip=0.01,
    load=0.05,
    load_share=0.0,
    load_most=1.0,
    stiffness=0.06,
    damping=0.07,
    payload=0.08,
    friction=0.09,
    latency=0.001,
    lag=0.002,
)
"""Deviations that are all different, without white noise."""


def another(estimator, uncertainty=WALKS, **known):
    """A filter of the same arm with other assumptions."""
    rest = np.zeros(3)
    uses = ("tendon_length",)
    setting = Setting(PERIOD, rest, uses, uncertainty=uncertainty, **known)
    return ExtendedKalmanFilter(estimator.model, setting)


def prediction_of(filtering, belief, measured):
    """Belief after a period and its transition, about the mean, without a bank."""
    return filtering._prediction.predict(belief, measured, None, belief.mean)


def weight_of(model):
    """Weight [N] of an arm on earth."""
    return 9.81 * model.arm.rod.mass[0]


def test_what_the_model_has_wrong_walks_as_declared(estimator, moving):
    """Its variance grows by the squares of the deviations in a second, for the time that passes, in
    units of the arm."""
    belief, measured = moving
    walking = another(estimator)
    space = estimator.space
    model = estimator.model
    covariance = np.zeros_like(belief.covariance)
    certain = belief._replace(covariance=covariance)
    after = prediction_of(walking, certain, measured).belief
    growth = np.diag(after.covariance) / PERIOD
    deviations = np.sqrt(growth)
    mass = model.arm.rod.mass[0]
    expected = {
        "offset": 0.3 * space.tension,
        "gain": 0.04,
        "tip": 0.01 * np.repeat([1.0, model.length], 3),
        "load": 0.05 * weight_of(model),
        "stiffness": 0.06,
        "damping": 0.07,
        "payload": 0.08 * mass,
        "friction": 0.09,
        "latency": 0.001,
        "lag": 0.002,
        "z": 0.0,
        "v": 0.0,
    }
    for name, deviation in expected.items():
        part = getattr(space.layout, name)
        np.testing.assert_allclose(deviations[part], deviation, rtol=1e-9, err_msg=name)


def test_what_is_there_walks_by_a_share_of_itself_too(estimator, moving):
    """Of a load it is a share of the whole force, in every direction, up to the most."""
    belief, measured = moving
    most = 0.04  # [N]
    load_most = most / weight_of(estimator.model)
    shares = WALKS._replace(offset_share=0.4, gain_share=0.5, load_share=0.6, load_most=load_most)
    layout = estimator.space.layout
    mean = belief.mean.copy()
    mean[layout.offset] = [0.0, -0.2, 0.3]
    mean[layout.gain] = [0.05, 0.0, -0.02]
    forces = np.zeros((estimator.space.places.size, 3))
    forces[0] = [0.03, 0.0, -0.04]  # 0.05 N in all
    forces[1] = [0.0, 0.1, 0.0]
    mean[layout.load] = forces.ravel()
    there = belief._replace(mean=mean)
    even = prediction_of(another(estimator), there, measured).belief
    grown = prediction_of(another(estimator, shares), there, measured).belief
    growth = np.diag(grown.covariance - even.covariance) / PERIOD
    walked = np.zeros_like(forces)
    walked[0] = 0.6 * 0.05
    walked[1] = most
    expected = np.zeros_like(mean)
    expected[layout.offset] = 0.4 * mean[layout.offset]
    expected[layout.gain] = 0.5 * mean[layout.gain]
    expected[layout.load] = walked.ravel()
    np.testing.assert_allclose(growth, expected**2, rtol=1e-6, atol=1e-9)


def test_a_timing_that_is_known_does_not_walk(estimator, moving):
    belief, measured = moving
    timed = another(estimator, latency=0.03, lag=0.01)
    covariance = np.zeros_like(belief.covariance)
    certain = belief._replace(covariance=covariance)
    sent = measured.sent[-timed.history :]
    fewer = measured._replace(sent=sent)
    after = prediction_of(timed, certain, fewer).belief
    variance = np.diag(after.covariance)
    layout = estimator.space.layout
    assert variance[layout.latency] == 0.0
    assert variance[layout.lag] == 0.0


WALKING = ("offset", "gain", "tip", "load", "payload", "friction", "latency", "lag")


def test_offsets_and_gains_are_forgotten_in_their_times(estimator, moving):
    """To 1/e: the mean, and the deviation with it. Nothing else is forgotten."""
    belief, measured = moving
    walking = another(estimator)
    layout = estimator.space.layout
    mean = belief.mean.copy()
    mean[layout.offset] = [0.1, -0.2, 0.3]
    mean[layout.gain] = [0.05, -0.05, 0.02]
    known = belief._replace(mean=mean)
    after = prediction_of(walking, known, measured).belief
    kept = dict.fromkeys(WALKING, 1.0)
    kept["offset"] = np.exp(-PERIOD / 2.0)
    kept["gain"] = np.exp(-PERIOD / 5.0)
    for name, share in kept.items():
        part = getattr(layout, name)
        expected = share * mean[part]
        np.testing.assert_allclose(after.mean[part], expected, rtol=1e-12)
    before = np.diag(belief.covariance)
    variance = np.diag(after.covariance)
    walked = WALKS.gain**2 * PERIOD
    remembered = variance[layout.gain] - walked
    expected = kept["gain"] ** 2 * before[layout.gain]
    np.testing.assert_allclose(remembered, expected, rtol=1e-9)


def test_white_tensions_move_the_arm_as_offsets_do(estimator, moving):
    """Their noise is that of offsets with as large a deviation, over a single period."""
    belief, measured = moving
    layout = estimator.space.layout
    uncertainty = WALKS._replace(tension=0.05, offset_time=1e9)
    white = another(estimator, uncertainty)
    prediction = prediction_of(white, belief, measured)
    rows = prediction.transition[: layout.v.stop]
    deviation = 0.05 * estimator.space.tension
    moved = rows[:, layout.offset] * deviation
    expected = moved @ moved.T
    np.testing.assert_allclose(prediction.belief.noise, expected, rtol=1e-6, atol=1e-12)


def test_friction_is_uncertain_by_a_share_of_what_it_takes(estimator, moving):
    """As white tensions are: without friction, or under no tension, by nothing."""
    belief, measured = moving
    layout = estimator.space.layout
    steady = measured._replace(sent=np.tile(COMMAND, (estimator.history, 1)))
    rubbing = another(estimator, WALKS._replace(sliding=0.5))
    prediction = prediction_of(rubbing, belief, steady)
    by_offset = prediction.transition[: layout.v.stop, layout.offset]
    taken = 0.1 * belief.locality.loss * COMMAND
    moved = by_offset * (0.5 * taken)
    expected_noise = moved @ moved.T
    np.testing.assert_allclose(prediction.belief.noise, expected_noise, rtol=1e-6, atol=1e-12)
    mean = belief.mean.copy()
    mean[layout.friction] = 0.0
    smooth = belief._replace(mean=mean)
    free = prediction_of(rubbing, smooth, steady)
    np.testing.assert_array_equal(free.belief.noise, 0.0)


def noise_by_forces(estimator, moving, force, inertial):
    """Noise of white forces, and of a share of the inertial ones."""
    uncertainty = WALKS._replace(force=force, inertial=inertial)
    white = another(estimator, uncertainty)
    return prediction_of(white, *moving).belief.noise


def test_noises_of_white_forces_are_squares_that_add_up(estimator, moving):
    constant = noise_by_forces(estimator, moving, 0.1, 0.0)
    inertial = noise_by_forces(estimator, moving, 0.0, 0.1)
    both = noise_by_forces(estimator, moving, 0.1, 0.1)
    twice = noise_by_forces(estimator, moving, 0.2, 0.0)
    thrice = noise_by_forces(estimator, moving, 0.0, 0.3)
    round_off = 1e-9 * np.abs(both).max()
    np.testing.assert_allclose(twice, 4.0 * constant, atol=round_off)
    np.testing.assert_allclose(thrice, 9.0 * inertial, atol=round_off)
    np.testing.assert_allclose(both, constant + inertial, atol=round_off)


def test_white_forces_are_shares_of_those_that_bend_the_arm(estimator, moving):
    """By 1 rad in each coordinate. Forces do what loads do that make such forces."""
    belief, measured = moving
    space = estimator.space
    noise = noise_by_forces(estimator, moving, 0.1, 0.0)
    transition = prediction_of(another(estimator), belief, measured).transition
    rows = transition[: space.layout.v.stop]
    by_load = rows[:, space.layout.load]
    loads = np.linalg.pinv(belief.locality.load_jacobian)
    by_force = by_load @ loads
    bending_force = estimator.model.bending_energy / space.scale
    moved = by_force * (0.1 * bending_force)
    expected = moved @ moved.T
    round_off = 1e-9 * np.abs(noise).max()
    np.testing.assert_allclose(noise, expected, atol=round_off)


def test_inertial_forces_are_those_of_the_period(estimator, moving):
    """A mean over all coordinates of M q_ddot, against what bends the arm by 1 rad."""
    belief, measured = moving
    space = estimator.space
    inertial = noise_by_forces(estimator, moving, 0.0, 0.2)
    constant = noise_by_forces(estimator, moving, 1.0, 0.0)
    after = prediction_of(another(estimator), belief, measured).belief
    _, q_dot = space.coordinates(belief.mean)
    _, next_q_dot = space.coordinates(after.mean)
    q_ddot = (next_q_dot - q_dot) / PERIOD
    force = belief.locality.terms.mass @ q_ddot
    bending_force = estimator.model.bending_energy / space.scale
    shares = force / bending_force
    share = 0.2**2 * np.mean(shares**2)
    assert share > 0.0
    round_off = 1e-9 * np.abs(inertial).max()
    np.testing.assert_allclose(inertial, share * constant, rtol=1e-6, atol=round_off)


LATENCIES = np.array([0.01, 0.018, 0.026])  # [s]
LAGS = np.array([0.0, 0.01, 0.01])  # [s]
SHARES = np.array([0.5, 0.3, 0.2])


def test_hypotheses_on_the_timing_move_each_under_its_own_commands(estimator, moving):
    """About their mean: each where a filter that knows its timing expects the arm.

    Without friction, whose sense may differ between hypotheses.
    """
    belief, measured = moving
    layout = estimator.space.layout
    smooth = belief.mean.copy()
    smooth[layout.friction] = 0.0
    belief = belief._replace(mean=smooth)
    rows = slice(layout.v.stop)
    deviation = np.zeros((layout.size, 3))
    bank = Bank(Timing(LATENCIES, LAGS), deviation, np.log(SHARES), SHARES)
    uncertain = belief._replace(bank=bank)
    predict = estimator._prediction.predict
    together = predict(uncertain, measured, SHARES, belief.mean).belief
    middle = together.mean[rows]
    deviations = together.bank.deviation[rows]
    for k in range(3):
        mean = belief.mean.copy()
        mean[layout.latency] = LATENCIES[k]
        mean[layout.lag] = LAGS[k]
        timed = belief._replace(mean=mean)
        alone = prediction_of(estimator, timed, measured).belief
        apart = alone.mean[rows] - middle
        off = deviations[:, k] - apart
        allowed = 0.3 * np.linalg.norm(apart)
        assert np.linalg.norm(off) < allowed
    # what lies between two hypotheses adds to the noise
    certain = prediction_of(estimator, belief, measured).belief
    assert np.trace(together.noise) > np.trace(certain.noise)


def test_what_jumped_loads_do_is_what_loads_do(estimator, moving):
    """By their deviation, which is a share of the arm's weight."""
    belief, measured = moving
    uncertainty = WALKS._replace(load_jump=0.4)
    jumping = another(estimator, uncertainty)
    prediction = prediction_of(jumping, belief, measured)
    by_load = prediction.transition[:, estimator.space.layout.load]
    deviation = 0.4 * weight_of(estimator.model)
    np.testing.assert_allclose(prediction.belief.jump, deviation * by_load, rtol=1e-12)
