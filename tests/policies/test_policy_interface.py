"""Environments and agents as controllers meet them: interfaces, names, Stable-Baselines3's evaluation, recordings."""

from types import SimpleNamespace

import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.policies.controller_policy import ControllerPolicy, make_policy
from soft_tendon_env.tools.configuration import ConfigurationError


def test_observations_that_say_too_little_are_refused(short, probed):
    _, probe = probed(short("single", IDS["TipPose"]))
    blind = short("single", IDS["TipPose"], observation=("tip_position", "coordinates"))
    with pytest.raises(ConfigurationError, match="observation.*lacks tip_rotation, rates, target_error, preview, which Probe needs"):
        probed(blind)
    with pytest.raises(ConfigurationError, match="lacks strain"):
        ControllerPolicy(probe, short("single", IDS["TipPose"]), estimator=SimpleNamespace(needs=("strain", "strain_rate"), history=0))


@pytest.mark.parametrize("preview", [(0.04, 0.02), (0.02, 0.02), (0.02, 0.021)])
def test_preview_times_increase(short, probed, preview):
    with pytest.raises(ConfigurationError, match=r"it should be times that increase by at least a control period"):
        probed(short("single", IDS["TipPose"], preview=preview))


@pytest.mark.cases(
    "task, controller, latency, preview, told",
    [
        ("TipPose", "predictive", 0.0, (0.02, 0.04), "0.02, 0.04] s, and it is needed at every control period up to 0.14 s"),
        ("TipPose", "predictive", 0.0, (0.1, 0.2), "it is needed at every control period up to 0.14 s"),
        ("TipPose", "long_horizon_predictive", 0.0, (0.5,), "up to 0.5 s: make the environment with observation_options"),
        ("TipPose", "robust_predictive", 0.03, (0.02, 0.04, 0.06, 0.08, 0.12, 0.14, 0.16, 0.18), "up to 0.18 s"),
        ("Shape", "predictive", 0.0, (0.1, 0.2), "up to 0.14 s"),
        ("Shape", "feedforward", 0.0, (0.02,), "it is needed at every control period up to 0.04 s"),
        ("TipPose", "tracking", 0.05, (0.02, 0.04, 0.08), "it is needed at every control period up to 0.1 s"),
        ("TipPose", "tracking", 0.05, (0.02, 0.04, 0.1), None),
        ("TipPose", "tracking", 0.0, (0.1, 0.2), None),  # goes straight in between, which feedback makes up for
        ("Reach", "predictive", 0.0, (0.02,), None),  # goals do not move
    ],
)
def test_a_preview_that_lacks_what_a_controller_looks_at_is_refused(short, task, controller, latency, preview, told):
    env = short("single", IDS[task], preview=preview)
    if told is None:
        make_policy(controller, env, latency=latency)
    else:
        with pytest.raises(ConfigurationError, match=told):
            make_policy(controller, env, latency=latency)
