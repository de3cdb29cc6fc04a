"""Agents that ship act where neither PyTorch nor Stable-Baselines3 is installed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TRAINED = Path(__file__).parent.parent.parent / "agents" / "trained"
SHIPPED = sorted(
    (path.parent.parent.name, path.parent.name) for path in TRAINED.glob("*/*/weights.npz")
)
BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "stable_baselines3", "sb3_contrib"):
            raise ImportError(f"{name} should not be needed")

sys.meta_path.insert(0, Blocked())
"""
ACTS = """
import gymnasium as gym
import numpy as np
from soft_tendon_env.envs import IDS
from soft_tendon_env.policies import load_policy, policy_options

for name, task in AGENTS:
    env = gym.make(IDS[task], **policy_options(name, task, {}))
    policy = load_policy(name, env)
    state = None
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        action, state = policy.predict(observation, state)
        assert action.shape == env.action_space.shape and np.abs(action).max() > 0.0
        observation, *_ = env.step(action)
"""
COMMAND = """
from soft_tendon_env.cli.main import main

sys.argv = ["soft-tendon", *ARGUMENTS]
main()
"""


def run_blocked(script, folder, **names):
    """What a script prints where what trains cannot be imported; names: of values in it."""
    values = "".join(f"{name} = {value!r}\n" for name, value in names.items())
    environment = {**os.environ, "SOFT_TENDON_ENV_QUIET": "1"}
    return subprocess.run(
        [sys.executable, "-c", BLOCKED + values + script],
        cwd=folder,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


@pytest.mark.parametrize(
    "agents",
    [
        pytest.param([("agent", "TipPose")], id="agent"),
        pytest.param(SHIPPED, id="every", marks=pytest.mark.slow),
    ],
)
def test_agents_that_ship_act(tmp_path, agents):
    run_blocked(ACTS, tmp_path, AGENTS=agents)


@pytest.mark.slow
def test_they_are_evaluated(tmp_path):
    arguments = "evaluate agent --task TipPose --episodes 2 --seconds 0.4 --skip 0.1"
    printed = run_blocked(COMMAND, tmp_path, ARGUMENTS=[*arguments.split(), "--errors", "nominal"])
    assert "| nominal " in printed
