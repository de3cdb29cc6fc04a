"""Path from commands to tendon tensions: what effects make of a command in the present configuration, and what is lost along the tendons.

Without such an effect a command is the tension of every tendon, the same along all of it.
"""

import math

from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread
from soft_tendon_env.mechanics.algebra.lie import twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store6, zero6
from soft_tendon_env.mechanics.effects import Actuation, Delivery, call
from soft_tendon_env.mechanics.late_binding import call_late
from soft_tendon_env.mechanics.terms.tendons import actuation_column, wrench_column
from soft_tendon_env.tools.compilation import kernel

SMOOTH = 0.05  # of the greatest tension, the change of any that extrapolation in time may make

@kernel(counted=True)
def values_of(effects, i):
    """The numbers of the i-th effect."""
    return effects.values[effects.first_value[i] : effects.first_value[i + 1]]


@kernel(counted=True)
def state_of(effects, state, i):
    """The internal state of the i-th effect, in those of all."""
    return state[effects.first_state[i] : effects.first_state[i + 1]]


@kernel(counted=True)
def actuation_of(arm, work, i):
    """What the i-th effect sees of the tendons."""
    tendons = arm.tendons
    return Actuation(
        arm.rod.packs, work.clock[0], state_of(arm.effects, work.state, i), work.command, work.tension, work.tendon_stiffness,
        work.tendon_creep, work.share, work.xi, work.xi_dot, arm.rod.weight, tendons.geometry, work.tangent, tendons.first, tendons.last,
    )  # fmt: skip


@kernel(counted=True)
def delivered(effects, u, time, state, acting, until):
    """The command that acts at a time [s] where u (n_a) is commanded, `acting` or u itself, and up to when [s]; -1 where none can."""
    until[0] = math.inf
    found = False
    for i in range(effects.count):
        if effects.deliver[i] != 0:
            if not found:
                copy(u, acting)
                found = True
            call_late(deliver, (effects, i, time, state, acting, until))
    return acting if found else u


@kernel
def deliver(effects, i, time, state, acting, until):
    """The same by the i-th effect: `acting` is what was commanded of it, and becomes what acts."""
    call(effects.deliver[i], (values_of(effects, i), Delivery(time, state_of(effects, state, i), acting, until)))


@kernel(counted=True)
def transmitted(arm, u, work):
    """Tensions (n_a) at the actuators under u, where it is a command, in the strain of work.xi; u itself where nothing is between."""
    effects, between = arm.effects, False
    if work.driven[0] != 0.0:
        for i in range(effects.count):
            between = between or effects.tension[i] != 0 or effects.loss[i] != 0
    if not between:
        return u
    call_late(transmit, (arm, u, work))
    return work.tension


@kernel
def transmit(arm, u, work):
    """The tensions under the command u into work.tension, with their derivatives."""
    effects = arm.effects
    copy(u, work.command)
    copy(u, work.tension)
    work.tendon_stiffness[:] = 0.0
    work.tendon_creep[:] = 0.0
    for i in range(effects.count):
        if effects.tension[i] != 0:
            call(effects.tension[i], (values_of(effects, i), actuation_of(arm, work, i)))


@kernel
def find_losses(arm, work):
    """What is left of the tensions along the tendons, in work.share; whether anything was lost."""
    effects, lossy = arm.effects, False
    if work.driven[0] != 0.0:
        for i in range(effects.count):
            if effects.loss[i] != 0:
                if not lossy:
                    work.share[:] = 1.0
                    lossy = True
                call(effects.loss[i], (values_of(effects, i), actuation_of(arm, work, i)))
    return lossy


@kernel
def add_lost_stress(arm, work):
    """Add to work.stress what losses make of the tendons' wrench: - sum tau (1 - share) s."""
    rod, tendons = arm.rod, arm.tendons
    blocks = 2 * rod.packs
    for block in range(blocks):
        at, total = block * 6 * LANES, zero6()
        for i in range(tendons.size):
            if tendons.first[i] <= block // 2 < tendons.last[i]:
                geometry_at = (i * blocks + block) * 5 * LANES
                t = load3(work.tangent, (i * blocks + block) * 4 * LANES)
                left = load(work.share, (i * blocks + block) * LANES)
                lost = work.tension[i] * load(tendons.geometry, geometry_at + 4 * LANES) * (left - spread(1.0))
                total = twist_sum(total, twist_scaled(lost, wrench_column(tendons.geometry, geometry_at, t)))
        store6(work.stress, at, twist_sum(load6(work.stress, at), total))


@kernel
def add_tendon_stiffness(arm, work):
    """Add the share of stiff tendons, sum k B_i B_i^T with the tensions' derivatives k by length, to work.G; their creep to work.drift."""
    work.drift[:] = 0.0
    if work.driven[0] == 0.0:
        return
    for i in range(arm.tendons.size):
        k, column = work.tendon_stiffness[i], work.tendon_columns[i]
        if k != 0.0:
            actuation_column(arm.rod, arm.tendons, arm.strain, i, work, column)
            for a in range(column.size):
                work.drift[a] += work.tendon_creep[i] * column[a]
                for b in range(column.size):
                    work.G[a, b] += k * column[a] * column[b]


@kernel
def jolts(work, q_from, q_to):
    """Whether the way between coordinates changes the tension of a stiff tendon by more than is smooth, see SMOOTH."""
    greatest = 0.0
    for tension in work.tension:
        greatest = max(greatest, abs(tension))
    for i in range(work.tension.size):
        if work.tendon_stiffness[i] != 0.0:
            change = 0.0
            for j in range(q_from.size):
                change += work.tendon_columns[i, j] * (q_to[j] - q_from[j])
            if abs(work.tendon_stiffness[i] * change) > SMOOTH * greatest:
                return True
    return False
