"""The agents that ship do what is said of them, on the fixed evaluation targets."""

import json
import math
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows, summarise
from soft_tendon_env.learning.config import Normalisation, Training, config_names
from soft_tendon_env.policies import load_agent, policy_options
from soft_tendon_env.policies.agent_files import shipped_as

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
    assert not summary.flagged
    if name != shipped_as("agent", task):  # others show what they can
        return
    assert summary.bound_violations == 0
    for error, bar in BARS.get(task, {}).items():
        assert summary.errors[error].rms < bar
    assert summary.chatter < 0.05
    if task == "Reach":
        assert summary.reached == 1.0


def test_it_says_where_it_comes_from(agent):
    name, task = agent
    folder = TRAINED / name / task
    found = json.loads((folder / "config.json").read_text())
    assert (found["task"], found["algorithm"].lower()) == (task, name), "as its folder says"
    words = found["record"]["command"].split()
    assert words[: words.index("train")] in (["soft-tendon"], ["python", "-m", "soft_tendon_env"])
    assert {Path(word).stem for word in words} & {*config_names()}, "a training that ships"
    assert found["record"]["commit"] and found["record"]["versions"]["torch"]
    files = {path.name for path in folder.iterdir()}
    statistics = {"statistics.npz"} if found["normalise"]["observations"] else set()
    assert found["files"].keys() == {"weights.pt"} | statistics == files - {"config.json"}
    training = {key: found[key] for key in Training.model_fields if key in found}  # some came later
    training["normalise"] = {key: found["normalise"][key] for key in Normalisation.model_fields}
    assert Training.parse(training, "config.json").task == task
    assert found["steps_done"] > 0
