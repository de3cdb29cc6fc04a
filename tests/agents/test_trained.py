"""The agents that ship do what is said of them, on the fixed evaluation targets."""

import json
import math
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows, summarise

TRAINED = Path(__file__).parent.parent.parent / "agents" / "trained"
BARS = {
    "TipPose": {"position_error": 0.010, "angle_error": math.radians(5.0)},
    "Shape": {"backbone_error": 0.010},
}


@pytest.fixture(scope="module", params=sorted(path.name for path in TRAINED.iterdir() if path.is_dir()))
def task(request):
    return request.param


def test_it_brings_the_arm_where_it_should_be(module, task):
    path = TRAINED / task / "model.zip"
    options = module("_agents").agent_options(path)
    policy = module("_agents").load_agent(str(path), gym.make(IDS[task], **options))
    envs = gym.make_vec(IDS[task], num_envs=len(EVALUATION_SEEDS), **options)
    summary = summarise(evaluate_rows(policy, envs, EVALUATION_SEEDS))
    assert not summary.flagged and summary.bound_violations == 0
    for name, bar in BARS.get(task, {}).items():
        assert summary.errors[name].rms < bar
    if task == "Reach":
        assert summary.reached > 0.9


def test_it_says_where_it_comes_from(module, task):
    config = json.loads((TRAINED / task / "config.json").read_text())
    assert config["task"] == task and config["record"]["command"].startswith("train.py configs/")
    assert config["record"]["commit"] and config["record"]["versions"]["torch"]
    assert config["files"].keys() == {"model.zip", "vecnormalize.pkl"}
    training = {key: config[key] for key in module("_training").Training.model_fields}
    assert module("_training").Training.parse(training, "config.json").task == task and config["steps_done"] > 0


def test_there_is_one_for_every_task():
    assert {path.name for path in TRAINED.iterdir() if path.is_dir()} == {*IDS}
