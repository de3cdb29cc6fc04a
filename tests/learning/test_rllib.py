"""Trainings with RLlib: the same numbers by its own names, and agents that act alike without
Ray."""

import csv
import json

import gymnasium as gym
import numpy as np
import pytest
import torch

pytest.importorskip("ray.rllib")

from soft_tendon_env.envs import IDS  # noqa: E402
from soft_tendon_env.learning.config import find_config, read_training  # noqa: E402
from soft_tendon_env.learning.rllib import RllibTraining, make_config, make_runner_env  # noqa: E402
from soft_tendon_env.learning.train import checkpoint_to_resume  # noqa: E402
from soft_tendon_env.policies import load_policy  # noqa: E402
from soft_tendon_env.tools.configuration import ConfigurationError  # noqa: E402
from soft_tendon_env.tools.parallel import ray_cluster  # noqa: E402


@pytest.fixture(scope="module")
def running():
    with ray_cluster(None, 2, "tests"):
        yield


def test_hyperparameters_keep_their_values_under_rllibs_names():
    for name in ("ppo_tip_pose_nominal", "ppo_shape", "ppo_reach"):
        chosen = read_training(find_config(name))
        found = make_config(chosen, 2)
        given = chosen.hyperparameters
        assert (found.minibatch_size, found.num_epochs, found.gamma) == (
            given["batch_size"],
            given["n_epochs"],
            given["gamma"],
        )
        assert (found.lambda_, found.clip_param, found.vf_loss_coeff, found.grad_clip) == (
            0.95,
            0.2,
            0.5,
            0.5,
        ), "as Stable-Baselines3 has it"
        assert (found.total_train_batch_size, found.kl_target) == (
            chosen.arms * given["n_steps"],
            given["target_kl"],
        )
        first, last = chosen.learning_rate
        assert found.lr == [[0, first], [chosen.steps, last]]
        assert (found.num_env_runners, found.num_envs_per_env_runner) == (2, chosen.arms // 2)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"algorithm": "SAC", "hyperparameters": {}}, "algorithm has no counterpart"),
        ({"normalise": {"observations": True}}, r"normalise\.observations has no counterpart"),
        ({"arms": 5}, "arms is 5: it should be a multiple of the 2 runners"),
        (
            {"hyperparameters": {"clip_range_vf": 0.2}},
            r"hyperparameters\.clip_range_vf has no counterpart",
        ),
    ],
)
def test_what_has_no_counterpart_is_refused_with_its_key(training, changes, said):
    with pytest.raises(ConfigurationError, match=f"with RLlib: {said}"):
        make_config(training(**changes), 2)


class Context(dict):
    """As RLlib's EnvContext: settings, and which runner it is."""

    worker_index = 0


def test_runners_have_the_rows_of_one_environment_each_its_own(training):
    plain, contexts = (
        training(normalise={"rewards": False}),
        [Context(seed=7, num_envs=2) for _ in range(2)],
    )
    for index, context in enumerate(contexts, 1):
        context.worker_index = index
        context["training"] = plain
    envs = [make_runner_env(context) for context in contexts]
    whole = gym.make_vec(
        IDS["TipPose"],
        num_envs=4,
        vectorization_mode="vector_entry_point",
        max_episode_steps=20,
        **plain.options,
    )
    expected, _ = whole.reset(seed=7)
    np.testing.assert_array_equal(
        np.concatenate([env.reset(seed=100)[0] for env in envs]), expected
    )
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (4, 3)).astype(np.float32)
    for _ in range(22):  # past the end of an episode
        results, expected = (
            [env.step(part) for env, part in zip(envs, np.split(actions, 2), strict=True)],
            whole.step(actions),
        )
        for part in range(4):
            np.testing.assert_array_equal(
                np.concatenate([result[part] for result in results]), expected[part]
            )


@pytest.mark.filterwarnings(
    "ignore:.*Overriding environment rllib"
)  # of RLlib, which registers one per training of a process
@pytest.mark.parametrize(("task", "runners"), [("TipPose", 2), ("Reach", 0)])
def test_a_training_leaves_what_one_of_stable_baselines3_does_and_goes_on(
    running, training, tmp_path, task, runners
):
    chosen = training(task=task)
    done = RllibTraining(chosen, tmp_path, runners, None)
    done.learn()
    for name in ("best", "last"):
        config = json.loads((tmp_path / name / "config.json").read_text())
        assert (config["engine"], config["runners"]) == (
            "rllib",
            runners,
        )
        assert "weights.npz" in config["files"]
        assert (tmp_path / name / "rllib").is_dir() == (name == "last"), (
            "which a training goes on from"
        )
    envs = gym.make_vec(IDS[task], num_envs=64, **chosen.options)
    observation, _ = envs.reset(seed=3)
    seen = (
        {key: torch.as_tensor(part) for key, part in observation.items()}
        if task == "Reach"
        else torch.as_tensor(observation)
    )
    mean = (
        done.algorithm.get_module()
        .forward_inference({"obs": seen})["action_dist_inputs"]
        .chunk(2, dim=-1)[0]
    )
    policy = load_policy(str(tmp_path / "last"), gym.make(IDS[task], **chosen.options))
    action, _ = policy.predict(observation, None, np.ones(64, dtype=bool))
    expected_action = np.clip(mean.numpy(), -1.0, 1.0)
    np.testing.assert_allclose(action, expected_action, atol=1e-6)
    more, before = (
        training(task=task, steps=384),
        {name: value.clone() for name, value in done.network().state_dict().items()},
    )
    done.algorithm.stop()  # its runners have all processors
    again = RllibTraining(
        more, tmp_path, runners, checkpoint_to_resume(tmp_path, more, resume=True, engine="rllib")
    )
    assert all(
        torch.equal(value, before[name]) for name, value in again.network().state_dict().items()
    )
    again.learn()
    with open(tmp_path / "evaluations.csv") as file:
        assert [float(row["steps"]) for row in csv.DictReader(file)] == [0, 128, 256, 384]
