"""Motion of one arm and the scratch of an integrator step: extrapolation table, matrices at the start of a step, error estimates."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import aligned_zeros
from soft_tendon_env.mechanics.algebra.linear import row_stride
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import ContactFlags, make_contact_flags
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import Bounded, Workspace, make_bounded, make_workspace, zeros_of


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


class Start(Struct):
    """Parts of the evaluation at the start of a step that effects with internal states need in every row; empty without any."""

    pose: np.ndarray
    xi: np.ndarray
    J: np.ndarray
    Phi: np.ndarray
    tension: np.ndarray


class Balance(Struct):
    """Forces and matrices of one substep."""

    mass: np.ndarray  # (n, n) M
    damping: np.ndarray  # (n, n) D and G with the effects' share
    stiffness: np.ndarray
    force: np.ndarray  # (n) drive - C v - D v + F
    drift: np.ndarray  # (n) the rate at which the force grows besides by the motion of the arm
    bounded: Bounded  # the tensions with bounds
    columns: np.ndarray  # (n_a, n) and their columns


class Scratch(Struct):
    """Arrays that a step fills: evaluations, extrapolation table, linear system, error estimates."""

    work: Workspace  # of the evaluations
    table_q: np.ndarray  # (columns, columns, n) extrapolation table
    table_v: np.ndarray
    table_state: np.ndarray  # (columns, columns, states)
    first: Balance  # at the start of the step
    now: Balance  # of the last evaluation, its arrays those of `work` and `force`
    rod_damping: np.ndarray  # (n, n) D and G at the start of the step without the effects' share
    rod_stiffness: np.ndarray
    held: np.ndarray  # (1) status of hold_bounds()
    jolted: np.ndarray  # (1) 1 where the step is one of first order, see complete_row(), else 0
    parts: np.ndarray  # (n_a) of the tensions with bounds, at the end of the first substep
    force: np.ndarray  # (n) drive - C v - D v + F of the last evaluation
    q_last: np.ndarray  # (n) where that was
    system: np.ndarray  # n rows, see linear
    delta: np.ndarray  # (n)
    ahead: np.ndarray  # (n) the rates that a substep ends with
    q: np.ndarray  # (n)
    v: np.ndarray  # (n)
    error_q: np.ndarray  # (n) estimated error of the step
    error_v: np.ndarray
    state: np.ndarray  # (states)
    longest: np.ndarray  # (1) [s] the longest step from the motion that effects allow
    contact: ContactFlags
    pose: np.ndarray  # nodes x 12, of the motion, and its base (24): where effects look at the way of the arm
    base: np.ndarray
    acting: np.ndarray  # (n_a) the command that has arrived
    until: np.ndarray  # (1) [s] when another one does
    rows: np.ndarray  # (1) rows of the table that the last step took
    taken: np.ndarray  # (steps, 2) room for a log of the accepted steps: length [s] and rows
    start: Start


def make_scratch(arm: Arm, columns: int, log: int = 0) -> Scratch:
    """Zeroed scratch for one arm and a method with this many columns, with room for a log of so many steps."""
    n, n_a, states, work = arm.strain.size, arm.tendons.size, arm.effects.state.size, make_workspace(arm)
    arrays = zeros_of(
        ((columns, columns, n), "table_q table_v"),
        ((columns, columns, states), "table_state"),
        ((n, n), "rod_damping rod_stiffness"),
        ((n,), "force q_last delta ahead q v error_q error_v"),
        ((n * row_stride(n + 1),), "system"),
        ((n_a,), "parts acting"),
        ((states,), "state"),
        ((1,), "held jolted until rows"),
        ((log, 2), "taken"),
        ((work.pose.size,), "pose"),
        ((work.base.size,), "base"),
    )
    kept = zeros_of(((n, n), "mass damping stiffness"), ((n,), "force drift"), ((n_a, n), "columns"))
    now = {"mass": work.M, "damping": work.D, "stiffness": work.G, "force": arrays["force"], "drift": work.drift}
    return Scratch(
        work=work,
        first=Balance(bounded=make_bounded(n_a), **kept),
        now=Balance(bounded=work.bounded, columns=work.tendon_columns, **now),
        start=Start(**{name: aligned_zeros(getattr(work, name).size if states else 0) for name in Start.__annotations__}),
        longest=np.full(1, np.inf),
        contact=make_contact_flags(),
        **arrays,
    )
