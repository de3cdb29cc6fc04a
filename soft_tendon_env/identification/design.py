"""Experiment design: the feasible holds that would narrow the intervals of an estimate most.

Greedy D-optimal choice by the linearised readings: each hold raises log det of the information most (V. V. Fedorov, Theory of Optimal
Experiments, 1972).
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.identification.identify import Estimate
from soft_tendon_env.identification.parameters import command_limits
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.identification.simulated import NoHoldError
from soft_tendon_env.tools.types import Array

CANDIDATES = 128
"""Candidate holds, evenly in the commands' limits (Sobol)."""
LEAST = 1e-6
"""Information that every coordinate has at least, so that directions which no data contain are told from those that some would."""


class Design(NamedTuple):
    """Holds in the order in which they help. shrinks: the largest interval's width after each of them, in parts of what it is now."""

    command: Array  # (count, n_a)
    shrinks: Array  # (count,)


def next_holds(found: Estimate, count: int) -> Design:
    """The `count` holds within the commands' limits that would add most to what is known. Raises NoHoldError where none has an
    equilibrium."""
    commands, information = _candidates(found)
    known = found.fit.information + np.diag(found.fit.prior + LEAST)
    before, chosen, shrinks = _widest(known), list[int](), list[float]()
    for _ in range(count):
        gain = np.linalg.slogdet(known + information)[1]
        gain[chosen] = -np.inf  # the same hold again would average noise, but shows no other error of the model
        best = int(np.argmax(gain))
        known = known + information[best]
        chosen.append(best)
        shrinks.append(_widest(known) / before)
    return Design(commands[chosen], np.array(shrinks))


def _widest(information: Array) -> float:
    """Largest standard deviation of a coordinate."""
    return float(np.sqrt(np.diag(np.linalg.inv(information)).max()))


def _candidates(found: Estimate) -> tuple[Array, Array]:
    """Commands (c, n_a) that have an equilibrium, and the information (c, k, k) of each."""
    from scipy.stats.qmc import Sobol  # here: it takes longer to import than all else that most scenes need

    limits = command_limits(found.scene)
    commands = limits[:, 0] + np.ptp(limits, axis=1) * Sobol(len(limits), rng=0).random(CANDIDATES)
    kept, information = [], []
    for command in commands:
        hold = Recording("candidate", "candidate", command[None], np.zeros((1, len(found.markers.markers), 3)), 0.0, {})
        try:
            J = Readings(found.fitted.plants, [hold]).jacobian(found.fit.x) / found.fit.sigma
        except NoHoldError:
            continue
        kept.append(command)
        information.append(J.T @ J)
    if not kept:
        raise NoHoldError("no hold within the commands' limits has an equilibrium at the estimate")
    return np.array(kept), np.array(information)
