"""From commands to tensions at the actuators, see effects.Transmission.

Elastic tendons pull with k (u - shortening), between nothing and the strength of their actuators.

See tendon_friction for what is left of a tension along its way, and motion.implicit_euler for how
both enter a step. Who gives tensions instead of commands calls none of this.
"""

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms.tendon_friction import add_friction_damping, tendons_rub
from soft_tendon_env.mechanics.terms.tendons import actuation_column, tendon_lengths


@kernel(inline=True)
def tendons_transmit(arm):
    """Whether tensions are other than commands: tendons are elastic, or rub."""
    path = arm.effects.transmission
    return path.elastic or path.friction > 0.0


@kernel(refcount=True)
def actuator_tensions(arm, command, xi, tendons):
    """Tensions (n_a) at the actuators under a command (n_a) at strains xi (points x 6): the command
    itself where nothing is between."""
    if not tendons_transmit(arm):
        return command
    transmit(arm, command, xi, tendons)
    return tendons.tension


@phase
def transmit(arm, command, xi, tendons):
    """Tensions under a command into tendons.tension, and of elastic tendons the shortening into
    tendons.shortening."""
    path = arm.effects.transmission
    copy(command, tendons.tension)
    if path.elastic:
        shortening = tendons.shortening
        tendon_lengths(arm.rod, arm.tendons, xi, shortening)
        for i in range(command.size):
            shortening[i] = path.length[i] - shortening[i]
            stretch = command[i] - shortening[i]
            taut = path.stiffness[i] * stretch
            # not slack, and within the drive's strength
            pulling = max(taut, 0.0)
            tendons.tension[i] = min(pulling, path.strength[i])


@phase
def find_columns(arm, strain, share, stress, columns):
    """Finds columns (n_a, n) of the forces of tendons with a share (n_a x points) of the tension.

    Overwrites `stress` (points x 6).
    """
    for i in range(arm.tendons.size):
        actuation_column(arm, i, share, strain, stress, columns[i])


@phase
def add_tendon_matrices(arm, work, borders, damping, stiffness):
    """Adds what elastic tendons and those that rub have of D and G.

    find_shares(), find_borders() and find_columns() have been called before.
    """
    path = arm.effects.transmission
    tendons = work.tendons
    rubs = tendons_rub(arm)
    if rubs:
        add_friction_damping(arm, tendons, work.friction, borders, damping)
    if not path.elastic:
        return
    # the symmetric part of k C B^T, C the columns with what friction leaves
    share = work.friction.share if rubs else work.ones.tendon
    find_columns(arm, work.strain, share, work.spare.stress, tendons.rubbed)
    n = stiffness.shape[0]
    for i in range(arm.tendons.size):
        slope = 0.5 * tension_slope(path, i, tendons)
        column = tendons.columns[i]
        rubbed = tendons.rubbed[i]
        for a in range(n):
            for b in range(n):
                both = rubbed[a] * column[b] + column[a] * rubbed[b]
                stiffness[a, b] += slope * both


@kernel
def tension_slope(path, i, tendons):
    """Derivative of a tendon's tension by its command, where transmit() has just been."""
    if not path.elastic:
        return 1.0
    if 0.0 < tendons.tension[i] < path.strength[i]:
        return path.stiffness[i]
    return 0.0
