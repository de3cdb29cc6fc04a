"""What controllers believe of effects: their time, their internal states, and models that lack some."""

import gymnasium as gym
import numpy as np
import pytest

import soft_tendon_env  # noqa: F401
from soft_tendon_env.control import ControllerInput, Reference
from soft_tendon_env.control.objectives import TipPosition
from soft_tendon_env.control.predictive import Predictive
from soft_tendon_env.evaluation import evaluate, summarise
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.policies import make_policy, observation_options

PERIOD = 0.02
LATE = {
    "a disturbance": {"effects.disturbance.loads": [{"at": 0.3, "force": [0.0, 0.05, 0.02], "signal": {"type": "sine", "frequency": 1.5}}]},
    "a moving base": {"effects.moving_base": {"amplitude": [0.0, 0.02, 0.01], "angular_amplitude": 0.1, "frequency": 1.5}},
    "memory": {"effects.viscoelastic_memory.branches": [{"modulus": 1.0, "relaxation_time": 0.3}]},
}


@pytest.fixture(params=LATE)
def model(request, build):
    return build("three_tendon", {"quadrature.intervals": 6, **LATE[request.param]})


def test_what_is_predicted_is_what_happens(model):
    """Rates and internal states of the next period, by a controller that has followed the arm from the beginning to a target."""
    simulation, limits = Simulation(model), np.tile([0.0, 5.0], (3, 1))
    controller = Predictive(model, limits, PERIOD, TipPosition())
    target = simulation.tip_pose[None, :3, 3] + [-0.01, 0.03, 0.02]
    memory, tension = None, np.zeros(3)
    for _ in range(25):
        state = simulation.state
        reference = Reference(np.zeros(1), tip_position=target)
        decision = controller.act(ControllerInput(state.q, state.q_dot, simulation.tip_pose, tension, reference, state.time), memory)
        memory, tension = decision.memory, decision.tension
        simulation.step(tension + memory.disturbance, PERIOD)  # what the controller takes for granted
        np.testing.assert_allclose(memory.rates, simulation.state.q_dot, atol=1e-6 * np.abs(simulation.state.q_dot).max())
        np.testing.assert_allclose(memory.effects, simulation.state.effects, atol=1e-9)
    assert np.abs(memory.disturbance).max() < 1e-3


CABLES = {"scene": "three_tendon", "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [-0.03, 0.05]}}


@pytest.mark.parametrize("controller, greatest", [("tracking", 5e-4), ("predictive", 1e-3)])
def test_controllers_of_tensions_move_elastic_tendons(controller, greatest):
    """Displacements are made of the tensions that they decide on: two episodes of 3 s, the first second left out."""
    options = observation_options(controller, "TipPose")
    env = gym.make("TendonRod-TipPose-v0", scene=CABLES, fidelity="fast", max_episode_steps=150, target="random", **options)
    assert summarise(evaluate(make_policy(controller, env), env, [1, 2])).errors["position_error"].rms < greatest
