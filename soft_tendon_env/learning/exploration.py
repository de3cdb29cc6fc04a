"""Exploration along the modes of the tip: Gaussian actions whose covariance follows the static Jacobian of the tip pose.

A tendon of the paper's arm moves the tip by 50 mm/N across and by a few tenths of a millimetre along the arm. Noise on single tendons
therefore is noise across, and what little pulling less all over would bring is lost in it. In the right singular vectors of the Jacobian
each way can have a noise of its own.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.distributions import DiagGaussianDistribution
from torch.distributions import Normal

from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.model.statics import static_equilibrium, static_tip_jacobian
from soft_tendon_env.tools.types import Array

PLACES, PART = 8, 1.0 / 3.0
"""Equilibria that the Jacobian is averaged over, under tensions drawn from that part of their range."""
RADIAN = 0.2
"""Distance that counts as much as a turn of the tip by a radian, as a share of the rod's length."""
LARGEST = 0.5
"""Largest standard deviation, of modes that hardly move the tip, as a share of the range of an action."""


class TipModes(NamedTuple):
    """Modes of the tip, the one that moves it most first."""

    direction: Array  # (n_a, n_a), orthonormal columns: actions
    response: Array  # (n_a,) [m] root mean square change of the tip pose for a unit of each


def tip_modes(episodes: Episodes) -> TipModes:
    """Right singular vectors of the static Jacobian of the tip pose by actions, over several equilibria of the scene's arm.

    Raises ValueError where commands are no tensions, or hold the arm at none of these.
    """
    model, limits = episodes.model, episodes.limits
    random, length = np.random.default_rng(0), np.repeat([RADIAN * model.length, 1.0], 3)
    if not model.scene.effects.command_tension:
        raise ValueError("exploration along the modes of the tip needs a scene whose commands are tensions, without tendon_elasticity")
    actions = episodes.actuation.actions
    unit = 0.5 * (limits[:, 1] - limits[:, 0]) if actions.increment is None else actions.increment
    rows = []
    for _ in range(PLACES):
        tension = limits[:, 0] + PART * random.uniform(size=len(limits)) * (limits[:, 1] - limits[:, 0])
        found = static_equilibrium(model, tension)
        if found.converged:
            rows.append(length[:, None] * static_tip_jacobian(model, found.q, tension) * unit)
    if not rows:
        raise ValueError(f"exploration along the modes of the tip: {found.reason}")
    _, values, transposed = np.linalg.svd(np.concatenate(rows) / math.sqrt(len(rows)))
    return TipModes(transposed.T, np.pad(values, (0, len(limits) - values.size)))


class ModalGaussian(DiagGaussianDistribution):
    """Gaussian with independent parts along orthonormal directions: the columns of `directions` (n_a, n_a), in place of the axes."""

    def __init__(self, directions: torch.Tensor) -> None:
        super().__init__(len(directions))
        self._directions = directions

    def proba_distribution(self, mean_actions: torch.Tensor, log_std: torch.Tensor) -> "ModalGaussian":
        """The distribution around `mean_actions` (.., n_a); log_std (n_a,): by direction."""
        self._mean = mean_actions
        self.distribution = Normal(torch.zeros_like(mean_actions), torch.ones_like(mean_actions) * log_std.exp())
        return self

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        """Log density (..) of actions (.., n_a). Directions are orthonormal, so that densities are the same in either coordinates."""
        return super().log_prob((actions - self._mean) @ self._directions)

    def sample(self) -> torch.Tensor:
        """Actions (.., n_a)."""
        return self._mean + super().sample() @ self._directions.T

    def mode(self) -> torch.Tensor:
        """The mean."""
        return self._mean


def explore_along_modes(model: BaseAlgorithm, begins: bool) -> None:
    """Let an agent of PPO explore along the modes of the tip, of the arm that it learns on.

    begins: it has explored in no way yet, and gets standard deviations: the policy's own (log_std_init) for the mode that moves the tip
    most, and so much more for others that half of what they move the tip less is made up for (the root of the ratio), up to LARGEST.
    """
    policy: Any = model.policy
    env = model.get_env()
    assert env is not None, "trainings have one"
    modes = tip_modes(unwrapped(env).env.episodes)
    policy.action_dist = ModalGaussian(torch.tensor(modes.direction, dtype=torch.float32))
    if begins:
        share = np.sqrt(modes.response[0] / np.maximum(modes.response, 1e-12 * modes.response[0]))
        deviation = np.minimum(np.exp(policy.log_std.detach().numpy()) * share, LARGEST)
        policy.log_std.data = torch.tensor(np.log(deviation), dtype=torch.float32)
