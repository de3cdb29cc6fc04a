"""Tape of a period over rows: where every part of it began, for the adjoint to go back from."""

from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.scratch import Motion, copy_motion
from soft_tendon_env.mechanics.types import Arm, IntVector
from soft_tendon_env.mechanics.workspace import sizes_of, zeros


class Tape(Struct):
    """Motion of every row where the parts of a period began, and where the last one ended; without rows nothing is kept."""

    q: Annotated[np.ndarray, "rows", "borders", "n"]
    q_dot: Annotated[np.ndarray, "rows", "borders", "n"]
    xi: Annotated[np.ndarray, "rows", "borders", "points x 6"]
    state: Annotated[np.ndarray, "rows", "borders", "states"]
    clock: Annotated[np.ndarray, "rows", "borders"]
    command: Annotated[np.ndarray, "rows", "parts", "n_a"]
    duration: Annotated[np.ndarray, "rows", "parts"]  # [s]; negative where the step has failed
    begins: np.ndarray  # (rows, parts) int64: 1 where the command began with the part, 0 where it went on
    material: IntVector  # (rows) which of the materials that a row has had it was


def make_tape(arm: Arm, rows: int, parts: int) -> Tape:
    """Zeroed Tape for so many rows of an arm and parts of a period."""
    sizes = {**sizes_of(arm), "rows": rows, "parts": parts, "borders": parts + 1}
    return zeros(Tape, sizes, begins=np.zeros((rows, parts), dtype=np.int64), material=np.zeros(rows, dtype=np.int64))


@kernel(refcount=True)
def motion_at(tape, row, border):
    """Motion of a row on the tape where a part begins, or the last one ends."""
    own = row, border
    return Motion(tape.q[own], tape.q_dot[own], tape.xi[own], tape.state[own], tape.clock[row, border : border + 1])


@kernel
def tape_border(tape, row, border, motion):
    """Keeps a motion as that at a border between parts, where anything is kept."""
    if tape.duration.shape[0] > 0:
        copy_motion(motion, motion_at(tape, row, border))


@kernel
def tape_part(tape, row, part, command, duration, begins):
    """Keeps what was commanded in a part, for how long, and whether it began there, where anything is kept."""
    if tape.duration.shape[0] > 0:
        copy(command, tape.command[row, part])
        tape.duration[row, part] = duration
        tape.begins[row, part] = 1 if begins else 0
