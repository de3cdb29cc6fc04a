"""Periods of a motion repeated with their steps held, and what is measured at their ends: what sensitivities of motions are made from."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.motion.batch import read
from soft_tendon_env.mechanics.motion.equilibrium import ROUND_OFF
from soft_tendon_env.mechanics.motion.replay import replay
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess


@kernel
def replay_periods(arm, method, log, commands, motion, places, scratch, state, reading):
    """Repeat a motion in place, and note states (periods, s) and measurements at the ends of its periods; a status.

    log: its steps (steps, 4), see Scratch.taken, and the first of each period and one past the last (periods + 1).
    """
    taken, first = log
    n = motion.q.size
    for k in range(first.size - 1):
        status = replay(arm, method, taken[first[k] : first[k + 1]], commands, motion, scratch)
        if status != OK:
            return status
        copy(motion.xi, scratch.work.xi)
        if strain_from_guess(arm, motion.q, ROUND_OFF, scratch.work) >= 0:
            return NO_STRAIN
        scratch.work.clock[0] = motion.clock[0]
        read(arm, places, motion.q_dot, scratch.work, k, reading)
        copy(motion.q, state[k, :n])
        copy(motion.q_dot, state[k, n : 2 * n])
        copy(motion.state, state[k, 2 * n :])
    return OK
