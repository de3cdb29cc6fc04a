"""Linearisation of a Runge-Kutta step, with the derivatives of its stages."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import add_product, copy, copy_matrix, solve_columns
from soft_tendon_env.mechanics.motion.differentiation import differentiate
from soft_tendon_env.mechanics.motion.replay import end_step
from soft_tendon_env.mechanics.motion.runge_kutta import REACH, WEIGHT, begin_stages, end_stages, take_stage
from soft_tendon_env.mechanics.motion.status import OK


@kernel
def run_stages(arm, method, u, motion, step, scratch, course):
    """One Runge-Kutta step as runge_kutta_step() takes it, to its end, with its stages kept in the course; a status."""
    begin_stages(motion, scratch)
    for stage in range(4):
        copy(scratch.q, course.q[stage])
        copy(scratch.v, course.v[stage])
        copy(motion.state, course.state[stage])
        copy(scratch.work.xi_dot, course.rate[stage])
        course.time[stage] = motion.clock[0] + REACH[stage] * step
        status = take_stage(arm, method, u, motion, step, stage, scratch)
        if status != OK:
            return status
        copy(scratch.work.xi, course.xi[stage])
        copy(scratch.delta, course.change[stage])
        copy_matrix(scratch.work.M, course.system[stage])
        equation = course.equation[stage]
        equation[0], equation[1], equation[2], equation[3] = 0.0, 1.0, 1.0, step if stage == 3 else 0.0
    end_stages(arm, motion, step, scratch)
    copy(scratch.v, course.ahead[3])
    return end_step(arm, motion, scratch)


@kernel
def carry_stages(step, difference, tangents):
    """Carries the tangents over a Runge-Kutta step."""
    course, slopes, begin, now, change = difference.course, difference.slopes, tangents.begin, tangents.now, tangents.change
    n, m = change.shape[0], tangents.state.shape[0]
    ends = tangents.table[0, 0]  # of coordinates and rates, then of the stage's velocity
    inputs = now.shape[1]
    copy_matrix(begin, now)
    for i in range(2 * n * inputs):
        ends[i] = begin[i // inputs, i % inputs]
    for stage in range(4):
        change[:] = 0.0
        add_product(slopes.force[stage], now, change)
        copy_matrix(course.system[stage], tangents.system)
        solve_columns(tangents.system, change)
        reach = step * REACH[stage + 1] if stage < 3 else 0.0
        for i in range(n):
            for j in range(inputs):
                velocity = now[n + i, j]
                ends[i * inputs + j] += step * WEIGHT[stage] * velocity
                ends[(n + i) * inputs + j] -= step * WEIGHT[stage] * change[i, j]
                if stage < 3:
                    now[i, j] = begin[i, j] + reach * velocity
                    now[n + i, j] = begin[n + i, j] - reach * change[i, j]
    for i in range(n):
        for j in range(inputs):
            now[n + i, j] = ends[(n + i) * inputs + j]
    tangents.state[:] = 0.0
    add_product(slopes.state[3], now, tangents.state)
    for i in range(2 * n * inputs):
        begin[i // inputs, i % inputs] = ends[i]
    copy_matrix(tangents.state, begin[2 * n : 2 * n + m])


@kernel
def linearise_runge_kutta_step(arm, method, u, motion, taken, scratch, difference, tangents):
    """One Runge-Kutta step with its tangents; a status."""
    status = run_stages(arm, method, u, motion, taken[1], scratch, difference.course)
    for stage in range(4):
        if status == OK:
            difference.own[0] = stage
            status = differentiate(arm, False, u, difference.own[:1], difference.later[:0], scratch, difference)
    if status == OK:
        carry_stages(taken[1], difference, tangents)
    return status
