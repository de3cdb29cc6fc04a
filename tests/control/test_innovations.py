"""Expected measurements of the filter: their Jacobians against differences, their variances by
field."""

import numpy as np
import pytest

from soft_tendon_env.control.innovations import (
    SensorModel,
    Surprise,
    layout_of,
    noise_variances,
)
from soft_tendon_env.control.protocol import Measurement, SensorNoise
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error

PLACES = 4
SENSORS = np.array([0.1, 0.2])
FIELDS = ("tip_twist", "tendon_length", "strain", "strain_rate")
SIZES = {"tip_twist": 6, "tendon_length": 3, "strain": 12, "strain_rate": 12}
NOISE = SensorNoise(
    position=0.001,
    rotation=0.02,
    length=0.003,
    curvature=0.4,
    stretch=0.05,
    curvature_rate=6.0,
    stretch_rate=0.7,
)


@pytest.fixture
def sensor_model(model):
    return SensorModel(model, layout_of(model, PLACES), FIELDS, SENSORS, SensorNoise())


@pytest.fixture
def mean(model, random_state):
    """The state of a filter in motion, with a displaced tip."""
    q, q_dot = random_state(model, 0)
    scale = model.coordinate_scale()
    layout = layout_of(model, PLACES)
    state = np.zeros(layout.size)
    state[layout.z] = q / scale
    state[layout.v] = q_dot / scale
    state[layout.offset] = 0.1
    state[layout.tip] = [0.01, -0.02, 0.03, 0.001, 0.002, -0.001]
    return state


def exact_measurement(model, mean):
    """What the sensors of an arm in the state of a filter say."""
    layout = layout_of(model, PLACES)
    scale = model.coordinate_scale()
    q = scale * mean[layout.z]
    q_dot = scale * mean[layout.v]
    terms = model.terms(q, q_dot)
    strain, slope = model.strain_at(q, SENSORS)
    return Measurement(
        tip_pose=moved_pose(terms.tip_pose, mean[layout.tip]),
        sent=np.zeros((2, 3)),
        time=0.0,
        tip_twist=terms.tip_jacobian @ q_dot,
        tendon_length=model.tendon_lengths(q),
        strain=strain,
        strain_rate=slope @ q_dot,
    )


def rows_of(name):
    """Rows of a field among the innovations: the tip's pose comes first."""
    start = 6
    for field in FIELDS:
        if field == name:
            break
        start += SIZES[field]
    return slice(start, start + SIZES[name])


def test_the_layout_has_every_entry_once(model):
    """In the order of its fields."""
    layout = layout_of(model, PLACES)
    sizes = [part.stop - part.start for part in layout]
    assert sizes == [3, 3, 3, 3, 6, 3 * PLACES, 1, 1, 1, 1, 1, 1]
    assert layout.z.start == 0
    assert all(a.stop == b.start for a, b in zip(layout, layout[1:], strict=False))


def test_what_is_expected_leaves_no_innovation(model, sensor_model, mean):
    innovation, *_ = sensor_model.innovations(mean, exact_measurement(model, mean))
    assert innovation.size == 6 + sum(SIZES.values())
    np.testing.assert_allclose(innovation, 0.0, atol=1e-9)


def test_innovations_are_what_is_measured_less_what_is_expected(model, sensor_model, mean):
    exact = exact_measurement(model, mean)
    twist = np.array([0.01, 0.02, 0.03, 0.001, -0.002, 0.003])
    more = {name: getattr(exact, name) + 0.25 for name in FIELDS}
    off = exact._replace(tip_pose=moved_pose(exact.tip_pose, twist), **more)
    innovation, *_ = sensor_model.innovations(mean, off)
    np.testing.assert_allclose(innovation[:6], twist, atol=1e-9)
    np.testing.assert_allclose(innovation[6:], 0.25, atol=1e-9)


def test_jacobians_are_the_slopes_of_what_is_expected(model, sensor_model, mean):
    """Column by column; velocities by the rates alone, what coordinates change of them is noise."""
    layout = layout_of(model, PLACES)
    measured = exact_measurement(model, mean)
    _, jacobian, _ = sensor_model.innovations(mean, measured)
    step = 1e-5
    slopes = np.zeros_like(jacobian)
    for column in range(mean.size):
        aside = np.zeros(mean.size)
        aside[column] = step
        more, _, _ = sensor_model.innovations(mean + aside, measured)
        less, _, _ = sensor_model.innovations(mean - aside, measured)
        slopes[:, column] = (less - more) / (2.0 * step)
    for name in ("tip_twist", "strain_rate"):
        slopes[rows_of(name), layout.z] = 0.0
    # a displaced tip turns the frame in which the model's is seen: to first order in it
    allowed = 0.1 * np.abs(slopes[:6]).max(axis=0)
    assert (np.abs(jacobian[:6] - slopes[:6]) <= allowed + 1e-9).all()
    largest_slope = np.abs(slopes).max()
    np.testing.assert_allclose(jacobian[6:], slopes[6:], atol=1e-5 * largest_slope)


def test_variances_add_those_of_sensors_to_those_of_the_model(model):
    """Of independent errors: the squares of their deviations."""
    exact = noise_variances(model, SensorNoise(), 2)
    noisy = noise_variances(model, NOISE, 2)
    of_sensors = {
        "tip_pose": np.repeat([0.02, 0.001], 3) ** 2,
        "tip_twist": 0.0,
        "tendon_length": 0.003**2,
        "strain": np.tile(np.repeat([0.4, 0.05], 3), 2) ** 2,
        "strain_rate": np.tile(np.repeat([6.0, 0.7], 3), 2) ** 2,
    }
    assert exact.keys() == of_sensors.keys()
    for name, variance in of_sensors.items():
        added = noisy[name] - exact[name]
        expected_added = np.broadcast_to(variance, added.shape)
        np.testing.assert_allclose(added, expected_added, atol=1e-12)
        assert (exact[name] > 0.0).all()


def test_variances_of_the_model_are_of_the_rod_s_size(model, build):
    """Curvatures by its length, lengths in shares of it; a rod four times as long."""
    longer = build("three_tendon", {"quadrature.intervals": 4, "segments.0.length": 1.2})
    expected_length = 4.0 * model.length
    assert longer.length == pytest.approx(expected_length)
    of_short = noise_variances(model, SensorNoise(), 1)
    of_long = noise_variances(longer, SensorNoise(), 1)
    ratio = {}
    for name, variance in of_short.items():
        ratio[name] = np.sqrt(of_long[name] / variance)

    rotation_then_position = [1, 1, 1, 4, 4, 4]
    np.testing.assert_allclose(ratio["tip_pose"], rotation_then_position)
    np.testing.assert_allclose(ratio["tip_twist"], rotation_then_position)
    np.testing.assert_allclose(ratio["tendon_length"], 4.0)
    curvature_then_stretch = [0.25, 0.25, 0.25, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(ratio["strain"], curvature_then_stretch)
    np.testing.assert_allclose(ratio["strain_rate"], curvature_then_stretch)


@pytest.mark.parametrize(("tolerance", "share"), [(1e-6, 1e-4), (1.5e-4, 2e-3)])
def test_the_tip_of_a_model_is_off_by_four_tolerances_or_a_ten_thousandth(build, tolerance, share):
    """Tolerances are in m, and the rod has 0.3 m. Its turn is off by ten times as many radians."""
    changes = {"quadrature.intervals": 4, "integrator.tolerance": tolerance}
    model = build("three_tendon", changes)
    variances = noise_variances(model, SensorNoise(), 1)
    off = share * model.length
    expected = np.repeat([10.0 * share, off], 3) ** 2
    np.testing.assert_allclose(variances["tip_pose"], expected)
    np.testing.assert_allclose(variances["tendon_length"], off**2)


def test_velocities_are_less_certain_the_faster_the_arm(model, sensor_model, mean):
    """By a share of what is expected of them, as the Jacobian at other coordinates is another."""
    layout = layout_of(model, PLACES)
    still = mean.copy()
    still[layout.v] = 0.0
    measured = exact_measurement(model, mean)
    _, _, at_rest = sensor_model.innovations(still, measured)
    _, _, moving = sensor_model.innovations(mean, measured)
    for name in ("tip_twist", "strain_rate"):
        added = moving[rows_of(name)] - at_rest[rows_of(name)]
        expected = getattr(measured, name).ravel()
        expected_added = 0.2**2 * expected**2
        np.testing.assert_allclose(added, expected_added, atol=1e-9)
    for name in ("tendon_length", "strain"):
        np.testing.assert_array_equal(moving[rows_of(name)], at_rest[rows_of(name)])


def test_a_surprise_comes_soon_and_goes_slowly():
    """The running mean over half a second of squares up to 10, and the greatest of it, of which 1/e
    is left after ten seconds."""
    period = 0.02
    surprise = Surprise()
    for _ in range(50):
        surprise = surprise.after(4.0, period)
    kept = np.exp(-period / 0.5)
    expected = 4.0 * (1.0 - kept**50)
    assert surprise.recent == pytest.approx(expected)
    assert surprise.lasting == surprise.recent
    for _ in range(100):
        surprise = surprise.after(0.0, period)
    assert surprise.recent == pytest.approx(expected * kept**100)
    assert surprise.lasting == pytest.approx(expected * np.exp(-100 * period / 10.0))
    pushed = Surprise().after(1e6, period)
    assert pushed.recent == pytest.approx(10.0 * (1.0 - kept))


def test_without_sensors_of_strains_there_are_none(model, mean):
    layout = layout_of(model, PLACES)
    blind = SensorModel(model, layout, ("tendon_length",), np.zeros(0), NOISE)
    exact = exact_measurement(model, mean)
    measured = exact._replace(strain=None, strain_rate=None)
    innovation, jacobian, variance = blind.innovations(mean, measured)
    assert innovation.shape == (9,)
    assert variance.shape == (9,)
    assert jacobian.shape == (9, mean.size)
    off = pose_error(np.eye(4), measured.tip_pose)
    assert np.abs(off).max() > 0.01
