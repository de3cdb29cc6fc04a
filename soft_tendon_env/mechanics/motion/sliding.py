"""Rates at the end of a substep of tendons that rub, by implicit Euler with their friction there.

With the rows w_k of the borders and the tensions T_k beyond them, see terms.tendon_friction, the
change dv of the rates solves

    A dv = h (f + sum_k (T_k - T_k-1) w_k),    T_k = T exp(-sum_j<=k mu dphi_j z_j),

z_j the direction of v_j = w_j (v + dv). Newton's method takes z_j as an unknown of its own, by the
derivative of z_j sqrt(v_j^2 + v_s^2) = v_j, and holds it within [-1, 1] (T. F. Chan, G. H. Golub
and P. Mulet, SIAM J. Sci. Comput. 20, 1999): it converges in a few steps however small v_s is,
where Newton's method for dv alone goes in circles. At its end the power of friction is negative at
every border.

A is eliminated once: that it is positive definite tells a stable step. Newton's matrix is A where
nothing sticks, since directions of what slides stay as they are. What a direction changes behind
its place has one row and one column for each place that sticks. It may outweigh what the place
resists, so that pivots are negative.

The tensions of elastic tendons at the end of the substep solve a complementarity problem within
each step, see implicit_euler.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import (
    LANES,
    lane,
    lane_sums,
    largest,
    load,
    prefix_sum,
    spread,
    sqrt,
    store,
    with_lane,
)
from soft_tendon_env.mechanics.algebra.linear import (
    copy,
    product,
    row_stride,
    solve_again,
    solve_columns,
    solve_positive_definite,
)
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK, UNSETTLED
from soft_tendon_env.mechanics.motion.tendon_ends import add_answers, bound_tensions
from soft_tendon_env.mechanics.terms.tendon_friction import PER_PACK

MOST = 100  # Newton steps
SMALL_TURN = 0.25  # of a logarithm, up to which its Padé approximant is right to 2e-13
# of a logarithm, by which a place may change a tension and have no slope: in the first Newton
# steps, in the next, and in the last, since without slopes they may go in circles
SATURATED = (1e-3, 1e-5, 0.0)
FIRST = 4  # Newton steps
NEXT = 8
SAME = 1e-7  # of the logarithm of a tension, by which directions may be off what slides


@phase
def slide_tendons(arm, command, balance, substep, scratch):
    """Finds the change scratch.delta of rates in a substep with the friction at its end.

    Its system is scratch.system; elastic tendons are under a command (n_a) at its end. A status
    goes into scratch.sliding.status.
    """
    h = substep.length
    sliding = scratch.sliding
    path = arm.effects.transmission
    n = scratch.delta.size
    columns = 1
    if path.elastic:
        columns += arm.tendons.size
    copy(scratch.system, sliding.factors)
    if not solve_positive_definite(sliding.factors, n, sliding.change):
        sliding.status[0] = NOT_POSITIVE
        return
    if substep.is_alone:
        sliding.acceleration[:] = 0.0
    begin_sliding(arm, balance, h, scratch)
    if substep.is_alone:
        keep_directions(arm, sliding)
    sliding.status[0] = UNSETTLED
    for repeat in range(MOST):
        sticks = fill_sliding(arm, balance, h, saturation(repeat), scratch)
        if sticks:
            if not solve_sticking(n, columns, sliding):
                sliding.status[0] = NOT_POSITIVE
                return
        else:
            for column in range(columns):
                solve_again(sliding.factors, n, sliding.sides[column])
        copy(sliding.sides[0], sliding.change)
        if path.elastic:
            stretch_sliding(path, command, balance, h, scratch)
        off = follow_change(arm, balance.borders, scratch.ends.change, sliding)
        for a in range(n):
            scratch.delta[a] += sliding.change[a]
        if off <= SAME:
            sliding.status[0] = OK
            for a in range(n):
                sliding.acceleration[a] = scratch.delta[a] / h
            find_turned(arm, balance.borders, sliding)
            return


@kernel(inline=True)
def saturation(repeat):
    """Change of a logarithm of a tension up to which slopes are left out in a Newton step."""
    if repeat < FIRST:
        return SATURATED[0]
    if repeat < NEXT:
        return SATURATED[1]
    return SATURATED[2]


@kernel
def begin_sliding(arm, balance, h, scratch):
    """Begins with the tensions of the substep's beginning and rates ahead.

    The rates are those to which the accelerations of the substep before lead.
    """
    sliding = scratch.sliding
    delta = scratch.delta
    rows = balance.borders.row
    ahead = sliding.change
    slow = arm.effects.transmission.stiction_speed
    copy(balance.tendons.tension, sliding.tension)
    for a in range(delta.size):
        delta[a] = h * sliding.acceleration[a]
        ahead[a] = scratch.v[a] + delta[a]
    for i in range(arm.tendons.size):
        begin, end = places_of(arm, i)
        for k in range(begin, end, LANES):
            rate = row_products(rows, k, ahead)
            inverse = spread(1.0) / sqrt(rate * rate + spread(slow * slow))
            direction = rate * inverse
            store(sliding.rate, k, rate)
            store(sliding.inverse, k, inverse)
            store(sliding.lead, k, direction)
            store(sliding.direction, k, direction)


@kernel(inline=True)
def places_of(arm, i):
    """First place of a tendon's borders, and one past the last."""
    start = i * 2 * arm.rod.packs * LANES
    first = start + PER_PACK * arm.tendons.pack_begin[i]
    behind = start + PER_PACK * arm.tendons.pack_end[i]
    return first, behind


@kernel(inline=True)
def row_products(rows, k, x):
    """Scalar products of four rows from k on with x, all filled up to whole packs with zeros."""
    at = k * x.size
    first = spread(0.0)
    second = spread(0.0)
    third = spread(0.0)
    fourth = spread(0.0)
    for m in range(0, x.size, LANES):
        own = load(x, m)
        first = first + own * load(rows, at + m)
        second = second + own * load(rows, at + x.size + m)
        third = third + own * load(rows, at + 2 * x.size + m)
        fourth = fourth + own * load(rows, at + 3 * x.size + m)
    return lane_sums((first, second, third, fourth))


@kernel
def fill_sliding(arm, balance, h, saturated, scratch):
    """Fills sliding.sides with the right-hand sides of a Newton step, and sliding.system with its
    matrix where a tendon sticks.

    Elastic tendons have a side each, the force of a newton. Returns whether a tendon sticks: the
    direction of a place would change the logarithm of its tension by more than `saturated`.
    """
    is_elastic = arm.effects.transmission.elastic
    sliding = scratch.sliding
    n = scratch.delta.size
    rows = balance.borders.row
    fill_force(scratch)
    sticks = False
    for i in range(arm.tendons.size):
        tension = sliding.tension[i]
        if not is_elastic and tension == 0.0:
            continue
        begun = balance.tendons.tension[i]
        places = places_of(arm, i)
        tendon_sticks = find_falls(balance.borders, places, begun, saturated, sliding)
        stretched = tension - begun if is_elastic else 0.0
        add_rows(rows, places, h * tension, sliding.fall, h * stretched, sliding.sides[0])
        if is_elastic:
            force = sliding.sides[1 + i]
            force[:] = 0.0
            add_rows(rows, places, h, sliding.left, h, force)
        if tendon_sticks:
            if not sticks:
                copy_system(scratch)
            sticks = True
            count = find_pulls(balance.borders, places, begun, h * tension, sliding)
            add_products(rows, count, n, sliding)
    return sticks


@kernel
def fill_force(scratch):
    """Fills the first of sliding.sides with what the change so far leaves of scratch.system."""
    delta = scratch.delta
    n = delta.size
    stride = row_stride(n + 1)
    side = scratch.sliding.sides[0]
    for a in range(n):
        first = a * stride
        row = scratch.system[first : first + n]
        right = scratch.system[first + n]
        side[a] = right - product(row, delta)


@kernel
def copy_system(scratch):
    """Copies the coefficients of scratch.system to sliding.system, whose rows are longer."""
    sliding = scratch.sliding
    n = scratch.delta.size
    stride = row_stride(n + 1)
    wide = sliding.system.size // sliding.change.size
    for a in range(n):
        first = a * stride
        row = scratch.system[first : first + n]
        out = sliding.system[a * wide : a * wide + n]
        copy(row, out)


@kernel
def find_falls(borders, places, begun, saturated, sliding):
    """Finds how the share of a tendon's tension that is left changes at its borders.

    sliding.left is that by the directions, and sliding.fall that to which the rates lead. Slopes
    are left out where the logarithm of the tension would change by less than `saturated` with a
    rate that changes by itself. Returns whether there is any.
    """
    begin, end = places
    sign = math.copysign(1.0, begun)
    sticks = False
    late = 0.0  # by how much the rates' own mu z dphi, up to the border, is more
    left = 1.0
    late_before = 0.0
    for first in range(begin, end, LANES):
        turn = load(borders.turn, first)
        z = load(sliding.direction, first)
        lead = load(sliding.lead, first)
        kept = decays(sign * turn * z, largest(turn))
        late_by = prefix_sum(sign * turn * (lead - z))
        unsaturated = spread(1.0) - z * lead
        # of a change of the rate by itself
        swayed = turn * unsaturated
        if largest(swayed) > saturated:
            find_slopes(first, swayed, unsaturated, saturated, sliding)
            sticks = True
        else:
            store(sliding.slope, first, spread(0.0))
        for m in range(LANES):
            k = first + m
            left_before = left
            left = left_before * lane(kept, m)
            lately = late + lane(late_by, m)
            change = left - left_before
            sliding.left[k] = change
            sliding.fall[k] = change - (left * lately - left_before * late_before)
            late_before = lately
        late = late_before
    return sticks


@kernel(inline=True)
def find_slopes(first, swayed, unsaturated, saturated, sliding):
    """Finds slopes of a pack of places, of those that sway a tension by more than `saturated`."""
    for m in range(LANES):
        k = first + m
        slope = 0.0
        if lane(swayed, m) > saturated:
            slope = lane(unsaturated, m) * sliding.inverse[k]
        sliding.slope[k] = slope


@kernel
def add_rows(rows, places, share, factors, first, out):
    """Adds the sum of share factors_k w_k over a tendon's borders, and of first w_0, to `out`."""
    begin, end = places
    stride = out.size
    for m in range(0, stride, LANES):
        total = load(out, m) + first * load(rows, begin * stride + m)
        for k in range(begin, end):
            factor = share * factors[k]
            total = total + factor * load(rows, k * stride + m)
        store(out, m, total)


@kernel
def find_pulls(borders, places, begun, tension, sliding):
    """Finds what places that stick change behind them, rows of sliding.pulls; returns their number.

    By parts the derivative of sum_k (T_k - T_k-1) w_k is a sum of products: of w_j with
    mu dphi_j dz_j/dv_j times what is pulled from border j on, T_j w_j + sum_k>j (T_k - T_k-1) w_k.
    """
    begin, end = places
    stride = sliding.change.size
    rows = borders.row
    pulled = sliding.pulled
    pulls = sliding.pulls
    pulled[:] = 0.0
    left = 1.0
    for k in range(begin, end):
        left += sliding.left[k]
    count = 0
    for k in range(end - 1, begin - 1, -1):
        row = k * stride
        change = sliding.left[k]
        slope = sliding.slope[k]
        if slope > 0.0:
            steepness = tension * math.copysign(borders.turn[k], begun) * slope
            for m in range(0, stride, LANES):
                behind = load(pulled, m) + left * load(rows, row + m)
                store(pulls, count * stride + m, steepness * behind)
            sliding.sticking[count] = k
            count += 1
        for m in range(0, stride, LANES):
            store(pulled, m, load(pulled, m) + change * load(rows, row + m))
        left -= change
    return count


@kernel(inline=True)
def decays(x, most):
    """exp(-x) of a pack, none of which is larger than `most`.

    Where that is small it is the Padé approximant of order 4, (even - odd) / (even + odd).
    """
    if most > SMALL_TURN:
        values = x
        for m in range(LANES):
            values = with_lane(values, m, math.exp(-lane(x, m)))
        return values
    square = x * x
    even = spread(1.0) + square * (spread(3.0 / 28.0) + (1.0 / 1680.0) * square)
    odd = x * (spread(0.5) + (1.0 / 84.0) * square)
    return (even - odd) / (even + odd)


@kernel
def add_products(rows, count, n, sliding):
    """Adds the sum of pulls_j w_j^T over `count` places that stick to the matrix of the system."""
    stride = sliding.change.size
    wide = sliding.system.size // stride
    system = sliding.system
    pulls = sliding.pulls
    # four rows at once: rows are filled up to whole packs with zeros, and the system with rows;
    # what is right of the matrix gets zeros too
    for a in range(0, n, 4):
        for m in range(0, n, LANES):
            at = a * wide + m
            first = load(system, at)
            second = load(system, at + wide)
            third = load(system, at + 2 * wide)
            fourth = load(system, at + 3 * wide)
            for j in range(count):
                w = load(rows, sliding.sticking[j] * stride + m)
                pull = load(pulls, j * stride + a)
                first = first + lane(pull, 0) * w
                second = second + lane(pull, 1) * w
                third = third + lane(pull, 2) * w
                fourth = fourth + lane(pull, 3) * w
            store(system, at, first)
            store(system, at + wide, second)
            store(system, at + 2 * wide, third)
            store(system, at + 3 * wide, fourth)


@kernel
def solve_sticking(n, columns, sliding):
    """Overwrites sliding.sides by the solutions of sliding.system; False if that is singular."""
    wide = sliding.system.size // sliding.change.size
    # at last: products add zeros to what is right of the matrix
    for a in range(n):
        for column in range(columns):
            sliding.system[a * wide + n + column] = sliding.sides[column, a]
    if not solve_columns(sliding.system, n, wide, columns):
        return False
    for a in range(n):
        for column in range(columns):
            sliding.sides[column, a] = sliding.system[a * wide + n + column]
    return True


@kernel
def stretch_sliding(path, command, balance, h, scratch):
    """Finds tensions sliding.tension of elastic tendons that rub, at the end of the substep.

    They are under a command (n_a); what they change is added to sliding.change.
    """
    sliding = scratch.sliding
    ends = scratch.ends
    n = scratch.delta.size
    count = command.size
    change = sliding.change
    for j in range(count):
        copy(sliding.sides[1 + j, :n], ends.answer[j])
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
        for first in range(begin, end, LANES):
            moved = row_products(borders.row, first, change)
            linear = load(sliding.lead, first) + load(sliding.slope, first) * moved
            rate = load(sliding.rate, first) + moved
            inverse = spread(1.0) / sqrt(rate * rate + spread(slow * slow))
            own = rate * inverse
            store(sliding.rate, first, rate)
            store(sliding.inverse, first, inverse)
            store(sliding.lead, first, own)
            for m in range(LANES):
                k = first + m
                turn = borders.turn[k]
                z = min(max(lane(linear, m), -1.0), 1.0)
                off += turn * (lane(own, m) - z)
                turned += turn * (z - sliding.direction[k])
                most = max(most, abs(off), share * abs(turned))
                sliding.direction[k] = z
    return most


@kernel
def keep_directions(arm, sliding):
    """Keeps directions as those at the beginning of a step."""
    sliding.turned[0] = 0.0
    for i in range(arm.tendons.size):
        begin, end = places_of(arm, i)
        copy(sliding.direction[begin:end], sliding.direction_before[begin:end])


@kernel
def find_turned(arm, borders, sliding):
    """Finds how much directions have changed within a step, the most into sliding.turned.

    It is by the logarithm of a tension that they change.
    """
    for i in range(arm.tendons.size):
        if sliding.tension[i] == 0.0:
            continue
        begin, end = places_of(arm, i)
        turned = 0.0
        for k in range(begin, end):
            change = sliding.direction[k] - sliding.direction_before[k]
            turned += borders.turn[k] * abs(change)
        sliding.turned[0] = max(sliding.turned[0], turned)
