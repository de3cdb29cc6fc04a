"""Bank of hypotheses on the timing of actuators, by the likelihoods of what is measured.

A Kalman filter cannot begin with a latency that is uncertain by several periods: the motion that a
late command causes is then taken for loads. So the first second has many hypotheses of latency and
lag, each with a state of its own, and one covariance for all: they differ in the commands that they
believe to act, not in how these act (multiple-model adaptive estimation, Magill 1965, by the
deviations of the hypotheses from their common mean).
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.tools.types import Array

LATENCY_STEP = 4e-3
"""Distance of the hypotheses in latency [s]: a fifth of a usual period."""
LAGS = (0.0, 6e-3, 12e-3, 20e-3, 30e-3, 42e-3, 56e-3)
"""Lags of the hypotheses [s], closer where a lag is small against a period."""
UNLIKELY = 1e-9
"""Share of the greatest likelihood, below which a hypothesis is given up."""


class Bank(NamedTuple):
    """Hypotheses on latency and lag, H in number."""

    timing: Timing  # latencies and lags (H,) [s]
    deviation: Array  # (m, H) of their states from the mean
    log_likelihood: Array  # (H,), the greatest 0
    # (H,) probabilities if the innovations were as small as their deviations say: about whose mean
    # to linearise
    sharp_weight: Array

    @property
    def weight(self) -> Array:
        """Probabilities (H,) of the hypotheses."""
        return _normalised(self.log_likelihood)

    @property
    def covariance(self) -> Array:
        """Covariance (m, m) of the states of the hypotheses about their mean."""
        weighted = self.deviation * self.weight
        return np.asarray(weighted @ self.deviation.T)

    def moments(self) -> tuple[Timing, Timing]:
        """Means and standard deviations [s] of latency and lag."""
        weight = self.weight
        means = [float(weight @ values) for values in self.timing]
        deviations = [
            float(np.sqrt(weight @ (values - mean) ** 2))
            for values, mean in zip(self.timing, means, strict=True)
        ]
        return Timing(*means), Timing(*deviations)


def first_bank(size: int, known: Timing, greatest: Timing, lag_probability: float) -> Bank:
    """Bank when an episode begins: a grid, equally likely but that no lag is the most usual.

    Args:
        size: m, of the state.
        known: latency and lag [s], None where the grid is to find it.
        greatest: latency and lag [s] of the grid.
        lag_probability: probability that there is a lag at all.

    Returns:
        The bank, with states that are all the same.
    """
    latencies = np.array([known.latency])
    if known.latency is None:
        count = round(greatest.latency / LATENCY_STEP) + 1
        latencies = np.linspace(0.0, greatest.latency, count)
    lags = np.array([known.lag])
    if known.lag is None:
        possible = [lag for lag in LAGS if lag <= greatest.lag]
        lags = np.array(possible)
    latency_grid, lag_grid = np.meshgrid(latencies, lags)
    latency = latency_grid.ravel()
    lag = lag_grid.ravel()
    prior = np.ones(latency.size)
    if known.lag is None:
        lagging = lag > 0.0
        prior[lagging] = lag_probability / (lags.size - 1)
        prior[~lagging] = 1.0 - lag_probability
    log_likelihood = np.log(prior / prior.max())
    return Bank(
        timing=Timing(latency, lag),
        deviation=np.zeros((size, latency.size)),
        log_likelihood=log_likelihood,
        sharp_weight=_normalised(log_likelihood),
    )


def judged(bank: Bank, innovations: Array, inverse_root: Array, sharp_root: Array) -> Bank:
    """Bank after a measurement, by the likelihoods of its innovations.

    Innovations beyond their deviations in every hypothesis say nothing of the timing: their
    covariance is taken for as many times greater.

    Args:
        bank: before it.
        innovations: (k, H) of the hypotheses.
        inverse_root: (k, k) L^-1, of the innovations' covariance L L^T.
        sharp_root: (k, k) likewise, if the linearisation about the mean left nothing out.
    """
    sharp = sharp_root @ innovations
    sharp_squares = (sharp**2).sum(axis=0)
    sharp_weight = _normalised(bank.log_likelihood - 0.5 * sharp_squares)
    whitened = inverse_root @ innovations
    squares = (whitened**2).sum(axis=0)
    surprise = float(squares.min()) / len(innovations)
    log_likelihood = bank.log_likelihood - 0.5 * squares / max(surprise, 1.0)
    log_likelihood -= log_likelihood.max()
    return bank._replace(log_likelihood=log_likelihood, sharp_weight=sharp_weight)


def pruned(bank: Bank) -> Bank:
    """Bank without the hypotheses that are given up."""
    likely = bank.log_likelihood > np.log(UNLIKELY)
    timing = Timing(*(values[likely] for values in bank.timing))
    return Bank(
        timing=timing,
        deviation=bank.deviation[:, likely],
        log_likelihood=bank.log_likelihood[likely],
        sharp_weight=bank.sharp_weight[likely],
    )


def _normalised(log_likelihood: Array) -> Array:
    """Probabilities (H,) of log likelihoods."""
    likelihood = np.exp(log_likelihood - log_likelihood.max())
    return np.asarray(likelihood / likelihood.sum())
