"""Policy networks of Stable-Baselines3 as nodes of a graph: linear layers and activations, of what acts without exploring."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.export.graph import Graph

ACTIVATIONS = {"ELU": "Elu", "LeakyReLU": "LeakyRelu", "ReLU": "Relu", "Sigmoid": "Sigmoid", "Tanh": "Tanh"}
"""Operators of ONNX by the names of layers in torch.nn."""
SLOPES = {"ELU": "alpha", "LeakyReLU": "negative_slope"}
FEATURES = ("FlattenExtractor", "CombinedExtractor")


def actions(graph: Graph, network: Any, observation: dict[str, str]) -> str:
    """Actions (n_a,), float32, within [-1, 1], of a policy network for observations by key ("": not a dictionary).

    Raises ValueError for networks that have other layers, or a memory.
    """
    actor = getattr(network, "actor", network)
    extractor = actor.features_extractor
    if hasattr(network, "lstm_actor"):
        raise ValueError("a recurrent network cannot be exported: train with the option history in its place")
    if type(extractor).__name__ not in FEATURES:
        raise ValueError(f"features of {type(extractor).__name__} cannot be exported: they should be of {' or '.join(FEATURES)}")
    keys = [*getattr(extractor, "extractors", observation)]
    value = graph.add("Concat", *(observation[key] for key in keys), axis=0)
    for layer in _layers(actor):
        value = _layer(graph, value, layer)
    distribution = getattr(actor, "action_dist", None)
    if type(distribution).__name__.startswith("Squashed") or getattr(distribution, "bijector", None) is not None:
        value = graph.add("Tanh", value)
    return graph.clip(value, np.array(np.float32(-1.0)), np.array(np.float32(1.0)))


def _layers(actor: Any) -> Iterator[Any]:
    """Layers of torch from features to the mean of actions."""
    if hasattr(actor, "mlp_extractor"):  # PPO, A2C, TRPO
        parts = [actor.mlp_extractor.policy_net, actor.action_net]
    elif hasattr(actor, "latent_pi"):  # SAC, TQC, CrossQ
        parts = [actor.latent_pi, actor.mu]
    else:  # TD3, DDPG; ARS
        parts = [actor.mu if hasattr(actor, "mu") else actor.action_net]
    for part in parts:
        for layer in part.modules():
            if not [*layer.children()]:
                yield layer


def _layer(graph: Graph, value: str, layer: Any) -> str:
    name = type(layer).__name__
    if name == "Linear":
        value = graph.add("MatMul", value, _numbers(layer.weight).T)
        return value if layer.bias is None else graph.add("Add", value, _numbers(layer.bias))
    if name == "Hardtanh":
        return graph.clip(value, np.array(np.float32(layer.min_val)), np.array(np.float32(layer.max_val)))
    if name == "BatchRenorm1d":  # as in evaluation
        deviation = np.sqrt(_numbers(layer.ra_var) + np.float32(layer.eps))
        scaled = graph.add("Div", graph.add("Sub", value, _numbers(layer.ra_mean)), deviation)
        return graph.add("Add", graph.add("Mul", scaled, _numbers(layer.scale)), _numbers(layer.bias))
    if name not in ACTIVATIONS:
        raise ValueError(f"a layer {name} cannot be exported: valid are Linear, {', '.join(ACTIVATIONS)}")
    slope = {"alpha": float(getattr(layer, SLOPES[name]))} if name in SLOPES else {}
    return graph.add(ACTIVATIONS[name], value, **slope)


def _numbers(tensor: Any) -> NDArray[np.float32]:
    return np.asarray(tensor.detach().cpu().numpy(), dtype=np.float32)
