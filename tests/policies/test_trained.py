"""The agents that ship do what is said of them, on the fixed evaluation targets."""

import json
import math
import shutil
from pathlib import Path

import gymnasium as gym
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import EVALUATION_SEEDS, evaluate_rows, summarise
from soft_tendon_env.learning.config import Normalisation, Training, config_names
from soft_tendon_env.policies import agent_files, load_agent, policy_options
from soft_tendon_env.policies.agent_files import find_agent, shipped_as, shipped_for
from soft_tendon_env.policies.trained_by import shipped_notes, trained_by

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
    training = {key: found[key] for key in Training.model_fields if key in found and key != "hindsight"}  # some came later
    training["normalise"] = {key: found["normalise"][key] for key in Normalisation.model_fields}
    assert Training.parse(training, "config.json").task == task
    assert found["steps_done"] > 0


@pytest.mark.parametrize("task", IDS)
def test_pages_say_how_the_best_was_trained(task):
    said = trained_by("agent", task)
    quickstart = ["docs/tutorials/quickstart.md"] if task == "TipPose" else []
    for page in ("agents/trained/README.md", "docs/how_to/train_at_scale.md", *quickstart):
        assert said in " ".join((TRAINED.parent.parent / page).read_text(encoding="utf-8").split()), f"{page} should say {said!r}"


def test_there_is_one_for_every_task():
    assert {shipped_as("agent", task) in shipped_for(task) for task in IDS} == {True}
    assert shipped_notes(["tracking", "agent"], "Reach") == [f"agent is {shipped_as('agent', 'Reach')}: {trained_by('agent', 'Reach')}"]


@pytest.mark.parametrize("name, training", [("sac", "sac_tip_pose"), ("ppo", "ppo_tip_pose")])
def test_who_does_not_ship_is_told_with_the_command_that_trains_one(name, training, monkeypatch, tmp_path):
    copied = shutil.copytree(TRAINED / "dagger", tmp_path / "dagger").parent
    monkeypatch.setattr(agent_files, "trained_folder", lambda: copied)
    with pytest.raises(FileNotFoundError) as error:
        policy_options(name, "TipPose", {})
    assert str(error.value) == f"the agent {name!r} does not ship for TipPose; what does: dagger; `soft-tendon train {training}` trains one"
    with pytest.raises(FileNotFoundError, match="^the agent 'apg' does not ship for Throw; what does: none$"):
        find_agent("apg", "Throw")
