"""Extended Kalman filter: it finds the state of arms that move, and what their model has wrong,
within the deviations that it says."""

import numpy as np
import pytest

from soft_tendon_env.control import (
    ExtendedKalmanFilter,
    Measurement,
    Setting,
    Uncertainty,
    kalman,
    timing_bank,
)
from soft_tendon_env.control.command_filter import Timing, mean_weights
from soft_tendon_env.control.protocol import SensorNoise
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
SENSORS = [0.1, 0.2]
NOISE = SensorNoise(position=0.002, rotation=0.01, length=0.0005)
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


def noisy(told, rng):
    """A measurement by sensors with NOISE, which are the tip's and those of lengths."""
    twist = rng.normal(size=6) * np.repeat([NOISE.rotation, NOISE.position], 3)
    length = told.tendon_length + NOISE.length * rng.normal(size=told.tendon_length.size)
    return told._replace(tip_pose=moved_pose(told.tip_pose, twist), tendon_length=length)


def live(found, model, periods, timing=(0.0, 0.0), start=None, gain=1.0, rng=None, force=None):
    """Estimates that a filter makes in every period of an arm under smooth tensions, from rest or a
    start, and q and q_dot as they were; gain (n_a,) of the tendons, rng of the sensors' noise,
    force(time) (n,) that pushes."""
    simulation = Simulation(model)
    n = model.tendon_count
    sent = [np.zeros(n)] * 40
    last = None
    if start is not None:
        simulation.reset(start, 0 * start)
    estimates = []
    states = []
    for k in range(periods):
        told = measurement(model, simulation.state, sent[-found.history :], k * PERIOD, found.needs)
        if rng is not None:
            told = noisy(told, rng)
        last = found.estimate(told, last)
        estimates.append(last)
        states.append(simulation.state)
        waves = 1.0 - np.cos(2.0 * k * PERIOD * (1.0 + 0.6 * np.arange(n)))
        sent.append(0.8 * waves)
        parts = 4
        for part in range(parts):
            begin = -PERIOD + part * PERIOD / parts
            weights = mean_weights(Timing(*timing), PERIOD, len(sent), begin, PERIOD / parts)
            simulation.step(gain * (weights @ np.array(sent)), PERIOD / parts)
    return (
        estimates,
        np.stack([state.q for state in states]),
        np.stack([state.q_dot for state in states]),
    )


def filter_of(model, uses=("tendon_length",), **more):
    options = {"latency": 0.0, "lag": 0.0, **more}
    setting = Setting(PERIOD, np.zeros(model.tendon_count), uses, SENSORS, **options)
    return ExtendedKalmanFilter(model, setting)


def scaled_errors(model, estimates, q, q_dot):
    """Errors (periods, 2, n) of coordinates and rates, in units of the coordinates."""
    scale = model.coordinate_scale()
    return np.array(
        [
            [(estimate.q - true_q) / scale, (estimate.q_dot - true_rate) / scale]
            for estimate, true_q, true_rate in zip(estimates, q, q_dot, strict=True)
        ]
    )


@pytest.mark.parametrize(
    ("noise", "is_estimated"),
    [
        (SensorNoise(length=0.0005), False),
        (SensorNoise(position=0.002), True),
        (SensorNoise(rotation=0.01), True),
    ],
)
def test_an_exact_pose_is_not_estimated(noise, is_estimated, model):
    found = filter_of(model, noise=noise)
    rest = model.rest_coordinates(np.zeros(3))
    told = Simulation(model)
    told.reset(rest, 0.0 * rest)
    exact = measurement(model, told.state, [np.zeros(3)] * found.history, 0.0, found.needs)
    displaced = moved_pose(exact.tip_pose, np.full(6, 1e-3))
    estimate = found.estimate(exact._replace(tip_pose=displaced), None)
    assert (np.abs(estimate.tip_pose - displaced).max() > 1e-6) == is_estimated


@pytest.mark.parametrize("uses", [("tendon_length",), ("tendon_length", "strain"), EVERYTHING])
def test_the_state_is_found_from_where_it_was_not_believed_to_be(uses, model):
    start = model.rest_coordinates(np.array([1.0, 0.0, 0.5]))
    scale = model.coordinate_scale()
    assert np.abs(start / scale).max() > 0.1
    estimates, q, q_dot = live(filter_of(model, uses), model, 100, start=start)
    wrong = scaled_errors(model, estimates, q, q_dot)
    greatest_wrong = np.abs(wrong[-50:]).max(axis=(0, 2))
    greatest = np.abs(q / scale).max()
    greatest_rate = np.abs(q_dot / scale).max()
    assert greatest_wrong[0] < 0.01 < greatest
    assert greatest_wrong[1] < 0.1 < greatest_rate


@pytest.mark.parametrize(
    "timing",
    [
        (0.013, 0.0),
        (0.02, 0.03),
        *(pytest.param(timing, marks=pytest.mark.slow) for timing in ((0.0, 0.0), (0.047, 0.0))),
    ],
)
def test_latency_and_lag_are_found(timing, model):
    """The sum of both is the delay of slow commands, and is found to a third of a period; smooth
    commands hardly tell one from the other, and neither is below zero."""
    found = filter_of(model, EVERYTHING, latency=None, lag=None)
    estimates, *_ = live(found, model, 150, timing=timing)
    latency, lag = estimates[-1].timing
    assert latency + lag == pytest.approx(sum(timing), abs=0.006)
    diagnosis = found.diagnosis(estimates[-1])
    for name, seconds in zip(("latency", "lag"), timing, strict=True):
        low, high = getattr(diagnosis, name).interval
        assert low - 0.006 < seconds < high + 0.006


def test_a_timing_that_is_known_is_not_estimated(model):
    """It is believed: with a wrong one the rates are off."""
    off = {}
    for latency in (0.05, 0.0):
        found = filter_of(model, latency=latency)
        estimates, _, q_dot = live(found, model, 60, timing=(0.05, 0.0))
        assert estimates[-1].timing is None
        off[latency] = np.abs((estimates[-1].q_dot - q_dot[-1]) / model.coordinate_scale()).max()
    assert off[0.05] < 0.2 * off[0.0]


def test_gains_of_the_tendons_are_found(model):
    gain = np.array([1.12, 0.9, 1.05])
    found = filter_of(model, EVERYTHING)
    estimates, *_ = live(found, model, 200, gain=gain)
    np.testing.assert_allclose(estimates[-1].input_error.gain, gain, atol=0.06)


@pytest.mark.parametrize("coefficient", [0.0, 0.15])
def test_friction_of_the_tendons_is_found(coefficient, build, model):
    """To a third: in the filter all of an arm's tendons lose the same share along their turns."""
    rubbing = model
    if coefficient > 0.0:
        changes = {"effects.tendon_friction.coefficient": coefficient}
        rubbing = build("three_tendon", {"quadrature.intervals": 4, **changes})
    found = filter_of(model, EVERYTHING)
    estimates, *_ = live(found, rubbing, 150)
    friction = found.diagnosis(estimates[-1]).friction
    assert friction.value[()] == pytest.approx(coefficient, rel=1.0 / 3.0, abs=0.01)


def test_a_load_is_told_by_the_sag_that_it_makes(model):
    """By the first measurement, of an arm at rest, to a tenth."""
    force = np.array([0.01, -0.03, 0.04])
    changes = {"effects.tip_load.force": force.tolist()}
    loaded = model.with_scene(model.scene.replace(changes))
    simulation = Simulation(loaded)
    simulation.reset_at_rest()
    found = filter_of(model, EVERYTHING)
    sent = np.zeros((found.history, 3))
    told = measurement(model, simulation.state, sent, 0.0, found.needs)
    estimate = found.estimate(told, None)
    # what holds the arm there, of all places together
    terms = model.terms(simulation.state.q, 0.0 * simulation.state.q)
    needed = terms.stiffness @ simulation.state.q
    error = estimate.force_error
    total = error.constant - error.stiffness @ estimate.q
    total += terms.actuation @ estimate.input_error.offset
    distance = np.linalg.norm(total - needed)
    assert distance < 0.1 * np.linalg.norm(needed)
    scale = model.coordinate_scale()
    expected = simulation.state.q / scale
    np.testing.assert_allclose(estimate.q / scale, expected, atol=0.01)


@pytest.fixture(scope="module")
def noisy_life(model):
    """A filter under noise, of an arm that is as its model says: its estimates, and coordinates and
    rates as they were."""
    found = filter_of(model, noise=NOISE)
    return live(found, model, 120, rng=np.random.default_rng(1))


def test_errors_are_within_the_filter_s_own_deviations(noisy_life, model):
    """On average of the size that its covariance says, or smaller: it counts with worse models."""
    estimates, q, q_dot = noisy_life
    n = model.coordinate_count
    errors = scaled_errors(model, estimates, q, q_dot)
    sizes = []
    for estimate, error in zip(estimates[50:], errors[50:], strict=True):
        covariance = estimate.memory.covariance[: 2 * n, : 2 * n]
        size = error.ravel() @ np.linalg.solve(covariance, error.ravel()) / (2 * n)
        sizes.append(size)
    assert 0.01 < np.mean(sizes) < 1.5


@pytest.mark.parametrize("gain", [1.0, np.array([1.1, 0.9, 1.0])], ids=["as it is", "gains wrong"])
def test_innovations_are_white(gain, model, monkeypatch):
    """Those of a period tell nothing of the next ones: correlations are those of 150 numbers."""
    found = filter_of(model, noise=NOISE)
    expect = found._sensor_model.innovations
    by_time = {}

    def kept(mean, measured):
        innovation, *rest = expect(mean, measured)
        by_time[measured.time] = innovation  # the last one, where a prediction is repeated
        return innovation, *rest

    monkeypatch.setattr(found._sensor_model, "innovations", kept)
    live(found, model, 180, gain=gain, rng=np.random.default_rng(3))
    innovations = np.array(list(by_time.values())[30:])
    innovations -= innovations.mean(axis=0)
    deviation = innovations.std(axis=0)
    for lag in (1, 2, 3):
        products = innovations[lag:] * innovations[:-lag]
        correlation = products.mean(axis=0) / deviation**2
        assert np.abs(correlation).max() < 3.5 / np.sqrt(len(innovations))


def test_a_filter_is_surprised_where_there_is_more_noise_than_it_was_told(noisy_life, model):
    """Mean squares of innovations are below 1 where it is right, and 9 times as large by three
    times the noise."""
    estimates, *_ = noisy_life
    third = {name: value / 3.0 for name, value in NOISE.model_dump().items()}
    trusting = filter_of(model, noise=SensorNoise(**third))
    of_trusting, *_ = live(trusting, model, 120, rng=np.random.default_rng(1))
    expected, found = (
        np.mean([estimate.memory.surprise.recent for estimate in life[50:]])
        for life in (estimates, of_trusting)
    )
    assert 0.3 < expected < 1.1
    assert 3.0 < found / expected < 9.0
    assert all(estimate.surprise < 1.5 for estimate in estimates)
    assert of_trusting[-1].surprise > 2.0


@pytest.fixture(scope="module")
def surprised(noisy_life, model):
    """A filter, its belief, the units of it, and what exact sensors say of an arm that is off by a
    third of the deviations."""
    estimates, *_ = noisy_life
    found = filter_of(model, noise=NOISE)
    belief = estimates[60].memory
    layout = found.space.layout
    unit = np.sqrt(np.diag(belief.covariance))
    waves = np.cos(np.arange(unit.size))
    aside = belief.mean + 0.3 * unit * waves
    q, q_dot = found.space.coordinates(aside)
    state = Simulation(model).reset(q, q_dot)
    sent = np.zeros((found.history, 3))
    told = measurement(model, state, sent, 1.0, found.needs)
    assert unit[layout.z].min() > 0.0
    return found, belief, unit + 1e-12, told


@pytest.mark.parametrize("is_iterated", [False, True], ids=["about the mean", "about a point"])
def test_an_update_by_what_was_expected_is_that_of_bayes(surprised, is_iterated):
    """The information that a measurement brings adds up, and the mean follows it. Linearised about
    another state, the slope is that there."""
    found, belief, unit, told = surprised
    mean = belief.mean
    covariance = belief.covariance
    point = None
    about = mean
    if is_iterated:
        waves = np.sin(np.arange(unit.size))
        point = mean + 0.5 * unit * waves
        about = point
    innovation, slope, variance = found._sensor_model.innovations(about, told)
    expected = slope @ (mean - about)
    innovation = innovation - expected
    update = found._update(belief, told, point)
    cross = slope @ covariance
    noise = np.diag(variance)
    of_innovation = cross @ slope.T + noise
    gain = np.linalg.solve(of_innovation, cross).T
    change = gain @ innovation
    assert np.abs(change / unit).max() > 0.05
    after = found._within_bounds(mean + change)
    off = update.belief.mean - after
    np.testing.assert_allclose(off / unit, 0.0, atol=1e-6)
    left = covariance - gain @ cross
    off_covariance = update.belief.covariance - left
    units = np.outer(unit, unit)
    np.testing.assert_allclose(off_covariance / units, 0.0, atol=1e-6)
    # the slope of the likelihood, by which states of before are smoothed
    whitened = np.linalg.solve(of_innovation, innovation)
    score = slope.T @ whitened
    np.testing.assert_allclose(unit * update.score, unit * score, atol=1e-6)


def test_the_covariance_of_a_bank_is_that_of_its_hypotheses():
    """By their probabilities, also of what they expect to be measured."""
    rng = np.random.default_rng(0)
    weight = np.array([0.5, 0.3, 0.2])
    states = rng.normal(size=(4, 3))
    mean = states @ weight
    deviation = states - mean[:, None]
    timing = Timing(np.zeros(3), np.zeros(3))
    bank = timing_bank.Bank(timing, deviation, np.log(weight), weight)
    slope = rng.normal(size=(2, 4))
    expected = np.cov(slope @ deviation, aweights=weight, ddof=0)
    of_states = slope @ bank.covariance
    np.testing.assert_allclose(of_states @ slope.T, expected)


def test_covariances_are_symmetric_and_positive_definite(noisy_life):
    estimates, *_ = noisy_life
    for estimate in estimates[::10]:
        covariance = estimate.memory.covariance
        np.testing.assert_array_equal(covariance, covariance.T)
        deviations = np.sqrt(np.diag(covariance))
        certain = deviations == 0.0  # of what is known
        correlation = covariance[~certain][:, ~certain]
        correlation = correlation / np.outer(deviations[~certain], deviations[~certain])
        assert np.linalg.eigvalsh(correlation).min() > -1e-9


def test_the_tip_is_known_better_than_it_is_measured(noisy_life, model):
    """Half as well at least; the noise is seen once a period, the motion from many."""
    estimates, q, _ = noisy_life
    off = [
        pose_error(model.tip_pose(coordinates), estimate.tip_pose)[3:]
        for estimate, coordinates in zip(estimates[50:], q[50:], strict=True)
    ]
    assert np.sqrt(np.mean(np.square(off))) < 0.6 * NOISE.position


def test_a_filter_that_lost_the_arm_finds_it_again(noisy_life, model):
    """An estimate of a shape and rates that no motion leads from."""
    estimates, q, q_dot = noisy_life
    found = filter_of(model, EVERYTHING)
    k = 60
    state = Simulation(model).reset(q[k], q_dot[k])
    sent = np.zeros((found.history, 3))
    told = measurement(model, state, sent, k * PERIOD, found.needs)
    good = found.estimate(told, None)
    belief = good.memory
    mean = belief.mean.copy()
    mean[found.space.layout.v] = 1e9
    lost = good._replace(memory=belief._replace(mean=mean))
    estimate = found.estimate(told, lost)
    largest = np.abs(q).max()
    np.testing.assert_allclose(estimate.q, q[k], atol=0.05 * largest)


def test_a_measurement_far_off_tells_where_the_arm_is_but_not_why(model):
    """Jumps of a resting arm that no load makes: the estimate moves with them, its loads do not."""
    found = filter_of(model, EVERYTHING)
    sent = np.zeros((found.history, 3))
    told = measurement(model, Simulation(model).state, sent, 0.0, EVERYTHING)
    last = found.estimate(told, None)
    direction = model.coordinate_scale() * np.array([1.0, -0.5, 0.3])
    moved = []
    loads = []
    for size in (0.003, 0.03, 0.3):
        state = Simulation(model).reset(size * direction, np.zeros(3))
        told = measurement(model, state, sent, PERIOD, EVERYTHING)
        estimate = found.estimate(told, last)
        moved.append(estimate.q / (size * direction))
        load = np.linalg.norm(estimate.memory.mean[found.space.layout.load])
        loads.append(load)
    np.testing.assert_allclose(moved[1], moved[0], rtol=0.1)
    np.testing.assert_allclose(moved[2], moved[0], rtol=0.1)
    assert loads[0] > loads[1] > loads[2]


def test_an_unknown_timing_does_not_hide_where_the_arm_is(model):
    """A first motion of which nobody knows when it was commanded, by exact sensors."""
    found = filter_of(model, EVERYTHING, latency=None, lag=None)
    estimates, q, q_dot = live(found, model, 12, (0.03, 0.0))
    assert estimates[3].memory.bank is not None
    assert np.abs(scaled_errors(model, estimates, q, q_dot)[:, 0]).max() < 1e-3


@pytest.mark.parametrize(("latencies", "has_jumped"), [((0.0, 0.004), True), ((0.0, 0.04), False)])
def test_loads_jump_once_the_timing_is_nearly_known(latencies, has_jumped, model):
    """A push is found then; before that, a late command looks like one."""
    found = filter_of(model, latency=None, lag=None)
    estimates, *_ = live(found, model, 3)
    belief = estimates[-1].memory
    bank = timing_bank.Bank(
        timing=Timing(np.array(latencies), np.zeros(2)),
        deviation=np.zeros((belief.mean.size, 2)),
        log_likelihood=np.zeros(2),
        sharp_weight=np.full(2, 0.5),
    )
    load = found.space.layout.load
    slope = np.zeros((6, belief.mean.size))
    slope[:, :6] = np.eye(6)
    jump = np.zeros_like(belief.jump)
    jump[:6, :6] = np.eye(6)
    jump[load] = 0.1 * np.eye(jump.shape[1])
    predicted = belief._replace(bank=bank, jump=jump)
    innovations = np.full((6, 2), 0.5)
    noise = 1e-6 * np.eye(6)
    covariance, *_ = kalman._plausible(predicted, slope, noise, innovations)
    before = np.diag(belief.covariance)[load]
    after = np.diag(covariance)[load]
    assert (after > before + 0.005).all() == has_jumped


def test_hypotheses_that_agree_become_the_covariance_of_what_is_not_known(model):
    """With the variance of a grid's step besides: of the lag here, since the latency was told."""
    found = filter_of(model, latency=0.0, lag=None)
    estimates, *_ = live(found, model, 3)
    belief = estimates[-1].memory
    layout = found.space.layout
    deviation = np.zeros((belief.mean.size, 2))
    deviation[layout.z] = np.array([0.1, -0.1])
    bank = timing_bank.Bank(
        timing=Timing(np.zeros(2), np.array([0.010, 0.011])),
        deviation=deviation,
        log_likelihood=np.zeros(2),
        sharp_weight=np.full(2, 0.5),
    )
    settled = found._settled(belief._replace(bank=bank))
    assert settled.bank is None
    added = settled.covariance - belief.covariance
    entries = np.arange(belief.mean.size)
    lag_entry = entries[layout.lag]
    step_variance = timing_bank.LATENCY_STEP**2 / 12.0
    expected = np.zeros_like(added)
    expected[layout.z, layout.z] = 0.01
    expected[lag_entry, lag_entry] = step_variance
    np.testing.assert_allclose(added, expected, rtol=1e-3, atol=1e-12)


def test_a_period_that_settles_on_no_motion_says_nothing_of_the_timing(model):
    """Hypotheses keep their probabilities, and the mean is theirs."""
    found = filter_of(model, latency=None, lag=None)
    estimates, *_ = live(found, model, 3)
    last = estimates[-1].memory
    rng = np.random.default_rng(0)
    deviation = rng.normal(size=last.bank.deviation.shape)
    log_likelihood = rng.normal(size=last.bank.log_likelihood.size)
    judged = last._replace(
        bank=last.bank._replace(deviation=deviation, log_likelihood=log_likelihood)
    )
    kept = kalman._weighted_as(judged, last.bank)
    np.testing.assert_allclose(kept.bank.weight, last.bank.weight)
    np.testing.assert_allclose(kept.bank.deviation @ kept.bank.weight, 0.0, atol=1e-12)
    states = last.mean[:, None] + deviation
    np.testing.assert_allclose(kept.mean[:, None] + kept.bank.deviation, states)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tension": [0.0]}, r"tension should have shape \(3,\)"),
        ({"latency": -0.1}, "latency should be a number, at least 0"),
        ({"lag": -0.1}, "lag should be a number, at least 0"),
        ({"uncertainty": Uncertainty(tip=-1.0)}, "uncertainty.tip should be a number, at least 0"),
    ],
)
def test_bad_settings_are_refused_by_name(model, changes, message):
    setting = Setting(PERIOD, np.zeros(3), ("tendon_length",), SENSORS)
    with pytest.raises(ValueError, match=message):
        ExtendedKalmanFilter(model, setting._replace(**changes))


@pytest.mark.parametrize("size", [1e1, 1e4, 1e200])
def test_absurd_measurements_give_states_that_a_model_can_take(size, model):
    found = filter_of(model, EVERYTHING)
    sent = np.zeros((found.history, 3))
    told = measurement(model, Simulation(model).state, sent, 0.0, EVERYTHING)
    absurd = told._replace(**{name: np.full_like(getattr(told, name), size) for name in EVERYTHING})
    with np.errstate(over="ignore", invalid="ignore"):
        last = found.estimate(absurd, found.estimate(told, None))
        assert np.isfinite(last.q).all()
        assert np.isfinite(last.q_dot).all()
        model.tip_pose(last.q)
        for _ in range(30):
            last = found.estimate(told, last)
    assert np.abs(last.q / model.coordinate_scale()).max() < 0.01  # it has come back
