"""Controllers by name, from this package and from outside."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import CONTROLLERS, Decision, register_controller
from soft_tendon_env.policies import make_policy, observation_options


class Half:
    """Half of the greatest tensions, whatever is measured."""

    def __init__(self, model, limits, period):
        self.greatest = limits[:, 1]

    def act(self, now, memory=None):
        return Decision(0.5 * self.greatest, report={"limited": 0.0, "singular": 0.0})


@pytest.fixture
def half(forgotten):
    """Registered for two tasks, until the end of the test."""
    register = register_controller("half", tasks=["TipPose", "Reach"], description="half of it", looks_ahead=3)
    assert register(Half) is Half and register(Half) is Half


def test_a_controller_from_outside_acts_by_its_name(half):
    assert observation_options("half", "Reach")["preview"] == pytest.approx([0.02, 0.04, 0.06])
    env = gym.make("TendonRod-Reach-v0", scene="three_tendon", fidelity="fast", **observation_options("half", "Reach"))
    observation, _ = env.reset(seed=0)
    action, _ = make_policy("half", env).predict(observation)
    np.testing.assert_allclose(action, 0.0, atol=1e-7)
    with pytest.raises(ValueError, match="controller is 'half': valid: feedforward, paper, predictive, tracking"):
        observation_options("half", "Shape")


def test_a_name_that_is_taken_is_refused():
    before = CONTROLLERS["TipPose"]["predictive"]
    with pytest.raises(ValueError, match="the controller 'predictive' of TipPose is registered twice"):
        register_controller("predictive", tasks=["TipPose"], description="")(Half)
    assert CONTROLLERS["TipPose"]["predictive"] is before
