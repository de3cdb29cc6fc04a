"""Path from commands to tendon tensions: what effects make of a command in the present configuration, and what is lost along the tendons.

Without such an effect a command is the tension of every tendon, the same along all of it.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread
from soft_tendon_env.mechanics.algebra.lie import twist_scaled, twist_sum
from soft_tendon_env.mechanics.algebra.linear import copy, product
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store6, zero6
from soft_tendon_env.mechanics.effects import Actuation, Delivery, call
from soft_tendon_env.mechanics.terms.tendons import actuation_column, wrench_column

SMOOTH = 0.05  # of the greatest tension, the change of any that extrapolation in time may make
SAME = 1e-12  # relative difference of tensions that is rounding
ON_PARTS = 2.0  # work.driven, where every tension stays on its part of the law: for derivatives beside a kink


@kernel(refcount=True)
def values_of(effects, i):
    """Parameters of the i-th effect, as numbers."""
    return effects.values[effects.first_value[i] : effects.first_value[i + 1]]


@kernel(refcount=True)
def state_of(effects, state, i):
    """Internal state of the i-th effect, in those of all."""
    return state[effects.first_state[i] : effects.first_state[i + 1]]


@kernel(refcount=True)
def actuation_of(arm, work, i):
    """View of the tendons that the i-th effect gets."""
    tendons = arm.tendons
    return Actuation(
        arm.rod.packs, work.clock[0], state_of(arm.effects, work.state, i), work.command, work.tension, work.tendon_stiffness,
        work.tendon_creep, work.bounded.least, work.bounded.greatest, work.share, work.xi, work.xi_dot, arm.rod.weight, tendons.geometry,
        work.tangent, tendons.first, tendons.last,
    )  # fmt: skip


@kernel(refcount=True)
def delivered(effects, u, begins, time, state, acting, until):
    """The command that acts at a time [s] where u (n_a) is commanded, from then on if it `begins`, `acting` or u itself, and up to
    when [s]; -infinity where none can."""
    until[0] = math.inf
    found = False
    for i in range(effects.count):
        if effects.deliver[i] != 0:
            if not found:
                copy(u, acting)
                found = True
            deliver(effects, i, begins, time, state, acting, until)
    return acting if found else u


@phase
def deliver(effects, i, begins, time, state, acting, until):
    """Applies the delay of the i-th effect: replaces `acting` by the command that acts at the time."""
    call(effects.deliver[i], (values_of(effects, i), Delivery(time, state_of(effects, state, i), acting, until, begins)))


@kernel
def makes_tensions(effects, work):
    """Whether effects are between the command and the tensions at the actuators."""
    between = False
    if work.driven[0] != 0.0:
        for i in range(effects.count):
            between = between or effects.tension[i] != 0 or effects.loss[i] != 0
    return between


@kernel(refcount=True)
def transmitted(arm, u, work):
    """Tensions (n_a) at the actuators under u, where it is a command, in the strain of work.xi; u itself where nothing is between."""
    if not makes_tensions(arm.effects, work):
        return u
    transmit(arm, u, work)
    return work.tension


@phase
def transmit(arm, u, work):
    """The tensions under the command u into work.tension, with their derivatives."""
    effects = arm.effects
    copy(u, work.command)
    copy(u, work.tension)
    work.tendon_stiffness[:] = 0.0
    work.tendon_creep[:] = 0.0
    work.bounded.least[:] = -math.inf
    work.bounded.greatest[:] = math.inf
    for i in range(effects.count):
        if effects.tension[i] != 0:
            call(effects.tension[i], (values_of(effects, i), actuation_of(arm, work, i)))
    bound_tensions(work.tension, work.tendon_stiffness, work.driven[0] == ON_PARTS, work.bounded)


@kernel
def bound_tensions(tension, stiffness, on_parts, bounded):
    """Bring the tensions (n_a) within their bounds, or with `on_parts` to the parts of their laws that were found last; keep in `bounded`
    what they would be without them."""
    bounded.any[0] = 0.0
    for i in range(tension.size):
        limited = bounded.least[i] > -math.inf or bounded.greatest[i] < math.inf
        bounded.free[i] = tension[i]
        bounded.stiffness[i] = stiffness[i] if limited else 0.0
        bounded.part[i] = bounded.part[i] if on_parts else part_of(bounded, i, tension[i])
        tension[i] = held_tension(bounded, i)
        if bounded.stiffness[i] != 0.0:
            bounded.any[0] = 1.0


@kernel
def part_of(bounded, i, free):
    """Part of its law on which a tension is, `free` [N] without its bounds: -1 at the least, 0 between, 1 at the greatest."""
    return -1.0 if free < bounded.least[i] else 1.0 if free > bounded.greatest[i] else 0.0


@kernel
def way_to_part(bounded, i):
    """How far [m] a tendon was from the part of its law on which it is held."""
    free, part, k = bounded.free[i], bounded.part[i], bounded.stiffness[i]
    low = bounded.greatest[i] if part > 0.0 else bounded.least[i] if part == 0.0 else -math.inf
    high = bounded.least[i] if part < 0.0 else bounded.greatest[i] if part == 0.0 else math.inf
    return max(low - free, free - high, 0.0) / k


@kernel
def held_tension(bounded, i):
    """The tension [N] of a tendon at the configuration that `bounded` belongs to, on the part of its law that is assumed."""
    return bounded.least[i] if bounded.part[i] < 0.0 else bounded.greatest[i] if bounded.part[i] > 0.0 else bounded.free[i]


@kernel
def put_on_part(bounded, i, part, column, stiffness, force):
    """Put a stiff tension on a part of its law, in the stiffness (n, n) and force (n) of a step; column (n) of the actuation matrix."""
    k, before = bounded.stiffness[i], held_tension(bounded, i)
    stiffer = (k if part == 0.0 else 0.0) - (k if bounded.part[i] == 0.0 else 0.0)
    bounded.part[i] = part
    more = held_tension(bounded, i) - before
    for a in range(column.size):
        force[a] += more * column[a]
        for b in range(column.size):
            stiffness[a, b] += stiffer * column[a] * column[b]


@kernel
def change_parts(bounded, columns, rates, h, one, stiffness, force):
    """Put the tensions that are on another part of their law after a motion at these rates (n) over a time h [s] on the next part on the
    way there, in the stiffness (n, n) and force (n) of the step; whether there was any. With `one` only the first of them."""
    changed = False
    for i in range(bounded.free.size):
        k, column = bounded.stiffness[i], columns[i]
        if k == 0.0:
            continue
        relaxed = k * h * product(column, rates)
        free = bounded.free[i] - relaxed
        part, slack = part_of(bounded, i, free), SAME * (abs(bounded.free[i]) + abs(relaxed))
        if part == bounded.part[i] or (part_of(bounded, i, free - slack) != part_of(bounded, i, free + slack)):
            continue
        if part * bounded.part[i] < 0.0:
            part = 0.0
        put_on_part(bounded, i, part, column, stiffness, force)
        changed = True
        if one:
            return True
    return changed


@kernel
def find_losses(arm, work):
    """Shares of the tensions that are left along the tendons, in work.share; True if anything was lost."""
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
    """Adds to work.stress the wrench that losses take from the tendons, - sum tau (1 - share) s."""
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
            if work.bounded.part[i] != 0.0:
                k -= work.bounded.stiffness[i]
            for a in range(column.size):
                work.drift[a] += work.tendon_creep[i] * column[a]
                for b in range(column.size):
                    work.G[a, b] += k * column[a] * column[b]


@kernel
def jolts(work, q_from, q_to):
    """Whether the way between coordinates changes a stiff tension without bounds by more than is smooth, see SMOOTH."""
    greatest = 0.0
    for tension in work.tension:
        greatest = max(greatest, abs(tension))
    for i in range(work.tension.size):
        stiffness = work.tendon_stiffness[i] - work.bounded.stiffness[i]
        if stiffness != 0.0:
            change = 0.0
            for j in range(q_from.size):
                change += work.tendon_columns[i, j] * (q_to[j] - q_from[j])
            if abs(stiffness * change) > SMOOTH * greatest:
                return True
    return False
