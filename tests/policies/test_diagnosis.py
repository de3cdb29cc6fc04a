"""Diagnosis of the Kalman filter: its intervals contain what an episode drew, and say much."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control.diagnosis import NORMAL
from soft_tendon_env.control.uncertainty import GREATEST_LATENCY, USUAL
from soft_tendon_env.envs import IDS
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.regimes import NOISE

WRONG = {
    "stiffness": [0.85, 1.15],
    "damping": [0.6, 1.4],
    "tension_gain": [0.92, 1.08],
    "latency": [0.0, 0.06],
    "payload": [0.0, 0.01],
}
"""Errors of the model, all at once."""
PERIODS = 60


def drawn_numbers(info, segment):
    """Numbers of an arm that an episode drew, by their names in Diagnosis."""
    drawn = info["drawn"]
    return {
        "latency": drawn["latency"],
        "stiffness": drawn["segments.0.young_modulus"] / segment.young_modulus,
        "damping": drawn["segments.0.damping"] / segment.damping,
        "gain": drawn["tension_gain"],
        "payload": drawn["effects.tip_load.mass"],
        "lag": 0.0,
        "offset": 0.0,
    }


def diagnosed(regime, noise, draws):
    """Errors (draws, values) of a diagnosis after a second, in its deviations, by quantity; and its
    last one."""
    name = PolicyName.parse("filtered:predictive@standard", "TipPose")
    given = {"fidelity": "fine", "scene": "three_tendon", "randomize": {**WRONG, **noise}}
    env = gym.make(IDS["TipPose"], max_episode_steps=200, **name.options(given, regime))
    policy = name.load(env)
    (segment,) = env.unwrapped.model.scene.segments
    errors = {}
    for seed in range(draws):
        observation, info = env.reset(seed=seed)
        state = None
        for _ in range(PERIODS):
            action, state = policy.predict(observation, state)
            observation, *_ = env.step(action)
        (diagnosis,) = policy.estimate(state)
        for quantity, number in drawn_numbers(info, segment).items():
            estimated = getattr(diagnosis, quantity)
            error = (estimated.value - number) / estimated.deviation
            errors.setdefault(quantity, []).append(np.ravel(error))
    return {quantity: np.array(rows) for quantity, rows in errors.items()}, diagnosis


@pytest.mark.parametrize(
    ("regime", "noise", "draws"),
    [
        ("sensors", {"noise": NOISE}, 4),
        pytest.param("sensors", {"noise": NOISE}, 100, marks=pytest.mark.slow),
    ],
)
def test_intervals_contain_what_was_drawn(regime, noise, draws):
    """Those of 95 % do so in 90 % of the draws at least, each by itself."""
    errors, diagnosis = diagnosed(regime, noise, draws)
    for quantity, of_draws in errors.items():
        share = np.mean(np.abs(of_draws) < NORMAL)
        assert share >= 0.9, quantity
    # they are far narrower than what is assumed at first
    assert diagnosis.latency.deviation < 0.75 * GREATEST_LATENCY / np.sqrt(12.0)
    assert diagnosis.stiffness.deviation < 0.75 * USUAL.stiffness_start
    assert diagnosis.damping.deviation < 0.75 * USUAL.damping_start
