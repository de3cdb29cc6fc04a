"""Trainings with RLlib: they learn, go on, and leave agents that act alike without Ray."""

import csv
import json

import gymnasium as gym
import numpy as np
import pytest
import torch

ray = pytest.importorskip("ray")
pytest.importorskip("ray.rllib")

from soft_tendon_env.cli.main import main  # noqa: E402
from soft_tendon_env.envs import IDS  # noqa: E402
from soft_tendon_env.evaluation import evaluate, summarise  # noqa: E402
from soft_tendon_env.learning import checkpoints, validation  # noqa: E402
from soft_tendon_env.learning.config import Training  # noqa: E402
from soft_tendon_env.learning.rllib import train  # noqa: E402
from soft_tendon_env.learning.train import checkpoint_to_resume  # noqa: E402
from soft_tendon_env.policies import load  # noqa: E402
from soft_tendon_env.tools.parallel import ray_cluster  # noqa: E402

TABLE = {
    "task": "TipPose",
    "algorithm": "PPO",
    "steps": 256,
    "arms": 4,
    "seconds": 0.4,
    "hyperparameters": {"n_steps": 16, "batch_size": 32, "n_epochs": 2},
    "options": {"scene": "three_tendon", "fidelity": "fast"},
    "evaluation": {"every": 128, "episodes": 2, "skip": 0.2},
    "checkpoint_every": 64,
}


@pytest.fixture(scope="module", autouse=True)
def running():
    with ray_cluster(None, 2, "tests"):
        yield


def curve(folder):
    with open(folder / "evaluations.csv", newline="") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def run(training, folder, runners=0, checkpoint=None):
    folder.mkdir(exist_ok=True)
    run = train.RllibTraining(training, folder, runners, checkpoint)
    run.learn()
    return run


def seeds_of(training):
    return validation.Validation(training)._seeds


@pytest.mark.parametrize("task, runners", [("TipPose", 2), ("Reach", 0)])
def test_a_training_leaves_what_one_of_stable_baselines3_does(tmp_path, task, runners):
    training = Training(**{**TABLE, "task": task})
    done = run(training, tmp_path, runners)
    rows = curve(tmp_path)
    assert [row["steps"] for row in rows] == [0, 128, 256] and done.steps_done() == 256
    for name in ("best", "last"):
        config = json.loads((tmp_path / name / "config.json").read_text())
        assert (config["engine"], config["runners"], config["algorithm"]) == ("rllib", runners, "PPO")
        assert config["record"]["versions"]["ray"] and "weights.pt" in config["files"]
        assert (tmp_path / name / "rllib").is_dir() == (name == "last"), "which a training goes on from"
    path = str(tmp_path / "last")
    env = gym.make(IDS[task], max_episode_steps=20, **load.policy_options(path, task, {}))
    summary = summarise(evaluate(load.load_policy(path, env), env, seeds_of(training), training.evaluation.skip))
    error = next(iter(summary.errors))
    assert summary.errors[error].rms == pytest.approx(rows[-1][f"{error}_rms"], rel=1e-3), "as the learning curve says"


@pytest.mark.parametrize("task", ["TipPose", "Reach"])
def test_an_exported_agent_acts_as_rllibs_module_does(tmp_path, task):
    options = {"options": {**TABLE["options"], "action": "increment"}, "task": task}
    training = Training(**{**TABLE, **options})
    done = run(training, tmp_path)
    module = done.algorithm.get_module()
    envs = gym.make_vec(IDS[task], num_envs=64, **training.options)
    observation, _ = envs.reset(seed=3)
    seen = {"obs": {key: torch.as_tensor(part) for key, part in observation.items()} if task == "Reach" else torch.as_tensor(observation)}
    mean = module.forward_inference(seen)["action_dist_inputs"].chunk(2, dim=-1)[0]
    policy = load.load_policy(str(tmp_path / "last"), gym.make(IDS[task], **training.options))
    action, _ = policy.predict(observation, None, np.ones(64, dtype=bool))
    np.testing.assert_allclose(action, np.clip(mean.numpy(), -1.0, 1.0), atol=1e-6)
    assert np.ptp(action, axis=0).min() > 1e-4, "they depend on what is seen"


def test_it_goes_on_from_rllibs_checkpoint(tmp_path):
    training = Training(**TABLE)
    first = run(training, tmp_path)
    weights = {name: value.clone() for name, value in first.network().state_dict().items()}
    more = Training(**{**TABLE, "steps": 384})
    checkpoint = checkpoint_to_resume(tmp_path, more, resume=True, engine="rllib")
    again = train.RllibTraining(more, tmp_path, 0, checkpoint)
    assert all(torch.equal(value, weights[name]) for name, value in again.network().state_dict().items())
    again.learn()
    assert [row["steps"] for row in curve(tmp_path)] == [0, 128, 256, 384] == sorted(row["steps"] for row in again.curve.rows)
    assert checkpoints.read_checkpoint(tmp_path / "last")["steps_done"] == 384
    with pytest.raises(ValueError, match="has a training with --engine rllib, which cannot go on with sb3"):
        checkpoint_to_resume(tmp_path, more, resume=True)


def test_what_ray_refuses_is_one_line(capsys, tmp_path):
    path = tmp_path / "small.toml"
    path.write_text('task = "TipPose"\nalgorithm = "SAC"\nsteps = 1000\n')
    with pytest.raises(SystemExit) as exit:
        main(["train", str(path), "--engine", "rllib", "--out", str(tmp_path / "run")])
    assert exit.value.code == 2 and "algorithm is 'SAC'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
