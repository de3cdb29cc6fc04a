"""The agents that ship do what is said of them, on the fixed evaluation targets."""

import math
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows, summarise
from soft_tendon_env.policies import load_agent, policy_options
from soft_tendon_env.policies.agent import shipped_as

TRAINED = Path(__file__).parent.parent.parent / "agents" / "trained"
BARS = {
    "TipPose": {"position_error": 0.002, "angle_error": math.radians(1.0)},
    "Shape": {"backbone_error": 0.002},
    "Reach": {"position_error": 0.003},
}


SHIPPED = sorted(path.parent for path in TRAINED.glob("*/*/weights.pt"))


@pytest.fixture(scope="module", params=SHIPPED, ids=lambda folder: f"{folder.parent.name}/{folder.name}")
def agent(request):
    """Name and task of an agent that ships."""
    return request.param.parent.name, request.param.name


def test_it_brings_the_arm_where_it_should_be(agent):
    name, task = agent
    options = policy_options(name, task, {})
    policy = load_agent(name, gym.make(IDS[task], **options))
    envs = gym.make_vec(IDS[task], num_envs=len(EVALUATION_SEEDS), **options)
    summary = summarise(evaluate_rows(policy, envs, EVALUATION_SEEDS))
    assert summary.diverged == 0
    if name != shipped_as("agent", task):  # others show what they can
        return
    for error, bar in BARS.get(task, {}).items():
        assert summary.errors[error].rms < bar
    assert summary.metrics["chatter"] < 0.05
    if task == "Reach":
        assert summary.reached == 1.0
