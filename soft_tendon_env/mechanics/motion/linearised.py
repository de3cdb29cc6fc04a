"""Exact linearisation of a motion: its end, differentiated by where it begins and by its commands, with the steps held as they were taken.

Tangents are carried from substep to substep by the derivatives of the equation that each solves, see differentiation, and extrapolated
like the motion itself.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.linear import add_product, copy, copy_matrix, solve_columns
from soft_tendon_env.mechanics.motion.differentiation import differentiate, slope
from soft_tendon_env.mechanics.motion.extrapolation import begin_row, extrapolate, fill_row, keep_first_entry, take_substep
from soft_tendon_env.mechanics.motion.replay import end_step
from soft_tendon_env.mechanics.motion.stages import evaluate_force
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.terms.transmission import delivered


@kernel
def linearise(arm, method, taken, commands, motion, scratch, difference, tangents):
    """Repeat a motion as replay() does, with the derivatives of its end in tangents.begin; a status."""
    inputs, n_a = tangents.begin.shape[0], tangents.command.shape[0]
    tangents.command[:] = 0.0
    write_identity(tangents.begin)
    for i in range(n_a):
        tangents.command[i, inputs - n_a + i] = 1.0
    for k in range(taken.shape[0]):
        u = commands[int(taken[k, 0])]
        for i in range(arm.effects.count):
            if arm.effects.deliver[i] != 0:
                carry_delivery(arm, u, motion, scratch, difference, tangents)
                break
        u = delivered(arm.effects, u, motion.clock[0], motion.state, scratch.acting, scratch.until)
        status = linearise_extrapolated_step(arm, method, u, motion, taken[k], scratch, difference, tangents)
        if status != OK:
            return status
        motion.clock[0] += taken[k, 1]
    return OK


@kernel
def write_identity(out):
    """Writes the identity matrix."""
    out[:] = 0.0
    for i in range(out.shape[0]):
        out[i, i] = 1.0


@kernel
def carry_delivery(arm, u, motion, scratch, difference, tangents):
    """Carries tangents of commands and internal states through the delay of commands."""
    n, m, n_a = motion.q.size, motion.state.size, u.size
    passed, unit, command = tangents.passed, difference.unit, difference.place[:n_a]
    for i in range(m + n_a):
        for side in range(3):
            for j in range(m):
                passed[side, j] = motion.state[j]
            copy(u, command)
            way = (side - 1) * unit[2 * n + i]
            if i < m:
                passed[side, i] += way
            else:
                command[i - m] += way
            acting = delivered(arm.effects, command, motion.clock[0], passed[side, :m], scratch.acting, scratch.until)
            for j in range(n_a):
                passed[side, m + j] = acting[j]
        for j in range(m + n_a):
            tangents.passing[j, i] = slope(passed[0, j], passed[1, j], passed[2, j], unit[2 * n + i])
    now = tangents.now
    copy_matrix(tangents.begin, now)
    copy_matrix(tangents.command, now[2 * n + m :])
    tangents.begin[2 * n :] = 0.0
    add_product(tangents.passing, now[2 * n :], tangents.begin[2 * n :])


@kernel
def run_substep(arm, method, u, motion, step, row, substep, scratch, course):
    """One substep as take_substep() takes it, kept in the course; a status."""
    k, h = row * (row + 1) // 2 + substep, step / (row + 1)
    copy(scratch.q, course.q[k])
    copy(scratch.v, course.v[k])
    copy(scratch.state, course.state[k])
    copy(scratch.work.xi_dot, course.rate[k])
    course.time[k] = motion.clock[0] + substep * h
    status, _ = take_substep(arm, method, 0.0, u, motion, step, row, substep, scratch)
    copy(scratch.work.xi, course.xi[k])
    copy(scratch.delta, course.change[k])
    copy(scratch.v, course.ahead[k])
    balance, share = scratch.now if substep > 0 else scratch.first, 1.0 if method.with_inertia else 0.0
    copy(balance.bounded.part, course.part[k])
    equation, system = course.equation[k], course.system[k]
    equation[0], equation[1], equation[2], equation[3] = h, share, h, h
    for i in range(system.shape[0]):
        for j in range(i, system.shape[0]):
            system[i, j] = share * balance.mass[i, j] + h * (balance.damping[i, j] + h * balance.stiffness[i, j])
    return status


@kernel
def run_step(arm, method, u, motion, taken, scratch, course):
    """One extrapolated step as it was taken, to its end, with its substeps kept in the course; a status."""
    columns = int(taken[2])
    copy(motion.xi, scratch.work.xi)
    for row in range(columns):
        begin_row(motion, scratch)
        for substep in range(row + 1):
            status = run_substep(arm, method, u, motion, taken[1], row, substep, scratch, course)
            if status != OK:
                return status
        fill_row(row, scratch)
    if taken[3] != 0.0:
        keep_first_entry(columns - 1, scratch)
    return end_step(arm, motion, scratch)


@kernel
def differentiate_step(arm, method, u, columns, scratch, difference):
    """Derivatives of all substeps of an extrapolated step: the first ones of its rows begin at one evaluation; a status."""
    firsts, laters = 0, 0
    for row in range(columns):
        difference.own[firsts] = row * (row + 1) // 2
        firsts += 1
        for substep in range(1, row + 1):
            difference.later[laters] = row * (row + 1) // 2 + substep
            laters += 1
    none = difference.later[:0]
    kept = difference.later[:laters] if method.keeps else none
    status = differentiate(arm, method.keeps, u, difference.own[:firsts], kept, scratch, difference)
    for i in range(laters):
        if status == OK:
            difference.own[0] = difference.later[i]
            status = differentiate(arm, method.keeps, u, difference.own[:1], none, scratch, difference)
    return status


@kernel
def carry_substep(k, begins, difference, tangents):
    """Carries the tangents now, of the step alone, over a substep; it `begins` the step where they are still those of the identity."""
    course, slopes, now, change, state = difference.course, difference.slopes, tangents.now, tangents.change, tangents.state
    n, m, h = change.shape[0], state.shape[0], course.equation[k, 0]
    if begins:
        copy_matrix(slopes.force[k], change)
    else:
        copy_matrix(slopes.kept[k], change)  # zero where nothing is kept
        add_product(slopes.force[k], now, change)
    copy_matrix(course.system[k], tangents.system)
    solve_columns(tangents.system, change)
    for i in range(n):
        for j in range(now.shape[1]):
            now[n + i, j] -= change[i, j]
    state[:] = 0.0
    add_product(slopes.state[k], now, state)
    copy_matrix(state, now[2 * n : 2 * n + m])
    for i in range(n):
        for j in range(now.shape[1]):
            now[i, j] += h * now[n + i, j]


@kernel
def linearise_extrapolated_step(arm, method, u, motion, taken, scratch, difference, tangents):
    """One extrapolated step as it was taken, with its tangents; a status."""
    columns, now, table = int(taken[2]), tangents.now, tangents.table
    status = run_step(arm, method, u, motion, taken, scratch, difference.course)
    if status == OK:
        status = differentiate_step(arm, method, u, columns, scratch, difference)
    if status != OK:
        return status
    for row in range(columns):
        write_identity(now)
        for substep in range(row + 1):
            carry_substep(row * (row + 1) // 2 + substep, substep == 0, difference, tangents)
        for i in range(table.shape[2]):
            table[row, 0, i] = now[i // now.shape[1], i % now.shape[1]]
        extrapolate(table, row)
    end = table[columns - 1, 0 if taken[3] != 0.0 else columns - 1]
    rows = end.size // now.shape[1]
    now[:rows] = 0.0
    add_product(end.reshape((rows, now.shape[1])), tangents.begin, now)
    copy_matrix(now[:rows], tangents.begin[:rows])
    return OK


@kernel
def tip_jacobian(arm, method, u, motion, scratch, out):
    """Body Jacobian out (6, n) of the tip at the end of a motion; a status."""
    work = scratch.work
    copy(motion.xi, work.xi)
    status = evaluate_force(arm, method, u, motion.q, motion.q_dot, motion.state, motion.clock[0], scratch)
    last = 6 * LANES * (arm.rod.packs - 1) + LANES - 1
    for j in range(arm.strain.size):
        for i in range(6):
            out[i, j] = work.J[6 * LANES * arm.rod.packs * j + last + i * LANES]
    return status
