"""RLlib's module and learner around the actor-critic network of Stable-Baselines3.

The network that RLlib trains is the very one that Stable-Baselines3 would train, initialised alike, so that the agent is saved as any other
and acts alike without Ray.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.connectors.connector_v2 import ConnectorV2
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule

from soft_tendon_env.learning.rllib.returns import Chunk, ReturnScale
from soft_tendon_env.policies.network import Architecture, new_network

NETWORK = "network"
"""Key of the model configuration: policy_kwargs of the training."""
REWARDS = "rewards"
"""Key of the learner's configuration: discount and clip of the normalisation of rewards, None without."""
RETURNS = "returns"  # key of the learner's state


class ActorCriticModule(TorchRLModule, ValueFunctionAPI):  # type: ignore[misc]
    """The network, as `policy`: mean and logarithm of the standard deviation of actions, and values."""

    def setup(self) -> None:
        """Make it."""
        self.policy = new_network(Architecture("PPO", self.model_config[NETWORK]), self.observation_space, self.action_space)

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        policy = self.policy
        features = policy.extract_features(batch[Columns.OBS], policy.pi_features_extractor)
        mean = policy.action_net(policy.mlp_extractor.forward_actor(features))
        return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, policy.log_std.expand_as(mean)], dim=-1)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        """Of states (n,)."""
        return self.policy.predict_values(batch[Columns.OBS]).squeeze(-1)


class NormaliseRewards(ConnectorV2):  # type: ignore[misc]
    """Rewards of episodes in terms of the deviation of returns."""

    def __init__(self, scale: ReturnScale) -> None:
        super().__init__()
        self._scale = scale

    def __call__(self, *, batch: Any, episodes: Sequence[Any], **kwargs: Any) -> Any:
        normalised = self._scale(Chunk(part.id_, part.get_rewards(), part.is_done) for part in episodes)
        for part, rewards in zip(episodes, normalised, strict=True):
            kept = part.rewards  # a buffer, whose array may lie in the memory of Ray, where it cannot be written
            kept.data = np.concatenate([kept.data[: kept.lookback], rewards])
        return batch


class ActorCriticLearner(PPOTorchLearner):  # type: ignore[misc]
    """PPO with the optimiser of the network, and rewards that are normalised before all else."""

    _scale: ReturnScale | None = None

    def build(self) -> None:
        super().build()
        if (given := self.config.learner_config_dict[REWARDS]) is not None:
            self._scale = ReturnScale(**given)
            self._learner_connector.prepend(NormaliseRewards(self._scale))

    def configure_optimizers_for_module(self, module_id: str, config: Any = None) -> None:
        """Adam, as Stable-Baselines3 sets it up."""
        module = self.module[module_id].unwrapped()
        parameters = self.get_parameters(module)
        optimizer = module.policy.optimizer_class(parameters, **module.policy.optimizer_kwargs)
        self.register_optimizer(module_id=module_id, optimizer=optimizer, params=parameters, lr_or_lr_schedule=config.lr)

    def get_state(self, components: Any = None, *, not_components: Any = None, **kwargs: Any) -> dict[str, Any]:
        state: dict[str, Any] = super().get_state(components, not_components=not_components, **kwargs)
        return state if self._scale is None else {**state, RETURNS: self._scale.get_state()}

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        if self._scale is not None and RETURNS in state:
            self._scale.set_state(state[RETURNS])
