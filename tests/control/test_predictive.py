"""Model-predictive control: its plan improves what the simulation does, within bounds; disturbances are found.

Controllers that are told of the errors of the inputs that an estimator has found act as if the arm were as the model says.
"""

import numpy as np
import pytest

from soft_tendon_env.control import ControllerInput, InputError
from soft_tendon_env.control.objectives import Shape, TipPose, TipPosition
from soft_tendon_env.control.predictive import Predictive, Tuning
from soft_tendon_env.model.simulation import Simulation

PERIOD = 0.02
OBJECTIVES = {"pose": lambda model: TipPose(0.1 * model.length), "position": lambda model: TipPosition(), "shape": Shape}
WIDE = np.tile([-100.0, 100.0], (10, 1))


@pytest.fixture(scope="module")
def model(build):
    return build("paper")


@pytest.fixture
def objective(model, request):
    return OBJECTIVES[request.param](model)


def near(model, holding, seed):
    """At rest near a target, both held by tensions."""
    rng = np.random.default_rng(seed)
    tension = rng.uniform(5.0, 20.0, 10)
    q = model.rest_coordinates(tension)
    target = holding(model, tension + rng.uniform(-4.0, 4.0, 10))
    return ControllerInput(q, np.zeros(10), model.tip_pose(q), tension, target)


def predicted_cost(model, objective, now, plan, settling_time=0.3):
    """Half the squared errors at the ends of the periods, each less what may be left of the present one, by the simulation."""

    def error(q, k):
        return objective.error(q, model.tip_pose(q), now.reference, k * PERIOD)

    simulation = Simulation(model)
    simulation.reset(now.q, now.q_dot)
    present, cost = error(now.q, 0), 0.0
    for k, tension in enumerate(plan, 1):
        simulation.step(tension, PERIOD)
        left = error(simulation.state.q, k) - np.exp(-4.0 * k * PERIOD / settling_time) * present
        cost += 0.5 * left @ left
    return cost


@pytest.mark.parametrize("objective", OBJECTIVES, indirect=True)
@pytest.mark.parametrize("seed", range(3))
def test_the_plan_improves_along_the_slope_of_the_simulation(model, objective, holding, seed):
    """The Jacobians of a rollout are not those of the simulation: the slopes agree within a tenth. The inputs may err."""
    now = near(model, holding, seed)
    controller, simulation = Predictive(model, WIDE, PERIOD, objective), Simulation(model)
    plan = np.tile(now.tension, (controller.horizon, 1))
    error = InputError(1.0 + 0.2 * seed * np.cos(np.arange(10.0)), 0.5 * seed * np.sin(np.arange(10.0)))
    simulation.reset(now.q, now.q_dot)
    _, gradient = controller._program(simulation.rollout(error.gain * plan + error.offset, PERIOD), error.gain, now)
    apart = 0.05
    slope = []
    for k in range(plan.size):
        aside = np.zeros(plan.size)
        aside[k] = apart
        aside = aside.reshape(plan.shape)
        costs = [predicted_cost(model, objective, now, error.gain * (plan + sign * aside) + error.offset) for sign in (1.0, -1.0)]
        slope.append((costs[0] - costs[1]) / (2.0 * apart))
    off = np.linalg.norm(gradient - slope) / np.linalg.norm(slope)
    assert off < 0.1


@pytest.mark.parametrize("hold", [1, 2])
def test_constant_disturbances_are_found_and_allowed_for(model, holding, drive, hold):
    """Two newtons too many in every tendon: found, and the target is held all the same."""
    target = holding(model, 12.0 + 3.0 * np.sin(np.arange(10.0)))
    off = {}
    for observer in (0.25, 0.0):
        controller = Predictive(model, WIDE, PERIOD, TipPose(0.1 * model.length), Tuning(observer=observer, hold=hold))
        motion = drive(controller, model, target, 150, act=lambda tension: tension + 2.0)
        off[observer] = np.linalg.norm(motion.tip[-1, :3, 3] - target.tip_position[0]) / model.length
        found = motion.memory.disturbance
        np.testing.assert_allclose(found, 2.0 if observer else 0.0, atol=0.1)
        assert motion.reports[-1]["disturbance"] == np.abs(found).max()
    assert off[0.25] < 1e-3
