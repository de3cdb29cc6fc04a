"""Derivatives of what is measured of an arm by its coordinates and rates, by central differences of the reading."""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.batch import read
from soft_tendon_env.mechanics.motion.differentiation import HERE
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess


class ReadingSlopes(Struct):
    """Derivatives of readings by n coordinates and their rates, side by side."""

    tip_twist: np.ndarray  # (6, 2 n)
    tendon_length: np.ndarray  # (n_a, 2 n)
    strain: np.ndarray  # (sensors, 6, 2 n)


@kernel
def differentiate_reading(arm, places, motion, unit, scratch, reading, slopes):
    """Derivatives of the reading at a motion, into slopes; reading has two rows, for both sides; unit (2 n): how far each input is moved.
    A status."""
    work, q, v = scratch.work, scratch.q, scratch.v
    work.clock[0] = motion.clock[0]
    for i in range(2 * q.size):
        for side in range(2):
            copy(motion.q, q)
            copy(motion.q_dot, v)
            way = (2 * side - 1) * unit[i]
            if i < q.size:
                q[i] += way
            else:
                v[i - q.size] += way
            copy(motion.xi, work.xi)
            if strain_from_guess(arm, q, HERE, work) >= 0:
                return NO_STRAIN
            read(arm, places, v, work, side, reading)
        width = 2.0 * unit[i]
        for j in range(6):
            slopes.tip_twist[j, i] = (reading.tip_twist[1, j] - reading.tip_twist[0, j]) / width
        for j in range(slopes.tendon_length.shape[0]):
            slopes.tendon_length[j, i] = (reading.tendon_length[1, j] - reading.tendon_length[0, j]) / width
        for sensor in range(slopes.strain.shape[0]):
            for j in range(6):
                slopes.strain[sensor, j, i] = (reading.strain[1, sensor, j] - reading.strain[0, sensor, j]) / width
    return OK
