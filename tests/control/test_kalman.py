"""Extended Kalman filter: it finds the state, errors of the inputs and the latency of arms that
move, from what there is."""

import numpy as np
import pytest

from soft_tendon_env.control import ExtendedKalmanFilter, Measurement, Setting
from soft_tendon_env.control.innovations import layout_of
from soft_tendon_env.control.kalman import Belief, Uncertainty
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


def live(found, arm, periods, late=0, start=None, gain=1.0, rng=None):
    """Estimates that a filter makes in every period of an arm under smooth tensions, from rest or a
    start, and q and q_dot as they were; gain (n_a,) of the tendons, rng of the sensors' noise."""
    simulation, n = Simulation(arm), arm.tendon_count
    sent, last = [np.zeros(n)] * 12, None
    if start is not None:
        simulation.reset(start, 0 * start)
    estimates, states = [], []
    for k in range(periods):
        told = measurement(arm, simulation.state, sent[-found.history :], k * PERIOD, found.needs)
        if rng is not None:
            told = noisy(told, rng)
        last = found.estimate(told, last)
        estimates.append(last)
        states.append(simulation.state)
        waves = 1.0 - np.cos(2.0 * k * PERIOD * (1.0 + 0.6 * np.arange(n)))
        sent.append(0.8 * waves)
        whole, rest = divmod(late, PERIOD)
        newest = len(sent) - 1 - int(whole)
        for tension, seconds in ((sent[newest - 1], rest), (sent[newest], PERIOD - rest)):
            simulation.step(gain * tension, seconds)
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


@pytest.fixture(scope="module")
def noisy_life(build):
    """A filter under noise, of an arm that is as its model says: its estimates, and coordinates and
    rates as they were."""
    model = build("three_tendon", {"quadrature.intervals": 4})
    found = filter_of(model, noise=NOISE)
    return model, live(found, model, 150, rng=np.random.default_rng(1))


def test_errors_are_within_the_filter_s_own_deviations(noisy_life):
    """On average of the size that its covariance says, or smaller: it counts with worse models."""
    model, (estimates, q, q_dot) = noisy_life
    scale, n = model.coordinate_scale(), model.coordinate_count
    sizes = []
    for estimate, coordinates, rates in zip(estimates[50:], q[50:], q_dot[50:], strict=True):
        off = np.concatenate([estimate.q - coordinates, estimate.q_dot - rates])
        off /= np.tile(scale, 2)
        covariance = estimate.memory.covariance[: 2 * n, : 2 * n]
        sizes.append(off @ np.linalg.solve(covariance, off) / (2 * n))
    assert 0.01 < np.mean(sizes) < 1.5


def test_the_tip_is_known_better_than_it_is_measured(noisy_life):
    """Half as well at least; the noise is seen once a period, the motion from many."""
    model, (estimates, q, _) = noisy_life
    off = [
        pose_error(model.tip_pose(coordinates), estimate.tip_pose)[3:]
        for estimate, coordinates in zip(estimates[50:], q[50:], strict=True)
    ]
    assert np.sqrt(np.mean(np.square(off))) < 0.6 * NOISE.position


def test_gains_of_the_tendons_are_found(arm):
    gain = np.array([1.12, 0.9, 1.05])
    estimates, *_ = live(filter_of(arm), arm, 250, gain=gain)
    np.testing.assert_allclose(estimates[-1].input_error.gain, gain, atol=0.03)
    assert np.abs(estimates[-1].input_error.offset).max() < 0.1


def test_a_latency_that_is_known_is_not_estimated(arm):
    """It is believed: with a wrong one the rates are off."""
    off = {}
    for latency in (0.05, 0.0):
        estimates, _, q_dot = live(filter_of(arm, latency=latency), arm, 60, late=0.05)
        assert estimates[-1].latency is None
        off[latency] = np.abs((estimates[-1].q_dot - q_dot[-1]) / arm.coordinate_scale()).max()
    assert off[0.05] < 0.2 * off[0.0]


UNCERTAINTY = Uncertainty(
    force=0.0,
    tension=0.0,
    timing=0.0,
    offset=0.3,
    offset_start=0.05,
    offset_time=2.0,
    gain=0.2,
    gain_start=0.07,
    gain_time=0.5,
    tip=0.004,
    tip_start=0.003,
    latency=0.002,
    latency_start=0.01,
    state_start=0.02,
)


def bending_tension(model):
    """Tensions of single tendons that store as much as bending the arm by 1 rad: twice that energy
    is the unit of energy."""
    rest = np.zeros(model.coordinate_count)
    terms = model.terms(rest, rest)
    compliance = terms.actuation.T @ np.linalg.solve(terms.stiffness, terms.actuation)
    return np.sqrt(model.bending_energy / np.diag(compliance))


def test_a_tendon_s_unit_bends_the_arm_by_about_a_radian(arm):
    """To first order, and a little less: it also shortens it."""
    small = 1e-3
    for k, tension in enumerate(bending_tension(arm)):
        tensions = small * tension * np.eye(3)[k]
        turn = pose_error(np.eye(4), arm.tip_pose(arm.rest_coordinates(tensions)))[:3]
        assert np.linalg.norm(turn) == pytest.approx(small, rel=0.2)


def test_the_first_belief_has_the_deviations_that_are_told(arm):
    """The arm at rest under the tensions that hold it; rates ten times as uncertain as
    coordinates, a radian of the tip as its length."""
    tension = np.array([1.0, 0.2, 0.4])
    setting = Setting(PERIOD, tension, latency=0.03, observed=(), uncertainty=UNCERTAINTY)
    layout = layout_of(arm)
    for greatest_latency, latency_deviation in ((0.08, 0.01), (None, 0.0)):
        first = ExtendedKalmanFilter(arm, setting, greatest_latency)._first()
        expected = {
            "z": 0.02,
            "v": 0.2,
            "offset": 0.05 * bending_tension(arm),
            "gain": 0.07,
            "tip": 0.003 * np.repeat([1.0, arm.length], 3),
            "latency": latency_deviation,
        }
        for name, deviation in expected.items():
            part = getattr(layout, name)
            variances = np.diag(first.covariance)[part]
            np.testing.assert_allclose(variances, np.broadcast_to(deviation, variances.shape) ** 2)
        at_rest = arm.rest_coordinates(tension) / arm.coordinate_scale()
        np.testing.assert_allclose(first.mean[layout.z], at_rest, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(first.mean[layout.latency], 0.03)
        others = np.delete(first.mean, [*range(3), layout.latency.start])
        np.testing.assert_array_equal(others, 0.0)


@pytest.fixture
def erring(arm, random_state):
    """The state of a filter of an arm in motion whose inputs err, without covariance."""
    q, q_dot = random_state(arm, 0)
    layout = layout_of(arm)
    mean = np.zeros(layout.latency.stop)
    mean[layout.z] = q / arm.coordinate_scale()
    mean[layout.v] = q_dot / arm.coordinate_scale()
    mean[layout.offset] = [0.1, -0.05, 0.2]
    mean[layout.gain] = [0.2, -0.1, 0.05]
    mean[layout.tip] = 0.01
    mean[layout.latency] = 0.025
    nothing = np.zeros((mean.size, mean.size))
    return Belief(mean, nothing, np.zeros((6, 6)), np.zeros(0))


SENT = np.array([[0.5, 1.0, 0.0], [1.5, 0.2, 0.4], [1.0, 0.0, 2.0], [0.0, 3.0, 1.0]])


def in_transit(time=1.0):
    """A measurement of an arm to which the commands SENT are on their way."""
    return Measurement(np.eye(4), SENT, time)


@pytest.mark.parametrize(
    ("latency", "indices", "seconds"),
    [
        (0.0, (2, 3), (0.0, 0.02)),
        (0.005, (2, 3), (0.005, 0.015)),
        (0.02, (1, 2), (0.0, 0.02)),
        (0.025, (1, 2), (0.005, 0.015)),
        (0.04, (0, 1), (0.0, 0.02)),
        (0.06, (0, 0), (0.0, 0.02)),  # the eldest is all that is known
    ],
)
def test_commands_act_after_their_latency(arm, latency, indices, seconds):
    found = filter_of(arm, (), greatest_latency=0.08)
    tension, parts = found._acting(latency, in_transit())
    np.testing.assert_array_equal(tension, SENT[list(indices)])
    np.testing.assert_allclose(parts, seconds, atol=1e-12)


@pytest.mark.parametrize(("greatest", "history"), [(None, 3), (0.02, 3), (0.05, 4), (0.06, 5)])
def test_commands_are_kept_for_as_long_as_they_may_be_late(arm, greatest, history):
    assert filter_of(arm, (), greatest_latency=greatest, latency=0.02).history == history


def test_a_period_s_prediction_is_the_motion_and_forgets_at_its_rates(arm, erring):
    """The commands act late, by gains and with offsets, which fade with their times; the tip's
    displacement and the latency stay."""
    found = filter_of(arm, (), greatest_latency=0.08, uncertainty=UNCERTAINTY)
    predicted = found._predict(erring, in_transit())
    layout, mean = layout_of(arm), erring.mean
    scale = arm.coordinate_scale()
    gain = 1.0 + mean[layout.gain]
    offset = mean[layout.offset]
    simulation = Simulation(arm)
    simulation.reset(scale * mean[layout.z], scale * mean[layout.v])
    # 25 ms late: the command before last takes over after 5 ms
    simulation.step(gain * SENT[1] + offset, 0.005)
    simulation.step(gain * SENT[2] + offset, 0.015)
    state = simulation.state
    for part, value in ((layout.z, state.q), (layout.v, state.q_dot)):
        scaled = value / scale
        np.testing.assert_allclose(predicted.mean[part], scaled, atol=1e-3 * np.abs(scaled).max())
    kept = {
        "offset": np.exp(-PERIOD / 2.0),
        "gain": np.exp(-PERIOD / 0.5),
        "tip": 1.0,
        "latency": 1.0,
    }
    for name, share in kept.items():
        part = getattr(layout, name)
        np.testing.assert_allclose(predicted.mean[part], share * mean[part], rtol=1e-12)


def test_walks_add_their_variance_in_a_second(arm, erring):
    """In a period its share of it."""
    found = filter_of(arm, (), greatest_latency=0.08, uncertainty=UNCERTAINTY)
    variances = np.diag(found._predict(erring, in_transit()).covariance) / PERIOD
    layout = layout_of(arm)
    expected = {
        "z": 0.0,
        "v": 0.0,
        "offset": 0.3 * bending_tension(arm),
        "gain": 0.2,
        "tip": 0.004 * np.repeat([1.0, arm.length], 3),
        "latency": 0.002,
    }
    for name, deviation in expected.items():
        part = variances[getattr(layout, name)]
        np.testing.assert_allclose(part, np.broadcast_to(deviation, part.shape) ** 2, atol=1e-12)


def test_the_transition_is_the_slope_of_the_prediction(arm, erring):
    """Column by column. The Jacobians of a rollout are not those of the simulation: within a third
    of the greatest. Of coordinates by the latency only the direction is right: a jump of
    the command, a small one here, counts as its mean over the period."""
    measured = in_transit()._replace(sent=1.0 + 0.1 * SENT)
    found = filter_of(arm, (), greatest_latency=0.08, uncertainty=UNCERTAINTY)
    layout = layout_of(arm)
    nothing = found._predict(erring, measured).covariance
    for column, unit in enumerate(np.eye(erring.mean.size)):
        certain = erring._replace(covariance=np.outer(unit, unit))
        outer = found._predict(certain, measured).covariance - nothing
        steps = [erring._replace(mean=erring.mean + sign * 1e-4 * unit) for sign in (1.0, -1.0)]
        more, less = (found._predict(step, measured).mean for step in steps)
        slope = (more - less) / 2e-4
        greatest = np.argmax(np.abs(slope))
        if column == layout.latency.start:
            greatest = np.argmax(np.abs(slope[layout.z]))
        transition = outer[greatest] / np.sqrt(outer[greatest, greatest])
        transition *= np.sign(slope[greatest])
        for rows in layout:
            off = np.abs(transition[rows] - slope[rows]).max()
            size = np.abs(slope[rows]).max()
            if column < layout.latency.start or rows == layout.latency:
                assert off <= 0.33 * size + 1e-9
    cosine = transition[layout.z] @ slope[layout.z]
    cosine /= np.linalg.norm(transition[layout.z]) * np.linalg.norm(slope[layout.z])
    assert cosine > 0.7


def test_white_tensions_are_more_where_late_commands_change(arm, erring):
    """By the deviation of the latency, in periods, times the range of the commands in transit."""
    told = Uncertainty(tension=0.02, timing=0.5)
    found = filter_of(arm, (), greatest_latency=0.08, uncertainty=told)
    latency = layout_of(arm).latency
    covariance = erring.covariance.copy()
    covariance[latency, latency] = 0.008**2
    white = found._white_tension(erring._replace(covariance=covariance), in_transit())
    of_timing = 0.5 * 0.008 / PERIOD * (SENT.max(axis=0) - SENT.min(axis=0))
    always = 0.02 * bending_tension(arm)
    np.testing.assert_allclose(white, np.sqrt(always**2 + of_timing**2))


@pytest.mark.parametrize("kind", ["force", "tension"])
def test_white_inputs_add_what_they_move(arm, erring, kind):
    """Of deviations that are told: the squares of what each alone moves in a period."""
    told = UNCERTAINTY._replace(**{kind: 0.03})
    found = filter_of(arm, (), greatest_latency=0.08, uncertainty=told)
    noise = found._predict(erring, in_transit()).noise
    layout, mean, scale = layout_of(arm), erring.mean, arm.coordinate_scale()
    simulation = Simulation(arm)
    simulation.reset(scale * mean[layout.z], scale * mean[layout.v])
    tension = (1.0 + mean[layout.gain]) * SENT[[1, 2]] + mean[layout.offset]
    seconds = np.array([0.005, 0.015])
    # a generalised force that bends the arm by a share of 1 rad
    forces = np.diag(0.03 * arm.bending_energy / scale)
    rollout = simulation.rollout(tension[None], seconds, forces=forces)
    moved = rollout.by_force[0]
    if kind == "tension":
        moved = rollout.by_tension[0] * (0.03 * bending_tension(arm))
    moved = moved / np.tile(scale, 2)[:, None]
    np.testing.assert_allclose(noise, moved @ moved.T, rtol=1e-9, atol=1e-15)


@pytest.fixture
def belief(arm, erring):
    """A belief with a covariance of every pair of entries, and noise of the last period."""
    rng = np.random.default_rng(3)
    deviations = 1e-3 * (1.0 + rng.random(erring.mean.size))
    factor = 0.3 * rng.normal(size=(erring.mean.size,) * 2)
    covariance = (factor @ factor.T + np.eye(erring.mean.size)) * np.outer(deviations, deviations)
    noise = 1e-5 * np.eye(6)
    return erring._replace(covariance=covariance, noise=noise)


@pytest.mark.parametrize("size", [1e-4, 0.3], ids=["usual", "surprising"])
def test_an_update_is_kalman_s(arm, belief, size):
    """mean + K y and (1 - K H) P with K = P H^T (H P H^T + R)^-1. Where the mean square of the
    innovations passes four of their variances, the noise of the motion is taken for greater, as
    often as it passes that."""
    found = filter_of(arm, ("tendon_length",), greatest_latency=0.08)
    layout, scale = layout_of(arm), arm.coordinate_scale()
    q = scale * belief.mean[layout.z]
    tip_pose = moved_pose(arm.tip_pose(q), belief.mean[layout.tip] + size * np.arange(6.0))
    lengths = arm.tendon_lengths(q) + 0.1 * size
    measured = Measurement(tip_pose, SENT, 1.0, tendon_length=lengths)
    y, H, variance = found._sensor_model.innovations(belief.mean, measured)
    P = belief.covariance.copy()
    S = H @ P @ H.T + np.diag(variance)
    surprise = y @ np.linalg.solve(S, y) / y.size
    assert (surprise > 4.0) == (size == 0.3)
    if surprise > 4.0:
        P[:6, :6] += (surprise / 4.0 - 1.0) * belief.noise
        S = H @ P @ H.T + np.diag(variance)
    K = np.linalg.solve(S, H @ P).T
    mean = belief.mean + K @ y
    mean[layout.gain] = np.clip(mean[layout.gain], -0.5, 1.0)
    mean[layout.latency] = np.clip(mean[layout.latency], 0.0, 0.08)
    updated = found._update(belief, measured)
    np.testing.assert_allclose(updated.mean, mean, atol=1e-9)
    np.testing.assert_allclose(updated.covariance, P - K @ H @ P, atol=1e-12)
    np.testing.assert_array_equal(updated.covariance, updated.covariance.T)


def test_updates_that_no_arm_can_take_are_given_up(arm, belief):
    """From what is usual to what is absurd: the shape is one that the model has, or there is no
    update; of the greatest there is none."""
    found = filter_of(arm, ("tendon_length",), greatest_latency=0.08)
    layout, scale = layout_of(arm), arm.coordinate_scale()
    q = scale * belief.mean[layout.z]
    tip_pose = moved_pose(arm.tip_pose(q), belief.mean[layout.tip])
    given_up = []
    for size in np.geomspace(1e-3, 1e12, 46):
        lengths = arm.tendon_lengths(q) + size * np.array([1.0, -0.5, 0.3])
        measured = Measurement(tip_pose, SENT, 1.0, tendon_length=lengths)
        updated = found._update(belief, measured)
        given_up.append(updated is None)
        if updated is not None:
            arm.tip_pose(scale * updated.mean[layout.z])
    assert not given_up[0]
    assert given_up[-1]


def test_gains_and_latency_stay_within_their_bounds(arm):
    """A tendon pulls with half to twice of what is asked for; commands are late by at most what is
    told, and not early."""
    layout = layout_of(arm)
    found = filter_of(arm, (), greatest_latency=0.08)
    for off, gain, latency in ((5.0, 1.0, 0.08), (-5.0, -0.5, 0.0), (0.05, 0.05, 0.05)):
        mean = np.full(layout.latency.stop, off)
        found._keep_plausible(mean)
        np.testing.assert_array_equal(mean[layout.gain], gain)
        np.testing.assert_array_equal(mean[layout.latency], latency)
        np.testing.assert_array_equal(mean[layout.z], off)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tension": [0.0]}, r"tension should have shape \(3,\)"),
        ({"latency": -0.1}, "latency should be a number, at least 0"),
        ({"uncertainty": Uncertainty(tip=-1.0)}, "uncertainty.tip should be a number, at least 0"),
    ],
)
def test_bad_settings_are_refused_by_name(arm, changes, message):
    setting = Setting(PERIOD, np.zeros(3), ("tendon_length",), SENSORS)
    with pytest.raises(ValueError, match=message):
        ExtendedKalmanFilter(arm, setting._replace(**changes))


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
