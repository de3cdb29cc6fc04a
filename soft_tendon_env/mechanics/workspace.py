"""Workspace of one evaluation: the arrays that the kernels write; layout and letters as in types.py."""

import math

import numpy as np

from soft_tendon_env.mechanics.algebra.lanes import LINE, aligned, aligned_zeros
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import BeforeStep, ContactFlags
from soft_tendon_env.mechanics.types import Arm, Explicit, FloatVector, Loaded

PER_LINE = LINE // 8  # numbers of a cache line


def zeros_of(*shapes: tuple[tuple[int, ...], str]) -> dict[str, np.ndarray]:
    """Zeros by name, each aligned to cache lines, for pairs of a shape and the names of all arrays that have it; in one piece of memory."""
    places, end = [], 0
    for shape, names in shapes:
        size = math.prod(shape)
        for name in names.split():
            places.append((name, end, size, shape))
            end += -(-size // PER_LINE) * PER_LINE
    memory = aligned_zeros(end)
    return {name: memory[begin : begin + size].reshape(shape) for name, begin, size, shape in places}


class LoadMemory(Struct):
    """Eliminated Hessian of the strain under dead loads, see load_hessian; all but empty for other strains."""

    e: FloatVector  # points x 6, the scaled strain
    step: FloatVector  # points x 6, residual of the balance and its correction
    inverse: np.ndarray  # (nodes, 12, 12) of the blocks on the diagonal: the two points of an interval have 12 unknowns
    turn: np.ndarray  # (nodes, 12, 3) turn of what is beyond by the unknowns, over the weight
    columns: np.ndarray  # (nodes, 12, 3) y of the unknowns
    answer: np.ndarray  # (nodes, 12, 3) unknowns by a turn of the interval's start


def make_load_memory(nodes: int) -> LoadMemory:
    """Zeroed LoadMemory for so many nodes."""
    return LoadMemory(**zeros_of(((12 * nodes,), "e step"), ((nodes, 12, 12), "inverse"), ((nodes, 12, 3), "turn columns answer")))


class Workspace(Struct):
    """Arrays that one evaluation fills. The kernels read what the same evaluation has written, and besides:

    xi, the guess from which the Newton of the statics-based strain starts; `clock`, `state`, `before` and `since`, when effects are
    evaluated and what was before; what make_workspace() fills and nothing writes: `unit`, `base` of an
    arm that stands still, Phi of explicit strains, which are their fields, and zeros: the columns Phi, Y and J in packs where their
    coordinate moves nothing, xi_bias of explicit strains, load without effects.
    """

    tau: FloatVector  # (n_a) tensions of the strain law [N]; of explicit strains those that pull
    tau_dot: FloatVector  # (n_a)
    Phi: FloatVector  # coordinate x points x 6
    Y: FloatVector  # coordinate x points x 6, wrenches of the coordinates times the weight, Phi^T Y = G
    mismatch: FloatVector  # points x 6, the stress that drives the coordinates, times the weight
    factor: FloatVector  # points x 21, L below the diagonal then 1 / D
    tangent: FloatVector  # tendon x points x 4, unit tangent t and 1 / |t_c|
    xi: FloatVector  # points x 6
    xi_dot: FloatVector  # points x 6
    xi_bias: FloatVector  # points x 6, the part of xi_ddot without q_ddot
    base: FloatVector  # 24: pose of the base, R rows and r; its twist and the rate of that, world frame, at the world's origin
    relative: FloatVector  # nodes x 12, exp(Omega) of each interval: R rows, r
    start: FloatVector  # nodes x 12, pose at the interval's start
    pose: FloatVector  # nodes x 12, pose at the interval's end
    J: FloatVector  # coordinate x nodes x 6
    carry: FloatVector  # (coordinate + 2) x 6, running sums of the sweep
    eta: FloatVector  # nodes x 6
    eta_bias: FloatVector  # nodes x 6, J_dot q_dot
    wrench: FloatVector  # nodes x 6
    node_stiffness: FloatVector  # nodes x 21, of the effects
    node_damping: FloatVector  # nodes x 21
    stress: FloatVector  # points x 6, of the effects
    point_stiffness: FloatVector  # points x 6
    point_damping: FloatVector  # points x 6
    state: FloatVector  # internal states of the effects
    before: FloatVector  # points x 6, the strain to which they belong; empty where no effect remembers it
    since: FloatVector  # (1) time since then [s]
    clock: FloatVector  # (1) time [s]
    before_step: BeforeStep
    contact: ContactFlags
    beside_pose: FloatVector  # nodes x 12, where effects are differentiated
    beside_twist: FloatVector  # nodes x 6
    beside_wrench: FloatVector  # nodes x 6
    here_wrench: FloatVector  # nodes x 6, that of one effect
    loaded: FloatVector  # coordinate x nodes x 6, node stiffness times J
    extra: np.ndarray  # (n, n) share of the effects in D or G
    unit: FloatVector  # points x 6, ones
    M: np.ndarray  # (n, n)
    D: np.ndarray  # (n, n)
    G: np.ndarray  # (n, n)
    bias: FloatVector  # (n) C q_dot
    drive: FloatVector  # (n) B u - K - D q_dot
    u_is_command: FloatVector  # (1) 1 where u is a command, 0 where it is the tensions
    tension: FloatVector  # (n_a) [N] that come of a command, where effects are between
    shortening: FloatVector  # (n_a) [m] of elastic tendons beside the stress-free rod
    pull_rate: FloatVector  # (n_a) [m/s] at which tendons that rub are pulled in
    grip: FloatVector  # (n_a) [N] the derivative of friction by the direction of sliding, for a tendon as a whole
    columns: np.ndarray  # (n_a, n) B_i of tendons that are elastic or rub
    rubbed: np.ndarray  # (n_a, n) the same, with what friction leaves of the tension
    rubbing: np.ndarray  # (n_a, n) -d force / d direction of sliding
    share: FloatVector  # tendon x points, of the tension
    slip: FloatVector  # tendon x points, -d share / d direction of sliding
    load: FloatVector  # (n) F
    under_loads: LoadMemory  # of a strain with loads inside


def make_workspace(arm: Arm) -> Workspace:
    """Zeroed Workspace for one arm."""
    strain, n, n_a, nodes = arm.strain, arm.strain.size, arm.tendons.size, arm.rod.length.size
    points = 2 * nodes
    arrays = zeros_of(
        ((1,), "clock since u_is_command"),
        ((n_a,), "tau tau_dot tension shortening pull_rate grip"),
        ((n,), "bias drive load"),
        ((n, n), "M D G extra"),
        ((n_a, n), "columns rubbed rubbing"),
        ((points * 6,), "mismatch xi xi_dot xi_bias stress point_stiffness point_damping"),
        ((points * 21,), "factor"),
        ((n_a * points * 4,), "tangent"),
        ((n * points * 6,), "Y"),
        ((nodes * 6,), "eta eta_bias wrench beside_twist beside_wrench here_wrench"),
        ((nodes * 12,), "relative start pose beside_pose"),
        ((nodes * 21,), "node_stiffness node_damping"),
        ((n * nodes * 6,), "J loaded"),
        (((n + 2) * 6,), "carry"),
    )
    return Workspace(
        **arrays,
        Phi=strain.field if isinstance(strain, Explicit) else aligned_zeros(n * points * 6),
        base=np.concatenate([np.eye(3).ravel(), np.zeros(15)]),
        state=arm.effects.state.copy(),
        before_step=BeforeStep(np.zeros(1), np.zeros(12 * nodes), np.zeros(24)),
        contact=ContactFlags(np.zeros(1), np.zeros(1), np.zeros(1)),
        unit=aligned(np.ones(points * 6)),
        share=aligned(np.ones(n_a * points)),
        slip=aligned_zeros(n_a * points),
        before=aligned_zeros(6 * points if arm.effects.remembers else 0),
        under_loads=make_load_memory(nodes if isinstance(strain, Loaded) else 0),
    )
