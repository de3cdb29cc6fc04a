"""Agents that have learned nothing, as exported files."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


@pytest.fixture
def exported(tmp_path):
    """exported(algorithm=..., task=..., ...): an environment, an agent of random weights for it, and the path of its file."""
    torch, export = pytest.importorskip("torch"), pytest.importorskip("soft_tendon_env.export")
    from soft_tendon_env.policies.agent import NetworkPolicy
    from soft_tendon_env.policies.integral import IntegralPolicy
    from soft_tendon_env.policies.network import Architecture, new_network
    from soft_tendon_env.policies.normalization import Moments, Normalization

    def make(algorithm="PPO", task="TipPose", policy=None, normalised=False, integral_time=None, **options):
        env = gym.make(IDS[task], **{**SMALL, **options})
        torch.manual_seed(0)
        network = new_network(Architecture(algorithm, {"net_arch": [16, 16], **(policy or {})}), env.observation_space, env.action_space)
        with torch.no_grad():
            for parameter in network.parameters():
                parameter += 0.1 * torch.randn_like(parameter)
        spaces = env.observation_space.spaces if task == "Reach" else {"": env.observation_space}
        draw = np.random.default_rng(0)
        moments = {key: Moments(draw.normal(size=of.shape), draw.uniform(0.1, 1.0, of.shape)) for key, of in spaces.items()}
        agent = NetworkPolicy(network, Normalization(moments, 3.0, 1e-8) if normalised else None)
        agent = agent if integral_time is None else IntegralPolicy(agent, env, integral_time)
        path = tmp_path / "agent.onnx"
        path.write_bytes(export.export_agent(agent, env, {"of": "nobody"}).SerializeToString())
        return env, agent, path

    return make
