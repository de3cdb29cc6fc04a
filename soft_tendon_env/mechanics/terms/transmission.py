"""From commands to tensions, see effects.Transmission: elastic tendons, and friction along them.

An elastic tendon pulls with k (u - shortening), between nothing and the strength of its actuator; see motion.elastic_tendons for how it
enters a step.
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.late_kernels import call_late, late
from soft_tendon_env.mechanics.terms.tendon_friction import rubbed_column
from soft_tendon_env.mechanics.terms.tendons import actuation_column, tendon_lengths
from soft_tendon_env.mechanics.workspace import make_workspace


@kernel(counted=True)
def transmitted(arm, u, work):
    """Tensions (n_a) at the actuators under u, where it is a command, in the strain of work.xi; u itself where nothing is between."""
    path = arm.effects.transmission
    if work.u_is_command[0] == 0.0 or not (path.elastic or path.friction > 0.0):
        return u
    call_late(transmit, arm.effects.late, (arm, u, work))
    return work.tension


@late(lambda effects: effects.transmission.makes_tensions, lambda arm: (arm, np.zeros(1), make_workspace(arm)))
@kernel
def transmit(arm, u, work):
    """Tensions under the command u into work.tension, and of elastic tendons the shortening into work.shortening."""
    path = arm.effects.transmission
    copy(u, work.tension)
    if path.elastic:
        tendon_lengths(arm.rod, arm.tendons, work, work.shortening)
        for i in range(u.size):
            work.shortening[i] = path.length[i] - work.shortening[i]
            work.tension[i] = min(max(path.stiffness[i] * (u[i] - work.shortening[i]), 0.0), path.strength[i])


@kernel
def add_grip(arm, work):
    """Add the damping of tendons that rub, sum c B_i B_i^T, to work.D; work.columns and work.rubbed of those and of elastic ones."""
    path = arm.effects.transmission
    rubs = path.friction > 0.0
    if work.u_is_command[0] == 0.0 or not (path.elastic or rubs):
        return
    for i in range(arm.tendons.size):
        column = work.columns[i]
        actuation_column(arm.rod, arm.tendons, arm.strain, i, work, column)
        copy(column, work.rubbed[i])
        if rubs:
            rubbed_column(arm, i, work, work.rubbed[i])
            for a in range(column.size):
                for b in range(column.size):
                    work.D[a, b] += work.grip[i] * column[a] * column[b]


@kernel
def add_tendon_stiffness(arm, work, stiffness):
    """Add that of elastic tendons between slack and their strength, sum k B_i B_i^T, to a matrix (n, n) of which add_grip() has made the
    columns: for what is linear in the motion."""
    path = arm.effects.transmission
    for i in range(arm.tendons.size if path.elastic else 0):
        for a in range(stiffness.shape[0]):
            for b in range(stiffness.shape[0]):
                stiffness[a, b] += tension_slope(path, i, work) * work.rubbed[i, a] * work.columns[i, b]


@kernel
def tension_slope(path, i, work):
    """Derivative of a tendon's tension by its command, where transmit() has just been."""
    if not path.elastic:
        return 1.0
    return path.stiffness[i] if 0.0 < work.tension[i] < path.strength[i] else 0.0
