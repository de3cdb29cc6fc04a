"""Base of the package's own algorithms, with the interface of Stable-Baselines3.

They have PPO's policies, on vector environments of this package.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Self, cast

from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback
from stable_baselines3.common.utils import safe_mean

from soft_tendon_env.envs.environments import TendonRodVectorEnv
from soft_tendon_env.learning.vec_env import unwrapped


class ActorAlgorithm(BaseAlgorithm):
    """Algorithm that learns the mean action of a policy of PPO, whose value network learns nothing.

    Args:
        env: vector environment of this package, see `make_sb3_vec_env`. Raises TypeError for
            others.
        settings: of the algorithm's `settings_class`.
        others: see BaseAlgorithm; `device` is "cpu" by default.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = PPO.policy_aliases
    settings_class: ClassVar[type]
    policy: ActorCriticPolicy

    def __init__(
        self,
        policy: str | type[ActorCriticPolicy],
        env: GymEnv | str | None,
        learning_rate: float | Callable[[float], float] = 1e-3,
        settings: Any = None,
        policy_kwargs: dict[str, Any] | None = None,
        _init_setup_model: bool = True,
        **general: Any,
    ) -> None:
        if isinstance(env, TendonRodVectorEnv):
            raise TypeError(
                "env is of gym.make_vec, which Stable-Baselines3 does not take: write"
                ' make_sb3_vec_env("TendonRod-TipPose-v0", 64), of soft_tendon_env.learning.vec_env'
            )
        super().__init__(
            policy,
            env,
            learning_rate,
            policy_kwargs,
            support_multi_env=True,
            **{"device": "cpu", **general},
        )
        if settings is None:
            self.settings = self.settings_class()
        else:
            self.settings = settings
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        policy = self.policy_class(
            self.observation_space,
            self.action_space,
            self.lr_schedule,
            **self.policy_kwargs,
        )
        self.policy = cast(ActorCriticPolicy, policy).to(self.device)
        if self.env is not None:
            self._prepare()

    @property
    def acting_policy(self) -> ActorCriticPolicy:
        """The network that acts and is saved."""
        return self.policy

    @property
    def rows(self) -> TendonRodVectorEnv:
        """The environment within its wrappers."""
        assert self.env is not None, "learning needs an environment"
        return unwrapped(self.env).env

    @abstractmethod
    def _prepare(self) -> None:
        """Prepare to learn on the environment that is set.

        Raises TypeError, ValueError where the algorithm cannot.
        """

    @abstractmethod
    def _learn_part(self, callback: BaseCallback) -> bool:
        """Act for a while and learn from that; False where the callback ends the training."""

    def learn(  # type: ignore[override]
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 1,
        **others: Any,
    ) -> Self:
        """Learn for so many steps of all rows, see `BaseAlgorithm.learn`.

        Every `log_interval`-th part has a row of the log.
        """
        self._prepare()
        total, every_callback = self._setup_learn(
            total_timesteps,
            callback,
            others.get("reset_num_timesteps", True),
            others.get("tb_log_name", type(self).__name__),
            others.get("progress_bar", False),
        )
        every_callback.on_training_start(locals(), globals())
        parts = 0
        while self.num_timesteps < total and self._learn_part(every_callback):
            parts += 1
            if parts % log_interval == 0:
                self._record_episodes("rollout/ep_rew_mean", "r")
                self._record_episodes("rollout/ep_len_mean", "l")
                self.logger.dump(self.num_timesteps)
        every_callback.on_training_end()
        return self

    def _record_episodes(self, name: str, key: str) -> None:
        """Log the mean of a number of the last episodes, NaN without any."""
        values = [episode[key] for episode in self.ep_info_buffer or ()]
        if values:
            mean = safe_mean(values)
        else:
            mean = math.nan
        self.logger.record(name, mean)
