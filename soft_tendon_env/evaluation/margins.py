"""Stability margins of the loop that a policy closes: delay margin and gain margin, from the linearised loop.

The loop is broken where commands leave for the actuators of all tendons. A pulse of one tendon's command, which the policy is not told of,
shows the input sensitivity S = (I + L)^-1 column by column: arms that differ in nothing but the pulse run side by side. Of L = S^-1 - I at
all frequencies the characteristic loci (eigenvalues) say, by the generalised Nyquist criterion, by how much all commands may be later or
larger before the loop becomes unstable (A. G. J. MacFarlane and I. Postlethwaite, The generalized Nyquist stability criterion and
multivariable root loci, International Journal of Control 25, 1977).

Tendons that rest at their least tension answer to one side only; the margins are those of small pulls beyond it.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.envs.vector import TendonRodVectorEnv
from soft_tendon_env.evaluation.play import play_steps
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.types import Array

SETTLING = 3.0
"""Time [s] in which the arm should come to rest at its pose."""
WATCHED = 2.0
"""Time [s] for which the answer to a pulse is watched."""
PULSE = 1e-2
"""Size of a pulse, of the range of commands."""
DYING = 0.1
"""Part of a pulse by which commands should change no more at the end, with and without it, or the loop does not come to rest."""
ROUND_OFF = 1e-6
"""Error of the phase of a locus [rad] that counts as none."""
FREQUENCIES = 2048
"""Number of frequencies of the transform, up to half the control rate."""


class Margins(NamedTuple):
    """delay [s] by which all commands can be later, gain by which they can be larger, where the linearised loop becomes unstable: infinite
    if it never does; zero and one where the arm does not come to rest with the policy as it is."""

    delay: float
    gain: float


def loop_margins(policy: Policy, envs: TendonRodVectorEnv, seed: int) -> Margins:
    """Margins about the pose that an episode with this seed holds.

    envs: with one more row than the arm has tendons, and episodes of at least SETTLING + WATCHED. Raises ValueError.
    """
    episodes = envs.episodes
    tendons, period = episodes.limits.shape[0], episodes.period
    if envs.num_envs != 1 + tendons:
        raise ValueError(f"envs should have {1 + tendons} rows, one more than tendons, not {envs.num_envs}")
    settling, watched = round(SETTLING / period), round(WATCHED / period)
    size = PULSE * (episodes.actions.greatest - episodes.actions.least)
    pulse = size * np.eye(1 + tendons, tendons, -1)  # none in the first row
    alone, answer = np.zeros((watched, tendons)), np.zeros((watched, tendons, tendons))
    try:
        for k, _ in enumerate(play_steps(policy, envs, [seed] * envs.num_envs), start=-settling):  # k = 0: at rest, before the pulse
            if episodes.diverged.any():
                return Margins(0.0, 1.0)
            if k > 0:
                alone[k - 1] = episodes.actuation.command[0]
                answer[k - 1] = (episodes.actuation.command[1:] - alone[k - 1]).T  # of all tendons to a pulse of each
            if k == watched:
                break
            episodes.actuation.disturbance = pulse if k == 0 else None
    finally:
        episodes.actuation.disturbance = None
    answer /= size
    end = -round(0.2 * watched)
    if np.abs(answer[end:]).max() > DYING or (np.ptp(alone[end:], axis=0) / size).max() > DYING:
        return Margins(0.0, 1.0)
    answer[0] += np.eye(tendons)  # what enters the arm is the command and the pulse
    return margins_of(answer, period)


def margins_of(response: Array, period: float) -> Margins:
    """Margins of a loop from its input sensitivity as impulse response (m, n, n), a sample per control period [s]."""
    count, size = len(response), response.shape[1]
    angle = np.linspace(0.0, math.pi, FREQUENCIES + 1)[1:]  # [rad] per period; integral action makes the loop infinite at zero
    waves = np.exp(-1j * np.outer(angle, np.arange(count)))
    sensitivity = np.tensordot(waves, response, axes=1)
    loop = np.linalg.inv(sensitivity) - np.eye(size)
    loci = _continued(np.linalg.eigvals(loop))
    delay, gain = math.inf, math.inf
    for locus in loci.T:
        size_of, phase = np.abs(locus), np.unwrap(np.angle(locus))
        for k in np.flatnonzero((size_of[:-1] - 1.0) * (size_of[1:] - 1.0) <= 0.0):
            share = _crossing(size_of[k] - 1.0, size_of[k + 1] - 1.0)
            at, omega = phase[k] + share * (phase[k + 1] - phase[k]), angle[k] + share * (angle[k + 1] - angle[k])
            delay = min(delay, ((at + math.pi) % (2.0 * math.pi)) / omega * period)
        turned = np.angle(-locus)  # zero where the locus is real and negative
        turned[-1] = 0.0 if abs(turned[-1]) < ROUND_OFF else turned[-1]  # at half the control rate loci are real, or pairs
        for k in np.flatnonzero((turned[:-1] * turned[1:] <= 0.0) & (np.abs(turned[:-1] - turned[1:]) < math.pi)):
            share = _crossing(turned[k], turned[k + 1])
            factor = 1.0 / (size_of[k] + share * (size_of[k + 1] - size_of[k]))
            gain = min(gain, factor) if factor > 1.0 else gain
    return Margins(float(delay), float(gain))


def _continued(values: Any) -> Any:
    """Eigenvalues (frequencies, n) in such an order that each column changes least from one frequency to the next."""
    from scipy.optimize import linear_sum_assignment  # here: it takes longer to import than all else that most commands need

    ordered = values.copy()
    for k in range(1, len(ordered)):
        _, order = linear_sum_assignment(np.abs(ordered[k - 1][:, None] - ordered[k][None, :]))
        ordered[k] = ordered[k][order]
    return ordered


def _crossing(before: float, after: float) -> float:
    """Zero of the line between two values, as a share of the way."""
    return 0.0 if before == after else before / (before - after)
