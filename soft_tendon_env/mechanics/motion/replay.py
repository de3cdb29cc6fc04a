"""Repetition of a motion with its steps as they were taken: lengths, columns and kept entries are those of a log, whatever the errors.

The end of such a motion is a smooth function of where it begins, of its commands and of the arm's parameters, which can be differentiated.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.motion.advance import accept
from soft_tendon_env.mechanics.motion.extrapolation import fill_row, keep_first_entry, substeps
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE, predict_strain
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess
from soft_tendon_env.mechanics.terms.transmission import delivered


@kernel
def replay(arm, method, taken, commands, motion, scratch):
    """Repeat a motion in place under its commands (rows, n_a), step by step as in a log (steps, 4), see Scratch.taken; a status."""
    for k in range(taken.shape[0]):
        u = delivered(arm.effects, commands[int(taken[k, 0])], motion.clock[0], motion.state, scratch.acting, scratch.until)
        status = repeat_extrapolated_step(arm, method, u, motion, taken[k], scratch)
        if status == OK:
            status = end_step(arm, motion, scratch)
        if status != OK:
            return status
        motion.clock[0] += taken[k, 1]
    return OK


@kernel
def end_step(arm, motion, scratch):
    """Takes the end of a step, with its strain; a status."""
    predict_strain(arm.strain, scratch.q, scratch.q_last, scratch.work)
    if strain_from_guess(arm, scratch.q, STEP_TOLERANCE, scratch.work) >= 0:
        return NO_STRAIN
    accept(motion, scratch)
    return OK


@kernel
def repeat_extrapolated_step(arm, method, u, motion, taken, scratch):
    """One extrapolated step with as many columns, and the entry of the table, that it took."""
    columns = int(taken[2])
    copy(motion.xi, scratch.work.xi)
    for row in range(columns):
        status, _ = substeps(arm, method, 0.0, u, motion, taken[1], row, scratch)
        if status != OK:
            return status
        fill_row(row, scratch)
    if taken[3] != 0.0:
        keep_first_entry(columns - 1, scratch)
    return OK
