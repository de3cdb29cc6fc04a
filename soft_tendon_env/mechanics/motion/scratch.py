"""Motion of one arm and the scratch of an integrator step: extrapolation table, matrices at the start of a step, error estimates."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import aligned_zeros
from soft_tendon_env.mechanics.algebra.linear import row_stride
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import Bounded, Workspace, make_bounded, make_workspace


class Motion(NamedTuple):
    """Coordinates, rates, strain and effects' states of one arm, which a step advances in place."""

    q: np.ndarray  # (n)
    q_dot: np.ndarray  # (n)
    xi: np.ndarray  # points x 6, the strain at q, from which the next Newton starts
    state: np.ndarray  # internal states of the effects
    clock: np.ndarray  # (1) time [s]


class Start(Struct):
    """The evaluation at the start of a step, as far as effects with internal states need it in every row; empty without any."""

    pose: np.ndarray
    xi: np.ndarray
    J: np.ndarray
    Phi: np.ndarray
    tension: np.ndarray


class Scratch(Struct):
    """Scratch of the steps."""

    work: Workspace  # of the evaluations
    table_q: np.ndarray  # (columns, columns, n) extrapolation table
    table_v: np.ndarray
    table_state: np.ndarray  # (columns, columns, states)
    mass: np.ndarray  # (n, n) M, D, G and the force at the start of the step
    damping: np.ndarray
    stiffness: np.ndarray
    rod_damping: np.ndarray  # (n, n) D and G there without the effects' share
    rod_stiffness: np.ndarray
    start_force: np.ndarray  # (n)
    start_drift: np.ndarray  # (n)
    start_bounded: Bounded  # the tensions with bounds there
    start_columns: np.ndarray  # (n_a, n) and their columns
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
    meeting: np.ndarray  # (2) 1 where the step went through something, else 0; 1 where it ends touching something or about to
    pose: np.ndarray  # nodes x 12, of the motion, and its base (24): where effects look at the way of the arm
    base: np.ndarray
    acting: np.ndarray  # (n_a) the command that has arrived
    until: np.ndarray  # (1) [s] when another one does
    start: Start


def make_scratch(arm: Arm, columns: int) -> Scratch:
    """Zeroed scratch for one arm and a method with this many columns."""
    n, states, work = arm.strain.size, arm.effects.state.size, make_workspace(arm)
    zeros = aligned_zeros
    return Scratch(
        work=work,
        table_q=zeros(columns, columns, n),
        table_v=zeros(columns, columns, n),
        table_state=zeros(columns, columns, states),
        mass=zeros(n, n),
        damping=zeros(n, n),
        stiffness=zeros(n, n),
        rod_damping=zeros(n, n),
        rod_stiffness=zeros(n, n),
        start_force=zeros(n),
        start_drift=zeros(n),
        start_bounded=make_bounded(arm.tendons.size),
        start_columns=zeros(arm.tendons.size, n),
        held=zeros(1),
        jolted=zeros(1),
        parts=zeros(arm.tendons.size),
        force=zeros(n),
        q_last=zeros(n),
        system=zeros(n * row_stride(n + 1)),
        delta=zeros(n),
        ahead=zeros(n),
        q=zeros(n),
        v=zeros(n),
        state=zeros(states),
        longest=np.full(1, np.inf),
        meeting=zeros(2),
        pose=zeros(work.pose.size),
        base=zeros(work.base.size),
        error_q=zeros(n),
        error_v=zeros(n),
        acting=zeros(arm.tendons.size),
        until=zeros(1),
        start=Start(**{name: zeros(getattr(work, name).size if states else 0) for name in ("pose", "xi", "J", "Phi", "tension")}),
    )
