"""Motion of one arm and the scratch of an integrator step: extrapolation table, matrices at the start of a step, error estimates."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, row_stride
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import Workspace, make_workspace, zeros_of


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
    """Forces and matrices of one substep; behind the force what is of elastic tendons, and of those that rub."""

    mass: np.ndarray  # (n, n) M
    damping: np.ndarray  # (n, n) D and G with the effects' share
    stiffness: np.ndarray
    force: np.ndarray  # (n) drive - C v - D v + F
    tension: np.ndarray  # (n_a) [N] in the force
    shortening: np.ndarray  # (n_a) [m]
    columns: np.ndarray  # (n_a, n) see Workspace
    rubbed: np.ndarray  # (n_a, n)
    rubbing: np.ndarray  # (n_a, n)
    pull_rate: np.ndarray  # (n_a) [m/s]


class Held(Struct):
    """Scratch of stretch_tendons() and slide_tendons(): tendons at the end of a substep."""

    tension: np.ndarray  # (n_a) [N], the solution
    least: np.ndarray  # (n_a) [N], zeros
    wanted: np.ndarray  # (n_a)
    part: np.ndarray  # (n_a) -1 slack, 0 between, 1 as tense as can be
    parts: np.ndarray  # (n_a) likewise in the first substep of the step
    answer: np.ndarray  # (n_a, n) change of rates by a newton
    rate: np.ndarray  # (n_a) [m/s] at which they are pulled in
    better: np.ndarray  # (n_a) likewise
    matrix: np.ndarray  # (n_a, n_a)
    give: np.ndarray  # (n_a, n_a)
    system: np.ndarray  # (n_a, n_a + 1)


class Scratch(Struct):
    """Arrays that a step fills: evaluations, extrapolation table, linear system, error estimates."""

    work: Workspace  # of the evaluations
    table_q: np.ndarray  # (columns, columns, n) extrapolation table
    table_v: np.ndarray
    first: Balance  # at the start of the step
    now: Balance  # of the last evaluation, its arrays those of `work` and `force`
    rod_damping: np.ndarray  # (n, n) D and G at the start of the step without the effects' share
    rod_stiffness: np.ndarray
    held: Held
    kinked: np.ndarray  # (1) 1 where elastic tendons become slack, taut or as tense as can be within the step, else 0
    force: np.ndarray  # (n) drive - C v - D v + F of the last evaluation
    q_last: np.ndarray  # (n) where that was
    system: np.ndarray  # n rows, see linear
    delta: np.ndarray  # (n)
    q: np.ndarray  # (n)
    v: np.ndarray  # (n)
    error_q: np.ndarray  # (n) estimated error of the step
    error_v: np.ndarray
    longest: np.ndarray  # (1) [s] the longest step from the motion that effects allow
    acting: np.ndarray  # (n_a) the command that has arrived
    command: np.ndarray  # (n_a) what acts of it
    until: np.ndarray  # (1) [s] when another one does
    rows: np.ndarray  # (1) rows of the table that the last step took
    taken: np.ndarray  # (steps, 2) room for a log of the accepted steps: length [s] and rows


def make_scratch(arm: Arm, columns: int, log: int = 0) -> Scratch:
    """Zeroed scratch for one arm and a method with this many columns, with room for a log of so many steps."""
    n, n_a, work = arm.strain.size, arm.tendons.size, make_workspace(arm)
    arrays = zeros_of(
        ((columns, columns, n), "table_q table_v"),
        ((n, n), "rod_damping rod_stiffness"),
        ((n,), "force q_last delta q v error_q error_v"),
        ((n * row_stride(n + 1),), "system"),
        ((n_a,), "acting command"),
        ((1,), "kinked until rows"),
        ((log, 2), "taken"),
    )
    held = zeros_of(
        ((n_a,), "tension least wanted part parts rate better"),
        ((n_a, n), "answer"),
        ((n_a, n_a), "matrix give"),
        ((n_a, n_a + 1), "system"),
    )
    kept = zeros_of(
        ((n, n), "mass damping stiffness"),
        ((n,), "force"),
        ((n_a,), "tension shortening pull_rate"),
        ((n_a, n), "columns rubbed rubbing"),
    )
    same = {name: getattr(work, name) for name in ("tension", "shortening", "pull_rate", "columns", "rubbed", "rubbing")}
    return Scratch(
        work=work,
        first=Balance(**kept),
        now=Balance(mass=work.M, damping=work.D, stiffness=work.G, force=arrays["force"], **same),
        held=Held(**held),
        longest=np.full(1, np.inf),
        **arrays,
    )
