"""Model-predictive control: its plan improves what the simulation does, within bounds, and
disturbances are found.

Controllers whose models have effects predict what happens, and turn tensions into the commands of
elastic tendons.
"""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env import Simulation
from soft_tendon_env.control import ControllerInput, InputError, Reference
from soft_tendon_env.control.objectives import Shape, TipPose, TipPosition
from soft_tendon_env.control.predictive import Predictive, Tuning
from soft_tendon_env.evaluation import evaluate, summarise
from soft_tendon_env.policies import make_policy, observation_options

PERIOD = 0.02
OBJECTIVES = {
    "pose": lambda model: TipPose(0.1 * model.length),
    "position": lambda model: TipPosition(),
    "shape": Shape,
}
WIDE = np.tile([-100.0, 100.0], (10, 1))
LATE = {
    "a disturbance": {
        "effects.disturbance.loads": [
            {"at": 0.3, "force": [0.0, 0.05, 0.02], "signal": {"type": "sine", "frequency": 1.5}}
        ]
    },
    "a moving base": {
        "effects.moving_base": {
            "amplitude": [0.0, 0.02, 0.01],
            "angular_amplitude": 0.1,
            "frequency": 1.5,
        }
    },
    "memory": {"effects.viscoelastic_memory.branches": [{"modulus": 1.0, "relaxation_time": 0.3}]},
}
CABLES = {
    "scene": "three_tendon",
    "effects.tendon_elasticity": {"stiffness": 5e3, "displacement_limits": [-0.03, 0.05]},
}


@pytest.fixture(scope="module")
def model(build):
    return build("paper")


def near(model, holding, seed):
    """At rest near a target, both held by tensions."""
    rng = np.random.default_rng(seed)
    tension = rng.uniform(5.0, 20.0, 10)
    q = model.rest_coordinates(tension)
    target = holding(model, tension + rng.uniform(-4.0, 4.0, 10))
    return ControllerInput(q, np.zeros(10), model.tip_pose(q), tension, target)


def predicted_cost(model, objective, now, plan, settling_time=0.3):
    """Half the squared errors at the ends of the periods, each less what may be left of the present
    one, by the simulation."""

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


@pytest.mark.parametrize("kind", OBJECTIVES)
@pytest.mark.parametrize("seed", range(3))
def test_the_plan_improves_along_the_slope_of_the_simulation(model, kind, holding, seed):
    """The Jacobians of a rollout are not those of the simulation: the slopes agree within a tenth.
    The inputs may err."""
    now, objective = near(model, holding, seed), OBJECTIVES[kind](model)
    controller, simulation = Predictive(model, WIDE, PERIOD, objective), Simulation(model)
    plan = np.tile(now.tension, (controller.horizon, 1))
    error = InputError(
        1.0 + 0.2 * seed * np.cos(np.arange(10.0)), 0.5 * seed * np.sin(np.arange(10.0))
    )
    simulation.reset(now.q, now.q_dot)
    _, gradient = controller._program(
        simulation.rollout(error.gain * plan + error.offset, PERIOD), error.gain, now
    )
    apart = 0.05
    slope = []
    for unit in np.eye(plan.size):
        aside = apart * unit.reshape(plan.shape)
        costs = [
            predicted_cost(model, objective, now, error.gain * (plan + sign * aside) + error.offset)
            for sign in (1.0, -1.0)
        ]
        slope.append((costs[0] - costs[1]) / (2.0 * apart))
    off = np.linalg.norm(gradient - slope) / np.linalg.norm(slope)
    assert off < 0.1


@pytest.mark.parametrize("hold", [1, 2])
def test_constant_disturbances_are_found_and_allowed_for(model, holding, drive, hold):
    """Two newtons too many in every tendon: found, and the target is held all the same."""
    target = holding(model, 12.0 + 3.0 * np.sin(np.arange(10.0)))
    off = {}
    for observer in (0.25, 0.0):
        controller = Predictive(
            model, WIDE, PERIOD, TipPose(0.1 * model.length), Tuning(observer=observer, hold=hold)
        )
        motion = drive(controller, model, target, 150, act=lambda tension: tension + 2.0)
        off[observer] = (
            np.linalg.norm(motion.tip[-1, :3, 3] - target.tip_position[0]) / model.length
        )
        found = motion.memory.disturbance
        np.testing.assert_allclose(found, 2.0 if observer else 0.0, atol=0.1)
        assert motion.reports[-1]["disturbance"] == np.abs(found).max()
    assert off[0.25] < 1e-3


@pytest.mark.parametrize("kind", LATE)
def test_what_is_predicted_is_what_happens(build, kind):
    """Rates and internal states of the next period, by a controller that has followed the arm from
    the beginning to a target."""
    model = build("three_tendon", {"quadrature.intervals": 6, **LATE[kind]})
    simulation, controller = (
        Simulation(model),
        Predictive(model, np.tile([0.0, 5.0], (3, 1)), PERIOD, TipPosition()),
    )
    target = simulation.tip_pose[None, :3, 3] + [-0.01, 0.03, 0.02]
    memory, tension = None, np.zeros(3)
    for _ in range(25):
        state = simulation.state
        reference = Reference(np.zeros(1), tip_position=target)
        decision = controller.act(
            ControllerInput(
                state.q, state.q_dot, simulation.tip_pose, tension, reference, state.time
            ),
            memory,
        )
        memory, tension = decision.memory, decision.tension
        simulation.step(
            tension + memory.disturbance, PERIOD
        )  # what the controller takes for granted
        np.testing.assert_allclose(
            memory.rates, simulation.state.q_dot, atol=1e-6 * np.abs(simulation.state.q_dot).max()
        )
        np.testing.assert_allclose(memory.effects, simulation.state.effects, atol=1e-9)
    assert np.abs(memory.disturbance).max() < 1e-3


@pytest.mark.parametrize(("controller", "greatest"), [("tracking", 5e-4), ("predictive", 1e-3)])
def test_controllers_of_tensions_move_elastic_tendons(controller, greatest):
    """Displacements are made of the tensions that they decide on: two episodes of 3 s, the first
    second left out."""
    options = observation_options(controller, "TipPose")
    env = gym.make(
        "TendonRod-TipPose-v0",
        scene=CABLES,
        fidelity="fast",
        max_episode_steps=150,
        target="random",
        **options,
    )
    assert (
        summarise(evaluate(make_policy(controller, env), env, [1, 2])).errors["position_error"].rms
        < greatest
    )
