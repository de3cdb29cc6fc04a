"""Motion of one arm; scratch of an integrator step: extrapolation table, matrices, error estimates;
tape of a period over rows: where every part of it began, for the adjoint to go back from."""

from typing import Annotated, NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import aligned_zeros
from soft_tendon_env.mechanics.algebra.linear import copy, row_stride
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm, IntVector
from soft_tendon_env.mechanics.workspace import Workspace, make_workspace, sizes_of, zeros


class Motion(NamedTuple):
    """Coordinates, rates, strain and effects' states of one arm, which a step advances in place."""

    q: np.ndarray  # (n)
    q_dot: np.ndarray  # (n)
    xi: np.ndarray  # points x 6, the strain at q, from which the next Newton starts
    state: np.ndarray  # internal states of the effects
    clock: np.ndarray  # (1) time [s]

    def copy(self) -> "Motion":
        """A motion of its own, at the same place."""
        return Motion(*(part.copy() for part in self))


@kernel
def copy_motion(source, out):
    """Copies a motion into another one."""
    copy(source.q, out.q)
    copy(source.q_dot, out.q_dot)
    copy(source.xi, out.xi)
    copy(source.state, out.state)
    copy(source.clock, out.clock)


class Balance(Struct):
    """Forces and matrices of one substep; behind the force what is of elastic tendons, and of those
    that rub, see Workspace."""

    mass: Annotated[np.ndarray, "n", "n"]  # M
    damping: Annotated[np.ndarray, "n", "n"]  # D and G with the effects' share
    stiffness: Annotated[np.ndarray, "n", "n"]
    force: Annotated[np.ndarray, "n"]  # drive - C v - D v + F
    tension: Annotated[np.ndarray, "n_a"]  # [N] in the force
    shortening: Annotated[np.ndarray, "n_a"]  # [m]
    pull_rate: Annotated[np.ndarray, "n_a"]  # [m/s]
    columns: Annotated[np.ndarray, "n_a", "n"]
    rubbed: Annotated[np.ndarray, "n_a", "n"]
    rubbing: Annotated[np.ndarray, "n_a", "n"]


class TendonEnds(Struct):
    """Scratch of stretch_tendons() and slide_tendons(): tendons at the end of a substep."""

    tension: Annotated[np.ndarray, "n_a"]  # [N], the solution
    least: Annotated[np.ndarray, "n_a"]  # [N], zeros
    wanted: Annotated[np.ndarray, "n_a"]
    part: Annotated[np.ndarray, "n_a"]  # -1 slack, 0 between, 1 as tense as can be
    parts: Annotated[np.ndarray, "n_a"]  # likewise in the first substep of the step
    answer: Annotated[np.ndarray, "n_a", "n"]  # change of rates by a newton
    rate: Annotated[np.ndarray, "n_a"]  # [m/s] at which they are pulled in
    better: Annotated[np.ndarray, "n_a"]  # likewise
    matrix: Annotated[np.ndarray, "n_a", "n_a"]
    give: Annotated[np.ndarray, "n_a", "n_a"]
    system: Annotated[np.ndarray, "n_a", "unknowns"]


class Scratch(Struct):
    """Arrays that a step fills: evaluations, extrapolation table, linear system, error
    estimates."""

    work: Workspace  # of the evaluations
    table_q: Annotated[np.ndarray, "orders", "orders", "n"]  # extrapolation table
    table_v: Annotated[np.ndarray, "orders", "orders", "n"]
    first: Balance  # at the start of the step
    now: Balance  # of the last evaluation, its arrays those of `work` and `force`
    rod_damping: Annotated[
        np.ndarray, "n", "n"
    ]  # D and G at the start of the step without the effects' share
    rod_stiffness: Annotated[np.ndarray, "n", "n"]
    ends: TendonEnds
    is_kinked: Annotated[
        np.ndarray, "1"
    ]  # 1 where elastic tendons become slack, taut or as tense as can be within the step, else 0
    force: Annotated[np.ndarray, "n"]  # drive - C v - D v + F of the last evaluation
    q_last: Annotated[np.ndarray, "n"]  # where that was
    system: Annotated[np.ndarray, "n x stride"]  # see linear
    delta: Annotated[np.ndarray, "n"]
    q: Annotated[np.ndarray, "n"]
    v: Annotated[np.ndarray, "n"]
    error_q: Annotated[np.ndarray, "n"]  # estimated error of the step
    error_v: Annotated[np.ndarray, "n"]
    longest: Annotated[np.ndarray, "1"]  # [s] the longest step from the motion that effects allow
    acting: Annotated[np.ndarray, "n_a"]  # the command that has arrived
    command: Annotated[np.ndarray, "n_a"]  # what acts of it
    until: Annotated[np.ndarray, "1"]  # [s] when another one does
    taken: Annotated[
        np.ndarray, "steps", "2"
    ]  # room for a log of the accepted steps: length [s] and rows of the table


def make_scratch(arm: Arm, columns: int, log: int = 0) -> Scratch:
    """Zeroed scratch for one arm and a method with this many columns, with room for a log of so
    many steps."""
    sizes, work = sizes_of(arm), make_workspace(arm)
    sizes |= {
        "orders": columns,
        "stride": row_stride(arm.strain.size + 1),
        "steps": log,
        "unknowns": arm.tendons.size + 1,
    }
    shared = {
        name: getattr(work, name)
        for name in ("tension", "shortening", "pull_rate", "columns", "rubbed", "rubbing")
    }
    force = aligned_zeros(arm.strain.size)
    now = Balance(mass=work.M, damping=work.D, stiffness=work.G, force=force, **shared)
    return zeros(
        Scratch,
        sizes,
        work=work,
        first=zeros(Balance, sizes),
        now=now,
        ends=zeros(TendonEnds, sizes),
        force=force,
    )


class Tape(Struct):
    """Motion of every row where the parts of a period began, and where the last one ended; without
    rows nothing is kept."""

    q: Annotated[np.ndarray, "rows", "borders", "n"]
    q_dot: Annotated[np.ndarray, "rows", "borders", "n"]
    xi: Annotated[np.ndarray, "rows", "borders", "points x 6"]
    state: Annotated[np.ndarray, "rows", "borders", "states"]
    clock: Annotated[np.ndarray, "rows", "borders"]
    command: Annotated[np.ndarray, "rows", "parts", "n_a"]
    duration: Annotated[np.ndarray, "rows", "parts"]  # [s]; negative where the step has failed
    begins: (
        np.ndarray
    )  # (rows, parts) int64: 1 where the command began with the part, 0 where it went on
    material: IntVector  # (rows) which of the materials that a row has had it was


def make_tape(arm: Arm, rows: int, parts: int) -> Tape:
    """Zeroed Tape for so many rows of an arm and parts of a period."""
    sizes = {**sizes_of(arm), "rows": rows, "parts": parts, "borders": parts + 1}
    return zeros(
        Tape,
        sizes,
        begins=np.zeros((rows, parts), dtype=np.int64),
        material=np.zeros(rows, dtype=np.int64),
    )


@kernel(refcount=True)
def motion_at(tape, row, border):
    """Motion of a row on the tape where a part begins, or the last one ends."""
    place = row, border
    return Motion(
        tape.q[place],
        tape.q_dot[place],
        tape.xi[place],
        tape.state[place],
        tape.clock[row, border : border + 1],
    )


@kernel
def tape_border(tape, row, border, motion):
    """Keeps a motion as that at a border between parts, where anything is kept."""
    if tape.duration.shape[0] > 0:
        copy_motion(motion, motion_at(tape, row, border))


@kernel
def tape_part(tape, row, part, command, duration, begins):
    """Keeps what was commanded in a part, for how long, and whether it began there, where anything
    is kept."""
    if tape.duration.shape[0] > 0:
        copy(command, tape.command[row, part])
        tape.duration[row, part] = duration
        tape.begins[row, part] = 1 if begins else 0
