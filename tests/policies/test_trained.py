"""The agents that ship do what is said of them, on the fixed evaluation targets."""

import json
import math
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows, summarise
from soft_tendon_env.learning.config import Training
from soft_tendon_env.policies import load_agent, policy_options
from soft_tendon_env.policies.trained_by import trained_by

TRAINED = Path(__file__).parent.parent.parent / "agents" / "trained"
BARS = {
    "TipPose": {"position_error": 0.002, "angle_error": math.radians(1.0)},
    "Shape": {"backbone_error": 0.002},
    "Reach": {"position_error": 0.003},
}


@pytest.fixture(scope="module", params=sorted(path.name for path in TRAINED.iterdir() if path.is_dir()))
def task(request):
    return request.param


def test_it_brings_the_arm_where_it_should_be(task):
    options = policy_options("agent", task, {})
    policy = load_agent("agent", gym.make(IDS[task], **options))
    envs = gym.make_vec(IDS[task], num_envs=len(EVALUATION_SEEDS), **options)
    summary = summarise(evaluate_rows(policy, envs, EVALUATION_SEEDS))
    assert not summary.flagged and summary.bound_violations == 0
    for name, bar in BARS.get(task, {}).items():
        assert summary.errors[name].rms < bar
    assert summary.chatter < 0.05
    if task == "Reach":
        assert summary.reached == 1.0


def test_it_says_where_it_comes_from(task):
    found = json.loads((TRAINED / task / "config.json").read_text())
    assert found["task"] == task and found["record"]["command"].startswith(("train.py configs/", "soft-tendon train "))
    assert found["record"]["commit"] and found["record"]["versions"]["torch"]
    files = {path.name for path in (TRAINED / task).iterdir()}
    statistics = {"statistics.npz"} if found["normalise"]["observations"] else set()
    assert found["files"].keys() == {"weights.pt"} | statistics == files - {"config.json"}
    training = {key: found[key] for key in Training.model_fields if key in found}  # some came later
    assert Training.parse(training, "config.json").task == task
    assert found["steps_done"] > 0 or found["imitation"], "imitation comes before the first step"


def test_pages_say_how_it_was_trained(task):
    said = trained_by("agent", task)
    for page in ("agents/trained/README.md", "docs/how_to/train_at_scale.md", *(["README.md"] if task == "TipPose" else [])):
        assert said in " ".join((TRAINED.parent.parent / page).read_text(encoding="utf-8").split()), f"{page} should say {said!r}"


def test_there_is_one_for_every_task():
    assert {path.name for path in TRAINED.iterdir() if path.is_dir()} == {*IDS}
