"""RLlib's view of a training, without Ray: the same numbers by its own names, an error for what it has no counterpart of, runners' arms."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.config import Training, config_names, find_config, read_training
from soft_tendon_env.learning.rllib.settings import make_runner_env, rllib_settings
from soft_tendon_env.tools.configuration import ConfigurationError

TABLE = {
    "task": "TipPose",
    "algorithm": "PPO",
    "steps": 10_000,
    "arms": 12,
    "seconds": 2.0,
    "seed": 5,
    "learning_rate": 2e-3,
    "hyperparameters": {
        "n_steps": 20,
        "batch_size": 60,
        "n_epochs": 7,
        "gamma": 0.9,
        "gae_lambda": 0.8,
        "clip_range": 0.1,
        "ent_coef": 0.01,
        "vf_coef": 0.4,
        "max_grad_norm": 0.3,
        "target_kl": 0.02,
        "policy_kwargs": {"net_arch": [8, 4], "activation_fn": "ELU"},
    },
    "options": {"scene": "three_tendon", "fidelity": "fast"},
}


def training(**changes):
    return Training(**{**TABLE, **changes})


def with_hyperparameters(**changes):
    return training(hyperparameters={**TABLE["hyperparameters"], **changes})


def test_hyperparameters_keep_their_values_under_rllibs_names():
    settings = rllib_settings(training(), 3)
    assert settings["training"] == {
        "minibatch_size": 60,
        "num_epochs": 7,
        "gamma": 0.9,
        "lambda_": 0.8,
        "clip_param": 0.1,
        "entropy_coeff": 0.01,
        "vf_loss_coeff": 0.4,
        "grad_clip": 0.3,
        "grad_clip_by": "global_norm",
        "lr": 2e-3,
        "train_batch_size_per_learner": 12 * 20,
        "use_kl_loss": True,
        "kl_target": 0.02,
        "vf_clip_param": float("inf"),
    }
    assert settings["rl_module"]["model_config"] == {"network": {"net_arch": [8, 4], "activation_fn": "ELU"}}
    arms = settings["environment"]["env_config"]
    assert arms["episode_steps"] == 100 and arms["rewards"] == {"gamma": 0.9, "clip": 10.0}


def test_what_is_left_out_is_as_stable_baselines3_has_it():
    settings = rllib_settings(training(hyperparameters={"n_steps": 32}), 2)
    expected = {"minibatch_size": 64, "num_epochs": 10, "gamma": 0.99, "lambda_": 0.95, "clip_param": 0.2}
    expected |= {"vf_loss_coeff": 0.5, "grad_clip": 0.5, "use_kl_loss": False}
    assert settings["training"].items() >= expected.items()
    assert rllib_settings(training(normalise={"rewards": False}), 2)["environment"]["env_config"]["rewards"] is None


@pytest.mark.parametrize("runners, rows", [(0, 12), (1, 12), (2, 6), (4, 3)])
def test_runners_share_the_arms(runners, rows):
    settings = rllib_settings(training(), runners)
    assert settings["env_runners"]["num_env_runners"] == runners
    assert settings["env_runners"]["num_envs_per_env_runner"] == rows
    of_runner = settings["env_runners"]["rollout_fragment_length"] * rows
    assert of_runner * max(runners, 1) == settings["training"]["train_batch_size_per_learner"]


def test_a_rate_that_falls_is_a_schedule_and_seeds_go_on():
    falling = training(learning_rate=(1e-3, 1e-4))
    settings = rllib_settings(falling, 2, done=300)
    assert settings["training"]["lr"] == [[0, 1e-3], [10_000, 1e-4]]
    assert settings["environment"]["env_config"]["seed"] == falling.arm_seed(300) and settings["debugging"]["seed"] == 305
    assert 0 <= rllib_settings(training(seed=2**32 - 1), 2)["debugging"]["seed"] < 2**32


@pytest.mark.cases(
    "changed, said",
    [
        (lambda: training(algorithm="SAC", hyperparameters={}), "algorithm is 'SAC'"),
        (lambda: training(normalise={"observations": True}), r"normalise\.observations is true"),
        (lambda: training(start_from="agent"), "start_from is .*no counterpart"),
        (lambda: training(arms=13), "arms is 13: it should be a multiple of the 2 runners"),
        (lambda: with_hyperparameters(clip_range_vf=0.2), r"hyperparameters\.clip_range_vf is 0\.2: .* None or left out"),
        (lambda: with_hyperparameters(normalize_advantage=False), r"hyperparameters\.normalize_advantage is False: .* True or left out"),
        (lambda: with_hyperparameters(use_sde=True), r"hyperparameters\.use_sde is True"),
        (
            lambda: with_hyperparameters(batch_size=1000),
            r"hyperparameters\.batch_size is 1000: it should be at most n_steps times arms, 240",
        ),
    ],
)
def test_what_has_no_counterpart_is_refused_with_its_key(changed, said):
    with pytest.raises(ConfigurationError, match=f"with RLlib: {said}"):
        rllib_settings(changed(), 2)


def test_all_that_is_wrong_is_said_at_once():
    with pytest.raises(ConfigurationError) as error:
        rllib_settings(training(arms=13, normalise={"observations": True}), 2)
    assert len(str(error.value).splitlines()) == 2


def test_the_trainings_that_ship_are_taken_or_refused_for_what_they_say():
    taken = set()
    for name in (name for name in config_names() if name.startswith(("ppo", "sac"))):
        chosen = read_training(find_config(name))
        try:
            rllib_settings(chosen, 2)
            taken.add(name)
        except ConfigurationError:
            assert chosen.algorithm != "PPO" or chosen.start_from
    assert {"ppo_tip_pose", "ppo_shape", "ppo_reach"} <= taken


def test_rllib_takes_the_settings():
    ppo = pytest.importorskip("ray.rllib.algorithms.ppo")
    config = ppo.PPOConfig()
    for method, arguments in rllib_settings(training(), 2).items():
        getattr(config, method)(**arguments)
    config.validate()
    assert (config.lambda_, config.num_epochs, config.total_train_batch_size, config.lr) == (0.8, 7, 240, 2e-3)


ARM = {"scene": "three_tendon", "fidelity": "fast"}


class Context(dict):
    """As RLlib's EnvContext: settings, and which runner it is."""

    worker_index = 0


def runner(index, rows, **more):
    context = Context(task="TipPose", options=ARM, episode_steps=4, threads=1, seed=7, num_envs=rows, **{"rewards": None, **more})
    context.worker_index = index
    return make_runner_env(context)


@pytest.mark.parametrize("indices", [(1, 2), (0,)])
def test_runners_have_the_rows_of_one_environment_each_its_own(indices):
    rows = 4 // len(indices)
    envs = [runner(index, rows) for index in indices]
    whole = gym.make_vec(IDS["TipPose"], num_envs=4, vectorization_mode="vector_entry_point", max_episode_steps=4, **ARM)
    expected, _ = whole.reset(seed=7)
    seen = [env.reset(seed=100 + index)[0] for env, index in zip(envs, indices, strict=True)]
    np.testing.assert_array_equal(np.concatenate(seen), expected)
    assert len({row.tobytes() for row in expected}) == 4
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 3)).astype(np.float32)
    for _ in range(6):  # past the end of an episode
        results = [env.step(part) for env, part in zip(envs, np.split(actions, len(envs)), strict=True)]
        expected = whole.step(actions)
        for part in range(4):
            np.testing.assert_array_equal(np.concatenate([result[part] for result in results]), expected[part])
        assert all(result[4] == {} for result in results)


def test_a_reset_without_seed_goes_on_with_the_rows_generators():
    env = runner(1, 2)
    first, _ = env.reset(seed=1)
    assert not np.array_equal(first, env.reset()[0])
    assert env.reset(seed=3)[1] == {} and env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP


def test_rewards_are_in_units_of_the_deviation_of_returns():
    plain, scaled = runner(1, 2), runner(1, 2, rewards={"gamma": 0.9, "clip": 1e-3})
    for env in (plain, scaled):
        env.reset(seed=1)
    actions = np.zeros((2, 3), dtype=np.float32)
    assert (plain.step(actions)[1] > 1e-2).all() and np.allclose(scaled.step(actions)[1], 1e-3)
