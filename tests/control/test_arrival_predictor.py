"""Arrival predictor: what it predicts is what the arm does under the commands in transit."""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, InputError, Reference
from soft_tendon_env.control.arrival_predictor import ArrivalPredictor
from soft_tendon_env.control.command_filter import Timing, lagged_plan, mean_weights
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
ERROR = InputError(np.array([1.2, 0.9, 1.1]), np.array([0.3, -0.2, 0.1]))
SENT = tuple(np.array([1.0, 0.5, 2.0]) * share for share in (0.2, 0.5, 1.0))
# latency [s], and for how long which of the commands act until the present one does
LATE = [
    (0.0, ()),
    (0.01, ((0.01, 2),)),
    (0.02, ((PERIOD, 2),)),
    (0.035, ((0.015, 1), (PERIOD, 2))),
    (0.05, ((0.01, 0), (PERIOD, 1), (PERIOD, 2))),
]


@pytest.fixture(scope="module")
def model(build):
    return build("three_tendon")


@pytest.fixture
def moving(model, random_state):
    """An arm in motion, as measured, and its simulation."""
    q, q_dot = random_state(model, 0)
    simulation = Simulation(model)
    simulation.reset(q, q_dot, time=0.7)
    reference = Reference(np.array([0.0, 0.1]))
    tip_pose = model.tip_pose(q)
    now = ControllerInput(q, q_dot, tip_pose, SENT[-1], reference, time=0.7)
    return now, simulation


@pytest.mark.parametrize(("latency", "acting"), LATE)
@pytest.mark.parametrize("error", [None, ERROR], ids=["exact", "erring"])
def test_the_prediction_is_the_motion_under_the_commands_in_transit(
    model, moving, latency, acting, error
):
    """Of a latency that is known, and of one that is told for now."""
    now, arm = moving
    now = now._replace(input_error=error)
    for seconds, index in acting:
        tension = SENT[index]
        if error is not None:
            tension = error.gain * tension + error.offset
        arm.step(tension, seconds)
    known = ArrivalPredictor(model, Timing(latency, 0.0), PERIOD)
    assert known.history == len(LATE[-1][1]) + 1 or latency < 0.05
    estimated = ArrivalPredictor(model, Timing(0.05, 0.0), PERIOD)
    told = estimated.predict(now, SENT, Timing(latency, 0.0))
    for predicted in (known.predict(now, SENT[-known.history :]), told):
        # a lag of a microsecond stands for none
        np.testing.assert_allclose(predicted.q, arm.state.q, rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(predicted.q_dot, arm.state.q_dot, rtol=1e-3, atol=1e-4)
        assert predicted.time == pytest.approx(0.7 + latency)
        expected_ahead = np.array([0.0, 0.1]) - latency
        np.testing.assert_allclose(predicted.reference.ahead, expected_ahead)
        np.testing.assert_allclose(predicted.tip_pose, arm.tip_pose, atol=1e-5)
        assert predicted.actuators is None


def test_a_lag_acts_on(model, moving):
    """Commands in transit are filtered, and the plan begins with the tension that acts then."""
    now, arm = moving
    lag = 0.015
    latency = 0.02
    predicted = ArrivalPredictor(model, Timing(latency, lag), PERIOD).predict(now, SENT)
    commands = np.array(SENT)
    mean = mean_weights(Timing(latency, lag), PERIOD, len(SENT), 0.0, PERIOD) @ commands
    arm.step(mean, PERIOD)
    np.testing.assert_allclose(predicted.q, arm.state.q, rtol=1e-6, atol=1e-9)
    acting = mean_weights(Timing(latency, lag), PERIOD, len(SENT), latency, 0.0) @ commands
    assert predicted.actuators.lag == lag
    np.testing.assert_allclose(predicted.actuators.tension, acting)
    # the command that arrives last is not reached yet
    by_plan, by_start = lagged_plan(lag, PERIOD, 1)
    assert 0.0 < by_start[0] < 1.0
    expected_by_plan = 1.0 - by_start[0]
    assert by_plan[0, 0] == pytest.approx(expected_by_plan)


def test_a_displaced_tip_moves_as_the_model_s_does(model, moving):
    """The displacement from the model's tip to the measured one stays, in the frame of the tip."""
    now, _ = moving
    displacement = np.array([0.1, -0.2, 0.05, 0.01, 0.02, -0.01])
    beside = now._replace(tip_pose=moved_pose(now.tip_pose, displacement))
    predictor = ArrivalPredictor(model, Timing(0.05, 0.0), PERIOD)
    straight = predictor.predict(now, SENT)
    displaced = predictor.predict(beside, SENT)
    moved = np.linalg.solve(now.tip_pose, straight.tip_pose)
    expected_tip_pose = beside.tip_pose @ moved
    np.testing.assert_allclose(displaced.tip_pose, expected_tip_pose, atol=1e-9)
    assert np.abs(pose_error(now.tip_pose, straight.tip_pose)).max() > 0.01


def test_a_model_without_such_a_motion_leaves_what_is_measured(model, moving):
    now, _ = moving
    lost = now._replace(q=np.full(3, 1e4))
    assert ArrivalPredictor(model, Timing(0.05, 0.0), PERIOD).predict(lost, SENT) is lost
