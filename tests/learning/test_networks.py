"""Agents act by NumPy as the networks of PyTorch that were trained, whatever algorithm trained
them."""

import inspect

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from soft_tendon_env import register  # noqa: E402
from soft_tendon_env.learning.hyperparameters import training_class  # noqa: E402
from soft_tendon_env.learning.networks import new_network  # noqa: E402
from soft_tendon_env.policies import save_agent  # noqa: E402
from soft_tendon_env.policies.activations import ACTIVATIONS  # noqa: E402
from soft_tendon_env.policies.algorithms import ALGORITHMS, network_kind, policy_name  # noqa: E402
from soft_tendon_env.policies.architecture import (  # noqa: E402
    ACTING,
    EXTRACTOR,
    OF_TRAINING,
    read_architecture,
)
from soft_tendon_env.policies.weights import WEIGHTS, build_network, read_weights  # noqa: E402

COUNT = 1000  # observations
OBSERVED = gym.spaces.Box(-np.inf, np.inf, (20,), np.float32)
GOALS = gym.spaces.Dict(
    {
        "observation": gym.spaces.Box(-np.inf, np.inf, (14,), np.float32),
        "desired_goal": gym.spaces.Box(-np.inf, np.inf, (3,), np.float32),
        "achieved_goal": gym.spaces.Box(-np.inf, np.inf, (3,), np.float32),
    }
)
ACTIONS = gym.spaces.Box(np.float32([-1.0, -1.0, 0.0]), np.float32([1.0, 1.5, 0.5]))
CASES = [
    ("PPO", {}),
    ("PPO", {"net_arch": {"pi": [32], "vf": [8]}, "activation_fn": "ELU", "log_std_init": -1.0}),
    ("PPO", {"net_arch": [], "share_features_extractor": False}),
    ("PPO", {"use_sde": True, "squash_output": True, "activation_fn": "ReLU"}),
    ("SAC", {}),
    ("SAC", {"net_arch": {"pi": [32, 16], "qf": [8]}, "use_sde": True}),
    ("SAC", {"use_sde": True, "clip_mean": 0.0}),
    ("TQC", {"n_quantiles": 7, "activation_fn": "GELU"}),
    ("CrossQ", {"net_arch": [32, 16]}),
    ("CrossQ", {"net_arch": [32, 16], "batch_norm": False, "use_sde": True}),
    ("CrossQ", {"net_arch": [32], "batch_norm_eps": 0.1}),
    ("DAgger", {"net_arch": [32, 32], "activation_fn": "ELU"}),
    ("APG", {}),
    ("APG", {"memory": 8, "net_arch": {"pi": [32], "vf": []}, "activation_fn": "ELU"}),
    ("APG", {"memory": 8, "fine": 10.0, "posture": 6, "net_arch": [32, 32]}),
    ("RecurrentPPO", {"lstm_hidden_size": 12}),
    ("RecurrentPPO", {"lstm_hidden_size": 8, "n_lstm_layers": 2, "net_arch": []}),
    (
        "RecurrentPPO",
        {"lstm_hidden_size": 8, "shared_lstm": True, "enable_critic_lstm": False},
    ),
]


def trained_network(algorithm, arguments, observations):
    """A network of PyTorch with weights, and running statistics, that are anything."""
    torch.manual_seed(0)
    network = new_network(algorithm, arguments, observations, ACTIONS)
    with torch.no_grad():
        for parameter in network.parameters():
            inputs = parameter.shape[-1]  # so that values stay of order 1 in wide layers too
            parameter += torch.randn_like(parameter) / inputs**0.5
        for name, values in network.named_buffers():
            if name.endswith("ra_mean"):
                values.normal_()
            if name.endswith("ra_var"):
                values.uniform_(0.1, 2.0)
    return network


def acting_network(folder, algorithm, arguments, network, observations):
    """The network that acts by the files that `save_agent` writes."""
    save_agent(folder, network, None)
    architecture = read_architecture(network_kind(algorithm), arguments)
    return build_network(architecture, read_weights(folder / WEIGHTS), observations, ACTIONS)


def draw_rows(space):
    draw = np.random.default_rng(0)
    if isinstance(space, gym.spaces.Dict):
        rows = {}
        for key, part in space.spaces.items():
            rows[key] = draw.normal(size=(COUNT, *part.shape))
        return rows
    drawn = draw.normal(size=(COUNT, *space.shape))
    return drawn.astype(np.float32)


def one_row(rows, number):
    if isinstance(rows, dict):
        return {key: values[number] for key, values in rows.items()}
    return rows[number]


@pytest.mark.usefixtures("recurrent_ppo")
@pytest.mark.parametrize("space", [OBSERVED, GOALS], ids=["Box", "Dict"])
@pytest.mark.parametrize(("algorithm", "arguments"), CASES)
def test_actions_are_those_of_the_trained_network(tmp_path, algorithm, arguments, space):
    if space is GOALS and algorithm == "CrossQ":
        pytest.skip("sb3-contrib has no CrossQ with tables of observations")
    trained = trained_network(algorithm, arguments, space)
    acting = acting_network(tmp_path, algorithm, arguments, trained, space)
    rows = draw_rows(space)
    expected_state = state = None
    start = np.ones(COUNT, dtype=bool)
    for _ in range(3):  # control periods, over which a memory goes on
        expected, expected_state = trained.predict(rows, expected_state, start, deterministic=True)
        actions, state = acting.predict(rows, state, start)
        np.testing.assert_allclose(actions, expected, atol=1e-5)
        assert actions.dtype == np.float32
        assert np.ptp(actions, axis=0).min() > 0.1
        start = np.arange(COUNT) % 5 == 0
    alone = one_row(rows, 7)
    expected, _ = trained.predict(alone, None, np.ones(1, dtype=bool), deterministic=True)
    action, _ = acting.predict(alone, None, np.ones(1, dtype=bool))
    assert action.shape == ACTIONS.shape
    np.testing.assert_allclose(action, expected, atol=1e-5)


def test_files_have_what_acting_needs_alone(tmp_path):
    trained = trained_network("SAC", {}, OBSERVED)
    save_agent(tmp_path, trained, None)
    names = read_weights(tmp_path / WEIGHTS).keys()
    assert {name.split(".")[1] for name in names} == {"latent_pi", "mu"}


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_activation_functions_are_those_of_pytorch(name):
    values = np.linspace(-30.0, 30.0, 10_001, dtype=np.float32)
    expected = getattr(torch.nn, name)()(torch.as_tensor(values)).numpy()
    found = ACTIVATIONS[name](values)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("algorithm", [*ALGORITHMS, "RecurrentPPO"])
def test_every_argument_of_policies_is_known(algorithm, recurrent_ppo):
    kind = network_kind(algorithm)
    learner = training_class(algorithm)
    policy = learner.policy_aliases[policy_name(learner, has_goals=False)]
    names = {*inspect.signature(policy.__init__).parameters}
    made_here = {"self", "observation_space", "action_space", "lr_schedule"}
    assert names - made_here <= {*ACTING[kind], *OF_TRAINING, EXTRACTOR}
    assert {*ACTING[kind]} <= names


def test_a_registered_algorithm_acts_by_the_policies_that_it_has(forgotten):
    from stable_baselines3 import PPO, TD3

    register("algorithm", "Mine", type("Mine", (PPO,), {}))
    assert network_kind("Mine") == "PPO"
    with pytest.raises(ValueError, match="policies of TD3 are of the class .*TD3Policy, which"):
        register("algorithm", "TD3", TD3)
    with pytest.raises(TypeError, match="'Net' should be a subclass of .*BaseAlgorithm"):
        register("algorithm", "Net", torch.nn.Linear)
    with pytest.raises(ValueError, match="algorithm is 'TD3': valid: APG, .*--import"):
        network_kind("TD3")


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (np.zeros((4, 19)), r"observation has the shape \(4, 19\): it should be \(20,\), or rows"),
        ((np.zeros(20), {}), "observation is a tuple: `reset` returns an observation and its info"),
    ],
)
def test_observations_of_another_space_are_refused(tmp_path, given, text):
    trained = trained_network("PPO", {}, OBSERVED)
    acting = acting_network(tmp_path, "PPO", {}, trained, OBSERVED)
    with pytest.raises(ValueError, match=text):
        acting.predict(given)
