"""Static balance of forces and measurements together, at many coordinates and tensions: what sensitivities of equilibria are made from."""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.motion.batch import read
from soft_tendon_env.mechanics.motion.equilibrium import ROUND_OFF
from soft_tendon_env.mechanics.terms.evaluate import balance_at_rest


@kernel(counted=True)
def read_balances(arm, places, tension, q, guess, work, force, reading):
    """Unbalanced forces f = B u - K + F into force (samples, n), and what is read there, at q (samples, n) under tensions (samples, n_a).

    guess (holds, points x 6): strains near those of the samples, of which neighbours share one. Returns the first sample without a strain,
    or -1.
    """
    still, each = np.zeros(q.shape[1]), q.shape[0] // guess.shape[0]
    for i in range(q.shape[0]):
        copy(guess[i // each], work.xi)
        if balance_at_rest(arm, tension[i], q[i], ROUND_OFF, work) >= 0:
            return i
        for j in range(still.size):
            force[i, j] = work.drive[j] + work.load[j]
        read(arm, places, still, work, i, reading)
    return -1
