"""From commands to tensions, see effects.Transmission: elastic tendons, and friction along them.

An elastic tendon pulls with k (u - shortening), between nothing and the strength of its actuator; see motion.implicit_tendons for how it
enters a step.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms.tendons import actuation_column, tendon_lengths


@kernel(refcount=True)
def actuator_tensions(arm, u, work):
    """Tensions (n_a) at the actuators under u, where it is a command, in the strain of work.xi; u itself where nothing is between."""
    path = arm.effects.transmission
    if work.u_is_command[0] == 0.0 or not (path.elastic or path.friction > 0.0):
        return u
    transmit(arm, u, work)
    return work.tension


@phase
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
def find_columns(arm, work):
    """Columns of the forces of elastic tendons and of those that rub, into work.columns, work.rubbed and work.rubbing."""
    path = arm.effects.transmission
    if work.u_is_command[0] == 0.0 or not (path.elastic or path.friction > 0.0):
        return
    for i in range(arm.tendons.size):
        actuation_column(arm, i, work.whole, work, work.columns[i])
        copy(work.columns[i], work.rubbed[i])
        if path.friction > 0.0:
            if path.elastic:
                actuation_column(arm, i, work.share, work, work.rubbed[i])
            actuation_column(arm, i, work.slip, work, work.rubbing[i])
            for a in range(work.rubbing.shape[1]):
                work.rubbing[i, a] *= work.tension[i]


@kernel
def add_tendon_matrices(arm, work, damping, stiffness):
    """Adds what elastic tendons and those that rub have of D and G, sum c B_i B_i^T and k B_i B_i^T; after find_columns()."""
    path = arm.effects.transmission
    for i in range(arm.tendons.size if path.elastic or path.friction > 0.0 else 0):
        slope, steepness = tension_slope(path, i, work) if path.elastic else 0.0, 0.0
        if path.friction > 0.0:
            speed = math.hypot(work.pull_rate[i], path.stiction_speed)
            steepness = work.grip[i] * (path.stiction_speed / speed) ** 2 / speed
        for a in range(stiffness.shape[0]):
            for b in range(stiffness.shape[0]):
                stiffness[a, b] += slope * work.rubbed[i, a] * work.columns[i, b]
                damping[a, b] += steepness * work.columns[i, a] * work.columns[i, b]


@kernel
def tension_slope(path, i, work):
    """Derivative of a tendon's tension by its command, where transmit() has just been."""
    if not path.elastic:
        return 1.0
    return path.stiffness[i] if 0.0 < work.tension[i] < path.strength[i] else 0.0
