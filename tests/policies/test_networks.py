"""Policy networks by plain formulas: activations, layers, memory, bounds of actions, normalisation;
architectures by the arguments of Stable-Baselines3."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.policies.activations import ACTIVATIONS
from soft_tendon_env.policies.architecture import read_architecture
from soft_tendon_env.policies.layers import (
    Clip,
    Feedforward,
    Gains,
    Gates,
    Linear,
    LstmLayer,
    Renormalisation,
)
from soft_tendon_env.policies.network import PolicyNetwork, flatten
from soft_tendon_env.policies.normalization import (
    Moments,
    Normalization,
    read_normalization,
    save_normalization,
)
from soft_tendon_env.policies.weights import build_network

OBSERVATIONS = gym.spaces.Box(-10.0, 10.0, (4,), np.float32)
ACTIONS = gym.spaces.Box(np.float32([-1.0, 2.0]), np.float32([3.0, 8.0]), dtype=np.float32)
SEEN = np.float32([[0.3, -1.0, 2.0, 0.5], [0.0, 0.0, 0.0, 0.0], [-3.0, 1.0, 0.2, -0.7]])


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def softplus(x):
    return np.log1p(np.exp(x))


def normal_share(x):
    """Of a standard normal distribution what lies below x, by the trapezoidal rule."""
    grid = np.linspace(-12.0, x, 20_001)
    return np.trapezoid(np.exp(-0.5 * grid**2) / np.sqrt(2.0 * np.pi), grid)


SELU_SCALE = 1.0507009873554805
SELU_ALPHA = 1.6732632423543772
FORMULAS = {
    "ELU": lambda x: x if x > 0 else np.exp(x) - 1,
    "GELU": lambda x: x * normal_share(x),
    "Hardtanh": lambda x: min(max(x, -1), 1),
    "Identity": lambda x: x,
    "LeakyReLU": lambda x: x if x > 0 else 0.01 * x,
    "Mish": lambda x: x * np.tanh(softplus(x)),
    "ReLU": lambda x: max(x, 0),
    "ReLU6": lambda x: min(max(x, 0), 6),
    "SELU": lambda x: SELU_SCALE * (x if x > 0 else SELU_ALPHA * (np.exp(x) - 1)),
    "SiLU": lambda x: x * sigmoid(x),
    "Sigmoid": sigmoid,
    "Softplus": softplus,
    "Softsign": lambda x: x / (1 + abs(x)),
    "Tanh": np.tanh,
}


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_activations_are_their_formulas_in_single_precision(name):
    values = np.float32([-8.0, -1.5, -0.3, 0.0, 0.3, 1.5, 5.0, 8.0])
    activated = ACTIVATIONS[name](values)
    assert activated.dtype == np.float32
    expected = [FORMULAS[name](float(value)) for value in values]
    np.testing.assert_allclose(activated, expected, rtol=1e-5, atol=1e-6)


def draw(*shape):
    rng = np.random.default_rng(sum(shape))
    return rng.normal(size=shape).astype(np.float32)


def test_layers_are_their_formulas():
    weight = draw(2, 4)
    bias = draw(2)
    products = np.array([[sum(w * x) for w in weight] for x in SEEN])
    np.testing.assert_allclose(Linear(weight)(SEEN), products, rtol=1e-5)
    affine = Linear(weight, bias)
    np.testing.assert_allclose(affine(SEEN), products + bias, rtol=1e-5)
    clipped = np.clip(SEEN, -0.5, 0.5)
    np.testing.assert_array_equal(Clip(0.5)(SEEN), clipped)
    mean = draw(4)
    deviation = np.abs(draw(4)) + 1.0
    scale = draw(4)
    renormalisation = Renormalisation(mean, deviation, scale, draw(4))
    expected = scale * (SEEN - mean) / deviation + draw(4)
    np.testing.assert_allclose(renormalisation(SEEN), expected, rtol=1e-5)
    both = Feedforward((affine, Clip(0.5)))
    expected = np.clip(products + bias, -0.5, 0.5)
    np.testing.assert_allclose(both(SEEN), expected, rtol=1e-5)


def test_the_memory_is_a_minimal_gated_unit():
    """m+ = (1 - f) m + f tanh(W [x, f m] + c), with f = sigmoid(V [x, m] + b)."""
    V = draw(3, 7)
    b = draw(3)
    W = 0.5 * V
    c = 0.2 * b
    memory = draw(3, 3)
    gates = Gates(Linear(V, b), Linear(W, c))
    assert gates.size == 3
    seen_after, after = gates(SEEN, memory)
    expected_seen_after = np.hstack([SEEN, after])
    np.testing.assert_array_equal(seen_after, expected_seen_after)
    for x, m, m_after in zip(SEEN, memory, after, strict=True):
        remembered = np.concatenate([x, m])
        f = sigmoid(V @ remembered + b)
        recalled = np.concatenate([x, f * m])
        candidate = np.tanh(W @ recalled + c)
        expected = (1 - f) * m + f * candidate
        np.testing.assert_allclose(m_after, expected, rtol=1e-5, atol=1e-6)


def test_lstms_forget_and_take_in_by_their_gates():
    """c+ = f c + i tanh(g) and h+ = o tanh(c+), with the gates i, f, g, o of PyTorch's order."""
    of_input = Linear(draw(8, 4), draw(8))
    of_hidden = Linear(draw(8, 2), 0.5 * draw(8))
    layer = LstmLayer(of_input, of_hidden)
    hidden = draw(3, 2)
    cell = draw(2, 3).T
    next_hidden, next_cell = layer(SEEN, hidden, cell)
    for row in range(3):
        from_input = of_input.weight @ SEEN[row] + of_input.bias
        from_hidden = of_hidden.weight @ hidden[row] + of_hidden.bias
        i, f, g, o = np.split(from_input + from_hidden, 4)
        kept = sigmoid(f) * cell[row]
        taken_in = sigmoid(i) * np.tanh(g)
        c = kept + taken_in
        np.testing.assert_allclose(next_cell[row], c, rtol=1e-5, atol=1e-6)
        h = sigmoid(o) * np.tanh(c)
        np.testing.assert_allclose(next_hidden[row], h, rtol=1e-5, atol=1e-6)


def test_gains_multiply_the_way_to_the_target():
    way = draw(5, 3)
    gain = draw(2, 5)
    latent = draw(3, 5)
    gains = Gains(1, Linear(way), Linear(gain))
    expected = (latent * (SEEN[:, 1:] @ way.T)) @ gain.T
    np.testing.assert_allclose(gains(latent, SEEN[:, 1:]), expected, rtol=1e-5)


def arrays_of(names_and_shapes):
    return {name: draw(*shape) for name, shape in names_and_shapes.items()}


PPO = {
    "mlp_extractor.policy_net.0.weight": (3, 4),
    "mlp_extractor.policy_net.0.bias": (3,),
    "action_net.weight": (2, 3),
    "action_net.bias": (2,),
}
SAC = {
    "actor.latent_pi.0.weight": (3, 4),
    "actor.latent_pi.0.bias": (3,),
    "actor.mu.weight": (2, 3),
    "actor.mu.bias": (2,),
}


def test_actions_of_ppo_are_cut_off_at_their_bounds():
    arrays = arrays_of(PPO)
    network = build_network(
        read_architecture("PPO", {"net_arch": [3]}), arrays, OBSERVATIONS, ACTIONS
    )
    W, b, V, c = arrays.values()
    mean = np.tanh(SEEN @ W.T + b) @ V.T + c
    expected = np.clip(mean, ACTIONS.low, ACTIONS.high)
    actions, state = network.predict(SEEN)
    np.testing.assert_allclose(actions, expected, rtol=1e-5)
    assert state is None
    assert (mean < ACTIONS.low).any()
    alone, _ = network.predict(SEEN[0])
    np.testing.assert_allclose(alone, expected[0], rtol=1e-5)


@pytest.mark.parametrize("clip_mean", [None, 0.5])
def test_actions_of_sac_are_squashed_between_their_bounds(clip_mean):
    """tanh of the mean, which is bounded where the training explored by state."""
    arrays = arrays_of(SAC)
    W, b, V, c = arrays.values()
    arguments = {"net_arch": {"pi": [3], "qf": [7]}}
    mean = np.maximum(SEEN @ W.T + b, 0.0) @ V.T + c
    if clip_mean is not None:
        arguments |= {"use_sde": True, "clip_mean": clip_mean}
        mean = np.clip(mean, -clip_mean, clip_mean)
        for part in ("weight", "bias"):
            arrays[f"actor.mu.0.{part}"] = arrays.pop(f"actor.mu.{part}")
    network = build_network(read_architecture("SAC", arguments), arrays, OBSERVATIONS, ACTIONS)
    low = ACTIONS.low
    high = ACTIONS.high
    expected = low + 0.5 * (np.tanh(mean) + 1.0) * (high - low)
    np.testing.assert_allclose(network.predict(SEEN)[0], expected, rtol=1e-5)


def test_crossq_renormalises_before_every_layer_and_after_the_last():
    name = "actor.latent_pi"
    arrays = {}
    for place, size in ((0, 4), (3, 3)):
        for part in ("ra_mean", "ra_var", "scale", "bias"):
            arrays[f"{name}.{place}.{part}"] = np.abs(draw(size, 1)[:, 0]) + np.float32(len(part))
    arrays |= {f"{name}.1.weight": draw(3, 4), f"{name}.1.bias": draw(3)}
    arrays |= {"actor.mu.weight": 0.1 * draw(2, 3), "actor.mu.bias": draw(2)}
    architecture = read_architecture("CrossQ", {"net_arch": [3], "batch_norm_eps": 0.25})
    network = build_network(architecture, dict(arrays), OBSERVATIONS, ACTIONS)

    def renormalised(values, place):
        mean, variance, scale, bias = (
            arrays[f"{name}.{place}.{part}"] for part in ("ra_mean", "ra_var", "scale", "bias")
        )
        return scale * (values - mean) / np.sqrt(variance + 0.25) + bias

    hidden = renormalised(SEEN, 0) @ arrays[f"{name}.1.weight"].T + arrays[f"{name}.1.bias"]
    latent = renormalised(np.maximum(hidden, 0.0), 3)
    mean = latent @ arrays["actor.mu.weight"].T + arrays["actor.mu.bias"]
    low = ACTIONS.low
    high = ACTIONS.high
    expected = low + 0.5 * (np.tanh(mean) + 1.0) * (high - low)
    np.testing.assert_allclose(network.predict(SEEN)[0], expected, rtol=1e-4)
    arrays[f"{name}.0.ra_var"][0] = -1.0
    with pytest.raises(ValueError, match=r"0\.ra_var has negative variances"):
        build_network(architecture, arrays, OBSERVATIONS, ACTIONS)


@pytest.mark.parametrize(
    ("kind", "arguments", "expected"),
    [
        ("PPO", {}, {"hidden": (64, 64), "activation": "Tanh", "squashes": False}),
        ("PPO", {"use_sde": True, "squash_output": True}, {"squashes": True, "clip_mean": None}),
        ("APG", {"memory": 3, "fine": 5.0, "posture": 1}, {"memory": 3, "fine": 5.0, "posture": 1}),
        ("SAC", {}, {"hidden": (256, 256), "activation": "ReLU", "squashes": True}),
        ("SAC", {}, {"clip_mean": None, "renorm_epsilon": None}),
        ("SAC", {"use_sde": True}, {"clip_mean": 2.0}),
        ("SAC", {"use_sde": True, "clip_mean": 0.0}, {"clip_mean": None}),
        ("TQC", {"net_arch": [7], "activation_fn": "ELU"}, {"hidden": (7,), "activation": "ELU"}),
        ("CrossQ", {}, {"renorm_epsilon": 0.001}),
        ("CrossQ", {"batch_norm": False}, {"renorm_epsilon": None}),
    ],
)
def test_architectures_have_the_defaults_of_stable_baselines(kind, arguments, expected):
    assert vars(read_architecture(kind, arguments)).items() >= expected.items()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"squash_output": True}, "which needs use_sde = true"),
        ({"net_arch": [0]}, "should be the units of hidden layers"),
        ({"net_arch": "64"}, "should be the units of hidden layers"),
    ],
)
def test_architectures_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        read_architecture("PPO", arguments)


def test_observations_are_one_or_many_and_dictionaries_in_the_order_of_their_keys():
    parts = gym.spaces.Dict(
        {key: gym.spaces.Box(-1.0, 1.0, (size,), np.float32) for key, size in (("b", 2), ("a", 1))}
    )
    rows = {"a": np.float32([[9.0], [8.0]]), "b": np.float32([[1.0, 2.0], [3.0, 4.0]])}
    flat, many = flatten(rows, parts)
    assert many
    in_order = [rows[key] for key in parts.spaces]
    expected_flat = np.concatenate(in_order, axis=1)
    np.testing.assert_array_equal(flat, expected_flat)
    one, many = flatten({key: value[0] for key, value in rows.items()}, parts)
    assert not many
    np.testing.assert_array_equal(one, flat[:1])
    for wrong in (np.zeros(3), np.zeros((2, 3)), np.zeros((2, 2, 4))):
        with pytest.raises(ValueError, match="it should be .*, or rows of it"):
            flatten(wrong, OBSERVATIONS)
    with pytest.raises(ValueError, match="is a tuple"):
        flatten((np.zeros(4), {}), OBSERVATIONS)


def test_actions_and_memory_of_many_rows_are_those_of_few(monkeypatch):
    """Beyond the rows whose products have one thread."""
    arrays = arrays_of(PPO)
    network = build_network(
        read_architecture("PPO", {"net_arch": [3]}), arrays, OBSERVATIONS, ACTIONS
    )
    assert isinstance(network, PolicyNetwork)
    assert network.memory == 0
    many, _ = network.predict(np.tile(SEEN, (100, 1)))
    few, _ = network.predict(SEEN)
    expected_many = np.tile(few, (100, 1))
    np.testing.assert_allclose(many, expected_many, rtol=1e-5)


def test_normalised_observations_are_in_deviations_and_clipped(tmp_path):
    """clip((o - mean) / sqrt(variance + epsilon)), also after writing and reading; parts without
    statistics pass."""
    mean = np.array([0.5, -1.0, 0.0, 2.0])
    variance = np.array([4.0, 0.25, 1e-4, 9.0])
    normalization = Normalization({"": Moments(mean, variance)}, clip=2.5, epsilon=0.01)
    save_normalization(tmp_path / "statistics.npz", normalization)
    read = read_normalization(tmp_path / "statistics.npz", OBSERVATIONS)
    expected = np.clip((SEEN - mean) / np.sqrt(variance + 0.01), -2.5, 2.5)
    for each in (normalization, read):
        assert each(SEEN).dtype == np.float32
        np.testing.assert_allclose(each(SEEN), expected, rtol=1e-6)
    of_part = Normalization({"a": Moments(mean, variance)}, clip=2.5, epsilon=0.01)
    parts = of_part({"a": SEEN, "b": SEEN})
    np.testing.assert_allclose(parts["a"], expected, rtol=1e-6)
    np.testing.assert_array_equal(parts["b"], SEEN)
