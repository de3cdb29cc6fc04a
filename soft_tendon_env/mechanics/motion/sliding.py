"""Rates at the end of a substep of tendons that rub, by implicit Euler with their friction there.

With the rows w_k of the borders and the tensions T_k beyond them, see terms.tendon_friction, the
change dv of the rates solves

    A dv = h (f + sum_k (T_k - T_k-1) w_k),    T_k = T exp(-sum_j<=k mu dphi_j z_j),

z_j the direction of v_j = w_j (v + dv). Newton's method takes z_j as an unknown of its own, by the
derivative of z_j sqrt(v_j^2 + v_s^2) = v_j, and holds it within [-1, 1] (T. F. Chan, G. H. Golub
and P. Mulet, SIAM J. Sci. Comput. 20, 1999): it converges in a few steps however small v_s is,
where Newton's method for dv alone goes in circles. At its end the power of friction is negative at
every border.

The matrix of a step need not be positive definite: where a tendon sticks at one place and slides
behind it, what a direction changes behind outweighs what the place there resists. Its pivots may
be negative then; that A alone is positive definite tells a stable step.

The tensions of elastic tendons at the end of the substep solve a complementarity problem within
each step, see implicit_euler.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, lane_sum, load, spread, store
from soft_tendon_env.mechanics.algebra.linear import (
    INDEFINITE,
    SINGULAR,
    copy,
    product,
    row_stride,
    solve_columns,
    solve_positive_definite,
)
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK, UNSETTLED
from soft_tendon_env.mechanics.motion.tendon_ends import add_answers, bound_tensions
from soft_tendon_env.mechanics.terms.tendon_friction import PER_PACK, smooth_speed

MOST = 100  # Newton steps
SMALL_TURN = 0.25  # of a logarithm, up to which its series is right to 3e-13
SATURATED = 1e-3  # of a logarithm, the change of a tension below which its slope is left out
FIRST = 4  # Newton steps in which it may be
SAME = 1e-7  # of the logarithm of a tension, by which directions may be off what slides


@phase
def slide_tendons(arm, command, balance, h, scratch):
    """Finds the change scratch.delta of rates in a substep with the friction at its end.

    The substep has length h and the system scratch.system; elastic tendons are under a command
    (n_a) at its end. A status goes into scratch.sliding.status.
    """
    sliding = scratch.sliding
    path = arm.effects.transmission
    n = scratch.delta.size
    columns = 1
    if path.elastic:
        columns += arm.tendons.size
    wide = sliding.system.size // sliding.change.size
    begin_sliding(arm, balance, h, scratch)
    sliding.status[0] = UNSETTLED
    is_stable = False
    for repeat in range(MOST):
        # without slopes steps may go in circles
        saturated = SATURATED if repeat < FIRST else 0.0
        fill_sliding(arm, balance, h, columns, saturated, scratch)
        pivots = solve_columns(sliding.system, n, wide, columns)
        if pivots == INDEFINITE and not is_stable:
            is_stable = has_positive_system(scratch)
            if is_stable:
                # once more: the system has been overwritten
                continue
            pivots = SINGULAR
        if pivots == SINGULAR:
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
            for a in range(n):
                sliding.acceleration[a] = scratch.delta[a] / h
            return


@kernel
def begin_sliding(arm, balance, h, scratch):
    """Begins with the tensions of the substep's beginning and rates ahead.

    The rates are those to which the accelerations of the substep before lead.
    """
    sliding = scratch.sliding
    delta = scratch.delta
    rows = balance.borders.row
    rates = sliding.rate
    directions = sliding.direction
    ahead = sliding.change
    slow = arm.effects.transmission.stiction_speed
    copy(balance.tendons.tension, sliding.tension)
    for a in range(delta.size):
        delta[a] = h * sliding.acceleration[a]
        ahead[a] = scratch.v[a] + delta[a]
    for i in range(arm.tendons.size):
        begin, end = places_of(arm, i)
        for k in range(begin, end):
            rate = row_product(rows, k, ahead)
            rates[k] = rate
            directions[k] = rate / smooth_speed(rate, slow)


@kernel
def has_positive_system(scratch):
    """Whether scratch.system, without friction, is positive definite; overwrites sliding.system."""
    n = scratch.delta.size
    sliding = scratch.sliding
    copy(scratch.system, sliding.system[: scratch.system.size])
    return solve_positive_definite(sliding.system, n, sliding.change)


@kernel(inline=True)
def places_of(arm, i):
    """First place of a tendon's borders, and one past the last."""
    start = i * 2 * arm.rod.packs * LANES
    first = start + PER_PACK * arm.tendons.pack_begin[i]
    behind = start + PER_PACK * arm.tendons.pack_end[i]
    return first, behind


@kernel(inline=True)
def row_product(rows, k, x):
    """Scalar product of a row with x, both filled up to whole packs with zeros."""
    first = k * x.size
    total = spread(0.0)
    for m in range(0, x.size, LANES):
        own = load(rows, first + m)
        total = total + own * load(x, m)
    return lane_sum(total)


@kernel
def fill_sliding(arm, balance, h, columns, saturated, scratch):
    """Fills sliding.system with the linear problem of a Newton step.

    Elastic tendons have a right-hand side each, the force of a newton.
    """
    sliding = scratch.sliding
    delta = scratch.delta
    n = delta.size
    stride = row_stride(n + 1)
    wide = sliding.system.size // stride
    for a in range(n):
        first = a * stride
        row = scratch.system[first : first + n]
        out = sliding.system[a * wide : (a + 1) * wide]
        copy(row, out[:n])
        right = scratch.system[first + n]
        out[n] = right - product(row, delta)
        for j in range(1, columns):
            out[n + j] = 0.0
    for i in range(arm.tendons.size):
        add_tendon(arm, i, balance, h, saturated, sliding)


@kernel
def add_tendon(arm, i, balance, h, saturated, sliding):
    """Adds a tendon's friction, and the tension of an elastic one, to the linear problem.

    Slopes are left out where the logarithm of a tension would change by less than `saturated`.
    """
    is_elastic = arm.effects.transmission.elastic
    tension = sliding.tension[i]
    if not is_elastic and tension == 0.0:
        return
    n = arm.strain.size
    begun = balance.tendons.tension[i]
    begin, end = places_of(arm, i)
    places = (begin, end)
    sway = find_falls(arm, balance.borders, places, begun, sliding)
    stretched = tension - begun if is_elastic else 0.0
    rows = balance.borders.row
    add_rows(rows, places, h * tension, sliding.fall, h * stretched, n, sliding)
    if is_elastic:
        add_rows(rows, places, h, sliding.left, h, n + 1 + i, sliding)
    if sway > saturated:
        find_slopes(balance.borders, places, begun, h * tension, sliding)
        add_products(rows, places, n, sliding)
    else:
        sliding.slope[begin:end] = 0.0


@kernel
def find_falls(arm, borders, places, begun, sliding):
    """Finds how the share of a tendon's tension that is left changes at its borders.

    sliding.left is that by the directions, and sliding.fall that to which the rates lead. Returns
    how much logarithms of the tension would change with rates that change by themselves.
    """
    begin, end = places
    slow = arm.effects.transmission.stiction_speed
    turns = borders.turn
    rates = sliding.rate
    directions = sliding.direction
    leads = sliding.lead
    slopes = sliding.slope
    falls = sliding.fall
    lefts = sliding.left
    late = 0.0  # by how much the rates' own mu z dphi, up to the border, is more
    left = 1.0
    late_before = 0.0
    sway = 0.0
    for k in range(begin, end):
        turn = math.copysign(turns[k], begun)
        z = directions[k]
        rate = rates[k]
        speed = smooth_speed(rate, slow)
        lead = rate / speed
        slope = (1.0 - z * lead) / speed
        leads[k] = lead
        slopes[k] = slope
        left_before = left
        left = left_before * decay(turn * z)
        late += turn * (lead - z)
        sway += turns[k] * slope * speed
        change = left - left_before
        late_change = left * late - left_before * late_before
        lefts[k] = change
        falls[k] = change - late_change
        late_before = late
    return sway


@kernel
def find_slopes(borders, places, begun, tension, sliding):
    """Finds derivatives of what a tension falls by at its borders, rows of sliding.falls."""
    begin, end = places
    stride = sliding.change.size
    rows = borders.row
    turns = borders.turn
    slopes = sliding.slope
    lefts = sliding.left
    falls = sliding.falls
    turning = sliding.turning
    pulling = sliding.pulling
    turning[:] = 0.0
    pulling[:] = 0.0
    left = 1.0
    for k in range(begin, end):
        left += lefts[k]
        steepness = math.copysign(turns[k], begun) * slopes[k]
        row = k * stride
        fall = (k - begin) * stride
        for m in range(0, stride, LANES):
            turned = load(turning, m) + steepness * load(rows, row + m)
            pulled = (tension * left) * turned
            before = load(pulling, m)
            store(falls, fall + m, pulled - before)
            store(turning, m, turned)
            store(pulling, m, pulled)


@kernel
def add_rows(rows, places, share, factors, first, column, sliding):
    """Adds the sum of share factors_k w_k over a tendon's borders, and of first w_0, to a column.

    The column is one of sliding.system.
    """
    begin, end = places
    stride = sliding.change.size
    wide = sliding.system.size // stride
    system = sliding.system
    for m in range(0, stride, LANES):
        total = first * load(rows, begin * stride + m)
        for k in range(begin, end):
            factor = share * factors[k]
            total = total + factor * load(rows, k * stride + m)
        for j in range(LANES):
            # rows beyond n, which nothing reads, are there too
            entry = (m + j) * wide + column
            system[entry] += lane(total, j)


@kernel(inline=True)
def decay(x):
    """exp(-x), where x is small by its series."""
    if abs(x) > SMALL_TURN:
        return math.exp(-x)
    # 1 - x (1 - x/2 (1 - x/3 (...))), up to x^9, by products, which are quicker than quotients
    rest = 1.0 - (1.0 / 9.0) * x
    rest = 1.0 - (1.0 / 8.0) * x * rest
    rest = 1.0 - (1.0 / 7.0) * x * rest
    rest = 1.0 - (1.0 / 6.0) * x * rest
    rest = 1.0 - (1.0 / 5.0) * x * rest
    rest = 1.0 - (1.0 / 4.0) * x * rest
    rest = 1.0 - (1.0 / 3.0) * x * rest
    rest = 1.0 - (1.0 / 2.0) * x * rest
    return 1.0 - x * rest


@kernel
def add_products(rows, places, n, sliding):
    """Adds the sum over a tendon's borders of w_k falls_k^T to the matrix of the system."""
    begin, end = places
    stride = sliding.change.size
    wide = sliding.system.size // stride
    system = sliding.system
    falls = sliding.falls
    # four rows at once: w_k is filled up to whole packs with zeros, and the system with rows; what
    # is right of the matrix gets zeros too
    for a in range(0, n, 4):
        for m in range(0, n, LANES):
            at = a * wide + m
            first = load(system, at)
            second = load(system, at + wide)
            third = load(system, at + 2 * wide)
            fourth = load(system, at + 3 * wide)
            for k in range(begin, end):
                fall = load(falls, (k - begin) * stride + m)
                w = load(rows, k * stride + a)
                first = first + lane(w, 0) * fall
                second = second + lane(w, 1) * fall
                third = third + lane(w, 2) * fall
                fourth = fourth + lane(w, 3) * fall
            store(system, at, first)
            store(system, at + wide, second)
            store(system, at + 2 * wide, third)
            store(system, at + 3 * wide, fourth)


@kernel
def take_change(n, sliding):
    """The solution of the linear problem, a change of the rates, into sliding.change."""
    wide = sliding.system.size // sliding.change.size
    for a in range(n):
        sliding.change[a] = sliding.system[a * wide + n]


@kernel
def stretch_sliding(path, command, balance, h, scratch):
    """Finds tensions sliding.tension of elastic tendons that rub, at the end of the substep.

    They are under a command (n_a); what they change is added to sliding.change.
    """
    sliding = scratch.sliding
    ends = scratch.ends
    n = scratch.delta.size
    wide = sliding.system.size // sliding.change.size
    count = command.size
    change = sliding.change
    for j in range(count):
        column = n + 1 + j
        for a in range(n):
            ends.answer[j, a] = sliding.system[a * wide + column]
    for i in range(count):
        row = balance.tendons.columns[i]
        rate = product(row, scratch.v) + product(row, scratch.delta)
        ends.rate[i] = rate + product(row, change[:n])
        for j in range(count):
            ends.give[i, j] = product(row, ends.answer[j])
    bound_tensions(path, command, balance.tendons.shortening, h, sliding.tension, ends)
    for j in range(count):
        ends.change[j] = ends.tension[j] - sliding.tension[j]
    add_answers(ends, change[:n])
    copy(ends.tension, sliding.tension)


@kernel
def follow_change(arm, borders, stretched, sliding):
    """Moves directions and speeds by sliding.change, and returns how far tensions are off.

    That is how much logarithms of tensions by the directions differ from those by the speeds, or
    products of changes: tensions of elastic tendons have changed by `stretched` (n_a) [N].
    """
    path = arm.effects.transmission
    slow = path.stiction_speed
    rows = borders.row
    turns = borders.turn
    leads = sliding.lead
    slopes = sliding.slope
    rates = sliding.rate
    directions = sliding.direction
    change = sliding.change
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
            turn = turns[k]
            moved = row_product(rows, k, change)
            lead = leads[k] + slopes[k] * moved
            z = min(max(lead, -1.0), 1.0)
            rate = rates[k] + moved
            own = rate / smooth_speed(rate, slow)
            off += turn * (own - z)
            turned += turn * (z - directions[k])
            most = max(most, abs(off), share * abs(turned))
            directions[k] = z
            rates[k] = rate
    return most
