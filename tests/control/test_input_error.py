"""Errors of the inputs that an estimator has found: controllers that are told act as if the arm were as the model says."""

import numpy as np
import pytest

from soft_tendon_env.control import InputError, Situation
from soft_tendon_env.control.objectives import TipPose
from soft_tendon_env.control.predictive import Predictive
from soft_tendon_env.control.smith_predictor import SmithPredictor
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
WIDE = np.tile([-100.0, 100.0], (10, 1))
HELD = 12.0 + 4.0 * np.sin(np.arange(10.0))
ERROR = InputError(1.0 + 0.2 * np.cos(np.arange(10.0)), 1.5 * np.sin(np.arange(10.0)))
CONTROLLERS = {"tracking": TipTracking, "predictive": Predictive}


class Told:
    """A controller that is told the error of the inputs."""

    def __init__(self, controller, error):
        self.controller, self.error = controller, error

    def act(self, now, memory=None):
        return self.controller.act(now._replace(input_error=self.error), memory)


@pytest.fixture(scope="module")
def model(build):
    return build("paper")


@pytest.fixture
def late_error(model, holding, drive):
    """late_error(name, error): of the tip [m] after a second on an arm with ERROR, of a controller that is told `error`."""

    def after(name, error):
        target = holding(model, HELD)._replace(tension=HELD)
        controller = Told(CONTROLLERS[name](model, WIDE, PERIOD, TipPose(0.1)), error)
        tracked = drive(controller, model, target, 50, act=lambda tension: ERROR.gain * tension + ERROR.offset)
        return np.linalg.norm(tracked.tip[-1][:3, 3] - target.tip_pose[0, :3, 3])

    return after


def test_tracking_that_is_told_needs_no_integral(late_error):
    assert late_error("tracking", ERROR) < 0.02 * late_error("tracking", None)


def test_predictive_control_that_is_told_needs_no_observer_of_its_own(late_error):
    assert late_error("predictive", ERROR) < 1e-4
    assert late_error("predictive", InputError(np.ones(10), np.zeros(10))) > 1e-3


def test_the_smith_predictor_acts_by_the_inputs_that_the_arm_gets(model, holding):
    arm, predictor = Simulation(model), SmithPredictor(model, 0.05, PERIOD)
    sent = tuple(HELD * share for share in (0.2, 0.5, 1.0))
    state = arm.state
    now = Situation(state.q, state.q_dot, model.tip_pose(state.q), sent[-1], holding(model, HELD), input_error=ERROR)
    predicted = predictor.predicted(now, sent)
    for tension, seconds in zip(sent, (0.01, PERIOD, PERIOD), strict=True):
        arm.step(ERROR.gain * tension + ERROR.offset, seconds)
    np.testing.assert_allclose(predicted.q, arm.state.q, rtol=1e-9, atol=1e-9)
    earlier = predictor.predicted(now, sent, latency=0.02)
    arm.reset()
    arm.step(ERROR.gain * sent[-1] + ERROR.offset, PERIOD)
    np.testing.assert_allclose(earlier.q, arm.state.q, rtol=1e-9, atol=1e-9)
    assert earlier.reference.ahead[0] == pytest.approx(now.reference.ahead[0] - 0.02)
