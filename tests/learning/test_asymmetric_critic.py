"""Critics that are told the parameters drawn for every arm, and policies that are not."""

import numpy as np
import pytest
import torch

from soft_tendon_env.learning import config, train, training_env
from soft_tendon_env.learning.asymmetric_critic import acting_network, told_env
from soft_tendon_env.learning.checkpoints import statistics_of
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.network import read_weights
from soft_tendon_env.tools.configuration import ConfigurationError

DRAWN = {"stiffness": [0.8, 1.2], "payload": [0.0, 0.02], "tension_gain": [0.9, 1.1], "latency": [0.0, 0.04], "damping": 0.5}
SIZE = 6  # stiffness, payload, three gains, latency
SMALL = {"scene": "three_tendon", "fidelity": "fast", "action": "increment"}
REPLAY = {"learning_starts": 20, "gradient_steps": 1, "buffer_size": 500, "batch_size": 16}
HYPERPARAMETERS = {"PPO": {"n_steps": 16, "batch_size": 32, "n_epochs": 1}, "SAC": REPLAY, "TQC": REPLAY}


def training(algorithm="PPO", randomize=DRAWN, **changes):
    table = {
        "task": "TipPose",
        "algorithm": algorithm,
        "steps": 96,
        "arms": 4,
        "seconds": 0.4,
        "hyperparameters": {**HYPERPARAMETERS.get(algorithm, {}), "policy_kwargs": {"net_arch": [8]}},
        "options": {**SMALL, "randomize": randomize},
        "evaluation": {"every": 1_000, "episodes": 2, "skip": 0.0},
        "asymmetric_critic": True,
        **changes,
    }
    return config.Training.parse(table, "test")


def observed(model, count=5):
    """Observations of the training, of so many steps of all arms."""
    env = statistics_of(model)
    found = [env.reset()]
    for _ in range(count):
        found.append(env.step(np.zeros((env.num_envs, 3)))[0])
    return np.concatenate(found)


@pytest.mark.parametrize("algorithm", HYPERPARAMETERS)
def test_policy_is_blind_to_what_its_critic_is_told(algorithm, tmp_path):
    model = train.train(training(algorithm), tmp_path)
    seen = torch.as_tensor(observed(model))
    other = seen.clone()
    other[:, -SIZE:] = torch.as_tensor(np.random.default_rng(0).uniform(-1.0, 1.0, (len(seen), SIZE)))
    policy = model.policy.eval()
    actions = [policy.predict(own.numpy(), deterministic=True)[0] for own in (seen, other)]
    np.testing.assert_array_equal(*actions)
    with torch.no_grad():
        value = policy.predict_values if algorithm == "PPO" else lambda own: policy.critic(own, torch.zeros(len(own), 3))[0]
        assert not torch.allclose(value(seen), value(other))
        seen[:, -SIZE:] = 0.0
        of_middle = value(seen)
        small = acting_network(model).eval()
        value = small.predict_values if algorithm == "PPO" else lambda own: small.critic(own, torch.zeros(len(own), 3))[0]
        torch.testing.assert_close(value(seen[:, :-SIZE]), of_middle)
    np.testing.assert_allclose(small.predict(seen[:, :-SIZE].numpy(), deterministic=True)[0], actions[0], atol=1e-6)
    saved = read_weights(tmp_path / "best" / "weights.pt")
    assert {name: tensor.shape for name, tensor in saved.items()} == {name: tensor.shape for name, tensor in small.state_dict().items()}


def test_a_training_that_goes_on_stays_blind(tmp_path):
    train.train(training(), tmp_path)
    longer = training(steps=160)
    model = train.train(longer, tmp_path, train.checkpoint_to_resume(tmp_path, longer, resume=True))
    seen = observed(model)
    actions = model.policy.predict(seen, deterministic=True)[0]
    seen[:, -SIZE:] *= -1.0
    np.testing.assert_array_equal(model.policy.predict(seen, deterministic=True)[0], actions)
    assert model.num_timesteps == 192


def test_told_are_the_parameters_of_each_episode_within_their_ranges():
    effects = {"fluid.density": [500.0, 1500.0]}
    fluid = {"scene": "three_tendon", "effects.fluid.density": 1000.0}
    env = training_env.make_training_env(training(options={**SMALL, "scene": fluid, "randomize": {**DRAWN, "effects": effects}}))
    episodes = unwrapped(env).env.episodes
    env.seed(3)
    told = env.reset()[:, -SIZE - 1 :]

    def expected(row):
        draw, density = episodes.draws[row], episodes.arms.effects_of(row).fluid.density
        of_arm = [(draw.material.stiffness - 1.0) / 0.2, draw.material.payload / 0.01 - 1.0, *((draw.gain - 1.0) / 0.1)]
        return [*of_arm, draw.latency / 0.02 - 1.0, (density - 1000.0) / 500.0]

    ended = 0
    for _ in range(25):
        np.testing.assert_allclose(told, [expected(row) for row in range(4)], atol=1e-6)
        observation, _, dones, infos = env.step(np.zeros((4, 3)))
        for row in np.flatnonzero(dones):
            np.testing.assert_array_equal(infos[row]["terminal_observation"][-SIZE - 1 :], told[row])
            assert not np.array_equal(observation[row, -SIZE - 1 :], told[row])
            ended += 1
        told = observation[:, -SIZE - 1 :]
        assert env.observation_space.contains(observation[0])
    assert ended >= 4


def test_goals_are_seen_by_both(tmp_path):
    hindsight = {**REPLAY, "learning_starts": 80}
    model = train.train(training("SAC", task="Reach", steps=120, hyperparameters=hindsight, hindsight={"goals": 2}), tmp_path)
    seen = statistics_of(model).reset()
    actions = model.policy.predict(seen, deterministic=True)[0]
    seen["observation"][:, -SIZE:] = 0.3
    np.testing.assert_array_equal(model.policy.predict(seen, deterministic=True)[0], actions)
    seen["desired_goal"][:] += 0.1
    assert not np.array_equal(model.policy.predict(seen, deterministic=True)[0], actions)
    assert told_env(model) is not None


def test_an_agent_that_was_told_nothing_can_be_refined(tmp_path):
    options = {**SMALL, "action": "tension", "randomize": DRAWN}
    before = training(asymmetric_critic=False, options=options)
    first = train.train(before, tmp_path)
    model = train.model_of(before.model_copy(update={"asymmetric_critic": True, "start_from": str(tmp_path / "last")}), None)
    seen = observed(model)
    actions = [own.policy.predict(seen[:, : own.observation_space.shape[0]], deterministic=True)[0] for own in (first, model)]
    np.testing.assert_allclose(*actions, atol=1e-6)
    assert not model.policy.state_dict()["mlp_extractor.value_net.0.weight"][:, -SIZE:].any()
    with pytest.raises(ValueError, match="not of the shape"):
        wider = {**before.hyperparameters, "policy_kwargs": {"net_arch": [8 + SIZE]}}
        train.model_of(before.model_copy(update={"hyperparameters": wider, "start_from": str(tmp_path / "last")}), None)


@pytest.mark.parametrize("algorithm", HYPERPARAMETERS)
def test_checkpoints_do_not_change_a_training(algorithm, tmp_path):
    weights = []
    for seconds in (1e9, 1e-3):
        model = train.train(training(algorithm, checkpoint_seconds=seconds), tmp_path / str(seconds))
        weights.append(torch.cat([own.ravel() for own in model.policy.state_dict().values()]))
    torch.testing.assert_close(*weights, rtol=0.0, atol=0.0)


def test_stages_are_told_within_the_ranges_of_the_training():
    fluid = {"scene": "three_tendon", "effects.fluid.density": 1000.0}
    gravity = {**fluid, "effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    effects = {"fluid.density": [500.0, 1500.0], "gravity.acceleration": {"factor": [0.8, 1.2]}}
    stages = [
        {"start": 0, "options": {"scene": fluid, "randomize": {"stiffness": [0.5, 2.0], "effects": {"fluid.density": [900.0, 2000.0]}}}},
        {"start": 40, "options": {}},
    ]
    own = training(options={**SMALL, "scene": gravity, "randomize": {**DRAWN, "effects": effects}}, curriculum=stages)
    training_env.check_stages(own)
    size, told = SIZE + 2, []
    for start in (0, 40):
        env = training_env.make_training_env(own, start)
        env.seed(5)
        told.append(np.concatenate([env.reset()[:, -size:] for _ in range(4)]))
        assert np.abs(told[-1]).max() <= 1.0 and env.observation_space.shape[0] > size
    first, second = np.ptp(told, axis=1)
    assert (second[[0, *range(2, size)]] > 0.2).all()
    assert not first[1:6].any() and not first[-1].any() and first[0] > 1.0 and first[-2] > 0.2


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"algorithm": "APG"}, "not for APG"),
        ({"algorithm": "CrossQ", "hyperparameters": REPLAY}, "not for CrossQ"),
        ({"randomize": {"noise": {"position": 0.001}}}, "randomize should draw parameters"),
        ({"randomize": {"stiffness": 1.1}}, "randomize should draw parameters"),
        ({"normalise": {"observations": True}}, "does not go with normalise.observations"),
        ({"hyperparameters": {"policy_kwargs": {"share_features_extractor": True}}}, "does not go with share_features_extractor"),
    ],
    ids=["no critic", "batch norm", "noise alone", "numbers alone", "normalised", "shared"],
)
def test_what_cannot_be_told_is_refused(changes, said):
    with pytest.raises(ConfigurationError, match=said):
        training_env.check_stages(training(**changes))
