"""Motion of one arm; scratch of an integrator step: extrapolation table, matrices, error estimates;
tape of a period over rows: where every part of it began, for the adjoint to go back from."""

from typing import Annotated, NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, row_stride
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import IntArray
from soft_tendon_env.mechanics.terms.command_filter import Arrival
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import (
    Borders,
    Matrices,
    TendonForces,
    Workspace,
    make_workspace,
    sizes_of,
    zeros,
)


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
    """Forces and matrices of one substep, with the effects' share."""

    matrices: Matrices
    force: Annotated[np.ndarray, "n"]  # drive - C v + F
    tendons: TendonForces  # those in the force, of tendons that are elastic or rub
    borders: Borders  # of tendons that rub


class TendonEnds(Struct):
    """Scratch of stretch_tendons() and slide_tendons(): elastic tendons at the end of a substep."""

    tension: Annotated[np.ndarray, "n_a"]  # [N], the solution
    rate: Annotated[np.ndarray, "n_a"]  # [m/s] at which they are pulled in
    change: Annotated[np.ndarray, "n_a"]  # of the forces, by the end of the substep
    part: Annotated[IntArray, "n_a"]  # of their tension, see solve_bounded()
    first_part: Annotated[IntArray, "n_a"]  # likewise, in the first substep of the step
    least: Annotated[np.ndarray, "n_a"]  # [N], zeros
    answer: Annotated[np.ndarray, "n_a", "n"]  # change of rates by a newton
    give: Annotated[np.ndarray, "n_a", "n_a"]  # change of the pulling in by a newton
    matrix: Annotated[np.ndarray, "n_a", "n_a"]
    right: Annotated[np.ndarray, "n_a"]  # right-hand side
    system: Annotated[np.ndarray, "n_a", "n_a + 1"]


class Sliding(Struct):
    """Scratch of slide_tendons(): tendons that rub, at their borders, at the end of a substep.

    Rows are filled up to whole packs.
    """

    status: Annotated[IntArray, "1"]
    tension: Annotated[np.ndarray, "n_a"]  # [N] at the actuators
    direction: Annotated[np.ndarray, "n_a x points"]  # z, an unknown of its own
    rate: Annotated[np.ndarray, "n_a x points"]  # [m/s] that slides
    lead: Annotated[np.ndarray, "n_a x points"]  # z of that rate
    inverse: Annotated[np.ndarray, "n_a x points"]  # z by that rate [s/m]
    slope: Annotated[np.ndarray, "n_a x points"]  # change of z by the rate [s/m], where it sticks
    # at the beginning of the step, and how much logarithms of tensions have changed since by that
    direction_before: Annotated[np.ndarray, "n_a x points"]
    turned: Annotated[np.ndarray, "1"]
    change: Annotated[np.ndarray, "row"]  # of the rates v by a Newton step
    left: Annotated[np.ndarray, "n_a x points"]  # what the share of a tension gains there
    fall: Annotated[np.ndarray, "n_a x points"]  # likewise, by the rates to first order
    # places of one tendon that stick, and what each of them changes from there on
    sticking: Annotated[IntArray, "points"]
    pulled: Annotated[np.ndarray, "row"]
    pulls: Annotated[np.ndarray, "points x row"]
    acceleration: Annotated[np.ndarray, "n"]  # in the substep before; 0 in the first of a step
    factors: Annotated[np.ndarray, "n x stride"]  # of scratch.system, see linear
    # right-hand sides and solutions: of the change, and of a newton in each elastic tendon
    sides: Annotated[np.ndarray, "n_a + 1", "row"]
    # rows of n coefficients, the right-hand side, and one for each tendon; filled up with rows
    system: Annotated[np.ndarray, "row x wide"]


SMOOTH = 0
KINKED = 1
"""Whether elastic tendons become slack, taut or as tense as can be within a step."""


class Scratch(Struct):
    """Arrays that a step fills: evaluations, extrapolation table, linear system, error
    estimates."""

    work: Workspace  # of the evaluations
    # commands: what has arrived, and what of it acts
    arrival: Arrival
    acting: Annotated[np.ndarray, "n_a"]
    # evaluations: at the start of the step, and the last one, whose matrices are those of `work`
    first: Balance
    now: Balance
    q_last: Annotated[np.ndarray, "n"]  # where the last one was
    # D and G at the start of the step without the effects' share
    rod_damping: Annotated[np.ndarray, "n", "n"]
    rod_stiffness: Annotated[np.ndarray, "n", "n"]
    # substeps
    q: Annotated[np.ndarray, "n"]
    v: Annotated[np.ndarray, "n"]
    delta: Annotated[np.ndarray, "n"]  # change of v
    system: Annotated[np.ndarray, "n x stride"]  # see linear
    ends: TendonEnds
    sliding: Sliding
    kink: Annotated[IntArray, "1"]  # SMOOTH or KINKED
    # extrapolation
    table_q: Annotated[np.ndarray, "orders", "orders", "n"]
    table_v: Annotated[np.ndarray, "orders", "orders", "n"]
    error_q: Annotated[np.ndarray, "n"]  # estimated error of the step
    error_v: Annotated[np.ndarray, "n"]
    # steps
    longest: Annotated[np.ndarray, "1"]  # [s] the longest step from the motion that effects allow
    # room for a log of the accepted steps: length [s] and rows of the table
    taken: Annotated[np.ndarray, "steps", "2"]


def make_scratch(arm: Arm, columns: int, log: int = 0) -> Scratch:
    """Zeroed scratch for one arm and a method with this many columns, with room for a log of so
    many steps."""
    sizes = sizes_of(arm)
    sizes["orders"] = columns
    sizes["stride"] = row_stride(arm.strain.size + 1)
    sizes["steps"] = log
    sizes["n_a + 1"] = arm.tendons.size + 1
    sizes["wide"] = row_stride(arm.strain.size + 1 + arm.tendons.size)
    work = make_workspace(arm)
    now = zeros(Balance, sizes, matrices=work.matrices, tendons=work.tendons)
    return zeros(Scratch, sizes, work=work, now=now)


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
    # 1 where the command began with the part, 0 where it went on
    begins: Annotated[IntArray, "rows", "parts"]
    # which of the materials that a row has had it was
    material: Annotated[IntArray, "rows"]


def make_tape(arm: Arm, rows: int, parts: int) -> Tape:
    """Zeroed Tape for so many rows of an arm and parts of a period."""
    sizes = sizes_of(arm)
    sizes["rows"] = rows
    sizes["parts"] = parts
    sizes["borders"] = parts + 1
    return zeros(Tape, sizes)


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
