"""Normalisation of rewards by the running standard deviation of the discounted return, as VecNormalize of Stable-Baselines3 does it.

It is done where the agent learns, over the episodes of all runners, so that there is one scale, however many runners there are.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter
from stable_baselines3.common.running_mean_std import RunningMeanStd

from soft_tendon_env.scene.scene import Array

EPSILON = 1e-8  # of VecNormalize


class Chunk(NamedTuple):
    """Rewards (n,) of a part of an episode, in the order of time; whether the episode ends with it."""

    episode: str
    rewards: Array
    ends: bool


class ReturnScale:
    """Divides rewards by the standard deviation of discounted returns so far.

    Args:
        gamma: by which returns are discounted.
        clip: greatest magnitude of what comes out.
    """

    def __init__(self, gamma: float, clip: float) -> None:
        self._gamma, self._clip = gamma, clip
        self._moments = RunningMeanStd(shape=())
        self._returns: dict[str, float] = {}

    def __call__(self, chunks: Iterable[Chunk]) -> list[Array]:
        """The normalised rewards of each; first all returns are counted."""
        given = list(chunks)
        returns = [self._discounted(chunk) for chunk in given]
        if values := [part for part in returns if part.size]:
            self._moments.update(np.concatenate(values))
        deviation = np.sqrt(self._moments.var + EPSILON)
        return [np.clip(chunk.rewards / deviation, -self._clip, self._clip) for chunk in given]

    def _discounted(self, chunk: Chunk) -> Array:
        """The return that has come together up to each step: R_t = gamma R_{t-1} + r_t."""
        before = self._returns.pop(chunk.episode, 0.0)
        returns = np.asarray(lfilter([1.0], [1.0, -self._gamma], chunk.rewards, zi=[self._gamma * before])[0])
        if not chunk.ends:
            self._returns[chunk.episode] = float(returns[-1]) if returns.size else before
        return returns

    def get_state(self) -> dict[str, Any]:
        """The moments; episodes that have begun do not go on in another process."""
        return {"mean": self._moments.mean, "var": self._moments.var, "count": self._moments.count}

    def set_state(self, state: dict[str, Any]) -> None:
        self._moments.mean, self._moments.var, self._moments.count = state["mean"], state["var"], state["count"]
