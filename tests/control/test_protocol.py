"""Outputs of controllers with their reports, and the noise of sensors by its fields."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.control.objectives import TipPosition
from soft_tendon_env.control.protocol import ModelController, SensorNoise
from soft_tendon_env.control.shape_tracking import ShapeTracking
from soft_tendon_env.control.tip_tracking import TipTracking

LIMITS = np.array([[0.0, 4.0], [-1.0, 1.0], [2.0, 10.0]])


@pytest.fixture
def controller():
    return ModelController(None, LIMITS, 0.02)


@pytest.mark.parametrize(
    ("tension", "cut_off", "limited"),
    [
        ([1.0, 0.5, 5.0], [1.0, 0.5, 5.0], 0.0),
        ([-1.0, 0.5, 5.0], [0.0, 0.5, 5.0], 1.0 / 3.0),
        ([5.0, 0.5, 1.0], [4.0, 0.5, 2.0], 2.0 / 3.0),
        ([9.0, -9.0, 99.0], [4.0, -1.0, 10.0], 1.0),
        ([1e-10, 0.5, 10.0 - 1e-10], [1e-10, 0.5, 10.0 - 1e-10], 2.0 / 3.0),
        ([1e-6, 0.5, 10.0 - 1e-6], [1e-6, 0.5, 10.0 - 1e-6], 0.0),
    ],
)
def test_tensions_are_cut_off_at_their_limits_and_counted_there(
    controller, tension, cut_off, limited
):
    output = controller.output(np.array(tension), "memory", disturbance=2.0)
    np.testing.assert_array_equal(output.tension, cut_off)
    assert output.memory == "memory"
    report = {"limited": pytest.approx(limited), "singular": 0.0, "disturbance": 2.0}
    assert output.report == report


def test_holding_keeps_the_last_tensions_and_says_so(controller):
    last = np.array([1.0, 0.0, 99.0])
    now = ControllerInput(np.zeros(3), np.zeros(3), np.eye(4), last, Reference(np.zeros(1)))
    output = controller.hold(now, "memory")
    np.testing.assert_array_equal(output.tension, [1.0, 0.0, 10.0])
    assert output.memory == "memory"
    assert output.report["singular"] == 1.0


def test_noise_of_strains_is_by_sensor_angular_before_linear():
    noise = SensorNoise(curvature=0.5, stretch=0.25, curvature_rate=4.0, stretch_rate=3.0)
    of_sensor = [0.5, 0.5, 0.5, 0.25, 0.25, 0.25]
    np.testing.assert_array_equal(noise.of_strains(2), of_sensor + of_sensor)
    of_rates = [4.0, 4.0, 4.0, 3.0, 3.0, 3.0]
    np.testing.assert_array_equal(noise.of_strain_rates(2), of_rates + of_rates)


CHANGE = np.array([0.5, 0.25, 3.0])  # [N] in a period


@pytest.mark.parametrize(
    ("last", "least", "greatest"),
    [
        ([2.0, 0.0, 6.0], [1.5, -0.25, 3.0], [2.5, 0.25, 9.0]),
        ([0.25, -1.0, 9.0], [0.0, -1.0, 6.0], [0.75, -0.75, 10.0]),
        # what was asked for beyond the limits was never there
        ([9.0, -9.0, 0.0], [3.5, -1.0, 2.0], [4.0, -0.75, 5.0]),
    ],
)
def test_actuators_reach_what_is_near_the_last_tensions_within_the_limits(
    controller, last, least, greatest
):
    reference = Reference(np.zeros(1))
    rest = np.zeros(3)
    now = ControllerInput(rest, rest, np.eye(4), np.array(last), reference)
    unlimited = controller.reachable(now)
    np.testing.assert_array_equal(unlimited, LIMITS.T)
    limited = now._replace(greatest_change=CHANGE)
    reachable = controller.reachable(limited)
    np.testing.assert_allclose(reachable, [least, greatest])


@pytest.mark.parametrize("kind", ["tip", "shape"])
def test_tracking_changes_tensions_no_faster_than_actuators_do(build, holding, kind):
    """Of what a far target asks for they take all that actuators can do."""
    model = build("three_tendon")
    limits = np.tile([0.0, 5.0], (3, 1))
    if kind == "tip":
        tracking = TipTracking(model, limits, 0.02, TipPosition())
    else:
        tracking = ShapeTracking(model, limits, 0.02)
    last = np.array([1.0, 2.0, 1.0])
    q = model.rest_coordinates(last)
    still = np.zeros_like(q)
    target = holding(model, [5.0, 0.0, 1.0])
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, still, tip_pose, last, target)
    most = np.array([0.01, 0.02, 5.0])
    free = tracking.act(now).tension
    change = free - last
    assert (np.abs(change) > most)[:2].all()
    limited = now._replace(greatest_change=most)
    tension = tracking.act(limited).tension
    expected = last + np.sign(change) * most
    np.testing.assert_allclose(tension[:2], expected[:2], rtol=1e-6)
