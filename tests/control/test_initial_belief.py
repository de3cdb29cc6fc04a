"""First beliefs of the Kalman filter: declared deviations in the arm's units, and coordinates that
go with loads as statics say."""

import numpy as np
import pytest

from soft_tendon_env import static_equilibrium
from soft_tendon_env.control import ExtendedKalmanFilter, Measurement, Setting, Uncertainty
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
TENSION = np.array([1.0, 0.3, 0.6])  # [N]
GRAVITY = 9.81  # [m/s^2]
START = Uncertainty(
    offset_start=0.03,
    gain_start=0.04,
    tip_start=0.005,
    load_start=0.2,
    stiffness_start=0.07,
    damping_start=0.6,
    payload_start=0.11,
    friction_start=0.08,
    state_start=0.013,
)


def filter_of(model, **more):
    options = {"latency": 0.03, "lag": 0.01, **more}
    return ExtendedKalmanFilter(
        model, Setting(PERIOD, TENSION, ("tendon_length",), uncertainty=START, **options)
    )


@pytest.fixture(scope="module")
def estimator(model):
    return filter_of(model)


@pytest.fixture(scope="module")
def resting(estimator):
    """The belief before the first measurement."""
    return estimator._initial.at_rest(estimator._initial.rest)


def test_deviations_are_those_declared_in_units_of_the_arm(model, estimator, resting):
    """Loads in its weight on earth, masses in its mass, displacements in its length, tensions in
    those that bend it by 1 rad."""
    layout = estimator.space.layout
    mass = model.arm.rod.mass[0]
    deviation = np.sqrt(np.diag(resting.covariance))
    rest = np.zeros(3)
    terms = model.terms(rest, rest)
    bent = np.linalg.solve(terms.stiffness, terms.actuation)
    # tensions of single tendons that store the energy of bending by 1 rad
    unit = np.sqrt(model.bending_energy / np.diag(terms.actuation.T @ bent))
    expected = {
        "offset": 0.03 * unit,
        "gain": 0.04,
        "tip": 0.005 * np.repeat([1.0, model.length], 3),
        "load": 0.2 * GRAVITY * mass,
        "stiffness": 0.07,
        "damping": 0.6,
        "payload": 0.11 * mass,
        "friction": 0.08,
        "latency": 0.0,
        "lag": 0.0,
        "v": 0.13,  # ten times the coordinates', in 1 s
    }
    for name, size in expected.items():
        np.testing.assert_allclose(deviation[getattr(layout, name)], size, rtol=1e-6, err_msg=name)


STEP = 1e-3
"""Difference of tensions [N] and of gains."""
FORCE = 1e-4
"""Difference of forces at the tip [N]."""


def moved_by_tensions(model, steps):
    """Differences (n, n_a) of coordinates at rest by other tensions, a row of steps each."""
    usual = static_equilibrium(model, TENSION).q
    columns = []
    for step in steps:
        tension = TENSION + step
        moved = static_equilibrium(model, tension).q
        columns.append(moved - usual)
    return np.stack(columns, axis=1)


def moved_by_loads(model):
    """Differences (n, 3) of coordinates at rest by forces at the tip along the world's axes."""
    usual = static_equilibrium(model, TENSION).q
    columns = []
    for axis in np.eye(3):
        force = FORCE * axis
        changes = {"effects.tip_load.force": force.tolist()}
        scene = model.scene.replace(changes)
        loaded = model.with_scene(scene)
        moved = static_equilibrium(loaded, TENSION).q
        columns.append(moved - usual)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("part", ["offset", "gain", "load"])
def test_coordinates_go_with_what_bends_the_arm_at_rest(model, estimator, resting, part):
    """Their covariance is the slope of static equilibria times the variance of the cause."""
    layout = estimator.space.layout
    entries = np.arange(layout.size)
    causes = entries[getattr(layout, part)]
    if part == "load":
        # those of the last place, which is the tip
        causes = causes[-3:]
        slope = moved_by_loads(model) / FORCE
    else:
        shares = TENSION if part == "gain" else np.ones(3)
        steps = STEP * np.diag(shares)
        slope = moved_by_tensions(model, steps) / STEP
    scale = estimator.space.scale[:, None]
    variance = resting.covariance[causes, causes]
    expected = slope / scale * variance
    rows = resting.covariance[layout.z]
    off = rows[:, causes] - expected
    # the place of a load is one of a coarse quadrature
    allowed = 0.02 * np.linalg.norm(expected)
    assert np.linalg.norm(off) < allowed


def test_a_stiffer_arm_is_less_bent(model, estimator, resting):
    """By as many per cent, as far as tensions alone bend it."""
    layout = estimator.space.layout
    factor = layout.stiffness.start
    column = resting.covariance[:, factor]
    variance = column[factor]
    share = column[layout.z] / variance
    rest = static_equilibrium(model, TENSION).q
    at_rest = rest / estimator.space.scale
    np.testing.assert_allclose(share, -at_rest, rtol=1e-3)


def test_the_arm_is_believed_where_its_tensions_hold_it(model, estimator, resting):
    """At rest, with the timing that is known and nothing wrong."""
    space = estimator.space
    layout = space.layout
    q, q_dot = space.coordinates(resting.mean)
    rest = static_equilibrium(model, TENSION).q
    np.testing.assert_allclose(q, rest, rtol=1e-9)
    np.testing.assert_array_equal(q_dot, 0.0)
    assert space.timing(resting.mean) == (0.03, 0.01)
    first = layout.offset.start
    behind = layout.latency.start
    errors = resting.mean[first:behind]
    np.testing.assert_array_equal(errors, 0.0)
    assert resting.bank is None


@pytest.fixture(scope="module")
def untimed(model):
    """A filter that knows neither latency nor lag."""
    return filter_of(model, latency=None, lag=None)


def test_an_unknown_timing_is_the_mean_of_its_hypotheses(untimed):
    initial = untimed._initial
    belief = initial.at_rest(initial.rest)
    layout = untimed.space.layout
    bank = belief.bank
    weight = bank.weight
    for name in ("latency", "lag"):
        values = getattr(bank.timing, name)
        entry = getattr(layout, name).start
        mean = weight @ values
        assert belief.mean[entry] == pytest.approx(mean)
        deviation = bank.deviation[entry]
        np.testing.assert_allclose(deviation, values - mean, atol=1e-15)
    np.testing.assert_array_equal(bank.deviation[layout.z], 0.0)


@pytest.fixture(scope="module")
def lost_and_known(model, untimed):
    """A belief after a measurement, and that of a filter that has lost the arm then."""
    still = Simulation(model).reset_at_rest(TENSION)
    sent = np.tile(TENSION, (untimed.history, 1))
    tip_pose = model.tip_pose(still.q)
    lengths = model.tendon_lengths(still.q)
    measured = Measurement(tip_pose, sent, 0.0, tendon_length=lengths)
    known = untimed.estimate(measured, None).memory
    known = known._replace(mean=known.mean + 0.01)
    lost = untimed._initial.lost(known)
    return lost, known


def test_a_lost_arm_may_be_anywhere(untimed, lost_and_known):
    """Its coordinates and rates no longer go with anything, nor with each other."""
    lost, known = lost_and_known
    layout = untimed.space.layout
    moving = slice(layout.v.stop)
    others = slice(layout.v.stop, None)
    before = known.covariance[moving, others]
    assert np.abs(before).max() > 0.0
    np.testing.assert_array_equal(lost.covariance[moving, others], 0.0)
    np.testing.assert_array_equal(lost.covariance[others, moving], 0.0)
    block = lost.covariance[moving, moving]
    variance = np.diag(block)
    expected_block = np.diag(variance)
    np.testing.assert_array_equal(block, expected_block)
    known_variance = np.diag(known.covariance)[moving]
    assert (variance > 0.2**2).all()
    assert (variance > 10.0 * known_variance).all()
    np.testing.assert_array_equal(lost.mean[layout.v], 0.0)
    np.testing.assert_array_equal(lost.bank.deviation[moving], 0.0)


def test_a_filter_that_lost_the_arm_remembers_all_else(untimed, lost_and_known):
    lost, known = lost_and_known
    layout = untimed.space.layout
    others = slice(layout.v.stop, None)
    np.testing.assert_array_equal(lost.mean[layout.z], known.mean[layout.z])
    np.testing.assert_array_equal(lost.mean[others], known.mean[others])
    block = lost.covariance[others, others]
    known_block = known.covariance[others, others]
    np.testing.assert_array_equal(block, known_block)
    deviation = lost.bank.deviation[others]
    known_deviation = known.bank.deviation[others]
    np.testing.assert_array_equal(deviation, known_deviation)
