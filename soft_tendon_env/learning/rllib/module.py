"""RLlib's module and learner around the actor-critic network of Stable-Baselines3.

The network that RLlib trains is the very one that Stable-Baselines3 would train, initialised alike, so that the agent is saved as any other
and acts alike without Ray.
"""

from collections.abc import Iterable, Sequence
from itertools import takewhile
from typing import Any

import numpy as np
import torch
from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.connectors.connector_v2 import ConnectorV2
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.torch.torch_rl_module import TorchRLModule

from soft_tendon_env.learning.rllib.returns import Chunk, ReturnScale
from soft_tendon_env.learning.rllib.settings import NETWORK, REWARDS, TARGET_KL
from soft_tendon_env.policies.network import Architecture, new_network

FURTHEST = 1.5  # times target_kl, as in Stable-Baselines3
RETURNS = "returns"  # key of the learner's state


class ActorCriticModule(TorchRLModule, ValueFunctionAPI):
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


class NormaliseRewards(ConnectorV2):
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


class ActorCriticLearner(PPOTorchLearner):
    """PPO with what Stable-Baselines3 adds to it: its optimiser, normalised rewards, a limit to how far a policy goes with one rollout."""

    _scale: ReturnScale | None = None
    _too_far = False

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

    def _create_iterator_if_necessary(self, **kwargs: Any) -> Iterable[Any]:
        """Minibatches of all epochs, until one is too far from the policy that acted."""
        self._too_far = False
        return takewhile(lambda _: not self._too_far, super()._create_iterator_if_necessary(**kwargs))

    def compute_loss_for_module(self, *, module_id: str, config: Any, batch: dict[str, Any], fwd_out: dict[str, Any]) -> torch.Tensor:
        """That of RLlib, with a look at the divergence of the policies: the mean of r - 1 - log r over ratios r of likelihoods."""
        if (target := config.learner_config_dict[TARGET_KL]) is not None:
            with torch.no_grad():
                now = self.module[module_id].unwrapped().get_train_action_dist_cls().from_logits(fwd_out[Columns.ACTION_DIST_INPUTS])
                ratio = (now.logp(batch[Columns.ACTIONS]) - batch[Columns.ACTION_LOGP])[batch[Columns.LOSS_MASK]]
                self._too_far = bool((ratio.exp() - 1.0 - ratio).mean() > FURTHEST * target)
        loss: torch.Tensor = super().compute_loss_for_module(module_id=module_id, config=config, batch=batch, fwd_out=fwd_out)
        return loss

    def apply_gradients(self, gradients_dict: dict[Any, Any]) -> None:
        """Unless they are of a policy that has gone too far."""
        if not self._too_far:
            super().apply_gradients(gradients_dict)

    def get_state(self, components: Any = None, *, not_components: Any = None, **kwargs: Any) -> dict[str, Any]:
        state: dict[str, Any] = super().get_state(components, not_components=not_components, **kwargs)
        return state if self._scale is None else {**state, RETURNS: self._scale.get_state()}

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        if self._scale is not None and RETURNS in state:
            self._scale.set_state(state[RETURNS])
