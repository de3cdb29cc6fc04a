"""Rates at the end of a substep of tendons that rub: implicit Euler with the friction of how they
slide there.

With the rows w_k of the borders and the tensions T_k beyond them, see terms.tendon_friction, the
change dv of the rates solves

    A dv = h (f + sum_k (T_k - T_k-1) w_k),    T_k = T exp(-sum_j<=k mu dphi_j z_j),

z_j the direction of v_j = w_j (v + dv). Newton's method takes z_j as an unknown of its own, by the
derivative of z_j sqrt(v_j^2 + v_s^2) = v_j, and holds it within [-1, 1] (T. F. Chan, G. H. Golub
and P. Mulet, SIAM J. Sci. Comput. 20, 1999): it converges in a few steps however small v_s is,
where Newton's method for dv alone goes in circles. At its end the power of friction is negative at
every border.

The tensions of elastic tendons at the end of the substep solve a complementarity problem within
each step, see implicit_euler.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, spread, store
from soft_tendon_env.mechanics.algebra.linear import copy, product, row_stride, solve_columns
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK, UNSETTLED
from soft_tendon_env.mechanics.motion.tendon_ends import bound_tensions
from soft_tendon_env.mechanics.terms.tendon_friction import PER_PACK, smooth_speed

MOST = 100  # Newton steps
SAME = 1e-7  # of the logarithm of a tension, by which it may be off what slides: a step squares it


@phase
def slide_tendons(arm, command, balance, h, scratch):
    """Change scratch.delta of the rates scratch.v in a substep of length h with the friction at its
    end, from the system in scratch.system, with elastic tendons under a command (n_a) there; a
    status into scratch.sliding.status."""
    sliding = scratch.sliding
    path = arm.effects.transmission
    n = scratch.delta.size
    columns = 1
    if path.elastic:
        columns += arm.tendons.size
    begin_sliding(arm, balance, scratch.v, scratch.delta, sliding)
    sliding.status[0] = UNSETTLED
    for _ in range(MOST):
        fill_sliding(arm, balance, h, columns, scratch)
        if not solve_columns(sliding.system, n, columns):
            sliding.status[0] = NOT_POSITIVE
            return
        take_change(n, sliding)
        if path.elastic:
            stretch_sliding(path, command, balance, h, scratch)
        off = follow_change(arm, balance.borders, scratch.ends.change, sliding)
        for a in range(n):
            scratch.delta[a] += sliding.change[a]
        if off <= SAME:
            sliding.status[0] = OK
            return


@kernel
def begin_sliding(arm, balance, v, delta, sliding):
    """Begins with the rates v (n) and tensions of the substep's beginning."""
    copy(v, sliding.change)
    slide = sliding.rate
    slow = arm.effects.transmission.stiction_speed
    copy(balance.tendons.tension, sliding.tension)
    delta[:] = 0.0
    for i in range(arm.tendons.size):
        begin, end = places_of(arm, i)
        for k in range(begin, end):
            slide[k] = row_product(balance.borders.row, k, sliding.change)
            sliding.direction[k] = slide[k] / smooth_speed(slide[k], slow)


@kernel(inline=True)
def places_of(arm, i):
    """First place of a tendon's borders, and one past the last."""
    start = i * 2 * arm.rod.packs * LANES
    first = start + PER_PACK * arm.tendons.pack_begin[i]
    return first, start + PER_PACK * arm.tendons.pack_end[i]


@kernel(inline=True)
def row_product(rows, k, x):
    """Scalar product of a row with x, both filled up to whole packs with zeros."""
    total = spread(0.0)
    for m in range(0, x.size, LANES):
        total = total + load(rows, k * x.size + m) * load(x, m)
    return lane_sum(total)


@kernel
def fill_sliding(arm, balance, h, columns, scratch):
    """Linear problem of a Newton step, with the change of rates by a newton in each elastic tendon,
    into sliding.system."""
    sliding = scratch.sliding
    delta = scratch.delta
    n = delta.size
    stride = row_stride(n + 1)
    wide = sliding.system.size // n
    for a in range(n):
        row = scratch.system[a * stride : a * stride + n]
        out = sliding.system[a * wide : (a + 1) * wide]
        copy(row, out[:n])
        out[n] = scratch.system[a * stride + n] - product(row, delta)
        for j in range(1, columns):
            out[n + j] = 0.0
    for i in range(arm.tendons.size):
        add_tendon(arm, i, balance, h, columns, sliding)


@kernel
def add_tendon(arm, i, balance, h, columns, sliding):
    """Adds the friction of a tendon, and of an elastic one its tension, to the linear problem."""
    path = arm.effects.transmission
    borders = balance.borders
    stride = sliding.change.size
    n = sliding.system.size // sliding.wide_row.size
    used = row_stride(n + columns)
    tension = sliding.tension[i]
    begun = balance.tendons.tension[i]
    begin, end = places_of(arm, i)
    row = sliding.wide_row
    turning = sliding.turning
    pulling = sliding.pulling
    row[:] = 0.0
    if path.elastic:
        row[n] = tension - begun
        row[n + 1 + i] = 1.0
        add_outer(borders.row, begin, h, used, row, sliding.system)
    elif tension == 0.0:
        return
    turning[:] = 0.0
    pulling[:] = 0.0
    turned = 0.0  # mu z dphi up to the border, and by how much the rates' own z have more
    late = 0.0
    left_before = 1.0
    late_before = 0.0
    for k in range(begin, end):
        turn = math.copysign(borders.turn[k], begun)
        if turn == 0.0:
            continue
        z = sliding.direction[k]
        speed = smooth_speed(sliding.rate[k], path.stiction_speed)
        lead = sliding.rate[k] / speed
        slope = (1.0 - z * lead) / speed
        sliding.lead[k] = lead
        sliding.slope[k] = slope
        turned += turn * z
        late += turn * (lead - z)
        left = math.exp(-turned)
        # T_k - T_k-1 and its derivative
        for m in range(0, stride, LANES):
            turns = load(turning, m) + (turn * slope) * load(borders.row, k * stride + m)
            pulls = (tension * left) * turns
            store(turning, m, turns)
            store(row, m, pulls - load(pulling, m))
            store(pulling, m, pulls)
        row[n] = tension * ((left - left_before) - (left * late - left_before * late_before))
        if path.elastic:
            row[n + 1 + i] = left - left_before
        add_outer(borders.row, k, h, used, row, sliding.system)
        left_before = left
        late_before = late


@kernel(inline=True)
def add_outer(rows, k, h, used, row, system):
    """Adds h w_k row^T to a system, with `used` numbers of each row."""
    wide = row.size
    n = system.size // wide
    stride = row_stride(n + 1)
    for a in range(n):
        share = h * rows[k * stride + a]
        for m in range(0, used, LANES):
            at = a * wide + m
            store(system, at, load(system, at) + share * load(row, m))


@kernel
def take_change(n, sliding):
    """The solution of the linear problem, a change of the rates, into sliding.change."""
    wide = sliding.wide_row.size
    for a in range(n):
        sliding.change[a] = sliding.system[a * wide + n]


@kernel
def stretch_sliding(path, command, balance, h, scratch):
    """Tensions sliding.tension at the end of the substep of elastic tendons that rub, under a
    command (n_a), and sliding.change with what they change."""
    sliding = scratch.sliding
    ends = scratch.ends
    n = scratch.delta.size
    wide = sliding.wide_row.size
    for j in range(command.size):
        for a in range(n):
            ends.answer[j, a] = sliding.system[a * wide + n + 1 + j]
    for i in range(command.size):
        column = balance.tendons.columns[i]
        ends.rate[i] = product(column, scratch.v) + product(column, scratch.delta)
        ends.rate[i] += product(column, sliding.change[:n])
        for j in range(command.size):
            ends.give[i, j] = product(column, ends.answer[j])
    bound_tensions(path, command, balance.tendons.shortening, h, sliding.tension, ends)
    for j in range(command.size):
        ends.change[j] = ends.tension[j] - sliding.tension[j]
        for a in range(n):
            sliding.change[a] += ends.change[j] * ends.answer[j, a]
    copy(ends.tension, sliding.tension)


@kernel
def follow_change(arm, borders, stretched, sliding):
    """Directions and speeds after sliding.change; how far logarithms of tensions by the former are
    off those by the latter, or by products of changes: those of elastic tendons were `stretched`
    (n_a) [N]."""
    path = arm.effects.transmission
    slow = path.stiction_speed
    most = 0.0
    for i in range(arm.tendons.size):
        if sliding.tension[i] == 0.0 and not path.elastic:
            continue
        begin, end = places_of(arm, i)
        off = 0.0
        turned = 0.0
        share = 0.0
        if path.elastic:
            share = abs(stretched[i]) / path.strength[i]
        for k in range(begin, end):
            turn = borders.turn[k]
            if turn == 0.0:
                continue
            moved = row_product(borders.row, k, sliding.change)
            z = min(max(sliding.lead[k] + sliding.slope[k] * moved, -1.0), 1.0)
            rate = sliding.rate[k] + moved
            off += turn * (rate / smooth_speed(rate, slow) - z)
            turned += turn * (z - sliding.direction[k])
            most = max(most, abs(off), share * abs(turned))
            sliding.direction[k] = z
            sliding.rate[k] = rate
    return most
