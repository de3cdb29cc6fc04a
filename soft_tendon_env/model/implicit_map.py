"""Cheap linear map of a held period, for controllers and filters that linearise at every period: see Simulation.implicit_map."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.motion import implicit_map as kernels
from soft_tendon_env.mechanics.motion import status
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.implicit_map import MapMemory
from soft_tendon_env.mechanics.motion.runge_kutta import RungeKutta
from soft_tendon_env.mechanics.motion.scratch import Motion, Scratch
from soft_tendon_env.mechanics.terms.transmission import delivered
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array


class ImplicitMap(NamedTuple):
    """Jacobians of the next coordinates and rates (q', q_dot') of a held period, of n coordinates and n_a tendons.

    They are those of a linearly implicit Euler step with the matrices at the start, extrapolated over two columns.
    """

    state: Array  # (2n, 2n) by (q, q_dot) at the start
    command: Array  # (2n, n_a) by the command, per unit of Model.command_unit


def implicit_map(
    model: Model, method: Extrapolated | RungeKutta, motion: Motion, command: Array, duration: float, scratch: Scratch, memory: MapMemory
) -> ImplicitMap:
    """Linear map of a period [s] under a command (n_a,) from a motion, which is left as it is. Raises LinAlgError."""
    arm, n = model.arm, model.coordinate_count
    found = np.empty((2 * n, 2 * n + command.size))
    motion = motion._replace(state=motion.state.copy())  # in which a delay queues the command
    acting = delivered(arm.effects, command, motion.clock[0], motion.state, scratch.acting, scratch.until)
    failed = kernels.implicit_map(arm, method, acting, motion, duration, scratch, memory, found)
    if failed != status.OK:
        raise np.linalg.LinAlgError(f"there is no linear map of this period: {status.MESSAGES[failed]}")
    return ImplicitMap(found[:, : 2 * n], found[:, 2 * n :])
